//! Loads a model, predicts at many positions, and writes one array `[positions, rows, columns]` for NumPy:
//! `cargo run --release -p pwrfgs --example predict -- MODEL.safetensors [SPECTRA.npy]`. Several models form an ensemble.
#![allow(clippy::print_stdout)] // example program

use pwrfgs::core::{Query, npy::npy_header_as};
use pwrfgs::prelude::*;
use std::path::Path;

/// Returns a grid of 10 × 10 positions in one plane, metres.
fn positions() -> Vec<[f64; 3]> {
    (0..100).map(|i| [0.3 + 0.15 * f64::from(i % 10), 0.5 + 0.1 * f64::from(i / 10), 1.0]).collect()
}

fn main() -> Result<()> {
    let is_array = |path: &String| Path::new(path).extension().is_some_and(|e| e == "npy");
    let (arrays, models): (Vec<String>, Vec<String>) = std::env::args().skip(1).partition(is_array);
    let out = arrays.first().map_or("spectra.npy", String::as_str);

    let members = models.iter().map(|path| pwrfgs::model::file::read(Path::new(path))).collect::<Result<Vec<_>>>()?;
    let ensemble = Ensemble::new(members).map_err(Error::Config)?;
    let prepared: Prepared<'_> = ensemble.prepare(); // computes values that do not depend on the transmitter
    let spectra = prepared.predict_many(&positions().into_iter().map(Query::from).collect::<Vec<_>>());

    let ImagePlane { width, height, .. } = prepared.plane();
    let mut array = npy_header_as("<f4", &[spectra.len(), *height, *width]);
    array.extend(spectra.iter().flat_map(|s| &s.pixels).flat_map(|v| (*v as f32).to_le_bytes()));
    std::fs::write(out, array).expect("room on the disk");

    for (position, spectrum) in positions().iter().zip(&spectra).step_by(33) {
        let (x, y) = (spectrum.argmax() % width, spectrum.argmax() / width);
        let strongest = prepared.plane().azimuth_elevation_deg(x as Real, y as Real);
        println!("{position:.1?}: strongest at azimuth and elevation {strongest:.0?}");
    }
    println!("{out}: {} spectra of {height} rows and {width} columns", spectra.len());
    Ok(())
}
