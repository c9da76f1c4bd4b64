//! `pwrfgs run`: a pipeline becomes a run folder.

use super::options::{Changes, named};
use crate::interrupt::{INTERRUPTED, stop_flag};
use crate::output::{self, Verbosity};
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::folder::REPORT;
use pwrfgs::experiment::{Outcome, read_pipeline};
use pwrfgs_core::Result;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
#[command(
    after_long_help = "The run folder holds pipeline.ron (every setting), curve.csv, validation.csv, scores.csv, \
    samples.csv, run.json, the checkpoint, model.safetensors and report.html; with --set tensorboard=true also \
    an event file, which `tensorboard --logdir runs` shows while the run goes on. The same command resumes a run that \
    was stopped or killed, and ends in the same files; with other baselines or metrics it scores the trained model anew, \
    without training. A folder that holds anything else is never touched.\n\nPaths in \
    a pipeline are relative to its file; on the command line, to where you stand.\n\nEXAMPLES\n  pwrfgs run \
    pipelines/s23-laptop.ron --set data.root=../shared/data/s23\n  pwrfgs run \
    pipelines/pwrfgs.ron --set 'initializer=Random(count: 20_000, std: 10.0)' --out runs/fewer\n  pwrfgs run \
    runs/fewer --set seed=1 --out runs/fewer-1\n  pwrfgs run pipelines/quickstart.ron --scale 0.25 --out runs/short"
)]
pub(crate) struct Run {
    /// The file of a pipeline; or a run folder, whose run is resumed, or repeated where --out says
    #[arg(value_name = "PIPELINE")]
    pub(crate) pipeline: PathBuf,
    #[command(flatten)]
    pub(crate) changes: Changes,
    /// The run folder [default: runs/NAME, after the name of the pipeline]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Run, verbosity: Verbosity) -> Result<ExitCode> {
    let (file, folder) = named(&arguments.pipeline)?;
    let pipeline = read_pipeline(&file, &arguments.changes.all())?;
    let out = arguments.out.clone().or(folder).unwrap_or_else(|| Path::new("runs").join(&pipeline.name));
    let stop = stop_flag();
    let outcome = Progress::during(verbosity, |progress| pwrfgs::run(&pipeline, Path::new(""), &out, progress, &stop));
    match outcome? {
        Outcome::Unscored => {
            output::note(&format!(
                "stopped before the scores were complete; the trained model lies in {}, and the same command scores it",
                out.display()
            ));
            Ok(ExitCode::from(INTERRUPTED))
        }
        Outcome::Interrupted { step: 0 } => {
            output::note("stopped before the first step; the same command begins again");
            Ok(ExitCode::from(INTERRUPTED))
        }
        Outcome::Interrupted { step } => {
            output::note(&format!(
                "stopped after step {step} of {}; the checkpoint lies in {}, and the same command goes on from there",
                pipeline.training.steps,
                out.display()
            ));
            Ok(ExitCode::from(INTERRUPTED))
        }
        Outcome::Finished { scores, already } => {
            if already {
                verbosity.note(&format!("{} holds this very run, finished: nothing to do", out.display()));
            }
            let report = pwrfgs::PAGE.map(|_| format!("\nreport: {}\n", out.join(REPORT).display()));
            output::result(&(scores.to_text() + &report.unwrap_or_default()))?;
            Ok(ExitCode::SUCCESS)
        }
    }
}
