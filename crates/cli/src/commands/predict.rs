//! `pwrfgs predict`: predictions at transmitter positions or receiver poses, from the model file alone.

use super::devices::choose_for_predictions;
use crate::interrupt::stop_flag;
use crate::output::{self, INTERRUPTED, SUCCESS, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::{read_frame_positions, read_poses};
use pwrfgs::experiment::{Session, text::grouped};
use pwrfgs::tasks::plane::{parse_pose, parse_position};
use pwrfgs::tasks::predict::{PredictSettings, PredictionCount, extrapolation_warning, write_predictions};
use pwrfgs::tasks::read_models;
use pwrfgs_core::files::PartialFolder;
use pwrfgs_core::statistics::median;
use pwrfgs_core::{Error, Geodetic, MeasurementSetup, Pose, Result};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
The command needs no data. Models in the program: s23, ble, office-channel (`pwrfgs pipelines`
describes them). predictions.csv has a row per position and receiver, with the distance to the
nearest stored training position (at most 1,024 per model) in metres and:
  spectra   azimuth and elevation of the strongest direction (receiver frame, degrees), its value
  powers    power in dBm
  channels  mean power of the gains in dB
Spectra are float32 [elevation, azimuth] in 00001.npy, .. and 8-bit 00001.png, ..; channels are
complex64 [antennas, subcarriers] in 00001.npy, .. (with --stacked: spectra.npy or channels.npy).
An ensemble predicts the mean of its members (spectra clamped to [0, 1]) and writes their standard
deviation: 00001-spread.npy (spread.npy with --stacked), for spectra also 00001-spread.png (white:
0.5), and for powers the column spread_db.
--interval needs a model of a run with a validation set or with `members`, and does not support
channels. For spectra, it writes the ends of an interval per pixel, as arrays (00001-lower.npy and
00001-upper.npy; lower.npy and upper.npy with --stacked) and images (00001-lower.png, ..), and the
column ssim_bound, a lower bound of the SSIM. For powers, it writes the columns lower_dbm and
upper_dbm.
Until the command ends, the predictions are in DIR.partial, next to the folder DIR of --out. Repeat
an interrupted command to resume it. To change models, positions or options, first delete
DIR.partial.
A warning gives the number of extrapolations: positions farther from all stored training positions
than 3 times the spacing of these (95th percentile of nearest-neighbour distances).

EXAMPLES
  pwrfgs predict s23 --tx 0.1,-0.2,1.2 --out predicted
  pwrfgs predict runs/quickstart --tx 3.5,2.2,1.2 --out predicted
  pwrfgs predict runs/quickstart --tx 3.5,2.2,1.2 --interval 0.9 --out band
  printf 'x,y,z\\n3,2,1.1\\n4,3,1.2\\n' > walk.csv
  pwrfgs predict runs/quickstart --tx-csv walk.csv --stacked --no-png --out walk
  pwrfgs predict runs/ble --tx-csv walk.csv --receiver g01 --out walk-g01
  pwrfgs predict runs/lobby --rx-pose 3.5,2.2,1.2,0,0,0,1 --out turned    # moving receiver")]
#[command(group(clap::ArgGroup::new("where").required(true).args(["tx", "tx_csv", "rx_pose", "rx_pose_csv"])))]
pub(crate) struct Predict {
    /// Run folder, model file or name of a model in `pwrfgs pipelines`, such as s23; several models form
    /// an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// One transmitter position in metres, world frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
    /// CSV file of transmitter positions: columns x, y, z in metres or, if the training
    /// data have degrees, latitude, longitude
    #[arg(long, value_name = "FILE")]
    pub(crate) tx_csv: Option<PathBuf>,
    /// One pose of a moving receiver: position, and orientation as a quaternion from receiver to world axes
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", allow_hyphen_values = true)]
    pub(crate) rx_pose: Option<String>,
    /// CSV file of poses of a moving receiver: columns x, y, z, qx, qy, qz, qw; other columns are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) rx_pose_csv: Option<PathBuf>,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) settings: PredictSettings,
}

/// Runs `pwrfgs predict`: writes the predictions and warns of extrapolations; returns the exit code.
pub(crate) fn predict(arguments: &Predict, verbosity: Verbosity) -> Result<u8> {
    let ensemble = read_models(&arguments.models)?;
    let stages = &ensemble.members()[0].stages;
    let height = median(ensemble.training_positions().into_iter().map(|position| position[2]));
    let poses = read_moving_poses(arguments, &stages.setup, if height.is_nan() { 0.0 } else { height })?;
    if let (Some(zero), true) = (stages.geodetic, arguments.tx.is_some()) {
        let Geodetic { latitude, longitude } = zero;
        verbosity.print_note(&format!(
            "note: --tx is in metres east and north of latitude {latitude}, longitude {longitude}; --tx-csv takes degrees too"
        ));
    }
    choose_for_predictions(&ensemble, poses.len(), verbosity);
    let stop = stop_flag();
    let written = RunProgress::observe(verbosity, |progress| {
        let session = &mut Session { stop: &stop, ..Session::new(progress) };
        write_predictions(&ensemble, &poses, &arguments.settings, &arguments.out, session)
    });
    if let Err(Error::Stopped) = written {
        let partial = PartialFolder::path_for(&arguments.out);
        let partial = partial.display();
        output::print_note(&format!("stopped; the predictions so far are in {partial}; repeat the command to resume"));
        return Ok(INTERRUPTED);
    }
    let PredictionCount { count, distances, latency: (timed, milliseconds) } = written?;
    match &distances {
        Some(distances) => extrapolation_warning(distances).iter().for_each(|warning| output::print_warning(warning)),
        None => verbosity.print_note("note: the model has no training positions, so extrapolations are not marked"),
    }
    if let Some(sentence) = ensemble.residuals().and_then(|residuals| residuals.describe_share(stages.task)) {
        verbosity.print_note(&sentence);
    }
    let kind = if count == 1 { stages.task.singular } else { stages.task.plural };
    verbosity.print_note(&format!("{} {kind} in {}", grouped(count as i64), arguments.out.display()));
    let timed = if timed == 1 { "a single prediction".into() } else { format!("median of {timed} single predictions") };
    verbosity.print_note(&format!("latency: {milliseconds:.3} ms, {timed}"));
    Ok(SUCCESS)
}

/// Reads the positions or poses of the moving end, at which to predict. Rows of latitude and longitude without a height get
/// `height`, metres. Returns an error if the arguments give the other end.
fn read_moving_poses(arguments: &Predict, setup: &MeasurementSetup, height: f64) -> Result<Vec<Pose>> {
    let moving = setup.moving;
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
        (_, Some(path), ..) => {
            let positions = read_frame_positions(path, setup.geodetic, height)?;
            Ok(positions.into_iter().map(Pose::from).collect())
        }
        (.., Some(text), _) => Ok(vec![parse_pose("--rx-pose", text)?]),
        (.., Some(path)) => read_poses(path),
        _ => Err(Error::Config("no positions; set --tx x,y,z or --tx-csv FILE".into())),
    }
}
