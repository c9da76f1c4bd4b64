//! Ctrl-C: once to stop where the same command can go on, twice to stop at once.

use crate::output;
use pwrfgs_core::{Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What a shell expects of an interrupted program.
pub(crate) const INTERRUPTED: u8 = 130;

/// A flag that Ctrl-C (or a request to terminate) sets; the second one ends the program at once.
pub(crate) fn stop_flag() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if raised.swap(true, Ordering::Relaxed) {
            std::process::exit(i32::from(INTERRUPTED));
        }
        output::note("stopping where the same command can go on; once more to stop at once");
    })
    .map_err(|e| Error::Config(format!("cannot listen for Ctrl-C: {e}")))?;
    Ok(stop)
}
