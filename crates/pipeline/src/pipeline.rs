//! `Pipeline`: a whole experiment as one RON value, and the patches that change it.

use crate::defaults;
use crate::draft::{Draft, shortened};
use crate::kinds::{mixed, refuse_mixed};
use crate::ron_tree::Tree;
use pwrfgs_core::plugin::{Checked, Plugin, read_ron, to_ron, try_to_ron};
use pwrfgs_core::{
    Baseline, DataSource, Dataset, Deformation, Error, ImagePlane, Initializer, JsonSchema, MaskRate, Method, Metric,
    Partition, Projector, Pruner, Rasterizer, Result, Split, plugin::name_of, rng,
};
use pwrfgs_model::{Calibration, Readout, SplattedChannel, Splatting, Stages, check_together};
use pwrfgs_train::{Trainer, Training, TrainingPatch, TrainingPlan};
use ron::value::RawValue;
use schemars::{Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Everything a run needs to know. Plugins are named in the words of the registry; plain settings are nested structs. A
/// field that is left out takes what [`defaults`] says; name, data and initializer have no default.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "PipelineFields<Checked<Training>>")]
#[schemars(!try_from, extend("required" = ["name", "data"]))]
pub struct Pipeline {
    /// Names the run folder: letters, digits, `.`, `-` and `_`.
    pub name: String,
    /// The one seed that decides everything.
    pub seed: u64,
    /// Seed of the split alone; left out, the one seed. Members of an ensemble are divided alike by it.
    pub split_seed: Option<u64>,
    /// Where the observations come from.
    pub data: Plugin<dyn DataSource>,
    /// Training, validation and test.
    pub split: Plugin<dyn Split>,
    /// The way from Gaussians to observations; left out, they are drawn as splats by the five fields that follow the
    /// initializer.
    pub method: Option<Plugin<dyn Method>>,
    /// Where the Gaussians start; a method without Gaussians needs none.
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
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(rename = "Pipeline", deny_unknown_fields)]
#[allow(missing_docs)] // each field means what it means in `Pipeline`
pub struct PipelineFields<T> {
    /// What a sweep calls this patch; changes nothing.
    #[serde(skip_serializing)]
    pub label: Option<String>,
    /// The pipeline file that a variant starts from.
    #[serde(skip_serializing)]
    pub base: Option<PathBuf>,
    /// Single values by their path, such as `{"pruners.LearnableMask.lambda": 0.05}`; in a patch only.
    #[serde(skip_serializing)]
    pub set: Option<BTreeMap<String, Box<RawValue>>>,
    pub name: Option<String>,
    pub seed: Option<u64>,
    pub split_seed: Option<u64>,
    pub data: Option<Plugin<dyn DataSource>>,
    pub split: Option<Plugin<dyn Split>>,
    pub method: Option<Plugin<dyn Method>>,
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

impl PipelinePatch {
    /// Whether the patch says something about this field of a pipeline, or about a part of it.
    pub fn gives(&self, field: &str) -> bool {
        let by_path = |path: &String| path.split('.').next().is_some_and(|first| first.trim() == field);
        let Ok(text) = try_to_ron(self) else { return true };
        let said = |tree: Tree| tree.field(field).is_some_and(|value| value.of(&text) != "None");
        self.set.iter().flatten().any(|(path, _)| by_path(path))
            || (field == "label" && self.label.is_some())
            || Tree::parse(&text).is_ok_and(said)
    }
}

/// What a patch is, in a list of what may stand in an experiment.
impl JsonSchema for PipelinePatch {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "fields of a Pipeline".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "title": Self::schema_name(), "type": "object" })
    }
}

impl TryFrom<PipelineFields<Checked<Training>>> for Pipeline {
    type Error = String;

    fn try_from(given: PipelineFields<Checked<Training>>) -> Result<Self, String> {
        let missing = |field: &str| format!("the field `{field}` is missing");
        if given.label.is_some() {
            return Err("only a variant of a sweep has a `label`".into());
        }
        if given.base.is_some() {
            return Err("only a variant of a sweep has a `base`".into());
        }
        if given.set.is_some() {
            return Err("only a sweep has `set`; give the values in their places".into());
        }
        let data: Plugin<dyn DataSource> = given.data.ok_or_else(|| missing("data"))?;
        let kind = data.task().unwrap_or_default();
        let has_gaussians = given.method.as_ref().is_none_or(|method| method.traits().has_gaussians());
        Ok(Self {
            name: given.name.ok_or_else(|| missing("name"))?,
            seed: given.seed.unwrap_or_default(),
            split_seed: given.split_seed,
            data,
            split: given.split.unwrap_or_else(defaults::split),
            initializer: match given.initializer {
                None if !has_gaussians => defaults::initializer(),
                initializer => initializer.ok_or_else(|| missing("initializer"))?,
            },
            method: given.method,
            projector: given.projector.unwrap_or_else(defaults::projector),
            rasterizer: given.rasterizer.unwrap_or_else(defaults::rasterizer),
            deformation: given.deformation.unwrap_or_else(defaults::deformation),
            calibration: given.calibration.unwrap_or_default(),
            readout: given.readout.unwrap_or_else(|| defaults::readout(kind)),
            pruners: given.pruners.unwrap_or_default(),
            training: given.training.unwrap_or_default(),
            baselines: given.baselines.unwrap_or_else(|| defaults::baselines(kind)),
            metrics: given.metrics.unwrap_or_else(|| defaults::metrics(kind)),
            tensorboard: given.tensorboard.unwrap_or_default(),
        })
    }
}

impl Pipeline {
    /// The fields that have no default, with an example each.
    pub const REQUIRED: [(&'static str, &'static str); 3] =
        [("name", "\"first\""), ("data", "Teacher()"), ("initializer", "Random()")];

    /// Reads a pipeline; `path` is for messages only.
    ///
    /// # Errors
    /// [`Error::Input`] with line and column.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let pipeline: Self = read_ron(text, path)?;
        refuse_mixed(&pipeline, text, path)?;
        pipeline.check().map_err(|why| Error::input(path, why))?;
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
        let why = "this pipeline cannot be written as text";
        try_to_ron(self).map_err(|e| format!("{why}: {e}"))
    }

    /// Applies `--set` arguments, such as `training.steps=1000` or `pruners.LearnableMask.lambda=0.05`, and checks the
    /// outcome once.
    ///
    /// # Errors
    /// [`Error::Config`] naming the argument.
    pub fn set_all<S: AsRef<str>>(&mut self, arguments: &[S]) -> Result<()> {
        self.apply(
            arguments,
            |draft, argument| draft.set_argument(argument.as_ref()),
            |argument| {
                let argument = argument.as_ref();
                (format!("--set {}", shortened(argument)), argument.split('=').next().unwrap_or_default())
            },
        )
    }

    /// The same with paths and the RON text of values.
    ///
    /// # Errors
    /// As there, naming path and value.
    pub fn set_values(&mut self, values: &[(String, String)]) -> Result<()> {
        self.apply(
            values,
            |draft, (path, value)| draft.set(path, value),
            |(path, value)| (format!("{path} = {}", shortened(value)), path),
        )
    }

    /// Does all of `changes`, or none of them. `named` is what messages call one, and its path.
    fn apply<C>(
        &mut self,
        changes: &[C],
        change: impl Fn(&mut Draft, &C) -> Result<()>,
        named: impl Fn(&C) -> (String, &str),
    ) -> Result<()> {
        let mut draft = Draft::of(self);
        changes.iter().try_for_each(|one| change(&mut draft, one))?;
        let alone = |one: &&C| {
            let mut draft = Draft::of(self);
            change(&mut draft, one).and_then(|()| draft.finish()).map_err(|e| e.to_string()).err()
        };
        let made = draft.finish().map_err(|error| {
            // Whoever makes the same mistake alone is to blame, else all together.
            let mut said = error.to_string();
            let one = changes.iter().find(|one| alone(one).as_ref() == Some(&said));
            // What only says that a value cannot be read says nothing of what can.
            let misread = ["Expected ", "Integer is "].iter().any(|begin| said.starts_with(begin))
                || said.ends_with("where a name is expected");
            if let Some(wanted) = one.filter(|_| misread).and_then(|one| draft.takes(named(one).1)) {
                said = format!("{said}; it takes a {wanted}");
            }
            let blamed = one.map_or(changes, std::slice::from_ref);
            let names: Vec<String> = blamed.iter().map(|one| named(one).0).collect();
            Error::Config(format!("{}: {said}", names.join(" ")))
        })?;
        *self = made;
        Ok(())
    }

    /// [`Self::set_all`] with one argument.
    ///
    /// # Errors
    /// As there.
    pub fn set(&mut self, argument: &str) -> Result<()> {
        self.set_all(&[argument])
    }

    /// The way from Gaussians to observations.
    pub fn method(&self) -> Plugin<dyn Method> {
        if let Some(method) = &self.method {
            return method.clone();
        }
        let deformation = self.deformation.clone();
        let method: Box<dyn Method> = match self.data.task() {
            Some(task) if task.is_complex => Box::new(SplattedChannel { deformation }),
            _ => Box::new(Splatting {
                deformation,
                projector: self.projector.clone(),
                rasterizer: self.rasterizer.clone(),
                calibration: self.calibration,
                readout: self.readout,
            }),
        };
        method.into()
    }

    /// The numbers of one observation of `data`: of spectra, the picture as the projector draws it.
    ///
    /// # Errors
    /// Where the projector cannot draw it.
    pub fn plane(&self, data: &Dataset) -> Result<ImagePlane> {
        Stages::of(self.method(), data).map(|stages| stages.frame.plane)
    }

    /// What is trained, with `training.scale` multiplied in.
    ///
    /// # Errors
    /// As [`Self::resolved`].
    pub fn plan(&self) -> Result<TrainingPlan> {
        self.resolved().map(|resolved| resolved.as_plan())
    }

    /// What is trained, as it stands.
    pub(crate) fn as_plan(&self) -> TrainingPlan {
        TrainingPlan {
            name: self.name.clone(),
            seed: self.seed,
            method: self.method(),
            initializer: self.initializer.clone(),
            pruners: self.pruners.clone(),
            training: self.training.clone(),
        }
    }

    /// A trainer before its first step.
    ///
    /// # Errors
    /// As [`Self::plan`] and [`Trainer::new`].
    pub fn trainer<'a>(&self, data: &'a Dataset, partition: &Partition) -> Result<Trainer<'a>> {
        Trainer::new(&self.plan()?, data, partition)
    }

    /// How its split divides `data`.
    ///
    /// # Errors
    /// What the split refuses.
    pub fn partition(&self, data: &Dataset) -> Result<Partition> {
        self.split.split(data, &mut rng::stream(self.split_seed.unwrap_or(self.seed), "split", 0))
    }

    /// The pipeline as it is trained: `training.scale` multiplied into every count of steps, and below 1 divided out of the
    /// rates of masks.
    ///
    /// # Errors
    /// [`Error::Config`] where training ends before the pruners are done: such a run would be scored unpruned.
    pub fn resolved(&self) -> Result<Self> {
        let training = self.training.resolved();
        let (steps, until) = (training.steps, training.prune_until);
        if !self.pruners.is_empty() && until > steps {
            return Err(Error::Config(format!(
                "training: it ends after step {steps}, but the pruners are at work until step {until} (`prune_until`), so \
                 the model would be scored unpruned; for a shorter training in the same proportions leave `steps` alone \
                 and give `scale`, such as --scale 0.25"
            )));
        }
        let training = Checked::new(training).map_err(|why| Error::Config(format!("training: {why}")))?;
        let (scale, resolved) = (self.training.scale, Self { training, ..self.clone() });
        let rates = self.pruners.iter().enumerate().filter_map(|(k, pruner)| Some((k, pruner.traits().mask_rate?)));
        let rates: Vec<(usize, MaskRate)> = rates.filter(|_| scale < 1.0).collect();
        if rates.is_empty() {
            return Ok(resolved);
        }
        let mut draft = Draft::of(&resolved);
        for (k, rate) in rates {
            draft.set(&format!("pruners.{k}.{}", rate.field), &to_ron(&rate.shortened(scale)))?;
        }
        draft.finish()
    }

    /// The same without what changes nothing of the result: TensorBoard, and how often a checkpoint is written.
    pub fn essential(&self) -> Self {
        let checkpoint_every = Training::default().checkpoint_every;
        let training = Training { checkpoint_every, ..Training::clone(&self.training) };
        let training = Checked::new(training).unwrap_or_else(|_| self.training.clone());
        Self { tensorboard: false, training, ..self.clone() }
    }

    /// What plugins cannot see of each other.
    fn check(&self) -> Result<(), String> {
        let good = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(good) {
            return Err(format!(
                "name: `{}` cannot name a folder; use letters, digits, `.`, `-` and `_`",
                shortened(&self.name)
            ));
        }
        self.readout.check()?;
        if let Some((field, what)) = mixed(self) {
            return Err(format!("{field}: {what}"));
        }
        if self.method.as_ref().is_some_and(|method| name_of(method) == "Splatting") {
            return Err(
                "method: `Splatting` is what the fields projector, rasterizer, deformation, calibration and readout \
                        say; leave `method` out"
                    .into(),
            );
        }
        let plane = self.projector.plane(360, 90);
        check_together(&*self.rasterizer, self.readout, self.calibration, &plane)
    }
}
