//! Ctrl-C: once to stop where the same command can go on, twice to stop at once.

use crate::output;
use pwrfgs_core::{Error, Result};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// What a shell expects of an interrupted program.
pub(crate) const INTERRUPTED: u8 = 130;

/// A flag that Ctrl-C (or a request to terminate) sets; the second one ends the program at once.
pub(crate) fn stop_flag() -> Result<Arc<AtomicBool>> {
    let failed = |e: std::io::Error| Error::Config(format!("cannot listen for Ctrl-C: {e}"));
    let mut signals = Signals::new([SIGINT, SIGTERM]).map_err(failed)?;
    #[cfg(unix)]
    if !hang_up_is_ignored() {
        signals.add_signal(signal_hook::consts::SIGHUP).map_err(failed)?;
    }
    let stop = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&stop);
    std::thread::spawn(move || {
        for _ in signals.forever() {
            if raised.swap(true, Ordering::Relaxed) {
                std::process::exit(i32::from(INTERRUPTED));
            }
            output::note("stopping where the same command can go on; once more to stop at once");
        }
    });
    Ok(stop)
}

/// Whether whoever started this program wants it to outlive the terminal, as `nohup` does; told by Linux only.
#[cfg(unix)]
fn hang_up_is_ignored() -> bool {
    let status = pwrfgs_core::files::read_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    // The first bit is that of signal 1, SIGHUP.
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}
