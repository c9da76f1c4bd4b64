//! Predictions at many positions, written to a folder as arrays, images and a table.

mod writers;

use crate::models::{check_positions, select_receivers};
use clap::Args;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Pose, Predict as _, Query, Result, Task};
use pwrfgs_experiment::{Observer, text::grouped};
use pwrfgs_model::{Ensemble, IntervalFactors, Prepared, TrainingDistances};
use writers::{PredictedRow, PredictionImage, PredictionRow, PredictionWriter};

/// Number of predictions in memory at a time.
const CHUNK: usize = 64;

/// Settings of [`write_predictions`].
#[derive(Clone, Debug, Default, Args)]
pub struct PredictSettings {
    /// Add prediction intervals that hold with this probability, such as 0.9
    #[arg(long, value_name = "LEVEL", allow_hyphen_values = true)]
    pub interval: Option<f64>,
    /// Predict only for this receiver (name in the data set); repeatable
    #[arg(long, value_name = "NAME")]
    pub receiver: Vec<String>,
    /// Write all spectra or channels as one array, which may exceed memory
    #[arg(long)]
    pub stacked: bool,
    /// Write no PNG images
    #[arg(long)]
    pub no_png: bool,
}

/// Outcome of [`write_predictions`].
#[derive(Debug)]
pub struct PredictionCount {
    /// Number of predictions: positions times receivers.
    pub count: usize,
    /// Distances of the positions to the training positions; `None` if the model has none.
    pub distances: Option<TrainingDistances>,
}

/// Predicts at the `poses` of the end that moves, and writes the predictions into `folder`. `observer` receives the progress.
///
/// # Errors
/// Invalid settings, a model whose input is not a position, a prediction that is not finite, or a file that cannot be written.
pub fn write_predictions(
    ensemble: &Ensemble,
    poses: &[Pose],
    settings: &PredictSettings,
    folder: &NewFolder,
    observer: &mut dyn Observer,
) -> Result<PredictionCount> {
    check_positions(ensemble)?;
    let positions: Vec<[f64; 3]> = poses.iter().map(|pose| pose.position).collect();
    let distances = ensemble.training_distances(&positions);
    let model = ensemble.prepare();
    let task = model.task();
    let receivers = select_receivers(model.receivers(), &settings.receiver)?;
    let count = poses.len() * receivers.len();
    if settings.stacked && task.shape((1, 1)).is_empty() {
        let why = "--stacked: not supported for received powers, which are all in predictions.csv; remove --stacked";
        return Err(Error::Config(why.into()));
    }
    let factors = settings.interval.map(|level| interval_factors(ensemble, level)).transpose()?;
    let mut writer = PredictionWriter::new(folder, &model, !settings.no_png, factors.is_some());
    if settings.stacked {
        writer.create_stacks(count)?;
    }
    let predictor = RowPredictor { model: &model, poses, receivers, distances, factors };
    for first in (0..count).step_by(CHUNK) {
        observer.on_stage("predicting", first, count);
        let rows = (first..(first + CHUNK).min(count)).map(|k| predictor.predict_row(k));
        writer.write(&rows.collect::<Result<Vec<_>>>()?)?;
    }
    observer.on_stage("predicting", count, count);
    writer.finish()?;
    Ok(PredictionCount { count, distances: predictor.distances })
}

/// Returns the factors of prediction intervals of this `level`, a probability.
///
/// # Errors
/// A model of channels, or without calibration, or a level for which it has too few samples.
pub fn interval_factors(ensemble: &Ensemble, level: f64) -> Result<IntervalFactors> {
    let refuse = |problem: &str| Err(Error::Config(format!("--interval: {problem}")));
    if ensemble.members()[0].stages.task.intervals.is_none() {
        return refuse("not supported for channels; remove --interval");
    }
    match ensemble.calibration() {
        Some(calibration) => calibration.factors(level),
        None => {
            refuse("the model has no calibration; use the model of a single run whose split has a `validation` share")
        }
    }
}

/// Describes the extrapolations; `None` without any.
pub fn extrapolation_warning(distances: &TrainingDistances) -> Option<String> {
    let TrainingDistances { metres, limit } = distances;
    let beyond: Vec<f64> = (0..metres.len()).filter(|&k| distances.is_beyond(k)).map(|k| metres[k]).collect();
    let largest = beyond.iter().copied().reduce(f64::max)?;
    Some(format!(
        "{} of {} predictions are extrapolations: farther than {limit:.2} m from all training positions (up to \
         {largest:.2} m)",
        grouped(beyond.len() as i64),
        grouped(metres.len() as i64)
    ))
}

/// Predictor of a row per pair of pose and receiver.
struct RowPredictor<'a> {
    model: &'a Prepared<'a>,
    /// Poses of the moving end.
    poses: &'a [Pose],
    /// Indices of the receivers.
    receivers: Vec<usize>,
    /// Distances of the poses to the training positions; none if unknown.
    distances: Option<TrainingDistances>,
    factors: Option<IntervalFactors>,
}

impl RowPredictor<'_> {
    /// Predicts row `k`, receiver by receiver; an error if the prediction is not finite. Rows are predicted one after
    /// another, so that each latency is measured without other load.
    fn predict_row(&self, k: usize) -> Result<PredictedRow<'_>> {
        let (model, task) = (self.model, self.model.task());
        let (p, receiver) = (k / self.receivers.len(), self.receivers[k % self.receivers.len()]);
        let is_named = !task.has_pixels || model.receivers().len() > 1;
        let row = PredictionRow {
            number: k + 1,
            pose: self.poses[p],
            has_orientation: model.moving().is_receiver(),
            name: is_named.then(|| model.receivers()[receiver].name.as_str()),
            training_distance: self.distances.as_ref().map(|distances| distances.metres[p]),
            geodetic: self.model.setup().geodetic,
        };
        let query = Query::at(row.pose, receiver);
        let (image, spread, times) = if model.models().count() == 1 {
            let (image, times) = model.predict_timed(query);
            (image, None, times)
        } else {
            let (image, spread, times) = model.predict_with_deviation(query);
            (image, Some(spread), times)
        };
        if !image.pixels.iter().all(|p| p.is_finite()) {
            return Err(not_finite_error(task, &row));
        }
        let interval = self.factors.as_ref().map(|factors| {
            let deviation = model.deviation(query).unwrap_or(1.0);
            factors.interval(task, &task.shown(image.clone()), deviation)
        });
        Ok((row, PredictionImage { image, spread, interval, milliseconds: 1e3 * times.total }))
    }
}

/// Creates the error for a prediction that is not finite.
fn not_finite_error(task: Task, row: &PredictionRow<'_>) -> Error {
    let observation = task.singular;
    Error::Config(format!(
        "row {}: the {observation} at {:?} is not finite: the model overflows there; remove the position if it \
         is far from the training positions, or train again with lower learning rates",
        row.number, row.pose.position
    ))
}
