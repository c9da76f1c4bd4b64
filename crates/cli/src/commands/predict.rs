//! `pwrfgs predict`: predictions at transmitter positions or receiver poses, from the model file alone.

mod writers;

use super::options::{check_position_input, parse_numbers, parse_position, read_models, select_receivers};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::{read_poses, read_transmitters};
use pwrfgs::experiment::Observer as _;
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::{Ensemble, IntervalFactors, Prepared, TrainingDistances};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{End, Error, Pose, Predict as _, Query, Result, Task};
use std::path::PathBuf;
use writers::{PredictedRow, PredictionImage, PredictionRow, PredictionWriter};

/// Number of predictions in memory at a time.
const CHUNK: usize = 64;

#[derive(Debug, Args)]
#[command(after_help = "\
Needs only the model. Writes all files or none. predictions.csv has a row per position and
receiver, with the latency in ms, the distance to the nearest training position in metres and:
  spectra   azimuth and elevation of the strongest direction in degrees, and its value
  powers    power in dBm
  channels  mean power of the gains in dB
Spectra are float32 [elevation, azimuth] in 00001.npy, .. and 8-bit 00001.png, ..; channels are
complex64 [antennas, subcarriers] in 00001.npy, .. --stacked: spectra.npy or channels.npy.
An ensemble predicts the mean of its members (spectra clamped to [0, 1]) and writes their standard
deviation: 00001-spread.npy and .png (white: 0.5), spread.npy, or column spread_db for powers.
--interval adds a band per pixel (00001-lower.npy and -upper.npy with .png, or lower.npy and upper.npy)
and column ssim_bound, or columns lower_dbm and upper_dbm. Not for channels.
A warning counts extrapolations: positions farther from all training positions than 3 times their
spacing (95th percentile of nearest-neighbour distances).

EXAMPLES
  pwrfgs predict runs/quickstart --tx 3.5,2.2,1.2 --out predicted
  pwrfgs predict runs/quickstart --tx 3.5,2.2,1.2 --interval 0.9 --out band
  printf 'x,y,z\\n3,2,1.1\\n4,3,1.2\\n' > walk.csv
  pwrfgs predict runs/quickstart --tx-csv walk.csv --stacked --no-png --out walk
  pwrfgs predict runs/ble --tx-csv walk.csv --receiver g01 --out walk-g01
  pwrfgs predict runs/lobby --rx-pose 3.5,2.2,1.2,0,0,0,1 --out turned    (the receiver moves)")]
#[command(group(clap::ArgGroup::new("where").required(true).args(["tx", "tx_csv", "rx_pose", "rx_pose_csv"])))]
pub(crate) struct Predict {
    /// Run folder or model file; several form an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// One transmitter position in metres, world frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
    /// CSV file of transmitter positions: columns x, y, z in metres; others are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) tx_csv: Option<PathBuf>,
    /// One pose of a moving receiver: position, and orientation as a quaternion from receiver to world axes
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", allow_hyphen_values = true)]
    pub(crate) rx_pose: Option<String>,
    /// CSV file of poses of a moving receiver: columns x, y, z, qx, qy, qz, qw; others are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) rx_pose_csv: Option<PathBuf>,
    /// Add prediction intervals that hold with this probability, such as 0.9
    #[arg(long, value_name = "LEVEL", allow_hyphen_values = true)]
    pub(crate) interval: Option<f64>,
    /// Output folder; must be new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Predict only for this receiver (name in the data set); repeatable
    #[arg(long, value_name = "NAME")]
    pub(crate) receiver: Vec<String>,
    /// Write all spectra or channels as one array, which may exceed memory
    #[arg(long)]
    pub(crate) stacked: bool,
    /// Write no PNG images
    #[arg(long)]
    pub(crate) no_png: bool,
}

/// Runs `pwrfgs predict`: writes the predictions and warns of extrapolations.
pub(crate) fn predict(arguments: &Predict, verbosity: Verbosity) -> Result<()> {
    let ensemble = read_models(&arguments.models)?;
    let poses = read_moving_poses(arguments, ensemble.members()[0].stages.setup.moving)?;
    let positions: Vec<[f64; 3]> = poses.iter().map(|pose| pose.position).collect();
    check_position_input(&ensemble)?;
    let distances = ensemble.training_distances(&positions);
    let model = ensemble.prepare();
    let task = model.task();
    let receivers = select_receivers(model.receivers(), &arguments.receiver)?;
    let count = poses.len() * receivers.len();
    if arguments.stacked && task.shape((1, 1)).is_empty() {
        let why = "--stacked: not supported for received powers, which are all in predictions.csv; remove --stacked";
        return Err(Error::Config(why.into()));
    }
    let factors = arguments.interval.map(|level| interval_factors(&ensemble, level)).transpose()?;
    let folder = NewFolder::begin(&arguments.out)?;
    let mut writer = PredictionWriter::new(folder, &model, !arguments.no_png, factors.is_some());
    if arguments.stacked {
        writer.create_stacks(count)?;
    }
    let mut progress = RunProgress::new(verbosity);
    let predictor = RowPredictor { model: &model, poses, receivers, distances, factors };
    for first in (0..count).step_by(CHUNK) {
        progress.on_stage("predicting", first, count);
        let rows = (first..(first + CHUNK).min(count)).map(|k| predictor.predict_row(k));
        writer.write(&rows.collect::<Result<Vec<_>>>()?)?;
    }
    progress.remove_bar();
    writer.finish()?;
    match &predictor.distances {
        Some(distances) => extrapolation_warning(distances).iter().for_each(|warning| output::print_warning(warning)),
        None => verbosity.print_note("note: the model has no training positions, so extrapolations are not marked"),
    }
    let kind = if count == 1 { task.singular } else { task.plural };
    verbosity.print_note(&format!("{} {kind} in {}", grouped(count as i64), arguments.out.display()));
    Ok(())
}

/// Reads the positions or poses of the end that moves, at which to predict; an error if the arguments give the other
/// end.
fn read_moving_poses(arguments: &Predict, moving: End) -> Result<Vec<Pose>> {
    let Predict { tx, tx_csv, rx_pose, rx_pose_csv, .. } = arguments;
    let refuse =
        |end: &str, advice: &str| Err(Error::Config(format!("the {end} of this model moves; give its {advice}")));
    let has_transmitters = tx.is_some() || tx_csv.is_some();
    if has_transmitters && moving.is_receiver() {
        return refuse("receiver", "poses with --rx-pose or --rx-pose-csv instead of --tx");
    }
    if !has_transmitters && !moving.is_receiver() {
        return refuse("transmitter", "positions with --tx or --tx-csv instead of --rx-pose");
    }
    match (tx, tx_csv, rx_pose, rx_pose_csv) {
        (Some(text), ..) => Ok(vec![parse_position("--tx", text)?.into()]),
        (_, Some(path), ..) => Ok(read_transmitters(path)?.into_iter().map(Pose::from).collect()),
        (.., Some(text), _) => {
            let refuse = |fault: &str| Err(Error::Config(format!("--rx-pose {text}: {fault}")));
            let Some([x, y, z, orientation @ ..]) = parse_numbers::<7>(text) else {
                return refuse("expected x,y,z,qx,qy,qz,qw, such as 3.5,2.2,1.2,0,0,0,1 for no rotation");
            };
            let pose = Pose { position: [x, y, z], orientation };
            pose.fault().map_or(Ok(vec![pose]), |(_, fault)| refuse(&fault))
        }
        (.., Some(path)) => read_poses(path),
        _ => Err(Error::Config("no positions; set --tx x,y,z or --tx-csv FILE".into())),
    }
}

/// Returns the factors of prediction intervals of this level, a probability; an error without a calibration of them.
fn interval_factors(ensemble: &Ensemble, level: f64) -> Result<IntervalFactors> {
    let refuse = |problem: &str| Err(Error::Config(format!("--interval: {problem}")));
    if ensemble.members()[0].stages.task.intervals.is_none() {
        return refuse("not supported for channels; remove --interval");
    }
    match ensemble.calibration() {
        Some(calibration) => calibration.factors(level),
        None => {
            refuse("the model has no calibration; give one model file, as a run with a `validation` share wrote it")
        }
    }
}

/// Describes the extrapolations; `None` without any.
fn extrapolation_warning(distances: &TrainingDistances) -> Option<String> {
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
    poses: Vec<Pose>,
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
