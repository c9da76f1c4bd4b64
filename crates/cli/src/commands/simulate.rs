//! `pwrfgs simulate`: a scene becomes a data set on disk.

use crate::args::Verbosity;
use crate::interrupt::{INTERRUPTED, stop_flag};
use crate::output;
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::Observer as _;
use pwrfgs::sim::Recipe;
use pwrfgs::sim::output::{self as folder, Pictures};
use pwrfgs_core::{Error, Result};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

#[derive(Debug, Args)]
#[command(after_long_help = "Writes, in the layout of NeRF2: gateway_info.yml, tx_pos.csv, spectrum/00001.png .., \
    train_index.txt and test_index.txt (every fifth); and beside it power.csv (absolute path gain, for RSSI), paths.csv \
    (every path with gain, delay, angles and what it met), points.ply (points on all surfaces, with normals) and \
    manifest.json (every parameter). A folder that holds anything is never touched. In a pipeline, data: \
    Simulated(scene: ..) makes the same data set without this command.\n\nEXAMPLES\n  pwrfgs simulate \
    scenes/office.ron --out data/office\n  pwrfgs simulate scenes/lab-s23.ron --samples 4898 --no-paths --out data/lab\n  pwrfgs \
    simulate scenes/office.ron --samples 100000 --no-paths --npy --out data/many")]
pub(crate) struct Simulate {
    /// The scene file
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,
    /// The folder to make
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// How many spectra
    #[arg(long, value_name = "N", default_value_t = 1000)]
    pub(crate) samples: usize,
    /// Which transmitter positions and receiver errors
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Points of the cloud
    #[arg(long, value_name = "N", default_value_t = 190_000)]
    pub(crate) points: usize,
    /// Write one array, spectra.npy, in place of a picture each; needed for 100,000 spectra and more
    #[arg(long)]
    pub(crate) npy: bool,
    /// Leave paths.csv out: it has some hundred rows a spectrum
    #[arg(long)]
    pub(crate) no_paths: bool,
}

pub(crate) fn simulate(arguments: &Simulate, verbosity: Verbosity) -> Result<ExitCode> {
    let begun = Instant::now();
    let stop = stop_flag()?;
    let recipe = Recipe::read(&arguments.scene, arguments.samples, arguments.seed, arguments.points)?;
    let bar = Mutex::new(Progress::new(verbosity));
    let tell = |done, total| bar.lock().unwrap_or_else(PoisonError::into_inner).on_stage("simulating", done, total);
    tell(0, 0);
    let (pictures, source) = if arguments.npy { (Pictures::Npy, "Arrays") } else { (Pictures::Png, "Nerf2Spectrum") };
    let written = folder::write_as(&recipe, pictures, !arguments.no_paths, &arguments.out, &tell, &stop);
    bar.lock().unwrap_or_else(PoisonError::into_inner).finish();
    if matches!(written, Err(Error::Stopped)) {
        output::note("stopped; nothing is left behind, and the same command begins anew");
        return Ok(ExitCode::from(INTERRUPTED));
    }
    written?;
    if verbosity != Verbosity::Quiet {
        output::note(&format!(
            "{} simulated spectra of {} in {} after {:.1} s; to train on them: data: {source}(root: \"{}\", points: \
             \"{}\")",
            arguments.samples,
            recipe.scene.name,
            arguments.out.display(),
            begun.elapsed().as_secs_f64(),
            arguments.out.display(),
            arguments.out.join(folder::POINTS).display(),
        ));
    }
    Ok(ExitCode::SUCCESS)
}
