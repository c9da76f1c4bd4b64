//! `Pipeline`: a whole run as one RON value.

use crate::changes::{Change, line_and_column, shortened};
use crate::defaults;
use crate::draft::{Draft, Fault};
use crate::kinds::mixed;
use crate::ron_tree::Tree;
use pwrfgs_core::plugin::{Checked, Plugin, explain, ron_options, to_ron, try_to_ron};
use pwrfgs_core::{
    Baseline, DataSource, Dataset, Deformation, Error, ImagePlane, Initializer, JsonSchema, MaskRate, Method, Metric,
    Partition, Projector, Pruner, Rasterizer, Result, Split, plugin::name_of, rng,
};
use pwrfgs_methods::{Calibration, Readout, SplattedChannel, Splatting, check_together};
use pwrfgs_model::Stages;
use pwrfgs_train::{Trainer, Training, TrainingPlan};
use ron::error::SpannedError;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// All settings of one run. `name`, `data` and, for methods with Gaussians, `initializer` are required; all other
/// fields have defaults. The defaults of method, readout, baselines and metrics depend on the data. Read a file with
/// [`Pipeline::parse`].
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Pipeline {
    /// Name of the run folder: letters, digits, `.`, `-` and `_`.
    pub name: String,
    /// Random seed of the run: split, initial Gaussians, batches and all other random draws.
    #[serde(default)]
    pub seed: u64,
    /// Random seed of the split, if it differs from `seed`. All models of an ensemble need the same split.
    pub split_seed: Option<u64>,
    /// Data source: measured or simulated spectra, powers or channels.
    pub data: Plugin<dyn DataSource>,
    /// Split into training, validation and test set.
    #[serde(default = "defaults::split")]
    pub split: Plugin<dyn Split>,
    /// Method that predicts observations. If omitted, Gaussians are rasterized as splats (channels: `SplattedChannel`)
    /// with the fields `projector`, `rasterizer`, `deformation`, `calibration` and `readout`.
    pub method: Option<Plugin<dyn Method>>,
    /// Initial Gaussians. Omit it for a method without Gaussians.
    #[serde(default = "defaults::initializer")]
    pub initializer: Plugin<dyn Initializer>,
    /// Projection of Gaussians to the image plane.
    #[serde(default = "defaults::projector")]
    pub projector: Plugin<dyn Projector>,
    /// Blending of projected Gaussians into pixels.
    #[serde(default = "defaults::rasterizer")]
    pub rasterizer: Plugin<dyn Rasterizer>,
    /// Effect of the transmitter on signals and geometry of the Gaussians, usually a network.
    #[serde(default = "defaults::deformation")]
    pub deformation: Plugin<dyn Deformation>,
    /// How outputs of the deformation network are combined with the learned parameters.
    #[serde(default)]
    pub calibration: Calibration,
    /// Conversion of the blended signals to a spectrum or a received power.
    #[serde(default)]
    pub readout: Readout,
    /// Pruning strategies. A Gaussian is kept if all strategies keep it.
    #[serde(default)]
    pub pruners: Vec<Plugin<dyn Pruner>>,
    /// Training settings (algorithm 1 of the paper).
    #[serde(default)]
    pub training: Checked<Training>,
    /// Baselines in the score table.
    #[serde(default)]
    pub baselines: Vec<Plugin<dyn Baseline>>,
    /// Metrics that score the model and the baselines.
    #[serde(default)]
    pub metrics: Vec<Plugin<dyn Metric>>,
    /// Whether the run writes an event file for TensorBoard.
    #[serde(default)]
    pub tensorboard: bool,
}

/// Why a text is no pipeline.
#[derive(Debug)]
pub(crate) struct Misfit {
    pub(crate) message: String,
    /// Where, as a byte of the text.
    pub(crate) at: Option<usize>,
    pub(crate) hint: TypeHint,
}

/// Whether a message should add what a value may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TypeHint {
    /// The message says it.
    Never,
    /// If the value has no parts.
    AtLeaf,
    /// The value is of another type.
    Always,
}

impl Misfit {
    /// Of a text that is no pipeline by its grammar or the types of its values.
    fn reading(error: &SpannedError, text: &str) -> Self {
        let hint = match error.code {
            ron::Error::Message(_) => TypeHint::AtLeaf,
            ron::Error::NoSuchEnumVariant { .. }
            | ron::Error::NoSuchStructField { .. }
            | ron::Error::MissingStructField { .. } => TypeHint::Never,
            _ => TypeHint::Always,
        };
        let end = error.span.end;
        let line = text.split_inclusive('\n').take(end.line - 1).map(str::len).sum::<usize>();
        let column = text[line..].char_indices().nth(end.col - 1).map_or(text.len() - line, |(i, _)| i);
        Self { message: explain(error), at: Some(line + column), hint }
    }

    /// Of a `field` that does not fit the others; it stands at the data if the field was left out.
    pub(crate) fn of(field: &str, message: String, tree: &Tree) -> Self {
        let place = tree.field(field).or_else(|| tree.field("data"));
        Self { message, at: place.map(|place| place.span.start), hint: TypeHint::Never }
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
        Self::read(text).map_err(|Misfit { message, at, .. }| Error::Input {
            path: path.into(),
            at: at.map(|at| line_and_column(text, at)),
            message,
        })
    }

    /// [`Self::parse`] with the place in bytes.
    pub(crate) fn read(text: &str) -> Result<Self, Misfit> {
        let mut pipeline: Self = ron_options().from_str(text).map_err(|e| Misfit::reading(&e, text))?;
        let tree = Tree::parse(text).map_err(|message| Misfit { message, at: None, hint: TypeHint::Never })?;
        pipeline.complete(&|field| tree.field(field).is_none()).map_err(|message| Misfit {
            message,
            at: Some(tree.span.end),
            hint: TypeHint::Never,
        })?;
        pipeline.check().map_err(|(field, message)| Misfit::of(field, message, &tree))?;
        Ok(pipeline)
    }

    /// Fills in the fields that were `left_out` and whose default depends on others.
    fn complete(&mut self, left_out: &dyn Fn(&str) -> bool) -> Result<(), String> {
        if left_out("initializer") && self.method.as_ref().is_none_or(|method| method.traits().has_gaussians()) {
            return Err("the field `initializer` is missing".into());
        }
        let task = self.data.task().unwrap_or_default();
        if left_out("readout") {
            self.readout = defaults::readout(task);
        }
        if left_out("baselines") {
            self.baselines = defaults::baselines(task);
        }
        if left_out("metrics") {
            self.metrics = defaults::metrics(task);
        }
        Ok(())
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

    pub(crate) fn text(&self) -> Result<String, String> {
        let why = "this pipeline cannot be written as text";
        try_to_ron(self).map_err(|e| format!("{why}: {e}"))
    }

    /// Makes all of `changes`, or none of them, and checks the outcome once.
    ///
    /// # Errors
    /// [`Error::Config`] naming the changes that do not fit.
    pub fn change(&mut self, changes: &[Change]) -> Result<()> {
        let mut draft = Draft::of(self);
        let made = changes.iter().try_for_each(|change| draft.set(change)).and_then(|()| draft.finish());
        *self = made.map_err(Fault::in_arguments)?;
        Ok(())
    }

    /// The same with absolute paths; `absolute` maps a path as it stands.
    ///
    /// # Errors
    /// [`Error::Config`] if the pipeline, or a path, cannot be written as text.
    pub fn rebased(&self, absolute: &dyn Fn(&Path) -> PathBuf) -> Result<Self> {
        self.check_text()?;
        let mut draft = Draft::of(self);
        draft.rebase(absolute).and_then(|()| draft.finish()).map_err(Fault::in_arguments)
    }

    /// Applies `--set` arguments, such as `training.steps=1000` or `pruners.LearnableMask.lambda=0.05`.
    ///
    /// # Errors
    /// As [`Self::change`].
    pub fn set_all<S: AsRef<str>>(&mut self, arguments: &[S]) -> Result<()> {
        let changes: Result<Vec<Change>> = arguments.iter().map(|one| Change::argument(one.as_ref())).collect();
        self.change(&changes?)
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
        let (scale, mut resolved) = (self.training.scale, Self { training, ..self.clone() });
        let rates = self.pruners.iter().enumerate().filter_map(|(k, pruner)| Some((k, pruner.traits().mask_rate?)));
        let rates: Vec<(usize, MaskRate)> = rates.filter(|_| scale < 1.0).collect();
        if rates.is_empty() {
            return Ok(resolved);
        }
        let change = |(k, rate): (usize, MaskRate)| {
            Change::new(&format!("pruners.{k}.{}", rate.field), &to_ron(&rate.shortened(scale)))
        };
        let changes: Vec<Change> = rates.into_iter().map(change).collect();
        resolved.change(&changes)?;
        Ok(resolved)
    }

    /// The same without what changes nothing of the result: TensorBoard, and how often a checkpoint is written.
    pub fn essential(&self) -> Self {
        let checkpoint_every = Training::default().checkpoint_every;
        let training = Training { checkpoint_every, ..Training::clone(&self.training) };
        let training = Checked::new(training).unwrap_or_else(|_| self.training.clone());
        Self { tensorboard: false, training, ..self.clone() }
    }

    /// What plugins cannot see of each other: the field and what is wrong.
    fn check(&self) -> Result<(), (&'static str, String)> {
        if let Some((field, what)) = mixed(self) {
            return Err((field, format!("{field}: {what}")));
        }
        let good = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
        if self.name.is_empty() || self.name.starts_with('.') || !self.name.chars().all(good) {
            let name = shortened(&self.name);
            let what = format!("name: `{name}` cannot name a folder; use letters, digits, `.`, `-` and `_`");
            return Err(("name", what));
        }
        self.readout.check().map_err(|what| ("readout", what))?;
        if self.method.as_ref().is_some_and(|method| name_of(method) == "Splatting") {
            let what = "method: `Splatting` is what the fields projector, rasterizer, deformation, calibration and readout \
                        say; leave `method` out";
            return Err(("method", what.into()));
        }
        let plane = self.projector.plane(360, 90);
        let fits = check_together(&*self.rasterizer, self.readout, self.calibration, &plane);
        fits.map_err(|what| ("rasterizer", what))
    }
}

#[cfg(test)]
mod tests {
    use super::Pipeline;
    use pwrfgs_core::plugin::{ron_options, to_ron};
    use pwrfgs_core::{Baseline, Metric, Plugin};
    use std::path::Path;

    fn parse(fields: &str) -> Result<Pipeline, String> {
        Pipeline::parse(&format!("Pipeline(\n{fields})"), Path::new("a.ron")).map_err(|e| e.to_string())
    }

    #[test]
    fn fields_left_out_take_the_defaults_of_the_task() {
        let cases = [
            (
                "Teacher()",
                "[MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: 3), NearestNeighbours(k: 5)]",
                "[Ssim(), L1(), Psnr(), RateRatio(), DirectionError(), Chamfer(), GaussianCount(), ModelSize(), Latency()]",
                "Magnitude",
            ),
            (
                "Nerf2Rssi(root: \"x\")",
                "[MeanSpectrum(), LogDistance(), NearestNeighbours(k: 5), Kriging()]",
                "[PowerError(), Chamfer(), GaussianCount(), ModelSize(), Latency()]",
                "Received(",
            ),
            (
                "Channels(root: \"x\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())",
                "[Zero(), NearestNeighbours(k: 1), NearestNeighbours(k: 5)]",
                "[ChannelSnr(), Chamfer(), GaussianCount(), ModelSize(), Latency()]",
                "",
            ),
        ];
        for (data, baselines, metrics, readout) in cases {
            let pipeline = parse(&format!("name: \"a\", data: {data}, initializer: Random()")).unwrap();
            let baselines: Vec<Plugin<dyn Baseline>> = ron_options().from_str(baselines).unwrap();
            let metrics: Vec<Plugin<dyn Metric>> = ron_options().from_str(metrics).unwrap();
            assert_eq!(to_ron(&pipeline.baselines), to_ron(&baselines), "{data}");
            assert_eq!(to_ron(&pipeline.metrics), to_ron(&metrics), "{data}");
            assert!(to_ron(&pipeline.readout).starts_with(readout), "{data}");
            let parts = (&pipeline.split, &pipeline.projector, &pipeline.rasterizer, &pipeline.deformation);
            let text = to_ron(&parts);
            for name in ["Official(", "Mercator(", "AlphaBlending(", "Mlp("] {
                assert!(text.contains(name), "{data}: {text}");
            }
            let given = parse(&format!("name: \"a\", data: {data}, initializer: Random(), baselines: [], metrics: []"));
            assert!(given.is_ok_and(|own| own.baselines.is_empty() && own.metrics.is_empty()), "{data}");
        }
    }

    #[test]
    fn missing_and_unsupported_fields_have_a_place() {
        let refused = |fields: &str| parse(fields).unwrap_err();
        assert_eq!(refused("name: \"a\", initializer: Random()"), "a.ron:2:33: the field `data` is missing");
        assert!(refused("name: \"a\", data: Teacher()").ends_with("the field `initializer` is missing"));
        let said = refused("name: \"a\",\n data: Teacher(),\n initializer: Random(),\n metrics: [PowerError()]");
        assert!(said.starts_with("a.ron:5:11: metrics: "), "{said}");
        assert!(refused("name: \"a/b\", data: Teacher(), initializer: Random()").starts_with("a.ron:2:7: name: "));
    }

    #[test]
    fn paths_of_plugins_become_absolute() {
        let data = "Channels(root: \"r\", points: \"p.ply\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())";
        let relative = parse(&format!("name: \"a\", data: {data}, initializer: Trained(model: \"m\")")).unwrap();
        let absolute = relative.rebased(&|path| Path::new("/base").join(path)).unwrap().to_ron();
        for field in ["root: \"/base/r\"", "points: \"/base/p.ply\"", "model: \"/base/m\""] {
            assert!(absolute.contains(field), "{field}: {absolute}");
        }
        assert_eq!(absolute.matches("/base/").count(), 3, "`file` and `positions` start at `root`: {absolute}");
    }

    #[test]
    fn fields_that_the_method_of_channels_lacks_are_refused_unless_at_their_default() {
        let channels = |field: &str| {
            let data = "Channels(root: \"x\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())";
            parse(&format!("name: \"a\", data: {data}, initializer: Random(),\n{field}"))
        };
        for field in
            ["projector: Mercator(blur: 1)", "rasterizer: ArrayResponse()", "calibration: AsReleased", "readout: Real"]
        {
            let (name, message) = (field.split(':').next().unwrap(), channels(field).unwrap_err());
            assert!(
                message.starts_with("a.ron:3:") && message.contains(&format!("{name}: the method of channels")),
                "{message}"
            );
        }
        let written = channels("").unwrap().to_ron();
        assert_eq!(Pipeline::parse(&written, Path::new("a.ron")).unwrap().to_ron(), written);
    }
}
