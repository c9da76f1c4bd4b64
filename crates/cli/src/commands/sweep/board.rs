//! The live table of a sweep: a line for each run at work, one for all of them.

use crate::args::Verbosity;
use crate::output::{bars, note};
use crate::progress::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use pwrfgs::experiment::sweep::{Board, Plan, State};
use pwrfgs::experiment::text::{duration, number};
use pwrfgs::experiment::{Observer, Outcome};
use pwrfgs_core::{Error, Result};
use std::time::Instant;

/// Draws what the runs of a plan report.
pub(in crate::commands) struct Table<'a> {
    plan: &'a Plan,
    verbosity: Verbosity,
    /// All runs.
    bar: ProgressBar,
    begun: Instant,
}

impl<'a> Table<'a> {
    pub(in crate::commands) fn new(plan: &'a Plan, runs: usize, verbosity: Verbosity) -> Self {
        let style = ProgressStyle::with_template("{bar:24.green/dim} {pos}/{len} runs  {msg}")
            .unwrap_or_else(|_| ProgressStyle::default_bar())
            .progress_chars("━╸─");
        let bar = ProgressBar::new(runs as u64).with_style(style);
        // The bar is hidden by itself where there is no terminal.
        let bar = if verbosity == Verbosity::Quiet { ProgressBar::hidden() } else { bars().add(bar) };
        bar.tick();
        Self { plan, verbosity, bar, begun: Instant::now() }
    }

    pub(in crate::commands) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    /// One line about the end of a run.
    fn line(&self, run: usize, end: &Result<Outcome>) -> String {
        let name = &self.plan.runs[run].folder;
        match end {
            Ok(Outcome::Finished { already: true, .. }) => format!("{name}: finished before"),
            Ok(Outcome::Finished { scores, .. }) => {
                let score = |key| scores.of_model(key).map(|value| format!("  {key} {}", number(value)));
                let time = match self.plan.state(run) {
                    State::Finished(end) => format!("  {}", duration(end.1.wall_seconds)),
                    _ => String::new(),
                };
                let words = [scores.task.headline.key, "eta_0db", "gaussians"]
                    .into_iter()
                    .filter_map(score)
                    .collect::<String>();
                format!("{name}: done{words}{time}")
            }
            Ok(Outcome::Interrupted { step }) => format!("{name}: stopped after step {step}"),
            Ok(Outcome::Unscored) => format!("{name}: stopped before it was scored"),
            Err(Error::Busy(_)) => format!("{name}: another process is at work on it; left to that one"),
            Err(error) => format!("{name}: failed: {error}"),
        }
    }
}

impl Board for Table<'_> {
    fn starts(&self, run: usize) -> Box<dyn Observer> {
        Box::new(Progress::of_run(&self.plan.runs[run].folder, self.verbosity))
    }

    fn ends(&self, run: usize, end: &Result<Outcome>) {
        self.bar.inc(1);
        let (done, all) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let left = self.begun.elapsed().as_secs_f64() / done.max(1) as f64 * all.saturating_sub(done) as f64;
        self.bar.set_message(format!("about {} left", duration(left)));
        let failed = end.as_ref().is_err_and(|error| !matches!(error, Error::Busy(_)));
        if self.verbosity != Verbosity::Quiet || failed {
            note(&self.line(run, end));
        }
    }
}
