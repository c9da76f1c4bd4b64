//! `Session`: what accompanies a run from outside, in one argument.

use crate::observer::Observer;
use crate::page::Page;
use pwrfgs_core::{Error, Result};
use std::sync::atomic::{AtomicBool, Ordering};

/// Observer, cancellation and report of a run, a sweep or an evaluation.
pub struct Session<'a> {
    /// Receives progress, messages and warnings.
    pub observer: &'a mut dyn Observer,
    /// Once it is set, work ends early with [`Error::Stopped`], or with a checkpoint.
    pub stop: &'a AtomicBool,
    /// Makes `report.html`; `None` writes none.
    pub page: Option<Page>,
}

impl std::fmt::Debug for Session<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("stop", self.stop).field("page", &self.page.is_some()).finish_non_exhaustive()
    }
}

impl<'a> Session<'a> {
    /// Creates a session that never stops early and writes no report.
    pub fn new(observer: &'a mut dyn Observer) -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self { observer, stop: &NEVER, page: None }
    }

    /// Returns [`Error::Stopped`] once `stop` is set.
    ///
    /// # Errors
    /// As above.
    pub fn check_stopped(&self) -> Result<()> {
        check_stopped(self.stop)
    }
}

/// Returns [`Error::Stopped`] once `stop` is set.
pub(crate) fn check_stopped(stop: &AtomicBool) -> Result<()> {
    if stop.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
}
