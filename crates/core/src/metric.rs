//! `Metric`: quality of predictions.

use crate::{Dataset, Demand, Image, ImagePlane, Link, Real, Result, Scene, Task, plugin_kind};
use serde::{Deserialize, Serialize};

/// Scores predictions or a whole model.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Metric: crate::plugin::PluginObject {
    /// Returns one or more measurements.
    ///
    /// # Errors
    /// Predictions and observations differ in number or size, or a class of Python raises an exception.
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>>;

    /// Checks whether the metric supports the observations of `data`, as
    /// [`Baseline::check_data`](crate::Baseline::check_data) does.
    ///
    /// # Errors
    /// The metric does not support `data`; the message names the setting to change.
    fn check_data(&self, data: &Dataset) -> Result<()> {
        Ok(())
    }

    /// Returns the measurement types that it supports; all by default.
    fn tasks(&self) -> &'static [Task] {
        &Task::ALL
    }

    /// Returns its demands, for [`check_compatible`](crate::check_compatible).
    fn demand(&self) -> Demand {
        Demand { field: "metrics", plugin: self.typetag_name(), tasks: self.tasks(), requires: &[] }
    }

    /// Returns the number of test samples that it needs at once, which determines the memory of an evaluation.
    fn scope(&self) -> Scope {
        Scope::All
    }

    /// Returns two energies of each sample for [`Scope::Energies`], `[L, 2]`, such as those of error and signal: squared units
    /// of the observation.
    ///
    /// # Errors
    /// Predictions and observations differ in number or size.
    fn energies(&self, evaluation: &Evaluation<'_>) -> Result<Vec<[f64; 2]>> {
        Ok(Vec::new())
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Metric);

/// Number of test samples that a metric needs at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// One sample: it receives some at a time and returns one of [`Values::PerSample`] for each.
    Sample,
    /// Two energies of each sample, [`Metric::energies`]: it receives [`Evaluation::energies`] of all samples.
    Energies,
    /// No sample: it scores the model or its speed.
    Model,
    /// All samples: correct for every metric, but all predictions are held in memory, eight bytes per pixel with their
    /// measurements.
    All,
}

/// Inputs of a metric.
#[derive(Clone, Copy)]
pub struct Evaluation<'a> {
    /// Predictions of test samples, not clamped, in order; their number follows from the [`Scope`] of the metric.
    pub predictions: &'a [Image],
    /// Observations, in the same order.
    pub truths: &'a [Image],
    /// Energies of all samples for [`Scope::Energies`]; if empty, they follow from predictions and observations.
    pub energies: &'a [[f64; 2]],
    /// Measurement type.
    pub task: Task,
    /// Links of the samples, in the same order; empty if unknown.
    pub links: &'a [Link],
    /// Image plane with the directions of the pixels.
    pub plane: &'a ImagePlane,
    /// Receivers, bounds and points.
    pub scene: &'a Scene,
    /// Properties of the model, or `None` for a baseline.
    pub model: Option<ModelFacts<'a>>,
    /// Predicts the next test transmitter in turn, and returns the time; for a baseline only `total`. `None` if no
    /// metric measures time.
    pub timed_prediction: Option<&'a dyn Fn() -> StageTimes>,
}

impl<'a> Evaluation<'a> {
    /// Creates an evaluation of data on `plane`, without samples.
    pub fn of(data: &'a Dataset, plane: &'a ImagePlane) -> Self {
        Self {
            predictions: &[],
            truths: &[],
            energies: &[],
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

/// Properties of a model for metrics.
#[derive(Clone, Copy, Debug)]
pub struct ModelFacts<'a> {
    /// Centres `[N,3]`, metres.
    pub means: &'a [[Real; 3]],
    /// Size of the Gaussians, bytes.
    pub gaussian_bytes: usize,
    /// Size of the whole model file, bytes.
    pub file_bytes: usize,
}

/// Time of one prediction per stage, seconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct StageTimes {
    /// Deformation network, seconds.
    pub network: f64,
    /// Activation and projection, seconds.
    pub projection: f64,
    /// Signal-independent part of the rasterizer, seconds: depth order and tile lists.
    pub sort: f64,
    /// Signals, blending and readout, seconds.
    pub blending: f64,
    /// Total from position to spectrum, seconds.
    pub total: f64,
    /// Transmitter-independent values, computed once before the first prediction and excluded from the total; seconds.
    pub prepare: f64,
}

/// Direction of improvement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Goal {
    /// Larger is better.
    Higher,
    /// Smaller is better.
    Lower,
}

/// First words of the note on times that other load of the machine has changed; reports find such notes by them.
pub const UNSTEADY: &str = "not steady: ";

/// Result of a metric.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// Column name in `scores.csv`, such as `ssim` or `eta_0db`.
    pub key: String,
    /// Unit, empty for a pure number.
    pub unit: String,
    /// Direction of improvement.
    pub goal: Goal,
    /// Values.
    pub values: Values,
    /// Note below tables on the validity of the values, such as a busy machine; `None` without one.
    pub note: Option<String>,
}

/// Values of a [`Measurement`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Values {
    /// One value per test sample; reported as mean, median and 10th (for errors 90th) percentile.
    PerSample(Vec<f64>),
    /// One value for the whole model.
    Whole(f64),
    /// Reason why the metric does not apply; reported as `n/a`.
    NotApplicable(String),
}

impl Values {
    /// Returns the mean over the test samples, or the single value; NaN without samples, and if the metric does not apply.
    pub fn mean(&self) -> f64 {
        match self {
            Self::PerSample(values) => values.iter().sum::<f64>() / values.len() as f64,
            Self::Whole(value) => *value,
            Self::NotApplicable(_) => f64::NAN,
        }
    }
}
