//! Progress of a sweep on a terminal: a bar per run and over all runs.

use crate::output::{Verbosity, print_note, progress_bars};
use crate::progress::RunProgress;
use indicatif::{ProgressBar, ProgressStyle};
use pwrfgs::experiment::sweep::{SweepObserver, SweepPlan};
use pwrfgs::experiment::text::format_duration;
use pwrfgs::experiment::{Observer, RunOutcome};
use pwrfgs_core::{Error, Result};
use std::time::Instant;

/// Returns whether a run failed; one that another process performs did not.
pub(super) fn has_failed(end: &Result<RunOutcome>) -> bool {
    end.as_ref().is_err_and(|error| !matches!(error, Error::Busy(_)))
}

/// Observer that shows the progress of a sweep.
pub(super) struct SweepProgress<'a> {
    plan: &'a SweepPlan,
    verbosity: Verbosity,
    /// Bar over all runs.
    bar: ProgressBar,
    begun: Instant,
}

impl<'a> SweepProgress<'a> {
    /// Creates the observer with a bar over `runs` runs.
    pub(super) fn new(plan: &'a SweepPlan, runs: usize, verbosity: Verbosity) -> Self {
        let style = ProgressStyle::with_template("{bar:24.green/dim} {pos}/{len} runs  {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("━╸─");
        let bar = ProgressBar::new(runs as u64).with_style(style);
        // Without a terminal, the bar hides itself.
        let bar = if verbosity == Verbosity::Quiet { ProgressBar::hidden() } else { progress_bars().add(bar) };
        bar.tick();
        Self { plan, verbosity, bar, begun: Instant::now() }
    }

    /// Removes the bar over all runs.
    pub(super) fn remove_bar(&self) {
        self.bar.finish_and_clear();
    }
}

impl SweepObserver for SweepProgress<'_> {
    fn on_run_start(&self, run: usize) -> Box<dyn Observer> {
        Box::new(RunProgress::of_run(&self.plan.runs[run].folder, self.verbosity))
    }

    fn on_run_end(&self, run: usize, end: &Result<RunOutcome>) {
        self.bar.inc(1);
        let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let left = self.begun.elapsed().as_secs_f64() / done.max(1) as f64 * total.saturating_sub(done) as f64;
        self.bar.set_message(format!("about {} left", format_duration(left)));
        if self.verbosity != Verbosity::Quiet || has_failed(end) {
            print_note(&self.plan.describe_end(run, end));
        }
    }
}
