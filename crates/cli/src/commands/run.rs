//! `pwrfgs run`: a pipeline becomes a run folder.

use crate::args::{Run, Verbosity};
use crate::interrupt::{INTERRUPTED, stop_flag};
use crate::output;
use crate::progress::Progress;
use pwrfgs::experiment::folder::REPORT;
use pwrfgs::experiment::{Outcome, read_pipeline, run as run_pipeline};
use pwrfgs_core::Result;
use std::path::Path;
use std::process::ExitCode;

pub(crate) fn run(arguments: &Run, verbosity: Verbosity) -> Result<ExitCode> {
    let pipeline = read_pipeline(&arguments.pipeline, &arguments.set)?;
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(&pipeline.name));
    let stop = stop_flag()?;
    let mut progress = Progress::new(verbosity);
    let outcome = run_pipeline(&pipeline, Path::new(""), &out, &mut progress, &stop);
    progress.finish();
    match outcome? {
        Outcome::Unscored => {
            output::note(&format!(
                "stopped before the scores were complete; the trained model lies in {}, and the same command scores it",
                out.display()
            ));
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
            if already && verbosity != Verbosity::Quiet {
                output::note(&format!("{} holds this very run, finished: nothing to do", out.display()));
            }
            output::result(&format!("{}\nreport: {}\n", scores.to_text(), out.join(REPORT).display()));
            Ok(ExitCode::SUCCESS)
        }
    }
}
