//! Runs of a sweep on a terminal: live lines per run and in total, and an aligned table.

use crate::output::{Verbosity, print_note, progress_bars};
use crate::progress::RunProgress;
use indicatif::{ProgressBar, ProgressStyle};
use pwrfgs::experiment::sweep::{JOINED, RunStage, SweepObserver, SweepPlan};
use pwrfgs::experiment::text::{aligned, duration, grouped, number};
use pwrfgs::experiment::{Facts, Observer, RunOutcome};
use pwrfgs_core::{Error, Result, Task};
use std::collections::BTreeSet;
use std::time::Instant;

/// Observer that shows the progress of a sweep.
pub(super) struct SweepTable<'a> {
    plan: &'a SweepPlan,
    verbosity: Verbosity,
    /// Bar over all runs.
    bar: ProgressBar,
    begun: Instant,
}

impl<'a> SweepTable<'a> {
    /// Creates the table with a bar over `runs` runs.
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

    /// Describes the end of a run in one line: its scores and time, or why it has none.
    fn describe_end(&self, run: usize, end: &Result<RunOutcome>) -> String {
        let name = &self.plan.runs[run].folder;
        match end {
            Ok(RunOutcome::Finished { already: true, .. }) => format!("{name}: already finished"),
            Ok(RunOutcome::Finished { scores, .. }) => {
                let score = |key| scores.model_score(key).map(|value| format!("  {key} {}", number(value)));
                let time = match self.plan.state(run) {
                    RunStage::Finished(end) => format!("  {}", duration(end.1.wall_seconds)),
                    _ => String::new(),
                };
                let words = [scores.task.headline.key, "eta_0db", "gaussians"]
                    .into_iter()
                    .filter_map(score)
                    .collect::<String>();
                format!("{name}: done{words}{time}")
            }
            Ok(RunOutcome::Interrupted { step }) => format!("{name}: stopped after step {step}"),
            Ok(RunOutcome::Unscored) => format!("{name}: stopped before scoring"),
            Err(Error::Busy(_)) => format!("{name}: skipped, another process is working on it"),
            Err(error) => format!("{name}: failed: {error}"),
        }
    }
}

impl SweepObserver for SweepTable<'_> {
    fn on_run_start(&self, run: usize) -> Box<dyn Observer> {
        Box::new(RunProgress::of_run(&self.plan.runs[run].folder, self.verbosity))
    }

    fn on_run_end(&self, run: usize, end: &Result<RunOutcome>) {
        self.bar.inc(1);
        let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
        let left = self.begun.elapsed().as_secs_f64() / done.max(1) as f64 * total.saturating_sub(done) as f64;
        self.bar.set_message(format!("about {} left", duration(left)));
        let failed = end.as_ref().is_err_and(|error| !matches!(error, Error::Busy(_)));
        if self.verbosity != Verbosity::Quiet || failed {
            print_note(&self.describe_end(run, end));
        }
    }
}

/// Formats the table of the progress of `runs` (indices in the plan); `queued` has the folders of those in the queue of
/// a scheduler.
pub(super) fn format_progress(plan: &SweepPlan, runs: &[usize], queued: &BTreeSet<String>) -> String {
    let states: Vec<RunStage> = runs.iter().map(|&run| plan.state(run)).collect();
    let ends = states.iter().filter_map(|state| if let RunStage::Finished(end) = state { Some(end) } else { None });
    let task = ends.clone().next().map_or_else(Task::default, |end| end.0.task);
    let head = ["run", "state", "step", "N", task.headline.short, "eta_0db", "time"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    let finished = ends.count();
    for (&run, state) in runs.iter().zip(&states) {
        let (name, steps) = (&plan.runs[run].folder, plan.runs[run].pipeline.training.steps);
        let progress = |step: u64| format!("{}/{}", grouped(step as i64), grouped(steps as i64));
        let mut line = vec![String::new(); lines[0].len()];
        line[0].clone_from(name);
        line[1] = state.name().into();
        let waits = queued.contains(name);
        match state {
            RunStage::Waiting if waits => line[1] = "queued".into(),
            RunStage::Waiting => {}
            RunStage::Stopped { step } if waits => (line[1], line[2]) = ("queued again".into(), progress(*step)),
            RunStage::Running { step } | RunStage::Stopped { step } => line[2] = progress(*step),
            RunStage::Failed(why) => line[1] = format!("failed: {why}"),
            RunStage::Finished(end) => {
                let (scores, facts) = &**end;
                let score = |key| scores.model_score(key).map_or_else(|| "n/a".into(), number);
                (line[2], line[3]) = (progress(facts.steps), grouped(facts.gaussians as i64));
                (line[4], line[5], line[6]) =
                    (score(scores.task.headline.key), score("eta_0db"), duration(facts.wall_seconds));
            }
        }
        lines.push(line);
    }
    let head = format!("{}: {finished} of {} runs finished, in {}\n", plan.name, runs.len(), plan.folder.display());
    let joined = plan.joined.as_ref().map_or("", |_| match Facts::read_finished(&plan.folder.join(JOINED)) {
        Ok(Some(_)) => "ensemble finished, in joined\n",
        _ => "the ensemble is made after the last run\n",
    });
    head + joined + &aligned(&lines, 2)
}

/// Formats the table of `runs` (indices in the plan) with their estimated seconds, which are 0 for finished ones.
pub(super) fn format_estimates(plan: &SweepPlan, runs: &[usize], seconds: &[f64], jobs: usize) -> String {
    let mut lines = vec![["run", "state", "time"].map(str::to_owned).to_vec()];
    for (&run, seconds) in runs.iter().zip(seconds) {
        let time = if *seconds > 0.0 { format!("about {}", duration(*seconds)) } else { String::new() };
        lines.push(vec![plan.runs[run].folder.clone(), plan.state(run).name().into(), time]);
    }
    let combinations = runs.iter().map(|&run| plan.runs[run].combination).collect::<BTreeSet<_>>().len();
    let mut text =
        format!("{}: {} runs of {combinations} combinations, in {}\n", plan.name, runs.len(), plan.folder.display());
    text += &aligned(&lines, 2);
    text += &describe_total(plan, runs, seconds, jobs);
    text
}

/// Total above which the slowest runs are named, and the number of them.
const LONG_SECONDS: f64 = 12.0 * 3600.0;
const SLOWEST: usize = 3;

/// Describes the estimated total time of `runs` (indices in the plan) from their seconds; NaN counts as none. If it is
/// long, also names the slowest run of the slowest combinations.
pub(super) fn describe_total(plan: &SweepPlan, runs: &[usize], seconds: &[f64], jobs: usize) -> String {
    let total = seconds.iter().filter(|seconds| seconds.is_finite()).sum::<f64>() / jobs as f64;
    let mut text = format!(
        "about {} in total on this machine with --jobs {jobs}, estimated from a few steps of each combination, before and after \
         pruning; densification lengthens later steps, and initialising, baselines and scoring are not included\n",
        duration(total)
    );
    if total > LONG_SECONDS {
        let mut slowest: Vec<(usize, f64)> = runs.iter().copied().zip(seconds.iter().copied()).collect();
        slowest.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut seen = BTreeSet::new();
        slowest.retain(|(run, seconds)| seconds.is_finite() && seen.insert(plan.runs[*run].combination));
        slowest.truncate(SLOWEST);
        text += "slowest runs; --only RUN runs one of the sweep\n";
        let line = |(run, s): &(usize, f64)| vec![plan.runs[*run].folder.clone(), format!("about {}", duration(*s))];
        text += &aligned(&slowest.iter().map(line).collect::<Vec<_>>(), 2);
    }
    text
}
