//! `pwrfgs compare`: all methods, all baselines and the predictions of other programs on one data folder.

use super::options::ChangeOptions;
use super::sweep::SelectedRuns;
use crate::output::{self, SUCCESS, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::samples;
use pwrfgs::tasks::compare::{CompareSettings, ComparedRuns, check_earlier_runs, without_position};
use pwrfgs::tasks::init::{DataSurvey, pipeline_name};
use pwrfgs_core::Result;
use pwrfgs_core::files::{check_new_file, create};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
A method is a kind of model, such as P-WRFGS or NeRF2; --dry-run lists the methods for the data. All
methods use the same split. Repeat the command to resume it or to add predictions; it does not train
finished models again. To compare another program, train it on the ids that --split-csv lists as
train and validation, and predict the test ids. Write spectra and channels as arrays like those of
`pwrfgs predict`, one file NNNNN.npy per id, and received powers as predictions.csv with the columns
id and dbm. With several receivers, the column `link` of the split replaces the id.

EXAMPLES
  pwrfgs compare data/s23 --dry-run
  pwrfgs compare data/s23 --split-csv split.csv
  pwrfgs compare data/s23 --methods P-WRFGS,waves --predictions U-Net=predicted")]
pub(crate) struct Compare {
    /// Folder with the data
    #[arg(value_name = "FOLDER")]
    pub(crate) folder: PathBuf,
    #[command(flatten)]
    pub(crate) settings: CompareSettings,
    #[command(flatten)]
    pub(crate) changes: ChangeOptions,
    /// Output folder [default: runs/compare-NAME, with the name of the data folder]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// List all runs with estimated times; run nothing
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Write id, position and set of all samples to a file; run nothing
    #[arg(long, value_name = "FILE", conflicts_with = "dry_run")]
    pub(crate) split_csv: Option<PathBuf>,
    /// Keep the training state of finished runs, checkpoint.safetensors
    #[arg(long)]
    pub(crate) keep_checkpoint: bool,
}

/// Runs `pwrfgs compare`: writes the split, lists the runs, or executes them; returns the exit code.
pub(crate) fn compare(arguments: &Compare, verbosity: Verbosity) -> Result<u8> {
    let folder = arguments.folder.canonicalize().unwrap_or_else(|_| arguments.folder.clone());
    let survey =
        RunProgress::observe(verbosity, |progress| DataSurvey::read(&folder, &arguments.changes.accept, progress))?;
    let compared = ComparedRuns {
        settings: arguments.settings.clone(),
        name: pipeline_name(&folder),
        changes: arguments.changes.assignments(),
        out: arguments.out.clone(),
    };
    let comparison = RunProgress::observe(verbosity, |progress| compared.plan(&survey, progress))?;
    let plan = &comparison.plan;
    if let Some(path) = &arguments.split_csv {
        check_new_file(path)?;
        create(
            path,
            samples::samples_csv(&survey.data, &comparison.partition, &comparison.partition.train, &[]).as_bytes(),
        )?;
        let [train, validation, test] = comparison.partition.sizes();
        output::print_result(&format!("{}: {train} train, {validation} validation, {test} test\n", path.display()))?;
        return Ok(SUCCESS);
    }
    let runs: Vec<usize> = (0..plan.runs.len()).collect();
    let keep_checkpoint = arguments.keep_checkpoint;
    let selected = SelectedRuns { plan, indices: &runs, jobs: 1, keep_checkpoint, all: false, verbosity };
    if arguments.dry_run {
        return selected.print_estimates().map_err(without_position);
    }
    check_earlier_runs(plan)?;
    selected.announce().map_err(without_position)?;
    selected.execute(comparison.reference.as_deref())
}
