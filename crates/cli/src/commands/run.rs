//! `pwrfgs run`: runs a pipeline.

use super::options::{ChangeOptions, resolve_pipeline};
use crate::interrupt::stop_flag;
use crate::output::{self, INTERRUPTED, SUCCESS, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::folder::REPORT;
use pwrfgs::experiment::scores::ScoreTable;
use pwrfgs::experiment::{RunOutcome, Session, read_pipeline};
use pwrfgs_core::Result;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Repeat the command to resume an interrupted run; the result is identical to an uninterrupted run.
A finished run deletes its checkpoint (state to resume it); --keep-checkpoint keeps the checkpoint.
If only baselines or metrics changed, the command scores the trained model without new training.
A folder of --out with other files is an error and stays unchanged. Paths in a pipeline file are
relative to the file. Paths in a pipeline of the program and on the command line are relative to the
current directory. docs/guide.md describes the run folder.

EXAMPLES
  pwrfgs run quickstart
  pwrfgs run quickstart --scale 0.25 --set tensorboard=true --out runs/quarter
  pwrfgs run runs/quarter --set seed=1 --out runs/quarter-1
  pwrfgs run pipelines/s23-laptop.ron --set data.root=data/s23
  pwrfgs run pipelines/ablation.ron --set pruners.LearnableMask.lambda=0.05 --out runs/sparse")]
pub(crate) struct Run {
    /// Pipeline file, name in `pwrfgs pipelines`, or run folder (to resume the run, or to repeat it in --out)
    #[arg(value_name = "PIPELINE")]
    pub(crate) pipeline: PathBuf,
    #[command(flatten)]
    pub(crate) changes: ChangeOptions,
    /// Run folder [default: runs/NAME, from the name of the pipeline]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Keep the training state of the finished run, checkpoint.safetensors
    #[arg(long)]
    pub(crate) keep_checkpoint: bool,
    /// Print all metrics, with median and 10th percentile (90th for errors)
    #[arg(long)]
    pub(crate) all: bool,
}

/// Runs `pwrfgs run`: trains and scores a pipeline; returns the exit code.
pub(crate) fn run(arguments: &Run, verbosity: Verbosity) -> Result<u8> {
    let (file, folder) = resolve_pipeline(&arguments.pipeline)?;
    let pipeline = read_pipeline(&file, &arguments.changes.assignments())?;
    let out = arguments.out.clone().or(folder).unwrap_or_else(|| Path::new("runs").join(&pipeline.name));
    let stop = stop_flag();
    let outcome = RunProgress::observe(verbosity, |observer| {
        let keep_checkpoint = arguments.keep_checkpoint;
        let mut session = Session { observer, stop: &stop, page: pwrfgs::PAGE, keep_checkpoint };
        pwrfgs::experiment::run(&pipeline, Path::new(""), &out, &mut session)
    });
    match outcome? {
        RunOutcome::Unscored => {
            output::print_note(&format!(
                "stopped before scoring was complete; the model and the scores so far are in {}; repeat the command to resume",
                out.display()
            ));
            Ok(INTERRUPTED)
        }
        RunOutcome::Interrupted { step: 0 } => {
            output::print_note("stopped before the first step; repeat the command to start again");
            Ok(INTERRUPTED)
        }
        RunOutcome::Interrupted { step } => {
            output::print_note(&format!(
                "stopped after step {step} of {}; the checkpoint is in {}; repeat the command to resume",
                pipeline.training.steps * pipeline.members as u64,
                out.display()
            ));
            Ok(INTERRUPTED)
        }
        RunOutcome::Finished { scores, already } => {
            if already {
                verbosity.print_note(&format!("{}: this run is already finished; nothing to do", out.display()));
            }
            let report = pwrfgs::PAGE.map(|_| format!("\nreport: {}\n", out.join(REPORT).display()));
            let table = format_scores(&scores, arguments.all);
            output::print_result(&(table + &report.unwrap_or_default() + &format_last_line(&out)))?;
            Ok(SUCCESS)
        }
    }
}

/// Formats a score table: all metrics, or the main ones of the task.
pub(super) fn format_scores(table: &ScoreTable, all: bool) -> String {
    table.to_text((!all).then_some("--all also prints"))
}

/// Formats the line with the commands that show more of a run; empty if there is none.
fn format_last_line(run: &Path) -> String {
    let commands = [(pwrfgs::PAGE.is_some(), "report"), (cfg!(feature = "viewer"), "view")];
    let commands = commands.iter().filter(|(is_built, _)| *is_built);
    let next: Vec<String> = commands.map(|(_, name)| format!("`pwrfgs {name} {}`", run.display())).collect();
    if next.is_empty() { String::new() } else { format!("next: {}\n", next.join(", ")) }
}
