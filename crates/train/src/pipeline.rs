//! `Pipeline`: a whole experiment as one RON value, and the patches that change it.

use crate::settings::{Training, TrainingPatch};
use pwrfgs_core::plugin::{Checked, Plugin, default_of, read_ron, ron_options};
use pwrfgs_core::{
    Baseline, DataSource, Deformation, Error, Initializer, Metric, Projector, Pruner, Rasterizer, Result, Split,
};
use pwrfgs_model::{Calibration, Readout};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Everything a run needs to know. Plugins are named in the words of the registry; plain settings are nested structs. A
/// field that is left out takes what the program that links the plugins has submitted for it
/// ([`FieldDefault`](pwrfgs_core::plugin::FieldDefault)); name, data and initializer have no default.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(try_from = "PipelineFields<Checked<Training>>")]
pub struct Pipeline {
    /// Names the run folder: letters, digits, `.`, `-` and `_`.
    pub name: String,
    /// The one seed that decides everything.
    pub seed: u64,
    /// Where the spectra come from.
    pub data: Plugin<dyn DataSource>,
    /// Training, validation and test.
    pub split: Plugin<dyn Split>,
    /// Where the Gaussians start.
    pub initializer: Plugin<dyn Initializer>,
    /// From space to the picture.
    pub projector: Plugin<dyn Projector>,
    /// From splats to pixels.
    pub rasterizer: Plugin<dyn Rasterizer>,
    /// What the transmitter changes.
    pub deformation: Plugin<dyn Deformation>,
    /// How calibration terms meet the base parameters.
    pub calibration: Calibration,
    /// From blended signals to a spectrum.
    pub readout: Readout,
    /// Who decides which Gaussians stay; all must agree.
    pub pruners: Vec<Plugin<dyn Pruner>>,
    /// Algorithm 1.
    pub training: Checked<Training>,
    /// Scored beside the model.
    pub baselines: Vec<Plugin<dyn Baseline>>,
    /// How all are scored.
    pub metrics: Vec<Plugin<dyn Metric>>,
    /// Whether the run folder gets an event file that TensorBoard opens.
    pub tensorboard: bool,
}

/// The fields of a [`Pipeline`], each of which may be left out.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename = "Pipeline", deny_unknown_fields)]
#[allow(missing_docs)] // each field means what it means in `Pipeline`
pub struct PipelineFields<T> {
    /// What a sweep calls this patch; changes nothing.
    pub label: Option<String>,
    pub name: Option<String>,
    pub seed: Option<u64>,
    pub data: Option<Plugin<dyn DataSource>>,
    pub split: Option<Plugin<dyn Split>>,
    pub initializer: Option<Plugin<dyn Initializer>>,
    pub projector: Option<Plugin<dyn Projector>>,
    pub rasterizer: Option<Plugin<dyn Rasterizer>>,
    pub deformation: Option<Plugin<dyn Deformation>>,
    pub calibration: Option<Calibration>,
    pub readout: Option<Readout>,
    pub pruners: Option<Vec<Plugin<dyn Pruner>>>,
    pub training: Option<T>,
    pub baselines: Option<Vec<Plugin<dyn Baseline>>>,
    pub metrics: Option<Vec<Plugin<dyn Metric>>>,
    pub tensorboard: Option<bool>,
}

/// A patch over a [`Pipeline`]: fields left out keep their value, plugins are replaced whole.
pub type PipelinePatch = PipelineFields<TrainingPatch>;

impl TryFrom<PipelineFields<Checked<Training>>> for Pipeline {
    type Error = String;

    fn try_from(given: PipelineFields<Checked<Training>>) -> Result<Self, String> {
        fn or_default<T: DeserializeOwned>(field: &str, given: Option<T>) -> Result<T, String> {
            given.map_or_else(|| default_of(field), Ok)
        }
        let missing = |field: &str| format!("the field `{field}` is missing");
        if given.label.is_some() {
            return Err("only a variant of a sweep has a `label`".into());
        }
        Ok(Self {
            name: given.name.ok_or_else(|| missing("name"))?,
            seed: given.seed.unwrap_or_default(),
            data: given.data.ok_or_else(|| missing("data"))?,
            split: or_default("split", given.split)?,
            initializer: given.initializer.ok_or_else(|| missing("initializer"))?,
            projector: or_default("projector", given.projector)?,
            rasterizer: or_default("rasterizer", given.rasterizer)?,
            deformation: or_default("deformation", given.deformation)?,
            calibration: given.calibration.unwrap_or_default(),
            readout: given.readout.unwrap_or_default(),
            pruners: given.pruners.unwrap_or_default(),
            training: given.training.unwrap_or_default(),
            baselines: or_default("baselines", given.baselines)?,
            metrics: or_default("metrics", given.metrics)?,
            tensorboard: given.tensorboard.unwrap_or_default(),
        })
    }
}

impl Pipeline {
    /// Reads a pipeline; `path` is for messages only.
    ///
    /// # Errors
    /// [`Error::Input`] with line and column.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let pipeline: Self = read_ron(text, path)?;
        pipeline.check().map_err(Error::Config)?;
        Ok(pipeline)
    }

    /// The pipeline as RON text, every default written out; [`Self::parse`] gives the same pipeline back.
    ///
    /// Where a plugin of somebody else cannot be written, a comment says so; [`Self::check_text`] finds that out before.
    pub fn to_ron(&self) -> String {
        self.text().unwrap_or_else(|why| format!("// {why}")) + "\n"
    }

    /// Refuses a pipeline that [`Self::to_ron`] cannot write.
    ///
    /// # Errors
    /// [`Error::Config`] that says why.
    pub fn check_text(&self) -> Result<()> {
        self.text().map(|_| ()).map_err(Error::Config)
    }

    fn text(&self) -> Result<String, String> {
        let config = ron::ser::PrettyConfig::new().struct_names(true).depth_limit(6);
        let why = "this pipeline cannot be written (paths of plugins need `serde(with = \"pwrfgs_core::paths\")`)";
        ron_options().to_string_pretty(self, config).map_err(|e| format!("{why}: {e}"))
    }

    /// Takes over what the patch names.
    ///
    /// # Errors
    /// [`Error::Config`] where the outcome cannot work.
    pub fn apply(&mut self, patch: PipelinePatch) -> Result<()> {
        macro_rules! take {
            ($($field:ident),*) => { $(if let Some(value) = patch.$field { self.$field = value; })* };
        }
        take!(name, seed, data, split, initializer, projector, rasterizer, deformation, calibration, readout, pruners);
        take!(baselines, metrics, tensorboard);
        if let Some(patch) = patch.training {
            let mut training = Training::clone(&self.training);
            training.apply(patch);
            self.training = Checked::new(training).map_err(|why| Error::Config(format!("training: {why}")))?;
        }
        self.check().map_err(Error::Config)
    }

    /// Applies one `--set` argument, such as `training.steps=1000` or `data=Teacher()`.
    ///
    /// # Errors
    /// [`Error::Config`] naming the argument.
    pub fn set(&mut self, argument: &str) -> Result<()> {
        let (path, value) = argument
            .split_once('=')
            .ok_or_else(|| Error::Config(format!("--set {argument}: write it as path.to.field=value")))?;
        let mut text = value.trim().to_owned();
        for field in path.trim().rsplit('.') {
            text = format!("({field}:{text})");
        }
        let patch: PipelinePatch = read_ron(&text, Path::new("--set")).map_err(|e| match e {
            // The position would count inside the patch we wrapped around the argument: leave it out.
            Error::Input { message, .. } => Error::Config(format!("--set {argument}: {message}")),
            other => other,
        })?;
        if patch.label.is_some() {
            return Err(Error::Config(format!("--set {argument}: only a variant of a sweep has a label")));
        }
        self.apply(patch)
    }

    /// What plugins cannot see of each other.
    fn check(&self) -> Result<(), String> {
        let good = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(good) {
            return Err(format!("name: `{}` cannot name a folder; use letters, digits, `.`, `-` and `_`", self.name));
        }
        let plane = self.projector.plane(360, 90);
        self.rasterizer.check_plane(&plane).map_err(|why| format!("rasterizer: {why}"))?;
        if self.rasterizer.coherent() && self.readout.channels() < 2 {
            return Err("readout: this rasterizer adds up waves, and Real takes one channel of each; use MinMax, \
                        Magnitude or Power"
                .into());
        }
        if self.rasterizer.coherent() && self.calibration == Calibration::AsReleased {
            return Err("calibration: AsReleased makes colours of signals, and this rasterizer adds up waves; use \
                        Physical"
                .into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_the_facade_a_field_left_out_is_an_error() {
        let said = Pipeline::parse("Pipeline(name: \"a\")", Path::new("a.ron")).unwrap_err().to_string();
        assert_eq!(said, "a.ron:1:20: the field `data` is missing");
        let said = default_of::<Plugin<dyn Split>>("split").unwrap_err();
        assert!(said.contains("`split` has no default") && said.contains("`pwrfgs`"), "{said}");
    }
}
