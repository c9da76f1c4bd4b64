//! `pwrfgs predict`: what is observed of transmitter positions, from the model file alone.

mod writers;

use super::options::{check_positions, chosen, position, positions, read_models};
use crate::output::Verbosity;
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::Observer as _;
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::Prepared;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Query, Result, Task};
use std::path::PathBuf;
use writers::{Drawn, Folder, Row, writer};

/// Predictions held in memory at once.
const CHUNK: usize = 64;

#[derive(Debug, Args)]
#[command(
    after_long_help = "Needs nothing but the model file. What is written depends on what the model was trained on; \
    the folder is whole or not there. One that holds anything, an earlier prediction too, is not touched.\n\nSPECTRA\n  For the first position 00001.npy (float32, rows are \
    elevation, columns azimuth) and 00001.png (8-bit grey), and so on; predictions.csv has row, x, y, z, strongest \
    direction (azimuth and elevation in degrees), its value, and the milliseconds it took. With --stacked all arrays are \
    one, spectra.npy [positions, rows, columns], which may be larger than memory.\nRECEIVED POWERS\n  predictions.csv has a \
    row for every position and receiver: row, x, y, z, receiver, dbm, ms.\nCHANNELS\n  For every position and receiver \
    00001.npy (complex64, rows are antennas, columns subcarriers), with --stacked all in channels.npy [rows of \
    predictions.csv, antennas, subcarriers]; predictions.csv has row, x, y, z, receiver, db (mean power of the gains) and \
    ms.\n\nSeveral models predict as an ensemble: the mean of what they say, pictures each clamped to [0, 1]. How far they \
    differ, the standard deviation of every number, is then written beside, as 00001-spread.npy and .png (white is 0.5) or \
    spread.npy, and of powers as a column spread_db: do not trust a prediction where it is large.\n\nEXAMPLES\n  pwrfgs \
    predict runs/quickstart/model.safetensors --tx 3.5,2.2,1.2 --out heard\n  pwrfgs predict runs/a-0/model.safetensors \
    runs/a-1/model.safetensors --tx-csv positions.csv --out heard\n  pwrfgs predict runs/quickstart/model.safetensors \
    --tx-csv walk.csv --stacked --no-png --out walk\n  pwrfgs predict runs/ble/model.safetensors --tx-csv walk.csv \
    --receiver g01 --receiver g07 --out walk"
)]
#[command(group(clap::ArgGroup::new("where").required(true).args(["tx", "tx_csv"])))]
pub(crate) struct Predict {
    /// The trained model, model.safetensors of a run folder; several, or the file of an ensemble, predict as one
    #[arg(value_name = "MODEL", required = true)]
    pub(crate) models: Vec<PathBuf>,
    /// One transmitter position in metres, world frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
    /// A CSV file with columns x, y, z in metres; others are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) tx_csv: Option<PathBuf>,
    /// The folder to write to; made where it is missing
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// A receiver that shall listen, by its name in the data; may be given several times [default: all]
    #[arg(long, value_name = "NAME")]
    pub(crate) receiver: Vec<String>,
    /// One array of all spectra or channels in place of one for each
    #[arg(long)]
    pub(crate) stacked: bool,
    /// No PNG pictures
    #[arg(long)]
    pub(crate) no_png: bool,
}

pub(crate) fn predict(arguments: &Predict, verbosity: Verbosity) -> Result<()> {
    let txs = match (&arguments.tx, &arguments.tx_csv) {
        (Some(text), _) => vec![position("--tx", text)?],
        (_, Some(path)) => positions(path)?,
        _ => return Err(Error::Config("give --tx x,y,z or --tx-csv FILE".into())),
    };
    let ensemble = read_models(&arguments.models)?;
    check_positions(&ensemble)?;
    let model = ensemble.prepare();
    let task = model.task();
    let listening = chosen(model.receivers(), &arguments.receiver)?;
    let count = txs.len() * listening.len();
    if arguments.stacked && task.is_scalar {
        let why = "--stacked: a received power is one number, and predictions.csv has them all; leave --stacked out";
        return Err(Error::Config(why.into()));
    }
    let made = NewFolder::begin(&arguments.out)?;
    let folder = Folder { path: made.path(), has_png: !arguments.no_png };
    let mut writer = writer(&folder, &model, count, arguments.stacked)?;
    let mut progress = Progress::new(verbosity);
    let mut list = writer.header();
    let is_named = !task.has_pixels || model.receivers().len() > 1;
    let row = |k: usize| {
        let (tx, receiver) = (txs[k / listening.len()], listening[k % listening.len()]);
        Row { number: k + 1, tx, receiver, name: is_named.then(|| model.receivers()[receiver].name.as_str()) }
    };
    for first in (0..count).step_by(CHUNK) {
        progress.on_stage("predicting", first, count);
        let rows: Vec<Row<'_>> = (first..(first + CHUNK).min(count)).map(row).collect();
        let drawn = draw(&model, &rows)?;
        writer.take(&folder, &rows, &drawn, &mut list)?;
    }
    progress.finish();
    writer.finish()?;
    folder.put("predictions.csv", list.as_bytes())?;
    made.publish()?;
    verbosity.note(&format!("{} {} in {}", grouped(count as i64), task.plural, arguments.out.display()));
    Ok(())
}

/// Observations, one after another: the time of a prediction is that of a program that has nothing else to do.
fn draw(model: &Prepared<'_>, rows: &[Row<'_>]) -> Result<Vec<Drawn>> {
    let alone = model.models().count() == 1;
    let one = |row: &Row<'_>| {
        let query = Query::at(row.tx, row.receiver);
        let (image, spread, times) = if alone {
            let (image, times) = model.predict_timed(query);
            (image, None, times)
        } else {
            let (image, spread, times) = model.predict_with_deviation(query);
            (image, Some(spread), times)
        };
        Drawn { image, spread, milliseconds: 1e3 * times.total }
    };
    let drawn: Vec<Drawn> = rows.iter().map(one).collect();
    match drawn.iter().position(|drawn| !drawn.image.pixels.iter().all(|p| p.is_finite())) {
        None => Ok(drawn),
        Some(i) => Err(not_finite(model.task(), &rows[i])),
    }
}

fn not_finite(task: Task, row: &Row<'_>) -> Error {
    let what = task.singular;
    Error::Config(format!(
        "row {}: the {what} of a transmitter at {:?} is not finite: numbers of the model overflow there; train it \
         anew with lower rates, or leave the position out if it is far from all that the model has seen",
        row.number, row.tx
    ))
}
