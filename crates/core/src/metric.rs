//! `Metric`: how good a prediction is.

use crate::{Dataset, Image, ImagePlane, Link, Real, Result, Scene, Task, plugin_kind};

/// Scores predictions or a whole model.
#[typetag::serde]
pub trait Metric:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// One or more measurements.
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>>;

    /// Checks whether the metric supports the observations of `data`, as
    /// [`Baseline::check_data`](crate::Baseline::check_data) does.
    ///
    /// # Errors
    /// The metric does not support `data`; the message names the setting to change.
    fn check_data(&self, data: &Dataset) -> Result<()> {
        let _ = data;
        Ok(())
    }

    /// Whether it scores observations of `task`. Metrics of the model itself support every task.
    fn supports(&self, task: Task) -> bool {
        let _ = task;
        true
    }

    /// What of the test part it has to see at once. What is said here decides how much memory an evaluation takes.
    fn scope(&self) -> Scope {
        Scope::All
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Metric);

/// What of the test part a metric has to see at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// One sample: it is shown some at a time and gives [`Values::PerSample`] of them, each of its sample alone.
    Sample,
    /// No sample: the model, or how long it takes. It is shown none.
    Model,
    /// Every sample: right whatever the metric does, but all predictions are then held in memory, eight bytes a pixel
    /// with their truths.
    All,
}

/// What a metric may look at.
#[derive(Clone, Copy)]
pub struct Evaluation<'a> {
    /// Predictions, not clamped: as many of the test samples, in order, as the metric's [`Scope`] says.
    pub predictions: &'a [Image],
    /// What was observed, in the same order.
    pub truths: &'a [Image],
    /// What is observed.
    pub task: Task,
    /// Which links they are of, in the same order; empty where nobody can say.
    pub links: &'a [Link],
    /// What a pixel means.
    pub plane: &'a ImagePlane,
    /// Receivers, bounds and points.
    pub scene: &'a Scene,
    /// The model, or `None` for a baseline.
    pub model: Option<ModelFacts<'a>>,
    /// Predicts once, for the next test transmitter in turn, and says how long it took; of a baseline `total` alone.
    /// `None` where nobody asks.
    pub timed_prediction: Option<&'a dyn Fn() -> StageTimes>,
}

impl<'a> Evaluation<'a> {
    /// Of data as they are seen on `plane`, without anything to score yet.
    pub fn of(data: &'a Dataset, plane: &'a ImagePlane) -> Self {
        Self {
            predictions: &[],
            truths: &[],
            task: data.task(),
            links: &[],
            plane,
            scene: &data.scene,
            model: None,
            timed_prediction: None,
        }
    }
}

impl std::fmt::Debug for Evaluation<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut f = f.debug_struct("Evaluation");
        f.field("predictions", &self.predictions.len()).field("model", &self.model).finish_non_exhaustive()
    }
}

/// What a metric may know of the model itself.
#[derive(Clone, Copy, Debug)]
pub struct ModelFacts<'a> {
    /// Centres `[N,3]`, metres.
    pub means: &'a [[Real; 3]],
    /// Bytes of the Gaussians in the model file.
    pub gaussian_bytes: usize,
    /// Bytes of the network in the model file.
    pub network_bytes: usize,
}

/// Seconds of one prediction, stage by stage.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageTimes {
    /// Deformation network.
    pub network: f64,
    /// Activation and projection.
    pub projection: f64,
    /// What the rasterizer finds before it looks at signals: depth order and tile lists.
    pub sort: f64,
    /// Signals, blending and readout.
    pub blending: f64,
    /// All of it, from position to picture.
    pub total: f64,
    /// What no transmitter changes, computed once before the first prediction and not in the total; seconds, as all others.
    pub prepare: f64,
}

/// Which way is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goal {
    /// Larger is better.
    Higher,
    /// Smaller is better.
    Lower,
}

/// One result.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Column name in `scores.csv`, such as `ssim` or `eta_0db`.
    pub key: String,
    /// Unit, empty for a pure number.
    pub unit: String,
    /// Which way is better.
    pub goal: Goal,
    /// The numbers.
    pub values: Values,
}

/// The numbers of a [`Measurement`].
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// One a test sample; reported as mean, median and bad tail.
    PerSample(Vec<f64>),
    /// One for the whole model.
    Whole(f64),
    /// Does not apply here, and why; reported as `n/a`.
    NotApplicable(String),
}

impl Values {
    /// The mean over the test samples, or the one number; NaN if the metric does not apply.
    pub fn mean(&self) -> f64 {
        match self {
            Self::PerSample(values) => values.iter().sum::<f64>() / values.len() as f64,
            Self::Whole(value) => *value,
            Self::NotApplicable(_) => f64::NAN,
        }
    }
}
