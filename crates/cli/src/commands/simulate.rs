//! `pwrfgs simulate`: a scene becomes a data set on disk.

use crate::args::{Simulate, Verbosity};
use crate::output;
use indicatif::{ProgressBar, ProgressStyle};
use pwrfgs::sim::{Recipe, output::write};
use pwrfgs_core::Result;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Bars appear after this long.
const PATIENCE: Duration = Duration::from_secs(1);

pub(crate) fn simulate(arguments: &Simulate, verbosity: Verbosity) -> Result<ExitCode> {
    let begun = Instant::now();
    let recipe = Recipe::read(&arguments.scene, arguments.samples, arguments.seed, arguments.points)?;
    let bar = ProgressBar::hidden();
    bar.set_length(arguments.samples as u64);
    let style = ProgressStyle::with_template("simulating {bar:40} {pos}/{len} spectra, {eta} left");
    bar.set_style(style.expect("the template is well formed"));
    let mut progress = |done: usize| {
        if verbosity != Verbosity::Quiet && bar.is_hidden() && begun.elapsed() > PATIENCE {
            bar.set_draw_target(indicatif::ProgressDrawTarget::stderr());
        }
        bar.set_position(done as u64);
    };
    let done = write(&recipe, !arguments.no_paths, &arguments.out, &mut progress);
    bar.finish_and_clear();
    done?;
    if verbosity != Verbosity::Quiet {
        output::note(&format!(
            "{} simulated spectra of {} in {}, {:.1} s; train on them with data: Nerf2Spectrum(root: \"{}\", points: \
             \"{}\")",
            arguments.samples,
            recipe.scene.name,
            arguments.out.display(),
            begun.elapsed().as_secs_f64(),
            arguments.out.display(),
            arguments.out.join("points.ply").display(),
        ));
    }
    Ok(ExitCode::SUCCESS)
}
