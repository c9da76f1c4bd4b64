//! Terminal output: results on stdout, all else on stderr, logs above the progress bar.

use indicatif::MultiProgress;
use pwrfgs_core::{Error, Result, messages::escape_control};
use std::collections::BTreeSet;
use std::io::{ErrorKind, IsTerminal as _, Write};
use std::path::Path;
use std::sync::{Mutex, OnceLock, PoisonError};
use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::prelude::*;

/// Exit code of a command that succeeded.
pub(crate) const SUCCESS: u8 = 0;
/// Exit code of a command that failed, such as on a full disk.
pub(crate) const FAILED: u8 = 1;
/// Exit code for invalid input.
pub(crate) const INVALID: u8 = 2;
/// Exit code of an interrupted program, by the convention of shells.
pub(crate) const INTERRUPTED: u8 = 130;

/// Amount of output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub(crate) enum Verbosity {
    /// Only errors, warnings and results.
    Quiet,
    /// Also progress.
    Normal,
    /// Also debug output.
    Verbose,
}

impl Verbosity {
    /// Prints a line on stderr, above the progress bars, unless quiet.
    pub(crate) fn print_note(self, line: &str) {
        if self != Self::Quiet {
            print_note(line);
        }
    }
}

/// Returns the progress bars of the process; lines are printed above them.
pub(crate) fn progress_bars() -> &'static MultiProgress {
    static BARS: OnceLock<MultiProgress> = OnceLock::new();
    BARS.get_or_init(MultiProgress::new)
}

/// Prints a line on stderr, above the progress bars.
pub(crate) fn print_note(line: &str) {
    progress_bars().suspend(|| _ = writeln!(std::io::stderr(), "{}", escape_control(line)));
}

/// Prints a warning on stderr, once per process.
pub(crate) fn print_warning(text: &str) {
    static SHOWN: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if SHOWN.lock().unwrap_or_else(PoisonError::into_inner).insert(text.to_owned()) {
        print_note(&format!("warning: {text}"));
    }
}

/// Prints the message of a failed command.
pub(crate) fn print_error(error: &Error) {
    print_note(&format!("error: {error}"));
}

/// Prints a result on stdout. A closed pipe (`pwrfgs plugins | head`) is not an error.
///
/// # Errors
/// If the result cannot be written, such as on a full disk.
pub(crate) fn print_result(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(escape_control(text).as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::write(Path::new("the result to stdout"), e)),
        _ => Ok(()),
    }
}

/// Sends logs to stderr: warnings; with `-v` also information, and debug output of pwrfgs. A valid `RUST_LOG` overrides this.
pub(crate) fn start_logging(verbosity: Verbosity) {
    let level = match verbosity {
        Verbosity::Verbose => Targets::new().with_default(Level::INFO).with_target("pwrfgs", Level::DEBUG),
        _ => Targets::new().with_default(Level::WARN),
    };
    let filter: Targets = std::env::var("RUST_LOG").ok().and_then(|text| text.parse().ok()).unwrap_or(level);
    let lines = tracing_subscriber::fmt::layer()
        .with_target(false)
        .without_time()
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(|| StderrAboveBars);
    _ = tracing_subscriber::registry().with(lines.with_filter(filter)).try_init(); // the Python package has its own logger
}

/// Writer to stderr, above the progress bars.
struct StderrAboveBars;

impl Write for StderrAboveBars {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        progress_bars().suspend(|| std::io::stderr().write(bytes))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}
