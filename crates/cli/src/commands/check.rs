//! `pwrfgs check`: validates a pipeline and estimates memory and time. `pwrfgs inspect`: summarises data before
//! training.

use super::options::{ChangeOptions, resolve_pipeline};
use crate::output::{self, Verbosity};
use crate::progress::{RunProgress, format_gigabytes, format_step_time};
use clap::Args;
use pwrfgs::experiment::inspect::Inspection;
use pwrfgs::experiment::sweep::LISTING;
use pwrfgs::experiment::text::{aligned, duration, format_length, grouped};
use pwrfgs::experiment::{Observer as _, Preview, Session, preview, read_pipeline, staged, warn_of_findings};
use pwrfgs::prelude::Pipeline;
use pwrfgs::tasks::init::{default_pipeline, is_table_or_array, pipeline_name, unknown_folder_error};
use pwrfgs::train::{Rays, TimeEstimate, Training};
use pwrfgs_core::plugin::{name_of as plugin_name, try_to_ron};
use pwrfgs_core::{DataSource, Dataset, Error, Plugin, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Loads the data, makes the split and the initial Gaussians and times a few steps; writes no files.
Reports the errors that `pwrfgs run` would report, and warns of settings without effect.
Describes the data briefly; `pwrfgs inspect` gives the details. The time is that of an initial search
and of training, with the initial Gaussians and after pruning. Densification increases memory and time.

EXAMPLES
  pwrfgs check pipelines/s23-laptop.ron
  pwrfgs check pipelines/pwrfgs.ron --scale 0.1")]
pub(crate) struct Check {
    /// Pipeline file, name in `pwrfgs pipelines`, or run folder
    #[arg(value_name = "PIPELINE")]
    pub(crate) pipeline: PathBuf,
    #[command(flatten)]
    pub(crate) changes: ChangeOptions,
}

/// Load average per core above which the machine is busy.
const IDLE: f64 = 0.25;
/// Upper over lower quartile of the times of equal steps above which the spread is printed; short steps spread on an
/// idle machine too.
const STEADY: f64 = 1.25;

/// Runs `pwrfgs check`: prints the warnings for a pipeline, then size and cost of its run.
pub(crate) fn check(arguments: &Check, verbosity: Verbosity) -> Result<()> {
    let (file, _) = resolve_pipeline(&arguments.pipeline)?;
    let pipeline = read_pipeline(&file, &arguments.changes.assignments())?;
    let preview = RunProgress::observe(verbosity, |progress| preview(&pipeline, Path::new(""), progress))?;
    preview.warnings.iter().for_each(|warning| RunProgress::new(verbosity).on_warning(warning));
    output::print_result(&describe_run(&preview))
}

/// Formats size and cost of a run as a table.
fn describe_run(preview: &Preview) -> String {
    let (training, n) = (&preview.pipeline.training, |count: usize| grouped(count as i64));
    let [train, validation, test] = preview.samples.map(n);
    let free = preview.free_bytes.map_or_else(String::new, |free| format!(", {} available", format_gigabytes(free)));
    let gaussians = match preview.time.start.gaussians {
        0 => "none".to_owned(),
        count => format!("{} initially", n(count)),
    };
    let mut rows = vec![
        ("data", format!("{}: {}", preview.title, preview.observed)),
        ("samples", format!("{train} training, {validation} validation, {test} test")),
        (
            "test distance",
            format!("{} to the nearest training transmitter (median)", format_length(preview.test_distance)),
        ),
        ("Gaussians", gaussians),
        ("network", format!("{} weights", n(preview.weights))),
        ("pruners", join_or_none(&preview.pipeline.pruners.iter().map(plugin_name).collect::<Vec<_>>())),
        ("steps", describe_steps(training)),
        ("phases", describe_phases(training)),
        ("memory", format!("about {}{free}", format_gigabytes(preview.loaded_bytes + preview.step_bytes))),
        ("time", describe_time(&preview.time, has_unlimited_densification(training))),
        ("machine", describe_machine(preview)),
    ];
    let pose = preview.summary.pose.as_ref().map(|pose| ("pose", pose.verdict.title().to_owned()));
    rows.splice(1..1, preview.summary.facts.iter().cloned().chain(pose));
    rows.extend(preview.outlook.iter().map(|sentence| ("pruning", sentence.clone())));
    aligned(&rows.into_iter().map(|(name, value)| vec![name.to_owned(), value]).collect::<Vec<_>>(), 2)
}

/// Joins names by commas; `none` without any.
fn join_or_none(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Describes the number of training steps and the batch of a step.
fn describe_steps(training: &Training) -> String {
    let (steps, n) = (grouped(training.steps as i64), |count: usize| grouped(count as i64));
    match training.rays {
        Rays::All => format!("{steps} of {} transmitters", n(training.batch)),
        Rays::Same(rays) => format!("{steps} of {} rays of {} transmitters", n(rays), n(training.batch)),
        Rays::Each(pairs) => format!("{steps} of {} pairs of spectrum and pixel", n(pairs)),
    }
}

/// Describes the phases of algorithm 1 by their steps.
fn describe_phases(training: &Training) -> String {
    let steps = |count: u64| grouped(count as i64);
    let phase = |(from, to, name): (u64, u64, &str)| {
        let last = to.min(training.steps);
        (from < last).then(|| format!("{name} from step {} to {}", steps(from + 1), steps(last)))
    };
    let phases = [
        (0, training.densify_until, "densify"),
        (training.densify_until, training.prune_until, "prune"),
        (training.prune_until, training.steps, "finetune"),
    ];
    join_or_none(&phases.into_iter().filter_map(phase).collect::<Vec<_>>())
}

/// Returns whether densification may add Gaussians, without a maximum number.
fn has_unlimited_densification(training: &Training) -> bool {
    training.densify.max_gaussians == 0
        && training.densify.every > 0
        && training.densify.from < training.densify_until.min(training.steps)
}

/// Describes the expected time of the initial search and of training, with its range, and the timed steps; `may_grow`
/// adds that densification lengthens it.
fn describe_time(time: &TimeEstimate, may_grow: bool) -> String {
    let range = |seconds: [f64; 2]| {
        let [shortest, longest] = seconds.map(duration);
        if shortest == longest { shortest } else { format!("{shortest} to {longest}") }
    };
    let TimeEstimate { seconds: [shortest, expected, longest], search_seconds: search, start, end, .. } = time;
    let seconds = [*shortest, *longest];
    let total = if search[1] > 0.0 {
        let whole = range([0, 1].map(|k| search[k] + seconds[k]));
        format!("{whole}: {} of initial search, then ", range(*search))
    } else {
        String::new()
    };
    let (spread, about) = (range(seconds), duration(*expected));
    let range = if spread.contains(" to ") { format!("about {about} ({spread})") } else { spread };
    let n = |count: usize| grouped(count as i64);
    let [first, last] = [start, end].map(|steps| format_step_time(steps.step_seconds) + " per step");
    let steps = if end.gaussians == start.gaussians {
        first
    } else {
        format!("{first} with N = {}, {last} with N = {}", n(start.gaussians), n(end.gaussians))
    };
    format!(
        "{total}{range} of training ({steps}){}",
        if may_grow { "; more if densification adds Gaussians" } else { "" }
    )
}

/// Describes the load of the machine, and the spread of the timed steps if it is large.
fn describe_machine(preview: &Preview) -> String {
    let is_loaded = preview.load.is_some_and(|(load, cores)| load > IDLE * cores as f64);
    let load = preview
        .load
        .map(|(load, cores)| format!("load average {load:.1} on {cores} core{}", if cores == 1 { "" } else { "s" }));
    let varies =
        (preview.time.spread > STEADY).then(|| format!("equal steps vary by a factor of {:.1}", preview.time.spread));
    let state = match preview.load {
        _ if is_loaded => "busy, an idle machine is faster",
        Some(_) => "idle",
        None => "load unknown",
    };
    [Some(state.to_owned()), load, varies].into_iter().flatten().collect::<Vec<_>>().join("; ")
}

#[derive(Debug, Args)]
#[command(after_help = "\
Prints positions, values, unusual spectra and a check of the recorded receiver pose. For each split
it prints the distance from test to training transmitters, the scores of the baselines and the noise
ceiling. A pipeline sets data, split, baselines, metrics and seed; a data folder uses the defaults.

EXAMPLES
  pwrfgs inspect pipelines/quickstart.ron
  pwrfgs inspect data/s23
  pwrfgs inspect pipelines/s23-array.ron --set data.root=data/s23")]
pub(crate) struct Inspect {
    /// Data folder (layouts in docs/data.md), pipeline (file or name) or run folder
    #[arg(value_name = "DATA")]
    pub(crate) data: PathBuf,
    /// Change a setting, such as 'split=Random(test: 0.3)'; repeatable
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
}

/// Runs `pwrfgs inspect`: prints the summary of data, splits and baselines.
pub(crate) fn inspect(arguments: &Inspect, verbosity: Verbosity) -> Result<()> {
    let text = RunProgress::observe(verbosity, |progress| {
        let (pipeline, data) = open_data(&arguments.data, &arguments.set, progress)?;
        let partition = pipeline.partition(&data).ok().filter(|_| !pipeline.split.is_sparse());
        warn_of_findings(&data, partition.as_ref(), progress)?;
        Ok(Inspection::of(&pipeline, &data, &mut Session::new(progress))?.to_text())
    });
    output::print_result(&text?)
}

/// Opens the pipeline that `path` names, or one with the split of `pwrfgs init` and defaults for the data in that
/// folder; also returns its data.
fn open_data(path: &Path, set: &[String], observer: &mut RunProgress) -> Result<(Pipeline, Dataset)> {
    let mut load = |source: &Plugin<dyn DataSource>| staged(observer, "spectra", |bar| source.load(Path::new(""), bar));
    let Some(source) = recognise(path) else {
        let pipeline = read_pipeline(&pipeline_file(path)?, set)?;
        let data = load(&pipeline.data)?;
        return Ok((pipeline, data));
    };
    let ron = |source: &Plugin<dyn DataSource>| try_to_ron(source).map_err(|why| Error::input(path, why));
    let (root, data) = (ron(&source)?, load(&source)?);
    let mut pipeline = default_pipeline(&root, &data, &pipeline_name(path))?;
    pipeline.set_all(set)?;
    let data = if ron(&pipeline.data)? == root { data } else { load(&pipeline.data)? };
    Ok((pipeline, data))
}

/// Returns the pipeline file that `path` names: itself, or that of a run folder. Other tables, arrays and folders are
/// errors.
fn pipeline_file(path: &Path) -> Result<PathBuf> {
    if is_table_or_array(path) {
        return Err(unknown_folder_error(path));
    }
    match resolve_pipeline(path) {
        Err(_neither) if !path.join(LISTING).is_file() => {
            let problem = "neither data (spectra, received powers or channels) nor a run found; name a data folder, a pipeline \
                        file or a run folder (layouts: docs/data.md)";
            Err(Error::input(path, problem))
        }
        path => Ok(path?.0),
    }
}
