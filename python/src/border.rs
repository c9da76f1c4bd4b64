//! Bridge between Rust and Python: errors, warnings, plugins, the interpreter lock (GIL), Ctrl-C and forked processes.

use pwrfgs_core::messages::sanitize_message;
use pwrfgs_core::plugin::{PluginKind, read_ron};
use pwrfgs_core::{Error, Plugin, Result};
use pyo3::exceptions::{PyKeyboardInterrupt, PyRuntimeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::any::Any;
use std::cell::Cell;
use std::fmt::{Debug, Write as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// Interval between checks for Ctrl-C.
pub(crate) const CHECK_INTERVAL: Duration = Duration::from_millis(50);
/// Largest number of queued events for a slow listener.
const QUEUE_LENGTH: usize = 64;

thread_local! {
    /// Number of nested strategy calls on this thread.
    static STRATEGY_CALLS: Cell<usize> = const { Cell::new(0) };
}

/// Id of the process that loaded the library. Threads do not survive a fork.
static LOADED_BY: OnceLock<u32> = OnceLock::new();

/// Records the process for [`check_not_forked`]; returns an error if the environment requests too many threads.
pub(crate) fn record_process(py: Python<'_>) -> PyResult<()> {
    LOADED_BY.get_or_init(process::id);
    pwrfgs_core::threads::check_environment().map_err(|error| to_exception(py, error))
}

/// Returns an error in a process that was forked after loading the library: its threads are missing, so it would hang.
pub(crate) fn check_not_forked() -> PyResult<()> {
    if *LOADED_BY.get_or_init(process::id) == process::id() {
        return Ok(());
    }
    Err(PyRuntimeError::new_err(
        "pwrfgs was loaded before this process was forked, and its threads stayed behind; start processes with \
         multiprocessing.get_context(\"spawn\"), or import pwrfgs in the child only",
    ))
}

/// Returns whether a strategy is called on this thread: its code must not wait for the run that called it.
pub(crate) fn is_in_strategy_call() -> bool {
    STRATEGY_CALLS.get() > 0
}

/// Performs `work` as part of a strategy call.
pub(crate) fn call_strategy<T>(work: impl FnOnce() -> T) -> T {
    // Ends the call also if `work` unwinds.
    struct StrategyCall;
    impl Drop for StrategyCall {
        fn drop(&mut self) {
            STRATEGY_CALLS.set(STRATEGY_CALLS.get() - 1);
        }
    }
    STRATEGY_CALLS.set(STRATEGY_CALLS.get() + 1);
    let _call = StrategyCall;
    work()
}

/// Performs `work` without the interpreter lock. Raises an exception for its error or panic, and in a forked process.
pub(crate) fn without_gil<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    check_not_forked()?;
    let done = py.detach(|| catch_unwind(AssertUnwindSafe(work)));
    python_result(py, done)
}

/// Performs `work` on a shared object without the interpreter lock: `work` returns `None` while the object is in use,
/// and is tried again. Ctrl-C ends the waiting. Inside a strategy call, an object in use is an error: the call would
/// wait for itself.
pub(crate) fn poll_work<T: Send>(py: Python<'_>, mut work: impl FnMut() -> Option<Result<T>> + Send) -> PyResult<T> {
    check_not_forked()?;
    loop {
        match py.detach(|| catch_unwind(AssertUnwindSafe(&mut work))).transpose() {
            Some(done) => return python_result(py, done),
            None if is_in_strategy_call() => {
                return reject(
                    py,
                    "this trainer is in the middle of a step, and the strategy that it asks cannot use it",
                );
            }
            None => {
                py.check_signals()?;
                py.detach(|| std::thread::sleep(Duration::from_millis(1)));
            }
        }
    }
}

/// Performs `work` on a separate thread, while this thread checks for Ctrl-C and passes events to `on_event`. An
/// interrupt, or an exception in `on_event`, sets the flag at which `work` should stop, and is raised when `work` has
/// ended.
pub(crate) fn run_with_events<T: Send, E: Send>(
    py: Python<'_>,
    work: impl FnOnce(SyncSender<E>, &AtomicBool) -> Result<T> + Send,
    mut on_event: impl FnMut(E) -> PyResult<()>,
) -> PyResult<T> {
    check_not_forked()?;
    let stop = AtomicBool::new(false);
    let (sender, events) = sync_channel(QUEUE_LENGTH);
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| catch_unwind(AssertUnwindSafe(|| work(sender, &stop))));
        let mut raised: Option<PyErr> = None;
        while let Some(event) = next_event(py, &events) {
            let handled = match event {
                Some(event) if raised.is_none() => on_event(event),
                _ => Ok(()),
            };
            if let Err(error) = handled.and_then(|()| py.check_signals()) {
                stop.store(true, Ordering::Relaxed);
                raised.get_or_insert(error);
            }
        }
        let done = py.detach(|| worker.join()).unwrap_or_else(Err);
        match (python_result(py, done), raised) {
            (_, Some(error)) => Err(error),
            (done, None) => done,
        }
    })
}

/// Performs a long `job` without the interpreter lock: Ctrl-C sets the flag at which `job` should stop, and is raised
/// when it has ended.
pub(crate) fn run_stoppable<T: Send>(py: Python<'_>, job: impl FnOnce(&AtomicBool) -> Result<T> + Send) -> PyResult<T> {
    run_with_events::<T, ()>(py, |_, stop| job(stop), |()| Ok(()))
}

/// Returns a progress callback for work that has no other point to stop at: once `stop` is set, it unwinds to
/// [`run_with_events`], which raises the exception.
pub(crate) fn stop_progress(stop: &AtomicBool) -> impl Fn(usize, usize) + Sync {
    move |_, _| {
        if stop.load(Ordering::Relaxed) {
            std::panic::resume_unwind(Box::new("stopped"));
        }
    }
}

/// Returns the next event; `Some(None)` after a pause without one, `None` when the worker has finished.
#[allow(clippy::option_option)]
fn next_event<E: Send>(py: Python<'_>, events: &Receiver<E>) -> Option<Option<E>> {
    // Wraps the receiver, since `detach` requires `Send`.
    let events = AssertSend(events);
    match py.detach(move || events.wait()) {
        Ok(event) => Some(Some(event)),
        Err(RecvTimeoutError::Timeout) => Some(None),
        Err(RecvTimeoutError::Disconnected) => None,
    }
}

/// Receiver that stays on its thread while the lock is released.
struct AssertSend<'a, E>(&'a Receiver<E>);

#[allow(unsafe_code)]
// SAFETY: `detach` runs its closure on the calling thread, so that the receiver is used by one thread only.
unsafe impl<E> Send for AssertSend<'_, E> {}

impl<E> AssertSend<'_, E> {
    /// Waits for the next event, at most [`CHECK_INTERVAL`].
    fn wait(&self) -> Result<E, RecvTimeoutError> {
        self.0.recv_timeout(CHECK_INTERVAL)
    }
}

/// Converts the result of work to Python: an error or a panic becomes an exception.
fn python_result<T>(py: Python<'_>, done: Result<Result<T>, Box<dyn Any + Send>>) -> PyResult<T> {
    match done {
        Ok(done) => done.map_err(|error| to_exception(py, error)),
        Err(panic) => Err(match panic.downcast::<Error>() {
            Ok(error) => to_exception(py, *error), // unwound by [`throw`], not a bug
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason given");
                new_exception(py, "Error", &format!("internal error in pwrfgs; please report it: {text}"))
            }
        }),
    }
}

/// Creates an exception of the class `name` of `pwrfgs`; if that fails, returns the exception of the failure.
fn new_exception(py: Python<'_>, name: &str, message: &str) -> PyErr {
    let exception = py.import("pwrfgs._errors").and_then(|m| m.getattr(name)).and_then(|class| class.call1((message,)));
    exception.map_or_else(|error| error, PyErr::from_value)
}

/// Converts an error to an exception with its text after [`replace_flags`]: `InputError` for invalid input,
/// `KeyboardInterrupt` after a stop, otherwise `Error`. It has `path`, `line` and `column` if the error names a file.
/// An exception that the error wraps is returned itself.
pub(crate) fn to_exception(py: Python<'_>, error: Error) -> PyErr {
    let is_input = error.is_input();
    let message = replace_flags(&error.to_string());
    match error {
        Error::Plugin(inner) => match inner.downcast::<PyErr>() {
            Ok(error) => *error, // an exception of a strategy, with its traceback
            Err(inner) => {
                let exception = new_exception(py, "InputError", &message);
                let cause = inner.source().and_then(|cause| cause.downcast_ref::<PyErr>());
                exception.set_cause(py, cause.map(|cause| cause.clone_ref(py)));
                exception
            }
        },
        Error::Stopped => PyKeyboardInterrupt::new_err(message),
        Error::Input { path, at, .. } => {
            let exception = new_exception(py, "InputError", &message);
            let value = exception.value(py);
            _ = value.setattr("path", path.display().to_string());
            if let Some((line, column)) = at {
                _ = value.setattr("line", line).and_then(|()| value.setattr("column", column));
            }
            exception
        }
        _ => new_exception(py, if is_input { "InputError" } else { "Error" }, &message),
    }
}

/// Parts of messages for the command line with their texts in Python. They are replaced in this order: a longer part precedes
/// one that it contains.
const PYTHON_TEXTS: [(&str, &str); 12] = [
    ("`residuals: Kriged()`", "`residuals=pwrfgs.settings.Kriged()`"),
    (
        "give it to `import --orientation`, or as `orientation` in gateway_info.yml",
        "give it as `orientation` of the receiver",
    ),
    (
        "this program was compiled without GPU support; compile it with `cargo build --release --features gpu`",
        "this package was compiled without GPU support; install it with `MATURIN_PEP517_ARGS='--features gpu' pip install ./python`",
    ),
    ("leave --device out", "use the CPU"),
    ("`pwrfgs devices`", "pwrfgs.devices()"),
    ("--device", "use_device"),
    ("--set ", ""),
    ("another --out", "another `out`"),
    ("--scale ", "scale="),
    ("to add one, give the complete list", "give the complete list; values of an axis: `[[Mine(0.1)], [Mine(0.2)]]`"),
    ("--candidates FILE or --floor SCENE", "`candidates` or `floor`"),
    ("--accept ", "accept="),
];

/// Returns a message with [`PYTHON_TEXTS`] replaced, and then command-line flags by names of Python arguments:
/// `no_grid` for `--no-grid`. Flags of commands between backticks are unchanged.
pub(crate) fn replace_flags(message: &str) -> String {
    let message = PYTHON_TEXTS.iter().fold(message.to_owned(), |message, (flag, text)| message.replace(flag, text));
    let is_command = |k: usize, part: &str| k % 2 == 1 && !part.starts_with("--");
    let parts = message.split('`').enumerate();
    let replaced = parts.map(|(k, part)| if is_command(k, part) { part.to_owned() } else { argument_names(part) });
    replaced.collect::<Vec<_>>().join("`")
}

/// Returns a text with the name of a Python argument in place of each flag, such as `--no-grid`.
fn argument_names(text: &str) -> String {
    let is_in_flag = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    let (mut names, mut remaining) = (String::new(), text);
    while let Some((before, after)) = remaining.split_once("--") {
        let (flag, tail) = after.split_at(after.find(|c| !is_in_flag(c)).unwrap_or(after.len()));
        let is_flag =
            flag.starts_with(|c: char| c.is_ascii_lowercase()) && !before.ends_with(|c: char| c.is_alphanumeric());
        names += before;
        names += &if is_flag { flag.replace('-', "_") } else { ["--", flag].concat() };
        remaining = tail;
    }
    names + remaining
}

/// Creates an `InputError`, for input that is invalid only in Python.
pub(crate) fn input_error(py: Python<'_>, message: &str) -> PyErr {
    new_exception(py, "InputError", &sanitize_message(message))
}

/// Returns an `InputError` as the result of a function.
pub(crate) fn reject<T>(py: Python<'_>, message: &str) -> PyResult<T> {
    Err(input_error(py, message))
}

/// Throws an exception through code without exceptions: it unwinds to [`without_gil`] or [`run_with_events`], or ends a run
/// of a sweep.
pub(crate) fn throw(error: PyErr) -> ! {
    std::panic::resume_unwind(Box::new(to_plugin_error(error)))
}

/// Wraps an exception as an error of the toolkit, from which [`to_exception`] recovers it.
pub(crate) fn to_plugin_error(error: PyErr) -> Error {
    Error::Plugin(Box::new(error))
}

/// Returns the RON text of a plugin given by a user: a value, a name with settings, or an object of a user class.
pub(crate) fn plugin_text(
    kind: &str,
    value: &Bound<'_, PyAny>,
    settings: Option<&Bound<'_, PyDict>>,
) -> PyResult<String> {
    let helper = value.py().import("pwrfgs._values")?.getattr("plugin_text")?;
    helper.call1((kind, value, settings))?.extract()
}

/// Parses a plugin from RON text; the exception has no position, which would refer to a generated text.
pub(crate) fn parse_plugin<T: ?Sized + PluginKind>(py: Python<'_>, text: &str) -> PyResult<Plugin<T>>
where
    Box<T>: for<'de> pwrfgs::prelude::Deserialize<'de>,
{
    without_gil(py, || read_ron(text, Path::new(T::KIND)).map_err(without_position))
}

/// Returns the error without its position, which refers to a generated text.
pub(crate) fn without_position(error: Error) -> Error {
    match error {
        Error::Input { message, .. } => Error::Config(message),
        other => other,
    }
}

/// Logs a message under the name "pwrfgs"; `level` is the name of a method, such as `info`. A failure of the logger is
/// ignored.
pub(crate) fn log_message(level: &str, text: &str) {
    Python::attach(|py| {
        let logger = py.import("pwrfgs._log").and_then(|module| module.getattr("log"));
        _ = logger.and_then(|logger| logger.call_method1(level, ("%s", text)));
    });
}

/// Forwards warnings to Python's `logging` under the name "pwrfgs"; by default they are printed on the error stream.
pub(crate) fn log_warnings() {
    _ = tracing::subscriber::set_global_default(Logger); // an earlier logger is kept
}

/// Forwards warnings and ignores spans.
struct Logger;

/// Text of an event.
#[derive(Default)]
struct Text(String);

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        if field.name() == "message" {
            _ = write!(self.0, "{value:?}");
        }
    }
}

impl Subscriber for Logger {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::WARN && metadata.target().starts_with("pwrfgs")
    }

    fn event(&self, event: &Event<'_>) {
        let mut text = Text::default();
        event.record(&mut text);
        log_message("warning", &text.0);
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}
    fn record_follows_from(&self, _: &Id, _: &Id) {}
    fn enter(&self, _: &Id) {}
    fn exit(&self, _: &Id) {}
}
