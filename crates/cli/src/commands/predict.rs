//! `pwrfgs predict`: predictions at transmitter positions, from the model file alone.

mod writers;

use super::options::{check_positions, chosen, numbers, position, read_models};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::{read_poses, read_transmitters};
use pwrfgs::experiment::Observer as _;
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::{Ensemble, IntervalFactors, Prepared, TrainingDistances};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Pose, Predict as _, Query, Result, Task};
use std::path::PathBuf;
use writers::{OutputFolder, PredictedRow, PredictionImage, PredictionRow, writer};

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
  pwrfgs predict runs/ble --tx-csv walk.csv --receiver g01 --out walk-g01")]
#[command(group(clap::ArgGroup::new("where").required(true).args(["tx", "tx_csv"])))]
pub(crate) struct Predict {
    /// Run folder or model file; several form an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// One transmitter position in metres, world frame; for a moving receiver its position, and optionally its
    /// orientation as a quaternion: x,y,z,qx,qy,qz,qw
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
    /// CSV file of positions: columns x, y, z in metres, and qx, qy, qz, qw for a moving receiver; others are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) tx_csv: Option<PathBuf>,
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

pub(crate) fn predict(arguments: &Predict, verbosity: Verbosity) -> Result<()> {
    let ensemble = read_models(&arguments.models)?;
    let setup = &ensemble.members()[0].stages.setup;
    let places = places(arguments, setup.moves.then(|| setup.pose().orientation))?;
    let txs: Vec<[f64; 3]> = places.iter().map(|place| place.tx).collect();
    check_positions(&ensemble)?;
    let distances = ensemble.training_distances(&txs);
    let model = ensemble.prepare();
    let task = model.task();
    let listening = chosen(model.receivers(), &arguments.receiver)?;
    let count = txs.len() * listening.len();
    if arguments.stacked && task.is_scalar {
        let why = "--stacked: not supported for received powers, which are all in predictions.csv; remove --stacked";
        return Err(Error::Config(why.into()));
    }
    let factors = arguments.interval.map(|level| factors(&ensemble, level)).transpose()?;
    let made = NewFolder::begin(&arguments.out)?;
    let folder = OutputFolder { folder: &made, has_png: !arguments.no_png, stacked: arguments.stacked };
    let mut writer = writer(&folder, &model, count, factors.is_some())?;
    let mut progress = RunProgress::new(verbosity);
    let mut list = writer.header();
    let is_named = !task.has_pixels || model.receivers().len() > 1;
    let row = |k: usize| {
        let (tx, receiver) = (txs[k / listening.len()], listening[k % listening.len()]);
        PredictionRow {
            number: k + 1,
            tx,
            orientation: places[k / listening.len()].orientation,
            receiver,
            name: is_named.then(|| model.receivers()[receiver].name.as_str()),
            training_distance: distances.as_ref().map(|all| all.metres[k / listening.len()]),
        }
    };
    for first in (0..count).step_by(CHUNK) {
        progress.on_stage("predicting", first, count);
        let rows = (first..(first + CHUNK).min(count)).map(row).map(|row| draw(&model, row, factors.as_ref()));
        writer.take(&folder, &rows.collect::<Result<Vec<_>>>()?, &mut list)?;
    }
    progress.finish();
    writer.finish()?;
    folder.put("predictions.csv", list.as_bytes())?;
    made.publish()?;
    match &distances {
        Some(distances) => extrapolation(distances).iter().for_each(|warning| output::warning(warning)),
        None => verbosity.note("note: the model has no training positions, so extrapolations are not marked"),
    }
    let kind = if count == 1 { task.singular } else { task.plural };
    verbosity.note(&format!("{} {kind} in {}", grouped(count as i64), arguments.out.display()));
    Ok(())
}

/// Positions to predict at, with orientations of a moving receiver: `level` if none is given.
fn places(arguments: &Predict, level: Option<[f64; 4]>) -> Result<Vec<Query<'static>>> {
    let at = |pose: Pose| Query { orientation: Some(pose.orientation), ..Query::at(pose.position, 0) };
    match (&arguments.tx, &arguments.tx_csv) {
        (Some(text), _) => match numbers::<7>(text).filter(|_| level.is_some()) {
            Some([x, y, z, orientation @ ..]) => {
                let pose = Pose { position: [x, y, z], orientation };
                let wrong = |(_, fault)| Err(Error::Config(format!("--tx {text}: {fault}")));
                pose.fault().map_or(Ok(vec![at(pose)]), wrong)
            }
            None => Ok(vec![Query { orientation: level, ..position("--tx", text)?.into() }]),
        },
        (_, Some(path)) if level.is_some() => Ok(read_poses(path)?.into_iter().map(at).collect()),
        (_, Some(path)) => Ok(read_transmitters(path)?.into_iter().map(Query::from).collect()),
        _ => Err(Error::Config("no positions; set --tx x,y,z or --tx-csv FILE".into())),
    }
}

/// Factors of prediction intervals of this level.
fn factors(ensemble: &Ensemble, level: f64) -> Result<IntervalFactors> {
    let refuse = |what: &str| Err(Error::Config(format!("--interval: {what}")));
    if ensemble.members()[0].stages.task.is_complex {
        return refuse("not supported for channels; remove --interval");
    }
    match ensemble.calibration() {
        Some(calibration) => calibration.factors(level),
        None => {
            refuse("the model has no calibration; give one model file, as a run with a `validation` share wrote it")
        }
    }
}

/// Warning about extrapolations.
fn extrapolation(distances: &TrainingDistances) -> Option<String> {
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

/// Predicts one row; rows are predicted one after another, so that each latency is measured without other load.
fn draw<'a>(
    model: &Prepared<'_>,
    row: PredictionRow<'a>,
    factors: Option<&IntervalFactors>,
) -> Result<PredictedRow<'a>> {
    let query = Query { orientation: row.orientation, ..Query::at(row.tx, row.receiver) };
    let (image, spread, times) = if model.models().count() == 1 {
        let (image, times) = model.predict_timed(query);
        (image, None, times)
    } else {
        let (image, spread, times) = model.predict_with_deviation(query);
        (image, Some(spread), times)
    };
    if !image.pixels.iter().all(|p| p.is_finite()) {
        return Err(not_finite(model.task(), &row));
    }
    let interval = factors.map(|factors| {
        let deviation = model.deviation(query).unwrap_or(1.0);
        factors.interval(model.task(), &model.task().shown(image.clone()), deviation)
    });
    Ok((row, PredictionImage { image, spread, interval, milliseconds: 1e3 * times.total }))
}

fn not_finite(task: Task, row: &PredictionRow<'_>) -> Error {
    let what = task.singular;
    Error::Config(format!(
        "row {}: the {what} of a transmitter at {:?} is not finite: the model overflows there; remove the position if it \
         is far from the training positions, or train again with lower learning rates",
        row.number, row.tx
    ))
}
