//! `pwrfgs predict`: spectra of transmitter positions, from the model file alone.

mod folder;
mod positions;

use super::evaluate::read_models;
use crate::args::Verbosity;
use crate::output;
use crate::progress::Progress;
use clap::Args;
use folder::{Folder, SPREAD, STACKS, Stack, name};
pub(super) use positions::position;
use positions::positions;
use pwrfgs::experiment::Observer as _;
use pwrfgs::model::Prepared;
use pwrfgs_core::{Error, Image, ImagePlane, Real, Result};
use rayon::prelude::*;
use std::path::PathBuf;
use std::process::ExitCode;

const HEADER: &str = "row,x,y,z,azimuth_deg,elevation_deg,peak,milliseconds\n";
/// Pictures held in memory at once.
const CHUNK: usize = 64;

#[derive(Debug, Args)]
#[command(after_long_help = "Needs nothing but the model file. Writes, for the first position, 00001.npy (float32, \
    rows are elevation, columns azimuth) and 00001.png (8-bit grey), and so on, and predictions.csv with row, x, y, z, \
    strongest direction (azimuth and elevation in degrees), its value, and the milliseconds it took. With --stacked \
    all arrays are one, spectra.npy [positions, rows, columns], which may be larger than memory. A folder that holds \
    anything, an earlier prediction too, is not touched; what a killed command left is made anew.\n\nSeveral models \
    predict as an ensemble: the mean of their pictures, each clamped to [0, 1]. How far they differ, the standard \
    deviation at every pixel, is then written beside, as 00001-spread.npy and .png (white is 0.5) or spread.npy: do not \
    trust a picture where it is bright.\n\nEXAMPLES\n  pwrfgs predict runs/quickstart/model.safetensors --tx 1.2,0.3,1.0 \
    --out heard\n  pwrfgs predict runs/a-0/model.safetensors runs/a-1/model.safetensors --tx-csv positions.csv --out \
    heard\n  pwrfgs predict runs/quickstart/model.safetensors --tx-csv walk.csv --stacked --no-png --out walk")]
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
    /// One array of all spectra, spectra.npy, in place of one for each
    #[arg(long)]
    pub(crate) stacked: bool,
    /// No PNG pictures
    #[arg(long)]
    pub(crate) no_png: bool,
}

pub(crate) fn predict(arguments: &Predict, verbosity: Verbosity) -> Result<ExitCode> {
    let txs = match (&arguments.tx, &arguments.tx_csv) {
        (Some(text), _) => vec![position("--tx", text)?],
        (_, Some(path)) => positions(path)?,
        _ => return Err(Error::Config("give --tx x,y,z or --tx-csv FILE".into())),
    };
    let ensemble = read_models(&arguments.models)?;
    let model = ensemble.prepare();
    let folder = Folder::claim(&arguments.out, txs.len(), !arguments.no_png)?;
    let mut stacks = Vec::new();
    if arguments.stacked {
        let size = [txs.len(), model.plane().height, model.plane().width];
        let names = STACKS.into_iter().take(if ensemble.members().len() > 1 { 2 } else { 1 });
        stacks = names.map(|name| Stack::create(&folder, name, size)).collect::<Result<_>>()?;
    }
    let mut progress = Progress::new(verbosity);
    let mut list = HEADER.to_owned();
    for (chunk, part) in txs.chunks(CHUNK).enumerate() {
        let first = 1 + chunk * CHUNK;
        progress.on_stage("predicting", first - 1, txs.len());
        let drawn = draw(&model, first, part)?;
        write(&folder, first, &drawn, &mut stacks)?;
        for (i, (drawn, tx)) in drawn.iter().zip(part).enumerate() {
            list += &line(model.plane(), first + i, *tx, &drawn.image, drawn.milliseconds);
        }
    }
    progress.finish();
    stacks.into_iter().try_for_each(Stack::finish)?;
    folder.finish(&list)?;
    if verbosity != Verbosity::Quiet {
        output::note(&format!("{} spectra in {}", txs.len(), arguments.out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// A prediction.
struct Drawn {
    image: Image,
    /// How far members differ, where there are several.
    spread: Option<Image>,
    milliseconds: f64,
}

/// Spectra, one after another: the time of a prediction is that of a program that has nothing else to do.
fn draw(model: &Prepared<'_>, first: usize, txs: &[[f64; 3]]) -> Result<Vec<Drawn>> {
    let alone = model.models().count() == 1;
    let one = |&tx: &[f64; 3]| {
        let (image, spread, times) = if alone {
            let (image, times) = model.predict_timed(tx);
            (image, None, times)
        } else {
            let (image, spread, times) = model.predict_with_deviation(tx);
            (image, Some(spread), times)
        };
        Drawn { image, spread, milliseconds: 1e3 * times.total }
    };
    let drawn: Vec<Drawn> = txs.iter().map(one).collect();
    match drawn.iter().position(|drawn| !drawn.image.pixels.iter().all(|p| p.is_finite())) {
        None => Ok(drawn),
        Some(i) => Err(Error::Config(format!(
            "row {}: the spectrum of a transmitter at {:?} is not finite: numbers of the model overflow there; train it \
             anew with lower rates, or leave the position out if it is far from all that the model has seen",
            first + i,
            txs[i]
        ))),
    }
}

/// Arrays and pictures of the positions from row `first` on.
fn write(folder: &Folder<'_>, first: usize, drawn: &[Drawn], stacks: &mut [Stack]) -> Result<()> {
    let images: Vec<&Image> = drawn.iter().map(|drawn| &drawn.image).collect();
    let spreads: Vec<&Image> = drawn.iter().filter_map(|drawn| drawn.spread.as_ref()).collect();
    let kinds = [("", 1.0, images), (SPREAD, 2.0, spreads)];
    for (k, (suffix, gain, images)) in kinds.iter().enumerate() {
        let one = |(i, image): (usize, &&Image)| {
            let name = name(first + i) + suffix;
            if stacks.is_empty() {
                folder.array(&name, image)?;
            }
            folder.picture(&name, image, *gain as Real)
        };
        images.par_iter().enumerate().map(one).collect::<Result<Vec<()>>>()?;
        if let Some(stack) = stacks.get_mut(k) {
            images.iter().try_for_each(|image| stack.push(image))?;
        }
    }
    Ok(())
}

/// A row of `predictions.csv`; without angles where the model's plane has none.
fn line(plane: &ImagePlane, row: usize, [x, y, z]: [f64; 3], image: &Image, milliseconds: f64) -> String {
    let strongest = image.argmax();
    let (column, line) = ((strongest % image.width) as Real, (strongest / image.width) as Real);
    let angles = plane.azimuth_elevation_deg(column, line);
    let angles = angles.map_or_else(|| ",".into(), |(az, el)| format!("{az},{el}"));
    format!("{row},{x},{y},{z},{angles},{},{milliseconds:.3}\n", image.pixels[strongest])
}
