//! Ctrl-C: the first stops at the next point from which the command can resume, the second stops immediately. Commands
//! without such a point stop immediately.
//!
//! Work checks a flag at the points where it can stop. After one second, the process ends: files are always written
//! completely or not at all. Only a training may finish its step, which its checkpoint then contains.

use crate::output::{self, INTERRUPTED};
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Result};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Note of a process that ends before its work has stopped.
const AT_ONCE: &str = "stopped immediately; repeat the command to resume";
/// Time for work other than training to stop.
const GRACE: Duration = Duration::from_secs(1);
/// Interval between checks for signals and running trainings.
const TICK: Duration = Duration::from_millis(50);

/// Number of running trainings.
static TRAININGS: AtomicUsize = AtomicUsize::new(0);
/// Flag that Ctrl-C sets, for commands that can resume.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();
/// Whether the process is ending; later errors are then ignored.
static ENDING: AtomicBool = AtomicBool::new(false);

/// Returns the flag that the first Ctrl-C (or request to terminate) sets. The process ends [`GRACE`] later unless a training
/// runs, or at the second Ctrl-C. Without this call, the first one ends the process.
pub(crate) fn stop_flag() -> Arc<AtomicBool> {
    Arc::clone(STOP.get_or_init(Arc::default))
}

/// Starts a thread that handles Ctrl-C and requests to terminate. It polls a flag, since waiting for a signal does not
/// work on Windows.
pub(crate) fn start_listener() -> Result<()> {
    let failed = |e: std::io::Error| Error::Config(format!("cannot handle Ctrl-C: {e}"));
    let received = Arc::new(AtomicBool::new(false));
    let register = |signal| flag::register(signal, Arc::clone(&received)).map_err(failed);
    register(SIGINT)?;
    register(SIGTERM)?;
    #[cfg(unix)]
    if !is_hang_up_ignored() {
        register(signal_hook::consts::SIGHUP)?;
    }
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(TICK);
            if !received.swap(false, Ordering::Relaxed) {
                continue;
            }
            let Some(stop) = STOP.get() else { end_process("stopped") };
            if stop.swap(true, Ordering::Relaxed) {
                end_process(AT_ONCE);
            }
            output::print_note("stopping at the next resumable point; press Ctrl-C again to stop immediately");
            std::thread::spawn(end_after_grace);
        }
    });
    Ok(())
}

/// Running training, which stops after its current step.
#[derive(Debug)]
pub(crate) struct InterruptibleRun(());

impl InterruptibleRun {
    /// Counts one more running training until the returned value is dropped.
    pub(crate) fn begin() -> Self {
        TRAININGS.fetch_add(1, Ordering::Relaxed);
        Self(())
    }
}

impl Drop for InterruptibleRun {
    fn drop(&mut self) {
        TRAININGS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Blocks forever if another thread is ending the process, so that errors that result from it are not printed.
pub(crate) fn wait_if_ending() {
    while ENDING.load(Ordering::Relaxed) {
        std::thread::sleep(TICK);
    }
}

/// Ends the process as soon as no training has run for [`GRACE`].
fn end_after_grace() {
    let mut last = Instant::now();
    while last.elapsed() < GRACE {
        std::thread::sleep(TICK);
        if TRAININGS.load(Ordering::Relaxed) > 0 {
            last = Instant::now();
        }
    }
    end_process(AT_ONCE)
}

/// Removes unfinished folders, prints `message` and ends the process as interrupted.
fn end_process(message: &str) -> ! {
    ENDING.store(true, Ordering::Relaxed);
    NewFolder::abandon_all();
    output::print_note(message);
    std::process::exit(i32::from(INTERRUPTED))
}

/// Turns a write beyond the file size limit (`ulimit -f`) into an error of that write instead of a fatal signal.
pub(crate) fn survive_file_limit() {
    #[cfg(unix)]
    {
        // The flag is unused. If the handler cannot be installed, the signal ends the process as before.
        _ = flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    }
}

/// Returns whether the process was started to outlive its terminal, as by `nohup`; detected on Linux only.
#[cfg(unix)]
fn is_hang_up_ignored() -> bool {
    let status = pwrfgs_core::files::read_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    // The first bit is that of signal 1, SIGHUP.
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}
