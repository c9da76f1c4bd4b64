//! Ctrl-C: once to stop where the same command can go on, twice to stop at once. A command without such a place stops at once.
//!
//! Work looks at the flag where it can stop; what does not within a second is ended, whatever it is: nothing that is
//! written is ever half. A training alone may finish its step, which its checkpoint then holds.

use crate::output;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::{Error, Result};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// What a shell expects of an interrupted program.
pub(crate) const INTERRUPTED: u8 = 130;
const AT_ONCE: &str = "stopped at once; the same command goes on from what is written";
/// How long anything but a training may take to stop.
const GRACE: Duration = Duration::from_secs(1);
/// How often it is looked whether a training goes on.
const TICK: Duration = Duration::from_millis(50);

/// Trainings under way.
static TRAININGS: AtomicUsize = AtomicUsize::new(0);
/// Set by Ctrl-C, for a command that stops where it can go on.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();
/// Whether the program is being ended, and no other end counts.
static ENDING: AtomicBool = AtomicBool::new(false);

/// A flag that Ctrl-C (or a request to terminate) sets; the second one ends the program at once. Without the flag, the
/// first one does.
pub(crate) fn stop_flag() -> Arc<AtomicBool> {
    Arc::clone(STOP.get_or_init(Arc::default))
}

/// Listens for Ctrl-C, in a thread of its own.
pub(crate) fn listen() -> Result<()> {
    let failed = |e: std::io::Error| Error::Config(format!("cannot listen for Ctrl-C: {e}"));
    let mut signals = Signals::new([SIGINT, SIGTERM]).map_err(failed)?;
    #[cfg(unix)]
    if !hang_up_is_ignored() {
        signals.add_signal(signal_hook::consts::SIGHUP).map_err(failed)?;
    }
    std::thread::spawn(move || {
        for _ in signals.forever() {
            let Some(stop) = STOP.get() else { end("stopped") };
            if stop.swap(true, Ordering::Relaxed) {
                end(AT_ONCE);
            }
            output::note("stopping where the same command can go on; once more to stop at once");
            std::thread::spawn(end_what_does_not_stop);
        }
    });
    Ok(())
}

/// A training under way, which stops after its step.
#[derive(Debug)]
pub(crate) struct Training(());

impl Training {
    pub(crate) fn begin() -> Self {
        TRAININGS.fetch_add(1, Ordering::Relaxed);
        Self(())
    }
}

impl Drop for Training {
    fn drop(&mut self) {
        TRAININGS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Waits for the end of the program where it is being ended: an error that comes of it is none.
pub(crate) fn wait_if_ending() {
    while ENDING.load(Ordering::Relaxed) {
        std::thread::sleep(TICK);
    }
}

/// Ends the program once nothing has trained for a while.
fn end_what_does_not_stop() {
    let mut last = Instant::now();
    while last.elapsed() < GRACE {
        std::thread::sleep(TICK);
        if TRAININGS.load(Ordering::Relaxed) > 0 {
            last = Instant::now();
        }
    }
    end(AT_ONCE)
}

fn end(said: &str) -> ! {
    ENDING.store(true, Ordering::Relaxed);
    NewFolder::abandon_all();
    output::note(said);
    std::process::exit(i32::from(INTERRUPTED))
}

/// Turns a write beyond the limit on file sizes (`ulimit -f`) into an error of that write; the signal would end the program.
pub(crate) fn survive_file_limit() {
    #[cfg(unix)]
    {
        // Nobody reads the flag. If the handler cannot be installed, the signal ends the program as before.
        _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::default());
    }
}

/// Whether whoever started this program wants it to outlive the terminal, as `nohup` does; told by Linux only.
#[cfg(unix)]
fn hang_up_is_ignored() -> bool {
    let status = pwrfgs_core::files::read_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    // The first bit is that of signal 1, SIGHUP.
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}
