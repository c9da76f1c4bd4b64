//! Metrics: quality of a prediction, and size and speed of the model.
//!
//! Each file holds one group of metrics. Metrics of a prediction give one number per test sample and run over samples
//! in parallel. Metrics of the model give one number, or the reason why they do not apply to a baseline.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod latency;
mod model;
mod signal;
mod spectrum;

pub use latency::Latency;
pub use model::{Chamfer, GaussianCount, ModelSize};
pub use signal::{ChannelSnr, PowerError};
pub use spectrum::{DirectionError, L1, Psnr, RateRatio, Ssim};

use pwrfgs_core::{Error, Evaluation, Goal, Image, Measurement, Metric, Result, Values};
use rayon::prelude::*;

/// Returns [`Values::NotApplicable`] with the reason if `metric` does not support the task of these observations, otherwise
/// `None`.
fn unsupported_task(metric: &dyn Metric, evaluation: &Evaluation<'_>) -> Option<Values> {
    let why = || format!("the metric does not support {}", evaluation.task.plural);
    (!metric.tasks().contains(&evaluation.task)).then(|| Values::NotApplicable(why()))
}

/// Returns `score(prediction, truth)` of every sample, in order, if `metric` supports them, otherwise
/// [`Values::NotApplicable`]; the prediction is not clamped. Errors are those of [`check_paired`].
fn score_samples(
    metric: &dyn Metric,
    evaluation: &Evaluation<'_>,
    score: impl Fn(&Image, &Image) -> f64 + Sync,
) -> Result<Values> {
    if let Some(unsupported) = unsupported_task(metric, evaluation) {
        return Ok(unsupported);
    }
    check_paired(evaluation)?;
    let both = evaluation.predictions.par_iter().zip(evaluation.truths);
    Ok(Values::PerSample(both.map(|(p, t)| score(p, t)).collect()))
}

/// Rejects predictions that differ from the measurements in number or size.
fn check_paired(evaluation: &Evaluation<'_>) -> Result<()> {
    let (predictions, truths) = (evaluation.predictions, evaluation.truths);
    let size = |i: &Image| (i.width, i.height, i.pixels.len());
    let paired = predictions.iter().zip(truths).all(|(p, t)| size(p) == size(t));
    if predictions.len() != truths.len() || !paired {
        let plural = evaluation.task.plural;
        let problem = "differ in number or size; evaluate on data of the size trained on";
        return Err(Error::Config(format!("predicted and measured {plural} {problem}")));
    }
    Ok(())
}

/// Returns a single measurement in the form of [`pwrfgs_core::Metric::evaluate`].
fn single_measurement(key: &str, unit: &str, goal: Goal, values: Values) -> Vec<Measurement> {
    vec![create_measurement(key, unit, goal, values)]
}

/// Creates a measurement without note.
fn create_measurement(key: &str, unit: &str, goal: Goal, values: Values) -> Measurement {
    Measurement { key: key.to_owned(), unit: unit.to_owned(), goal, values, note: None }
}

/// Returns [`Values::NotApplicable`] of a metric of the model for a baseline.
fn not_a_model() -> Values {
    Values::NotApplicable("a baseline has no Gaussians".to_owned())
}

/// Returns [`Values::NotApplicable`] of a metric of Gaussians for a model without Gaussians.
fn no_gaussians() -> Values {
    Values::NotApplicable("the method has no Gaussians".to_owned())
}

/// Test data for metrics.
#[cfg(test)]
mod fixture {
    use pwrfgs_core::{
        AngleAxis, End, Evaluation, Image, ImagePlane, Measurement, Metric, ModelFacts, Origin, Pose, Real, Receiver,
        Scene, StageTimes, Task, Values,
    };

    pub(crate) fn scene(points: &[[Real; 3]]) -> Scene {
        Scene {
            origin: Origin::ZERO,
            geodetic: None,
            moving: End::Transmitter,
            transmitter: None,
            receivers: vec![Receiver::new("receiver", Pose::IDENTITY)],
            bounds: ([0.0; 3], [1.0; 3]),
            points: points.to_vec(),
            floors: std::collections::BTreeMap::new(),
        }
    }

    /// Creates a plane of one degree per pixel, as measured.
    pub(crate) fn plane(width: usize, height: usize) -> ImagePlane {
        let axis = AngleAxis { first: 0.0, step: 1.0 };
        ImagePlane { wraps: true, angles: Some((axis, axis)), ..ImagePlane::plain(width, height) }
    }

    /// Creates an image of zeros except the listed pixels.
    pub(crate) fn spots(width: usize, height: usize, spots: &[(usize, usize, Real)]) -> Image {
        let mut image = Image::zeros(width, height);
        for (x, y, value) in spots {
            image.pixels[y * width + x] = *value;
        }
        image
    }

    pub(crate) fn of_pictures(metric: &dyn Metric, prediction: &Image, truth: &Image) -> Measurement {
        of_plane(metric, prediction, truth, &plane(truth.width, truth.height))
    }

    pub(crate) fn of_plane(metric: &dyn Metric, prediction: &Image, truth: &Image, plane: &ImagePlane) -> Measurement {
        let (predictions, truths) = (std::slice::from_ref(prediction), std::slice::from_ref(truth));
        let scene = scene(&[]);
        let evaluation = Evaluation { predictions, truths, ..spectra(plane, &scene) };
        metric.evaluate(&evaluation).unwrap().remove(0)
    }

    /// Creates an evaluation of spectra without samples.
    pub(crate) fn spectra<'a>(plane: &'a ImagePlane, scene: &'a Scene) -> Evaluation<'a> {
        Evaluation {
            predictions: &[],
            truths: &[],
            energies: &[],
            task: Task::Spectrum,
            links: &[],
            plane,
            scene,
            model: None,
            timed_prediction: None,
        }
    }

    pub(crate) fn of_kind(metric: &dyn Metric, task: Task, prediction: &Image, truth: &Image) -> Vec<Measurement> {
        let (predictions, truths) = (std::slice::from_ref(prediction), std::slice::from_ref(truth));
        let (plane, scene) = (plane(truth.width, truth.height), scene(&[]));
        metric.evaluate(&Evaluation { task, predictions, truths, ..spectra(&plane, &scene) }).unwrap()
    }

    pub(crate) fn of_model(metric: &dyn Metric, model: Option<ModelFacts<'_>>, scene: &Scene) -> Vec<Measurement> {
        of_timed(metric, model, scene, None)
    }

    pub(crate) fn of_timed(
        metric: &dyn Metric,
        model: Option<ModelFacts<'_>>,
        scene: &Scene,
        timed_prediction: Option<&dyn Fn() -> StageTimes>,
    ) -> Vec<Measurement> {
        let plane = plane(4, 3);
        metric.evaluate(&Evaluation { model, timed_prediction, ..spectra(&plane, scene) }).unwrap()
    }

    pub(crate) fn value(measurement: &Measurement) -> f64 {
        match &measurement.values {
            Values::PerSample(values) => values[0],
            Values::Whole(value) => *value,
            Values::NotApplicable(why) => panic!("{why}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_images_of_different_size() {
        let (small, large) = (Image::zeros(3, 3), Image::zeros(4, 3));
        let (plane, scene) = (fixture::plane(4, 3), fixture::scene(&[]));
        let (predictions, truths) = (&[small][..], &[large][..]);
        let evaluation = Evaluation { predictions, truths, ..fixture::spectra(&plane, &scene) };
        assert!(L1 {}.evaluate(&evaluation).is_err());
        assert!(L1 {}.evaluate(&Evaluation { truths: &[], ..evaluation }).is_err());
    }

    #[test]
    fn no_samples_give_no_scores() {
        let measured = fixture::of_model(&Ssim {}, None, &fixture::scene(&[]));
        assert_eq!(measured[0].values, Values::PerSample(vec![]));
    }
}
