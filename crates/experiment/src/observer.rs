//! `Observer`: who wants to know how a run gets on. The library prints nothing; `cli` draws a progress bar.

use crate::scores::ScoreTable;
use pwrfgs_train::StepReport;
use std::path::Path;

/// What a run is about to do.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The run folder.
    pub folder: &'a Path,
    /// What the data call themselves.
    pub title: &'a str,
    /// Samples for training, validation, test.
    pub samples: [usize; 3],
    /// Steps that an earlier start has done.
    pub done: u64,
    /// Steps in all.
    pub steps: u64,
}

/// A look at the validation part: one row of `validation.csv`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validation {
    /// Training step.
    pub step: u64,
    /// Mean SSIM.
    pub ssim_mean: f64,
    /// Median SSIM.
    pub ssim_median: f64,
    /// Mean η at 0 dB.
    pub eta_0db: f64,
}

/// Hears of everything that happens in a run; every method does nothing by default.
pub trait Observer {
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
}

/// Nobody.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Observer for Silent {}
