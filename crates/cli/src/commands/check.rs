//! `pwrfgs check`: what a pipeline would do and take, without training.

use super::changes::{Changes, named};
use crate::args::Verbosity;
use crate::output;
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::inspect::length;
use pwrfgs::experiment::text::{aligned, duration, grouped};
use pwrfgs::experiment::{Observer as _, Preview, preview, read_pipeline};
use pwrfgs::train::Rays;
use pwrfgs_core::Result;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
#[command(
    after_long_help = "Reads the pipeline, loads the data, divides them, makes the Gaussians and tries one step; writes \
    nothing. Describes the data: extent, units, distance of the test set, and whether the recorded pose can be right; \
    `pwrfgs inspect` gives the details. What it refuses, `pwrfgs run` would refuse. Warns of settings without effect. Memory and time are those of the Gaussians \
    at the start: densification makes both larger, pruning smaller.\n\nEXAMPLES\n  pwrfgs check pipelines/s23-laptop.ron\n  pwrfgs check \
    pipelines/pwrfgs.ron --scale 0.1"
)]
pub(crate) struct Check {
    /// The file of a pipeline, or a run folder
    #[arg(value_name = "PIPELINE")]
    pub(crate) pipeline: PathBuf,
    #[command(flatten)]
    pub(crate) changes: Changes,
}

pub(crate) fn check(arguments: &Check, verbosity: Verbosity) -> Result<ExitCode> {
    let (file, _) = named(&arguments.pipeline)?;
    let pipeline = read_pipeline(&file, &arguments.changes.all())?;
    let mut progress = Progress::new(verbosity);
    let found = preview(&pipeline, Path::new(""), &mut progress);
    progress.finish();
    let found = found?;
    found.warnings.iter().for_each(|warning| progress.on_warning(warning));
    output::result(&text(&found))?;
    Ok(ExitCode::SUCCESS)
}

/// The plan as a table.
fn text(p: &Preview) -> String {
    let (t, n) = (&p.pipeline.training, |count: usize| grouped(count as i64));
    let steps = |count: u64| grouped(count as i64);
    let [train, validation, test] = p.samples.map(n);
    let names = |all: Vec<String>| if all.is_empty() { "none".to_owned() } else { all.join(", ") };
    let phase = |from: u64, to: u64, what: &str| {
        (from < to.min(t.steps)).then(|| format!("{what} from step {} to {}", steps(from + 1), steps(to.min(t.steps))))
    };
    let phases = [
        phase(0, t.densify_until, "densify"),
        phase(t.densify_until, t.prune_until, "prune"),
        phase(t.prune_until, t.steps, "finetune"),
    ];
    let free = p.free_bytes.map_or_else(String::new, |free| format!(", {} left here", memory(free)));
    let seconds = p.estimate.step_seconds;
    let mut rows = vec![
        ("data", format!("{}: {}", p.title, p.observed)),
        ("samples", format!("{train} training, {validation} validation, {test} test")),
        ("test distance", format!("{} to the nearest training transmitter (median)", length(p.test_distance))),
        ("point cloud", if p.points > 0 { format!("{} points", n(p.points)) } else { "none".into() }),
        (
            "Gaussians",
            match p.estimate.gaussians {
                0 => "none".into(),
                count => format!("{} at the start", n(count)),
            },
        ),
        ("network", format!("{} numbers", n(p.weights))),
        ("pruners", names(p.pipeline.pruners.iter().map(plugin_name).collect())),
        (
            "steps",
            match t.rays {
                Rays::All => format!("{} of {} transmitters", steps(t.steps), n(t.batch)),
                Rays::Same(rays) => format!("{} of {} rays of {} transmitters", steps(t.steps), n(rays), n(t.batch)),
                Rays::Each(pairs) => format!("{} of {} pairs of a spectrum and a pixel", steps(t.steps), n(pairs)),
            },
        ),
        ("phases", names(phases.into_iter().flatten().collect())),
        ("memory", format!("about {}{free}", memory(p.loaded_bytes + p.estimate.step_bytes))),
        ("time", format!("{} a step, about {} in all", pace(seconds), duration(seconds * t.steps as f64))),
    ];
    let pose = p.summary.pose.as_ref().map(|pose| ("pose", pose.verdict.title().to_owned()));
    rows.splice(1..1, p.summary.facts.iter().cloned().chain(pose));
    aligned(&rows.into_iter().map(|(name, value)| vec![name.to_owned(), value]).collect::<Vec<_>>(), 2)
}

/// `LearnableMask` of `LearnableMask(lambda: 0.02, ..)`.
fn plugin_name(pruner: &pwrfgs_core::Plugin<dyn pwrfgs_core::Pruner>) -> String {
    let text = format!("{:?}", pruner.get());
    text.split([' ', '(', '{']).next().unwrap_or_default().to_owned()
}

/// `0.41 GB`.
pub(crate) fn memory(bytes: u64) -> String {
    format!("{:.2} GB", bytes as f64 / 1e9)
}

/// `12 ms` or `26.1 s`.
pub(crate) fn pace(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.1} ms", 1e3 * seconds) } else { format!("{seconds:.1} s") }
}
