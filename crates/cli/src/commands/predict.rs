//! `pwrfgs predict`: spectra of transmitter positions, from the model file alone.
//!
//! `predictions.csv` marks the folder as ours: its header is written first, so that a killed command can be given
//! again, and its rows last.

use super::evaluate::read_models;
use crate::args::Verbosity;
use crate::output;
use clap::Args;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use npyz::WriterBuilder as _;
use pwrfgs_core::files::{self, refuse_foreign, write_atomically};
use pwrfgs_core::{Error, Image, ImagePlane, Real, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const LIST: &str = "predictions.csv";
const HEADER: &str = "row,x,y,z,azimuth_deg,elevation_deg,peak,milliseconds\n";
/// What the picture of an ensemble's disagreement is called besides its row.
const SPREAD: &str = "-spread";
/// Pictures held in memory at once.
const CHUNK: usize = 64;

#[derive(Debug, Args)]
#[command(after_long_help = "Needs nothing but the model file. Writes, for the first position, 00001.npy (float32, \
    rows are elevation, columns azimuth) and 00001.png (8-bit grey), and so on, and predictions.csv with row, x, y, z, \
    strongest direction (azimuth and elevation in degrees), its value, and the milliseconds it took.\n\nSeveral models \
    predict as an ensemble: the mean of their pictures, each clamped to [0, 1]. How far they differ, the standard \
    deviation at every pixel, is then written beside, as 00001-spread.npy and .png (white is 0.5): do not trust a \
    picture where it is bright.\n\nEXAMPLES\n  pwrfgs predict runs/quickstart/model.safetensors --tx 1.2,0.3,1.0 --out \
    heard\n  pwrfgs predict runs/a-0/model.safetensors runs/a-1/model.safetensors --tx-csv positions.csv --out heard")]
#[command(group(clap::ArgGroup::new("where").required(true).args(["tx", "tx_csv"])))]
pub(crate) struct Predict {
    /// The trained model, model.safetensors of a run folder; several make an ensemble
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
}

pub(crate) fn predict(arguments: &Predict, verbosity: Verbosity) -> Result<ExitCode> {
    let txs = match (&arguments.tx, &arguments.tx_csv) {
        (Some(text), _) => vec![position(text)?],
        (_, Some(path)) => positions(path)?,
        _ => return Err(Error::Config("give --tx x,y,z or --tx-csv FILE".into())),
    };
    let ensemble = read_models(&arguments.models)?;
    let model = ensemble.prepare();
    let out = arguments.out.as_path();
    let ours = check_ours(out)?;
    std::fs::create_dir_all(out).map_err(|e| Error::write(out, e))?;
    let list = out.join(LIST);
    write_atomically(&list, HEADER.as_bytes())?;
    if ours {
        remove_old(out)?;
    }
    let mut text = HEADER.to_owned();
    for (chunk, txs) in txs.chunks(CHUNK).enumerate() {
        let first = 1 + chunk * CHUNK;
        // One after another: the time of a prediction is that of a program that has nothing else to do.
        let drawn: Vec<(Image, f64)> = txs
            .iter()
            .map(|&tx| {
                let (image, times) = model.predict_timed(tx);
                (image, 1e3 * times.total)
            })
            .collect();
        let written: Result<Vec<()>> = drawn
            .par_iter()
            .enumerate()
            .map(|(i, (image, _))| write_pictures(out, &name(first + i), image, 1.0))
            .collect();
        written?;
        if arguments.models.len() > 1 {
            let write = |(i, tx): (usize, &[f64; 3])| {
                write_pictures(out, &format!("{}{SPREAD}", name(first + i)), &model.deviation(*tx), 2.0)
            };
            txs.par_iter().enumerate().map(write).collect::<Result<Vec<()>>>()?;
        }
        for (i, ((image, milliseconds), tx)) in drawn.iter().zip(txs).enumerate() {
            text += &line(model.plane(), first + i, *tx, image, *milliseconds);
        }
    }
    write_atomically(&list, text.as_bytes())?;
    if verbosity != Verbosity::Quiet {
        output::note(&format!("{} spectra in {}", txs.len(), out.display()));
    }
    Ok(ExitCode::SUCCESS)
}

/// A row of `predictions.csv`; without angles where the model's plane has none.
fn line(plane: &ImagePlane, row: usize, [x, y, z]: [f64; 3], image: &Image, milliseconds: f64) -> String {
    let strongest = image.argmax();
    let (column, line) = ((strongest % image.width) as Real, (strongest / image.width) as Real);
    let angles = plane.azimuth_elevation_deg(column, line);
    let angles = angles.map_or_else(|| ",".into(), |(az, el)| format!("{az},{el}"));
    format!("{row},{x},{y},{z},{angles},{},{milliseconds:.3}\n", image.pixels[strongest])
}

/// `x,y,z` of the command line.
pub(super) fn position(text: &str) -> Result<[f64; 3]> {
    let wrong = || Error::Config(format!("--tx {text}: give three finite numbers in metres, such as 1.2,0.3,1.0"));
    let numbers: Option<Vec<f64>> = text.split(',').map(|t| t.trim().parse().ok()).collect();
    match <[f64; 3]>::try_from(numbers.unwrap_or_default()) {
        Ok([x, y, z]) if [x, y, z].iter().all(|v| (*v as Real).is_finite()) => Ok([x, y, z]),
        _ => Err(wrong()),
    }
}

/// Columns x, y, z of a CSV file.
fn positions(path: &Path) -> Result<Vec<[f64; 3]>> {
    let text = files::read(path).map_err(|e| Error::read(path, e))?;
    let text = text.strip_prefix("\u{feff}".as_bytes()).unwrap_or(&text);
    let mut reader = csv::ReaderBuilder::new().flexible(true).trim(csv::Trim::All).from_reader(text);
    let broken = |e: csv::Error| {
        let line = e.position().map_or(1, csv::Position::line) as usize;
        Error::at(path, line, 1, format!("this is not CSV text: {e}"))
    };
    let headers = reader.headers().map_err(broken)?.clone();
    let mut columns = [0; 3];
    for (column, name) in columns.iter_mut().zip(["x", "y", "z"]) {
        *column = headers.iter().position(|h| h.eq_ignore_ascii_case(name)).ok_or_else(|| {
            let found = headers.iter().collect::<Vec<_>>().join(",");
            Error::at(path, 1, 1, format!("no column `{name}` in `{found}`; the first line must name x, y and z"))
        })?;
    }
    let mut txs = Vec::new();
    for record in reader.records() {
        let record = record.map_err(broken)?;
        let line = record.position().map_or(1, csv::Position::line) as usize;
        let mut tx = [0.0; 3];
        for (value, &column) in tx.iter_mut().zip(&columns) {
            let field = record.get(column).ok_or_else(|| {
                let (has, needs) = (record.len(), headers.len());
                Error::at(path, line, 1, format!("this row has {has} fields and the first line names {needs}"))
            })?;
            *value = field.parse().ok().filter(|v: &f64| (*v as Real).is_finite()).ok_or_else(|| {
                let name = &headers[column];
                Error::at(path, line, column + 1, format!("`{field}` in column `{name}` is no finite number of metres"))
            })?;
        }
        txs.push(tx);
    }
    if txs.is_empty() {
        return Err(Error::input(path, "there is no row; give one position a line"));
    }
    Ok(txs)
}

/// Whether the folder holds an earlier prediction; refuses one that holds anything else.
fn check_ours(out: &Path) -> Result<bool> {
    if files::read_string(out.join(LIST)).is_ok_and(|text| text.starts_with(HEADER)) {
        return Ok(true);
    }
    refuse_foreign(out, "a folder of predictions").map(|()| false)
}

/// Removes the pictures of an earlier prediction: files named by five digits or more.
fn remove_old(out: &Path) -> Result<()> {
    for entry in std::fs::read_dir(out).map_err(|e| Error::read(out, e))?.flatten() {
        let path = entry.path();
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = stem.strip_suffix(SPREAD).unwrap_or(&stem);
        let ours = path.extension().is_some_and(|e| e == "npy" || e == "png");
        if ours && stem.len() >= 5 && stem.bytes().all(|b| b.is_ascii_digit()) {
            std::fs::remove_file(&path).map_err(|e| Error::write(&path, e))?;
        }
    }
    Ok(())
}

fn name(row: usize) -> String {
    format!("{row:05}")
}

/// `NAME.npy` (as it is) and `NAME.png` (times `gain`, clamped to [0, 1]).
fn write_pictures(out: &Path, name: &str, image: &Image, gain: Real) -> Result<()> {
    let (mut npy, mut png) = (Vec::new(), Vec::new());
    let path = |extension: &str| out.join(format!("{name}.{extension}"));
    let encode = |npy: &mut Vec<u8>| -> std::io::Result<()> {
        let shape = [image.height as u64, image.width as u64];
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(npy).begin_nd()?;
        writer.extend(image.pixels.iter().map(|p| *p as f32))?;
        writer.finish()
    };
    let shown = Image { pixels: image.pixels.iter().map(|p| gain * p).collect(), ..*image };
    encode(&mut npy).map_err(|e| Error::write(&path("npy"), e))?;
    PngEncoder::new(&mut png)
        .write_image(&shown.to_bytes(), image.width as u32, image.height as u32, ExtendedColorType::L8)
        .map_err(|e| Error::write(&path("png"), std::io::Error::other(e)))?;
    put(&path("npy"), &npy)?;
    put(&path("png"), &png)
}

/// Writes beside and renames: a file is whole or absent. Not synced, since the command can be given again.
fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    let beside = path.with_added_extension("tmp");
    std::fs::write(&beside, bytes).and_then(|()| std::fs::rename(&beside, path)).map_err(|e| {
        _ = std::fs::remove_file(&beside);
        Error::write(path, e)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_are_three_finite_numbers() {
        assert_eq!(position("1, -2.5,3e0").unwrap(), [1.0, -2.5, 3.0]);
        for wrong in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,NaN", "1,inf,2"] {
            assert!(position(wrong).unwrap_err().is_input(), "{wrong}");
        }
    }
}
