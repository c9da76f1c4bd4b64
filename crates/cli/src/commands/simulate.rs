//! `pwrfgs simulate`: a scene becomes a data set on disk.

use crate::args::{Simulate, Verbosity};
use crate::output;
use crate::progress::Progress;
use pwrfgs::experiment::Observer as _;
use pwrfgs::sim::{Recipe, output as folder};
use pwrfgs_core::Result;
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

pub(crate) fn simulate(arguments: &Simulate, verbosity: Verbosity) -> Result<ExitCode> {
    let begun = Instant::now();
    let recipe = Recipe::read(&arguments.scene, arguments.samples, arguments.seed, arguments.points)?;
    let bar = Mutex::new(Progress::new(verbosity));
    let tell = |done, total| bar.lock().unwrap_or_else(PoisonError::into_inner).on_stage("simulating", done, total);
    tell(0, 0);
    let written = folder::write(&recipe, !arguments.no_paths, &arguments.out, &tell);
    bar.lock().unwrap_or_else(PoisonError::into_inner).finish();
    written?;
    if verbosity != Verbosity::Quiet {
        output::note(&format!(
            "{} simulated spectra of {} in {} after {:.1} s; to train on them: data: Nerf2Spectrum(root: \"{}\", \
             points: \"{}\")",
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
