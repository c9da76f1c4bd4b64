//! Between Rust and Python: errors and warnings, plugins, the interpreter's lock, Ctrl-C, and processes that forked.

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

/// How often Ctrl-C is looked for.
pub(crate) const LOOK: Duration = Duration::from_millis(50);
/// Events that may wait for a slow listener.
const WAITING: usize = 64;

thread_local! {
    /// Strategies that are being asked on this thread.
    static ASKED: Cell<usize> = const { Cell::new(0) };
}

/// The process that loaded the library. Threads do not survive a fork.
static HOME: OnceLock<u32> = OnceLock::new();

/// Remembers the process, and refuses an environment that asks for too many threads.
pub(crate) fn begin(py: Python<'_>) -> PyResult<()> {
    HOME.get_or_init(process::id);
    pwrfgs_core::threads::check_environment().map_err(|error| raised(py, error))
}

/// Refuses a process that was forked after the library was loaded: its threads are not there, and it would wait for ever.
pub(crate) fn at_home() -> PyResult<()> {
    if *HOME.get_or_init(process::id) == process::id() {
        return Ok(());
    }
    Err(PyRuntimeError::new_err(
        "pwrfgs was loaded before this process was forked, and its threads stayed behind; start processes with \
         multiprocessing.get_context(\"spawn\"), or import pwrfgs in the child only",
    ))
}

/// Whether a strategy is being asked on this thread: what it does then must not wait for the run that asks it.
pub(crate) fn asked() -> bool {
    ASKED.get() > 0
}

/// Does `work` as a strategy that is being asked.
pub(crate) fn asking<T>(work: impl FnOnce() -> T) -> T {
    struct Asking;
    impl Drop for Asking {
        fn drop(&mut self) {
            ASKED.set(ASKED.get() - 1);
        }
    }
    ASKED.set(ASKED.get() + 1);
    let _asking = Asking;
    work()
}

/// Does `work` without the interpreter's lock.
pub(crate) fn free<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T> + Send) -> PyResult<T> {
    at_home()?;
    let done = py.detach(|| catch_unwind(AssertUnwindSafe(work)));
    settled(py, done)
}

/// The same, of something that others may have in hand: `work` gives nothing while they have, and is tried again. Ctrl-C ends
/// the waiting.
pub(crate) fn free_once_there<T: Send>(
    py: Python<'_>,
    mut work: impl FnMut() -> Option<Result<T>> + Send,
) -> PyResult<T> {
    at_home()?;
    loop {
        match py.detach(|| catch_unwind(AssertUnwindSafe(&mut work))).transpose() {
            Some(done) => return settled(py, done),
            None if asked() => {
                return Err(wrong(
                    py,
                    "this trainer is in the middle of a step, and the strategy that it asks cannot use it",
                ));
            }
            None => {
                py.check_signals()?;
                py.detach(|| std::thread::sleep(Duration::from_millis(1)));
            }
        }
    }
}

/// Does `work` on a thread of its own, while this one looks for Ctrl-C and hands events to `hear`. Once it is interrupted,
/// or `hear` raises, `work` is told to stop, and what interrupted it is raised when it has.
pub(crate) fn waited<T: Send, E: Send>(
    py: Python<'_>,
    work: impl FnOnce(SyncSender<E>, &AtomicBool) -> Result<T> + Send,
    mut hear: impl FnMut(E) -> PyResult<()>,
) -> PyResult<T> {
    at_home()?;
    let stop = AtomicBool::new(false);
    let (sender, events) = sync_channel(WAITING);
    std::thread::scope(|scope| {
        let worker = scope.spawn(|| catch_unwind(AssertUnwindSafe(|| work(sender, &stop))));
        let mut raised: Option<PyErr> = None;
        while let Some(event) = next(py, &events) {
            let said = match event {
                Some(event) if raised.is_none() => hear(event),
                _ => Ok(()),
            };
            if let Err(error) = said.and_then(|()| py.check_signals()) {
                stop.store(true, Ordering::Relaxed);
                raised.get_or_insert(error);
            }
        }
        let done = py.detach(|| worker.join()).unwrap_or_else(Err);
        match (settled(py, done), raised) {
            (_, Some(error)) => Err(error),
            (done, None) => done,
        }
    })
}

/// The next event; `Some(None)` after a while without one, `None` when the worker is done.
#[allow(clippy::option_option)]
fn next<E: Send>(py: Python<'_>, events: &Receiver<E>) -> Option<Option<E>> {
    // A receiver is no thing to share, and is not: this thread waits.
    let events = AssertSend(events);
    match py.detach(move || events.wait()) {
        Ok(event) => Some(Some(event)),
        Err(RecvTimeoutError::Timeout) => Some(None),
        Err(RecvTimeoutError::Disconnected) => None,
    }
}

/// A receiver that stays on its thread while the lock is free.
struct AssertSend<'a, E>(&'a Receiver<E>);

#[allow(unsafe_code)]
// SAFETY: `detach` runs its closure on the calling thread, so that the receiver is used by one thread only.
unsafe impl<E> Send for AssertSend<'_, E> {}

impl<E> AssertSend<'_, E> {
    fn wait(&self) -> Result<E, RecvTimeoutError> {
        self.0.recv_timeout(LOOK)
    }
}

/// What work came to, as Python has it.
fn settled<T>(py: Python<'_>, done: Result<Result<T>, Box<dyn Any + Send>>) -> PyResult<T> {
    match done {
        Ok(done) => done.map_err(|error| raised(py, error)),
        Err(panic) => Err(match panic.downcast::<PyErr>() {
            Ok(error) => *error,
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason given");
                exception(py, "Error", &format!("this is a mistake in pwrfgs, please report it: {text}"))
            }
        }),
    }
}

/// An exception of the class `name` of `pwrfgs`.
fn exception(py: Python<'_>, name: &str, message: &str) -> PyErr {
    let made = py.import("pwrfgs._errors").and_then(|m| m.getattr(name)).and_then(|class| class.call1((message,)));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// An error of the toolkit as an exception: with the same text, and where it names a file with `path`, `line` and `column`.
pub(crate) fn raised(py: Python<'_>, error: Error) -> PyErr {
    let is_input = error.is_input();
    let message = without_flags(&error.to_string());
    match error {
        Error::Plugin(inner) => match inner.downcast::<PyErr>() {
            Ok(error) => *error, // an exception of a strategy, with its traceback
            Err(_) => exception(py, "InputError", &message),
        },
        Error::Stopped => PyKeyboardInterrupt::new_err(message),
        Error::Input { path, at, .. } => {
            let made = exception(py, "InputError", &message);
            let value = made.value(py);
            _ = value.setattr("path", path.display().to_string());
            if let Some((line, column)) = at {
                _ = value.setattr("line", line).and_then(|()| value.setattr("column", column));
            }
            made
        }
        _ => exception(py, if is_input { "InputError" } else { "Error" }, &message),
    }
}

/// Settings by the names that they have in Python, where the command line has flags.
fn without_flags(message: &str) -> String {
    let flags = [
        ("--set ", ""),
        ("another --out", "another `out`"),
        ("--reference", "reference"),
        ("--scale ", "scale="),
        ("--launcher", "the launcher"),
    ];
    flags.iter().fold(message.to_owned(), |message, (flag, own)| message.replace(flag, own))
}

/// Wrong input that only Python can give.
pub(crate) fn wrong(py: Python<'_>, message: &str) -> PyErr {
    exception(py, "InputError", message)
}

/// An exception on its way through code that knows none: it unwinds to [`free`] or [`waited`].
pub(crate) fn throw(error: PyErr) -> ! {
    std::panic::resume_unwind(Box::new(error))
}

/// The same as an error of the toolkit.
pub(crate) fn carried(error: PyErr) -> Error {
    Error::Plugin(Box::new(error))
}

/// The RON text of what a user gives for a plugin of this kind: a value, a name with settings, or an object of a class of
/// their own.
pub(crate) fn text_of(kind: &str, value: &Bound<'_, PyAny>, settings: Option<&Bound<'_, PyDict>>) -> PyResult<String> {
    let helper = value.py().import("pwrfgs._values")?.getattr("plugin_text")?;
    helper.call1((kind, value, settings))?.extract()
}

/// A plugin from its text.
pub(crate) fn plugin<T: ?Sized + PluginKind>(py: Python<'_>, text: &str) -> PyResult<Plugin<T>>
where
    Box<T>: for<'de> pwrfgs::prelude::Deserialize<'de>,
{
    free(py, || read_ron(text, Path::new(T::KIND)).map_err(unplaced))
}

/// Without the position, which would count in a text that nobody has seen.
pub(crate) fn unplaced(error: Error) -> Error {
    match error {
        Error::Input { message, .. } => Error::Config(message),
        other => other,
    }
}

/// Hears warnings from now on, as records of Python's `logging` under the name "pwrfgs": printed on the error stream where
/// nobody has said otherwise.
pub(crate) fn log_warnings() {
    _ = tracing::subscriber::set_global_default(Logger); // whoever was there first stays
}

/// Hands warnings on; spans it does not look at.
struct Logger;

/// The text of an event.
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
        // Where logging fails there is nobody left to tell.
        Python::attach(|py| {
            let logger = py.import("logging").and_then(|logging| logging.call_method1("getLogger", ("pwrfgs",)));
            _ = logger.and_then(|logger| logger.call_method1("warning", ("%s", text.0)));
        });
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}
    fn record_follows_from(&self, _: &Id, _: &Id) {}
    fn enter(&self, _: &Id) {}
    fn exit(&self, _: &Id) {}
}
