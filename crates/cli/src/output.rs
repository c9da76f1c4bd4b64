//! What reaches the terminal: results on stdout, all else on stderr, logs above the progress bar.

use crate::args::Verbosity;
use indicatif::MultiProgress;
use pwrfgs_core::Error;
use std::io::{IsTerminal as _, Write};
use std::sync::OnceLock;
use tracing_subscriber::EnvFilter;

/// All progress bars, so that lines can be printed above them.
pub(crate) fn bars() -> &'static MultiProgress {
    static BARS: OnceLock<MultiProgress> = OnceLock::new();
    BARS.get_or_init(MultiProgress::new)
}

/// A line on stderr, above the progress bar.
pub(crate) fn note(line: &str) {
    bars().suspend(|| _ = writeln!(std::io::stderr(), "{line}"));
}

/// The one message of a failed command.
pub(crate) fn error(error: &Error) {
    note(&format!("error: {error}"));
}

/// A result. A reader that has gone away (`pwrfgs plugins | head`) is no failure.
pub(crate) fn result(text: &str) {
    _ = std::io::stdout().write_all(text.as_bytes());
}

/// Sends the libraries' logs to stderr: warnings, or everything with `-v`; `RUST_LOG` overrides.
pub(crate) fn start_logging(verbosity: Verbosity) {
    let level = if verbosity == Verbosity::Verbose { "info,pwrfgs=debug" } else { "warn" };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let started = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        .without_time()
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(|| Above)
        .try_init();
    if let Err(e) = started {
        note(&format!("warning: no logs: {e}"));
    }
}

/// Writes to stderr above the bars.
struct Above;

impl Write for Above {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        bars().suspend(|| std::io::stderr().write(bytes))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}
