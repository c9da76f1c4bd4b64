//! Predictions at many positions, written to a folder as arrays, images and a table.

mod writers;

use crate::models::{check_positions, select_receivers};
use clap::Args;
use pwrfgs_core::files::{PartialFolder, digest};
use pwrfgs_core::statistics::median;
use pwrfgs_core::{Error, Image, Pose, Predict as _, Query, Result, Task, device};
use pwrfgs_experiment::{Session, text::grouped};
use pwrfgs_model::{Ensemble, IntervalFactors, Prepared, TrainingDistances, file};
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};
use writers::{PredictedRow, PredictionImage, PredictionRow, PredictionWriter};

/// Number of predictions per call of the model.
const CALL: usize = 64;
/// Largest number of values that are in memory, and lost if the process is killed, unless [`CALL`] predictions have more.
const VALUES: usize = 1 << 22;
/// Largest number of predictions that are in memory.
const ROWS: usize = 2_048;
/// Largest number of single predictions from which the latency is measured.
const TIMED: usize = 64;
/// Time after which the latency is measured from the predictions so far.
const PATIENCE: Duration = Duration::from_secs(2);

/// Settings of [`write_predictions`].
#[derive(Clone, Debug, Default, Args)]
pub struct PredictSettings {
    /// Add prediction intervals that contain the observation with this probability, such as 0.9
    #[arg(long, value_name = "LEVEL", allow_hyphen_values = true)]
    pub interval: Option<f64>,
    /// Predict only for this receiver (name in the data set); repeatable
    #[arg(long, value_name = "NAME")]
    pub receiver: Vec<String>,
    /// Write all spectra or all channels as one array, which may be larger than memory
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
    /// Number of single predictions that were timed, and their median time in milliseconds.
    pub latency: (usize, f64),
}

/// Predicts at the `poses` of the end that moves, and writes the predictions into the folder `out`. If it stops early, the
/// complete rows stay in a folder with the suffix `.partial`, from which the same call continues.
///
/// # Errors
/// Invalid settings, a model whose input is not a position, a prediction that is not finite, or a file that cannot be written;
/// `out` is not empty, or its partial folder has predictions of other models, positions or settings; [`Error::Stopped`] once
/// the session is stopped.
pub fn write_predictions(
    ensemble: &Ensemble,
    poses: &[Pose],
    settings: &PredictSettings,
    out: &Path,
    session: &mut Session<'_>,
) -> Result<PredictionCount> {
    check_positions(ensemble)?;
    let task = ensemble.members()[0].stages.task;
    let receivers = select_receivers(&ensemble.members()[0].stages.setup.receivers, &settings.receiver)?;
    if settings.stacked && task.shape((1, 1)).is_empty() {
        let why = "--stacked: not supported for received powers, which are all in predictions.csv; remove --stacked";
        return Err(Error::Config(why.into()));
    }
    let factors = settings.interval.map(|level| interval_factors(ensemble, level)).transpose()?;
    let folder = PartialFolder::begin(out, &describe_request(ensemble, poses, settings))?;
    let positions: Vec<[f64; 3]> = poses.iter().map(|pose| pose.position).collect();
    let distances = ensemble.training_distances(&positions);
    let model = ensemble.prepare();
    let (count, latency) = {
        let predictor = RowPredictor { model: &model, poses, receivers, distances: distances.as_ref(), factors };
        match predictor.write(&folder, settings, session) {
            Err(error) if error.is_input() => {
                folder.discard(); // other positions, and so another request, are the only remedy
                return Err(error);
            }
            written => written?,
        }
        (predictor.count(), predictor.measure_latency())
    };
    folder.publish()?;
    Ok(PredictionCount { count, distances, latency })
}

/// Describes what determines the output: names of its parts, and their digests.
fn describe_request(ensemble: &Ensemble, poses: &[Pose], settings: &PredictSettings) -> [(&'static str, String); 5] {
    let numbers = poses.iter().flat_map(|pose| pose.position.into_iter().chain(pose.orientation));
    let bytes: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
    let version = env!("CARGO_PKG_VERSION").to_owned();
    let options = digest(format!("{settings:?}").as_bytes());
    let models = digest(&file::ensemble_to_bytes(ensemble));
    let device = digest(device::name().unwrap_or("CPU").as_bytes()); // devices round differently
    [("program", version), ("models", models), ("positions", digest(&bytes)), ("options", options), ("device", device)]
}

/// Returns the factors of prediction intervals of this `level`, a probability.
///
/// # Errors
/// A model of channels, or without calibration; a level that is not between 0 and 1, or for which it has too few samples.
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
    distances: Option<&'a TrainingDistances>,
    factors: Option<IntervalFactors>,
}

impl RowPredictor<'_> {
    /// Returns the number of rows.
    fn count(&self) -> usize {
        self.poses.len() * self.receivers.len()
    }

    /// Predicts and writes the rows that `folder` does not have yet.
    fn write(&self, folder: &PartialFolder, settings: &PredictSettings, session: &mut Session<'_>) -> Result<()> {
        let (model, count) = (self.model, self.count());
        let stacked = settings.stacked.then_some(count);
        let (mut writer, first) =
            PredictionWriter::resume(folder, model, !settings.no_png, self.factors.is_some(), stacked)?;
        if first > 0 {
            session.observer.on_message(&format!(
                "resuming after row {} of {}",
                grouped(first as i64),
                grouped(count as i64)
            ));
        }
        let step = (VALUES / model.setup().value_count().max(1)).clamp(CALL, ROWS);
        for row in (first..count).step_by(step) {
            session.check_stopped()?;
            session.observer.on_stage("predicting", row - first, count - first);
            writer.write(&self.predict_rows(row..(row + step).min(count))?)?;
        }
        session.observer.on_stage("predicting", count - first, count - first);
        Ok(())
    }

    /// Returns row `k`. The rows of a pose are consecutive, one per receiver.
    fn row(&self, k: usize) -> PredictionRow<'_> {
        let (model, task) = (self.model, self.model.task());
        let (p, receiver) = (k / self.receivers.len(), self.receivers[k % self.receivers.len()]);
        let is_named = !task.has_pixels || model.receivers().len() > 1;
        PredictionRow {
            number: k + 1,
            pose: self.poses[p],
            receiver,
            has_orientation: model.moving().is_receiver(),
            name: is_named.then(|| model.receivers()[receiver].name.as_str()),
            training_distance: self.distances.map(|distances| distances.metres[p]),
            geodetic: model.setup().geodetic,
        }
    }

    /// Predicts rows in calls of [`CALL`]; an error if a prediction is not finite or the GPU failed.
    fn predict_rows(&self, rows: Range<usize>) -> Result<Vec<PredictedRow<'_>>> {
        let rows: Vec<_> = rows.map(|k| self.row(k)).collect();
        let predict = |rows: &[PredictionRow<'_>]| {
            let queries: Vec<Query<'_>> = rows.iter().map(PredictionRow::query).collect();
            if self.model.models().count() > 1 {
                let with_spread = |(image, spread)| (image, Some(spread));
                return self.model.predict_many_with_deviation(&queries).into_iter().map(with_spread).collect();
            }
            self.model.predict_many(&queries).into_iter().map(|image| (image, None)).collect::<Vec<_>>()
        };
        let predicted: Vec<_> = rows.par_chunks(CALL).flat_map_iter(predict).collect();
        device::check()?; // before zeros of a failed GPU are written
        let complete = |((image, spread), row)| self.complete_row(row, image, spread);
        predicted.into_par_iter().zip(rows).map(complete).collect()
    }

    /// Adds the interval to a prediction; an error if it is not finite.
    fn complete_row<'r>(
        &self,
        row: PredictionRow<'r>,
        image: Image,
        spread: Option<Image>,
    ) -> Result<PredictedRow<'r>> {
        let task = self.model.task();
        if !image.pixels.iter().all(|p| p.is_finite()) {
            return Err(not_finite_error(task, &row));
        }
        let interval = self.factors.as_ref().map(|factors| {
            let deviation = self.model.deviation(row.query()).unwrap_or(1.0); // equal for all without an estimate
            factors.interval(task, &task.shown(image.clone()), deviation)
        });
        Ok((row, PredictionImage { image, spread, interval }))
    }

    /// Measures the times of single predictions at evenly spaced rows: their number, and their median in milliseconds.
    fn measure_latency(&self) -> (usize, f64) {
        let (begun, count) = (Instant::now(), self.count());
        let timed = count.min(TIMED);
        let time = |k: usize| self.model.predict_timed(self.row(k * count / timed).query()).1.total;
        let times: Vec<f64> = (0..timed).take_while(|k| *k == 0 || begun.elapsed() < PATIENCE).map(time).collect();
        (times.len(), 1e3 * median(times))
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
