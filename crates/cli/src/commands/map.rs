//! `pwrfgs map`: what a model predicts everywhere on a plane, as pictures and arrays.

mod layers;
mod output;
mod plane;

use super::evaluate::read_models;
use super::receivers::{check_positions, chosen};
use crate::args::Verbosity;
use crate::output as terminal;
use crate::progress::Progress;
use clap::Args;
use layers::{Of, layers, quantities};
use plane::{Bounds, Grid, Plane};
use pwrfgs::experiment::Observer as _;
use pwrfgs::experiment::text::grouped;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Pose, Result};
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
#[command(
    after_long_help = "A radio map: the model is asked for a transmitter at every place of a grid on a plane, and what a \
    receiver would observe of it is drawn.\n\nWHAT IS MAPPED\n  received powers   power in dBm at each receiver, and at the \
    strongest of them\n  spectra           azimuth and elevation of the strongest direction (degrees, receiver's frame; \
    arrows show it in the room) and its level; with --of mean the mean level\n  channels          mean power over antennas \
    and subcarriers, dB\n\nFILES\n  power.npy (or power-NAME.npy where there are several receivers) and so on: float32 [rows, \
    columns], the lowest row first; power.png: the same as a picture, receivers as squares; map.csv: for each array its \
    quantity, receiver, and where its rows and columns lie in metres. The folder is whole or not there.\n\nWithout --bounds the \
    map holds the middle nine tenths of the model's Gaussians and all receivers, which may be more or less than the room: \
    a model knows nothing where nobody measured, and says something nevertheless.\n\nEXAMPLES\n  pwrfgs map \
    runs/ble/model.safetensors --plane z=0 --step 0.25 --receiver g01 --out g01\n  pwrfgs map \
    runs/quickstart/model.safetensors --plane z=1.2 --of direction --bounds 0,8,0,6 --out directions\n  python3 -c \"import \
    numpy; m = numpy.load('g01/power-g01.npy'); print(m.shape, m.max())\""
)]
pub(crate) struct Map {
    /// The trained model, model.safetensors of a run folder; several predict as an ensemble
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// The coordinate that stays, and where in metres, such as z=1.2; x and y as well
    #[arg(long, value_name = "AXIS=M")]
    pub(crate) plane: String,
    /// Metres between two places
    #[arg(long, value_name = "M", default_value_t = 0.1)]
    pub(crate) step: f64,
    /// Ends of the map in metres: the first coordinate of the plane from and to, then the second
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true)]
    pub(crate) bounds: Option<String>,
    /// A receiver that is mapped, by its name in the data; may be given several times [default: all]
    #[arg(long, value_name = "NAME")]
    pub(crate) receiver: Vec<String>,
    /// What is mapped; may be given several times [default: power, or direction and level]
    #[arg(long, value_enum)]
    pub(crate) of: Vec<Of>,
    /// The folder to write; it must not hold anything
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

pub(crate) fn map(arguments: &Map, verbosity: Verbosity) -> Result<ExitCode> {
    let plane = Plane::parse(&arguments.plane)?;
    let bounds = arguments.bounds.as_ref().map(|text| Bounds::parse(text, plane.names())).transpose()?;
    let ensemble = read_models(&arguments.models)?;
    check_positions(&ensemble)?;
    let model = ensemble.prepare();
    let of = quantities(&model, &arguments.of)?;
    let receivers = chosen(model.receivers(), &arguments.receiver)?;
    let origin = ensemble.members()[0].stages.origin;
    let poses: Vec<Pose> = model.receivers().iter().map(|receiver| origin.world_pose(receiver.pose)).collect();
    if bounds.is_none() && ensemble.gaussians() == 0 {
        let what = "the model has no Gaussians that would say where the room is; give --bounds";
        return Err(pwrfgs_core::Error::Config(what.into()));
    }
    let bounds = bounds.unwrap_or_else(|| {
        let means =
            ensemble.members().iter().flat_map(|own| own.cloud.means.iter().map(|mean| own.stages.origin.world(*mean)));
        let listening: Vec<[f64; 2]> = receivers.iter().map(|&r| plane.flat(poses[r].position)).collect();
        let bounds =
            Bounds::around(means.map(|place| plane.flat(place)).collect(), &listening).outwards(arguments.step);
        if verbosity != Verbosity::Quiet {
            terminal::note(&said(plane, bounds));
        }
        bounds
    });
    let grid = Grid::new(plane, bounds, arguments.step, receivers.len())?;
    let folder = NewFolder::begin(&arguments.out)?;
    let mut progress = Progress::new(verbosity);
    let layers = layers(&model, &grid, &receivers, &of, |done| progress.on_stage("mapping", done, grid.len()));
    progress.finish();
    output::write(folder.path(), &grid, &layers, model.receivers(), &poses, &receivers)?;
    folder.publish()?;
    if verbosity != Verbosity::Quiet {
        let missing = layers.iter().flat_map(|layer| &layer.values).filter(|v| !v.is_finite()).count();
        if missing > 0 {
            let missing = grouped(missing as i64);
            terminal::note(&format!(
                "warning: {missing} values are not finite and grey: numbers of the model overflow there"
            ));
        }
        let (columns, rows) = (grouped(grid.columns as i64), grouped(grid.rows as i64));
        let maps = if layers.len() == 1 { "1 map".into() } else { format!("{} maps", layers.len()) };
        terminal::note(&format!("{maps} of {columns} by {rows} places in {}", arguments.out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// What is mapped where nobody says.
fn said(plane: Plane, Bounds([across, up]): Bounds) -> String {
    let ([a, b], short) = (plane.names(), |v: f64| (v * 100.0).round() / 100.0);
    format!(
        "{a} from {} to {} m, {b} from {} to {} m: the middle nine tenths of the Gaussians, and the receivers; --bounds changes it",
        short(across[0]),
        short(across[1]),
        short(up[0]),
        short(up[1])
    )
}
