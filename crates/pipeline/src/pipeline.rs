//! `Pipeline`: all settings of a run as one RON value.

use crate::defaults;
use pwrfgs_core::plugin::{Checked, Plugin, try_to_ron};
use pwrfgs_core::{
    Baseline, DataSource, Dataset, Deformation, Error, ImagePlane, Initializer, JsonSchema, Method, Metric, Partition,
    Projector, Pruner, Rasterizer, Result, Split, rng,
};
use pwrfgs_data::Fold;
use pwrfgs_methods::{Calibration, Readout, SplattedChannel, Splatting};
use pwrfgs_model::{Kriged, Stages};
use pwrfgs_train::{Trainer, Training, TrainingPlan};
use serde::{Deserialize, Serialize};

/// Largest number of parts into which the training and validation samples are divided for the models of a run.
const MOST_PARTS: usize = 4;

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
    /// Number of models, 1 to 100, trained one after another with seeds from `seed` on; their mean predicts. For several, the
    /// training and validation sets are divided, in blocks of the split, into as many parts as there are models, at most
    /// four, and each model leaves out one part. Residuals and intervals are fitted to the left-out parts, so the split needs
    /// no `validation` share. The time is that of all models.
    #[serde(default = "defaults::members")]
    pub members: usize,
    /// Gaussian process that predicts the residuals of the trained model, such as `Kriged()`; without it, the model
    /// predicts alone.
    pub residuals: Option<Checked<Kriged>>,
    /// Baselines in the score table.
    #[serde(default)]
    pub baselines: Vec<Plugin<dyn Baseline>>,
    /// Metrics that score the model and the baselines.
    #[serde(default)]
    pub metrics: Vec<Plugin<dyn Metric>>,
    /// Whether the run writes an event file for TensorBoard.
    #[serde(default)]
    pub tensorboard: bool,
    /// Names of accepted findings: properties of the data that would otherwise stop the run, such as `"lone-value"`.
    #[serde(default)]
    pub accept: Vec<String>,
}

impl Pipeline {
    /// Required fields, with an example each.
    pub const REQUIRED: [(&'static str, &'static str); 3] =
        [("name", "\"first\""), ("data", "Teacher()"), ("initializer", "Random()")];

    /// Returns the RON text of the pipeline with every default written out; [`Self::parse`] restores the same pipeline.
    ///
    /// # Errors
    /// [`Error::Config`] if a path is not valid text, or a third-party plugin cannot be written.
    pub fn to_ron(&self) -> Result<String> {
        let refused = |why| Error::Config(format!("this pipeline cannot be written as text: {why}"));
        try_to_ron(self).map(|text| text + "\n").map_err(refused)
    }

    /// Returns `method`; if it is omitted, the default with the fields of splats: [`SplattedChannel`] for channels, otherwise
    /// [`Splatting`].
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

    /// Returns the image plane of one observation of `data`; for spectra, the plane of the projector.
    ///
    /// # Errors
    /// The projector does not support the elevations, or the camera, of the data.
    pub fn plane(&self, data: &Dataset) -> Result<ImagePlane> {
        Stages::of(self.method(), data).map(|stages| stages.setup.plane)
    }

    /// Returns the training plan without scaling.
    pub(crate) fn unscaled_plan(&self) -> TrainingPlan {
        TrainingPlan {
            name: self.name.clone(),
            seed: self.seed,
            method: self.method(),
            initializer: self.initializer.clone(),
            pruners: self.pruners.clone(),
            training: self.training.clone(),
        }
    }

    /// Returns the training plan, with `training.scale` applied.
    ///
    /// # Errors
    /// Same as [`Self::resolved`].
    pub fn plan(&self) -> Result<TrainingPlan> {
        self.resolved().map(|resolved| resolved.unscaled_plan())
    }

    /// Creates a trainer before its first step.
    ///
    /// # Errors
    /// Errors of [`Self::plan`] and [`Trainer::new`].
    pub fn trainer<'a>(&self, data: &'a Dataset, partition: &Partition) -> Result<Trainer<'a>> {
        Trainer::new(&self.plan()?, data, partition)
    }

    /// Returns the pipeline with `training.scale` applied: multiplies all numbers of steps by it; if it is below 1, shortens
    /// the pruners by [`Pruner::shortened`], which raises mask learning rates up to a limit.
    ///
    /// # Errors
    /// [`Error::Config`] if training ends before the last prune step, since the scores would be those of an unpruned model; if
    /// the scaled settings are invalid; or if the shortened pruners do not fit the other settings.
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
        if scale < 1.0 {
            let shortened =
                |pruner: &Plugin<dyn Pruner>| pruner.shortened(scale).map_or_else(|| pruner.clone(), Plugin::from);
            resolved.pruners = self.pruners.iter().map(shortened).collect();
            // Rounding may leave no step for a phase.
            resolved.check().map_err(|(_, message)| Error::Config(message))?;
        }
        Ok(resolved)
    }

    /// Splits `data` with the split of the pipeline and the seed `split_seed` or, without it, `seed`.
    ///
    /// # Errors
    /// Errors of the split.
    pub fn partition(&self, data: &Dataset) -> Result<Partition> {
        self.split.split(data, &mut rng::stream(self.split_seed.unwrap_or(self.seed), "split", 0))
    }

    /// Returns the pipeline of one of `count` models of an ensemble: fold `index` (from 0) of the training and validation
    /// samples is its validation set.
    #[must_use]
    pub fn folded(&self, index: usize, count: usize) -> Self {
        let split: Box<dyn Split> = Box::new(Fold { of: self.split.clone(), index, count });
        Self { split: split.into(), ..self.clone() }
    }

    /// Returns the number of parts of the training and validation samples, of which each of the `members` leaves out one. Of
    /// more than four members, several leave out the same part: their mean, which also predicts, is then tested on it.
    pub fn parts(&self) -> usize {
        self.members.min(MOST_PARTS)
    }

    /// Returns the pipeline that trains model `index`, from 0. If the run has several `members`, this pipeline has its own name
    /// and seed, leaves out the part of the model, and has neither residuals nor baselines.
    #[must_use]
    pub fn member(&self, index: usize) -> Self {
        if self.members == 1 {
            return self.clone();
        }
        Self {
            name: format!("{}.{}", self.name, index + 1),
            seed: self.seed.wrapping_add(index as u64),
            split_seed: Some(self.split_seed.unwrap_or(self.seed)),
            members: 1,
            residuals: None,
            baselines: Vec::new(),
            ..self.folded(index % self.parts(), self.parts())
        }
    }

    /// Returns the pipeline without settings that do not affect the result: TensorBoard, accepted findings and
    /// checkpoint interval.
    pub fn essential(&self) -> Self {
        let training = Checked::new(self.training.of_run()).unwrap_or_else(|_| self.training.clone());
        Self { tensorboard: false, accept: Vec::new(), training, ..self.clone() }
    }
}
