//! `Session`: what accompanies a run from outside: who follows it, what stops it, who makes its page. The library
//! prints nothing; `cli` draws a progress bar.

use crate::record::Record;
use crate::scores::ScoreTable;
use pwrfgs_core::{Dataset, Error, Partition, Progress, Result, Task};
use pwrfgs_model::Ensemble;
use pwrfgs_train::{Estimate, StepReport};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// What a run is about to do.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The run folder.
    pub folder: &'a Path,
    /// What the data call themselves.
    pub title: &'a str,
    /// What they hold.
    pub task: Task,
    /// Samples for training, validation, test.
    pub samples: [usize; 3],
    /// Steps that an earlier start has done.
    pub done: u64,
    /// Steps in all.
    pub steps: u64,
    /// What a step takes, with the Gaussians at hand.
    pub estimate: Estimate,
}

/// A look at the validation part: one row of `validation.csv`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validation {
    /// Training step.
    pub step: u64,
    /// What was looked at.
    pub task: Task,
    /// The columns of [`Headline`](pwrfgs_core::Headline): mean and median, and one number more.
    pub values: [f64; 3],
}

/// Hears of everything that happens in a run; every method does nothing by default.
pub trait Observer: Send {
    /// Something other than training is under way: loading or simulating spectra, scoring a predictor. It begins with
    /// (0, 0); then `done` of `total` rises from call to call.
    fn on_stage(&mut self, name: &str, done: usize, total: usize) {
        let _ = (name, done, total);
    }

    /// Training starts or goes on.
    fn on_start(&mut self, start: &Start<'_>) {
        let _ = start;
    }

    /// A training step is done.
    fn on_step(&mut self, report: &StepReport) {
        let _ = report;
    }

    /// The validation part was looked at.
    fn on_validation(&mut self, validation: &Validation) {
        let _ = validation;
    }

    /// All scores on the test part are known.
    fn on_evaluation(&mut self, scores: &ScoreTable) {
        let _ = scores;
    }

    /// Something else worth a line.
    fn on_message(&mut self, message: &str) {
        let _ = message;
    }

    /// Input that can be used, but is probably not what was meant; several runs may report the same.
    fn on_warning(&mut self, warning: &str) {
        self.on_message(&format!("warning: {warning}"));
    }
}

/// Observer that ignores all events, and board that ignores all runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}

/// Does `work`, whose progress the observer hears of as that of the stage `name`.
pub fn staged<R>(observer: &mut dyn Observer, name: &str, work: impl FnOnce(Progress<'_>) -> R) -> R {
    observer.on_stage(name, 0, 0);
    let state = Mutex::new((observer, 0));
    work(&|done, total| {
        let (observer, most) = &mut *state.lock().unwrap_or_else(PoisonError::into_inner);
        if done > *most {
            *most = done;
            observer.on_stage(name, done, total);
        }
    })
}

/// A record with the data and the model behind it: what a page is made of.
#[derive(Clone, Copy, Debug)]
pub struct LoadedRun<'a> {
    /// What lies in the folder.
    pub record: &'a Record,
    /// The data it was scored on.
    pub data: &'a Dataset,
    /// Their split.
    pub partition: &'a Partition,
    /// The model, or several that predict together.
    pub model: &'a Ensemble,
}

/// Makes the page of a run, HTML in one file.
pub type Page = fn(&LoadedRun<'_>) -> Result<String>;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_begins_at_nothing_and_never_goes_back() {
        #[derive(Default)]
        struct Ear(Vec<(String, usize, usize)>);
        impl Observer for Ear {
            fn on_stage(&mut self, name: &str, done: usize, total: usize) {
                self.0.push((name.into(), done, total));
            }
        }
        let mut ear = Ear::default();
        let out = staged(&mut ear, "spectra", |progress| {
            [1, 3, 2, 3, 4].iter().for_each(|done| progress(*done, 4));
            "done"
        });
        assert_eq!(out, "done");
        assert_eq!(ear.0, [(0, 0), (1, 4), (3, 4), (4, 4)].map(|(done, total)| ("spectra".to_owned(), done, total)));
    }
}
