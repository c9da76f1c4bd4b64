//! `pwrfgs check`: validates a pipeline and estimates memory and time. `pwrfgs inspect`: summarises data before
//! training.

use super::options::{ChangeOptions, resolve_pipeline};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::inspect::Inspection;
use pwrfgs::experiment::sweep::LISTING;
use pwrfgs::experiment::{Observer as _, Session, check_findings, preview, read_pipeline, run_stage};
use pwrfgs::prelude::Pipeline;
use pwrfgs::tasks::init::{default_pipeline, is_table_or_array, pipeline_name, unknown_folder_error};
use pwrfgs_core::plugin::try_to_ron;
use pwrfgs_core::{DataSource, Dataset, Error, Plugin, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
The command loads the data, creates the split and the initial Gaussians, and times a few training
steps. It writes no files. It reports the errors that `pwrfgs run` would report before its first
training step, and warns of settings without effect. The estimated time covers training and, with
the initializer MatchingPursuit, its search for sources. Steps are timed with the initial number of
Gaussians and with the number expected after pruning. Gaussians that training adds (densification)
increase memory and time above the estimate. If --device selects a GPU, steps are timed on that GPU.

EXAMPLES
  pwrfgs check pipelines/s23-laptop.ron
  pwrfgs check pipelines/pwrfgs.ron --scale 0.1
  pwrfgs check pipelines/pwrfgs.ron --device gpu")]
pub(crate) struct Check {
    /// Pipeline file, name in `pwrfgs pipelines`, or run folder
    #[arg(value_name = "PIPELINE")]
    pub(crate) pipeline: PathBuf,
    #[command(flatten)]
    pub(crate) changes: ChangeOptions,
}

/// Runs `pwrfgs check`: prints the warnings for a pipeline, then size and cost of its run.
pub(crate) fn check(arguments: &Check, verbosity: Verbosity) -> Result<()> {
    let (file, _) = resolve_pipeline(&arguments.pipeline)?;
    let pipeline = read_pipeline(&file, &arguments.changes.assignments())?;
    let preview = RunProgress::observe(verbosity, |progress| preview(&pipeline, Path::new(""), progress))?;
    preview.warnings.iter().for_each(|warning| RunProgress::new(verbosity).on_warning(warning));
    output::print_result(&preview.table())
}

#[derive(Debug, Args)]
#[command(after_help = "\
The command prints the ranges of positions and values. For spectra, it also lists constant and equal
ones, and checks the recorded receiver orientation: it compares the direction to each transmitter
with the strongest direction of its spectrum. For each kind of split, it prints the median distance
from test transmitters to the nearest training transmitter, the mean score of each baseline on up to
300 test samples, and the noise ceiling: an approximate limit for the mean score of every model, from
samples at nearly equal positions. A pipeline sets data, split, baselines, metrics and seed. For a
data folder, the first split is that of `pwrfgs init`, and the other settings have their defaults.

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
        check_findings(&data, partition.as_ref(), None, progress)?;
        Ok(Inspection::of(&pipeline, &data, &mut Session::new(progress))?.to_text())
    });
    output::print_result(&text?)
}

/// Opens the pipeline that `path` names, or one with the split of `pwrfgs init` and defaults for the data in that
/// folder; also returns its data.
fn open_data(path: &Path, set: &[String], observer: &mut RunProgress) -> Result<(Pipeline, Dataset)> {
    let mut load =
        |source: &Plugin<dyn DataSource>| run_stage(observer, "observations", |bar| source.load(Path::new(""), bar));
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

/// Returns the pipeline file that `path` names: itself, or that of a run folder. Tables, arrays and other folders are
/// errors.
fn pipeline_file(path: &Path) -> Result<PathBuf> {
    if is_table_or_array(path) {
        return Err(unknown_folder_error(path));
    }
    match resolve_pipeline(path) {
        // The error for a sweep folder lists its runs, so it stays.
        Err(_neither) if !path.join(LISTING).is_file() => {
            let problem = "neither data (spectra, received powers or channels) nor a run found; name a data folder, a pipeline \
                        file or a run folder (layouts: docs/data.md)";
            Err(Error::input(path, problem))
        }
        resolved => Ok(resolved?.0),
    }
}
