//! `Session`: observer, cancellation and report function of a run. The library prints nothing; `cli` draws a progress
//! bar.

use crate::record::Record;
use crate::scores::ScoreTable;
use pwrfgs_core::{Dataset, Partition, Progress, Result, Task, check_stopped};
use pwrfgs_model::Ensemble;
use pwrfgs_train::StepReport;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

/// Description of a run that is about to start.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The run folder.
    pub folder: &'a Path,
    /// Title of the data set.
    pub title: &'a str,
    /// Task of the data set.
    pub task: Task,
    /// Numbers of training, validation and test samples.
    pub samples: [usize; 3],
    /// Number of steps completed by earlier starts.
    pub done: u64,
    /// Total number of steps.
    pub steps: u64,
    /// Current number of Gaussians N.
    pub gaussians: usize,
    /// Memory of a step in addition to the loaded data, bytes.
    pub step_bytes: u64,
}

/// Validation result: one row of `validation.csv`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validation {
    /// Training step.
    pub step: u64,
    /// Task of the validation samples.
    pub task: Task,
    /// The columns of [`Headline`](pwrfgs_core::Headline): mean and median of the first metric, and one further value.
    pub values: [f64; 3],
}

/// Observer of a run; every method does nothing by default.
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Observer: Send {
    /// Called during work other than training: loading or simulating spectra, scoring a predictor. The first call is
    /// (0, 0), and (0, `total`) may follow; then `done` of `total` increases.
    fn on_stage(&mut self, name: &str, done: usize, total: usize) {}

    /// Called when training starts or resumes.
    fn on_start(&mut self, start: &Start<'_>) {}

    /// Called after a training step.
    fn on_step(&mut self, report: &StepReport) {}

    /// Called after a validation.
    fn on_validation(&mut self, validation: &Validation) {}

    /// Called with all scores on the test set.
    fn on_evaluation(&mut self, scores: &ScoreTable) {}

    /// Called with other messages, one line each.
    fn on_message(&mut self, message: &str) {}

    /// Called for valid but implausible input; several runs may report the same.
    fn on_warning(&mut self, warning: &str) {
        self.on_message(&format!("warning: {warning}"));
    }
}

/// Observer that ignores all events, and sweep observer that ignores all runs.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoopObserver;

impl Observer for NoopObserver {}

/// Performs `work` and reports its progress to the observer as the stage `name`. Counts of parallel calls may arrive out of
/// order: lower ones are dropped.
pub fn run_stage<R>(observer: &mut dyn Observer, name: &str, work: impl FnOnce(Progress<'_>) -> R) -> R {
    observer.on_stage(name, 0, 0);
    let state = Mutex::new((observer, None));
    work(&|done, total| {
        let (observer, most) = &mut *state.lock().unwrap_or_else(PoisonError::into_inner);
        if most.is_none_or(|most| done > most) {
            *most = Some(done);
            observer.on_stage(name, done, total);
        }
    })
}

/// Finished run with its data and model: the input of a report.
#[derive(Clone, Copy, Debug)]
pub struct LoadedRun<'a> {
    /// Content of the run folder.
    pub record: &'a Record,
    /// Data set of the scores.
    pub data: &'a Dataset,
    /// Split of the data.
    pub partition: &'a Partition,
    /// Model, or an ensemble.
    pub model: &'a Ensemble,
}

/// Function that creates the report of a run as a single HTML file.
pub type PageBuilder = fn(&LoadedRun<'_>) -> Result<String>;

/// Observer, cancellation and report of a run, a sweep or an evaluation.
pub struct Session<'a> {
    /// Receives progress, messages and warnings.
    pub observer: &'a mut dyn Observer,
    /// Once it is set, work ends early with [`Error::Stopped`](pwrfgs_core::Error::Stopped), or with a checkpoint.
    pub stop: &'a AtomicBool,
    /// Makes `report.html`; `None` writes none.
    pub page: Option<PageBuilder>,
    /// Whether finished runs keep their files for resuming, see [`RESUME_ONLY`](crate::folder::RESUME_ONLY).
    pub keep_checkpoint: bool,
}

impl std::fmt::Debug for Session<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session")
            .field("stop", self.stop)
            .field("page", &self.page.is_some())
            .field("keep_checkpoint", &self.keep_checkpoint)
            .finish_non_exhaustive()
    }
}

impl<'a> Session<'a> {
    /// Creates a session that never stops early, writes no report, and keeps no checkpoint of a finished run.
    pub fn new(observer: &'a mut dyn Observer) -> Self {
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self { observer, stop: &NEVER, page: None, keep_checkpoint: false }
    }

    /// Checks whether the session is stopped.
    ///
    /// # Errors
    /// [`Error::Stopped`](pwrfgs_core::Error::Stopped) once `stop` is set.
    pub fn check_stopped(&self) -> Result<()> {
        check_stopped(self.stop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stage_progress_starts_at_zero_and_never_decreases() {
        #[derive(Default)]
        struct RecordingObserver(Vec<(String, usize, usize)>);
        impl Observer for RecordingObserver {
            fn on_stage(&mut self, name: &str, done: usize, total: usize) {
                self.0.push((name.into(), done, total));
            }
        }
        let mut observer = RecordingObserver::default();
        let out = run_stage(&mut observer, "spectra", |progress| {
            [0, 1, 3, 2, 0, 3, 4].iter().for_each(|done| progress(*done, 4));
            "done"
        });
        assert_eq!(out, "done");
        assert_eq!(
            observer.0,
            [(0, 0), (0, 4), (1, 4), (3, 4), (4, 4)].map(|(done, total)| ("spectra".to_owned(), done, total))
        );
    }
}
