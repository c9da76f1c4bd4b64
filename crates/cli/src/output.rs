//! What reaches the terminal: results on stdout, all else on stderr, logs above the progress bar.

use indicatif::MultiProgress;
use pwrfgs_core::{Error, Result, words::plain};
use std::collections::BTreeSet;
use std::io::{ErrorKind, IsTerminal as _, Write};
use std::path::Path;
use std::sync::{Mutex, OnceLock, PoisonError};
use tracing::Level;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::prelude::*;

/// How much is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd)]
pub(crate) enum Verbosity {
    /// Errors and results.
    Quiet,
    /// Progress too.
    Normal,
    /// What happens inside too.
    Verbose,
}

impl Verbosity {
    /// A line on stderr, unless only errors and results are wanted.
    pub(crate) fn note(self, line: &str) {
        if self != Self::Quiet {
            note(line);
        }
    }
}

/// All progress bars, so that lines can be printed above them.
pub(crate) fn bars() -> &'static MultiProgress {
    static BARS: OnceLock<MultiProgress> = OnceLock::new();
    BARS.get_or_init(MultiProgress::new)
}

/// A line on stderr, above the progress bar.
pub(crate) fn note(line: &str) {
    bars().suspend(|| _ = writeln!(std::io::stderr(), "{}", plain(line)));
}

/// A warning on stderr, once per process however many runs report it.
pub(crate) fn warning(text: &str) {
    static SHOWN: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if SHOWN.lock().unwrap_or_else(PoisonError::into_inner).insert(text.to_owned()) {
        note(&format!("warning: {text}"));
    }
}

/// The one message of a failed command.
pub(crate) fn error(error: &Error) {
    note(&format!("error: {error}"));
}

/// A result. A reader that has gone away (`pwrfgs plugins | head`) is no failure.
///
/// # Errors
/// Where it cannot be written, on a full disk say.
pub(crate) fn result(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(plain(text).as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::write(Path::new("the result to stdout"), e)),
        _ => Ok(()),
    }
}

/// Sends the libraries' logs to stderr: warnings, or everything with `-v`; `RUST_LOG` overrides.
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
        .with_writer(|| Above);
    let started = tracing_subscriber::registry().with(lines.with_filter(filter)).try_init();
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
