//! `pwrfgs run`: a pipeline becomes a run folder.

use crate::args::{Run, Verbosity};
use crate::output;
use crate::pipeline::load;
use crate::progress::Progress;
use pwrfgs::experiment::folder::REPORT;
use pwrfgs::experiment::{Outcome, run as run_pipeline};
use pwrfgs_core::{Error, Result};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What a shell expects of an interrupted program.
const INTERRUPTED: u8 = 130;

pub(crate) fn run(arguments: &Run, verbosity: Verbosity) -> Result<ExitCode> {
    let pipeline = load(&arguments.pipeline, &arguments.set)?;
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(&pipeline.name));
    let stop = stop_flag()?;
    let mut progress = Progress::new(verbosity);
    let outcome = run_pipeline(&pipeline, Path::new(""), &out, &mut progress, &stop);
    progress.finish();
    match outcome? {
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

/// A flag that Ctrl-C (or a request to terminate) sets; the second one ends the program at once.
fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if raised.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(INTERRUPTED));
        }
        output::note("stopping after this step; once more to stop at once");
    })
    .map_err(|e| Error::Config(format!("cannot listen for Ctrl-C: {e}")))?;
    Ok(stop)
}
