//! Texts on the runs of a sweep: tables of progress and of estimates, and the end of a run in one line.

use super::{JOINED, RunStage, SweepPlan};
use crate::facts::Facts;
use crate::runner::RunOutcome;
use crate::text::{align_columns, format_duration, grouped, number};
use pwrfgs_core::{Error, Result, Task};
use std::collections::BTreeSet;

/// Total above which the slowest runs are named, and the number of them.
const LONG_SECONDS: f64 = 12.0 * 3600.0;
const SLOWEST: usize = 3;

impl SweepPlan {
    /// Describes the end of a run in one line: its scores and time, or why it has none.
    pub fn describe_end(&self, run: usize, end: &Result<RunOutcome>) -> String {
        let name = &self.runs[run].folder;
        match end {
            Ok(RunOutcome::Finished { already: true, .. }) => format!("{name}: already finished"),
            Ok(RunOutcome::Finished { scores, .. }) => {
                let score = |key| scores.model_score(key).map(|value| format!("  {key} {}", number(value)));
                let time = match self.state(run) {
                    RunStage::Finished(end) => {
                        let (_, facts) = &*end;
                        format!("  {}", format_duration(facts.wall_seconds))
                    }
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

    /// Formats the table of the progress of `runs` (indices in the plan); `queued` has the folders of those in the queue of
    /// a scheduler.
    pub fn progress_table(&self, runs: &[usize], queued: &BTreeSet<String>) -> String {
        let states: Vec<RunStage> = runs.iter().map(|&run| self.state(run)).collect();
        let ends = states.iter().filter_map(|state| if let RunStage::Finished(end) = state { Some(end) } else { None });
        let task = ends.clone().next().map_or_else(Task::default, |end| {
            let (scores, _) = &**end;
            scores.task
        });
        let head = ["run", "state", "step", "N", task.headline.short, "eta_0db", "time"];
        let mut lines = vec![head.map(str::to_owned).to_vec()];
        let finished = ends.count();
        for (&run, state) in runs.iter().zip(&states) {
            lines.push(self.progress_line(run, state, queued.contains(&self.runs[run].folder)).into());
        }
        let head = format!("{}: {finished} of {} runs finished, in {}\n", self.name, runs.len(), self.folder.display());
        let joined = self.joined.as_ref().map_or("", |_| match Facts::read_finished(&self.folder.join(JOINED)) {
            Ok(Some(_)) => "ensemble finished, in joined\n",
            _ => "the ensemble is made after the last run\n",
        });
        head + joined + &align_columns(&lines, 2)
    }

    /// Formats the line of a run in the table of progress, in the order of its header. `is_queued`: the run is in the queue of a
    /// scheduler.
    fn progress_line(&self, run: usize, state: &RunStage, is_queued: bool) -> [String; 7] {
        let planned = &self.runs[run];
        let folder = &planned.folder;
        let steps = planned.pipeline.training.steps * planned.pipeline.members as u64;
        let progress = |step: u64| format!("{}/{}", grouped(step as i64), grouped(steps as i64));
        let line = |state: &str, step: String, [n, score, eta, time]: [String; 4]| {
            [folder.clone(), state.to_owned(), step, n, score, eta, time]
        };
        match state {
            RunStage::Waiting if is_queued => line("queued", String::new(), Default::default()),
            RunStage::Waiting => line(state.name(), String::new(), Default::default()),
            RunStage::Stopped { step } if is_queued => line("queued again", progress(*step), Default::default()),
            RunStage::Running { step } | RunStage::Stopped { step } => {
                line(state.name(), progress(*step), Default::default())
            }
            RunStage::Failed(why) => line(&format!("failed: {why}"), String::new(), Default::default()),
            RunStage::Finished(end) => {
                let (scores, facts) = &**end;
                let score = |key| scores.model_score(key).map_or_else(|| "n/a".into(), number);
                let [first, eta] = [scores.task.headline.key, "eta_0db"].map(score);
                let (n, time) = (grouped(facts.gaussians as i64), format_duration(facts.wall_seconds));
                line(state.name(), progress(facts.steps), [n, first, eta, time])
            }
        }
    }

    /// Formats the table of `runs` (indices in the plan) with their estimated seconds: 0 for finished ones, NaN if unknown.
    pub fn estimate_table(&self, runs: &[usize], seconds: &[f64], jobs: usize) -> String {
        let mut lines = vec![["run", "state", "time"].map(str::to_owned).to_vec()];
        for (&run, seconds) in runs.iter().zip(seconds) {
            let time = if *seconds > 0.0 { format!("about {}", format_duration(*seconds)) } else { String::new() };
            lines.push(vec![self.runs[run].folder.clone(), self.state(run).name().into(), time]);
        }
        let combinations = runs.iter().map(|&run| self.runs[run].combination).collect::<BTreeSet<_>>().len();
        let mut text = format!(
            "{}: {} runs of {combinations} combinations, in {}\n",
            self.name,
            runs.len(),
            self.folder.display()
        );
        text += &align_columns(&lines, 2);
        text += &self.describe_total(runs, seconds, jobs);
        text
    }

    /// Describes the estimated total time of `runs` (indices in the plan) from their seconds; NaN counts as none. If it is
    /// long, also names the slowest run of the slowest combinations.
    pub fn describe_total(&self, runs: &[usize], seconds: &[f64], jobs: usize) -> String {
        let total = seconds.iter().filter(|seconds| seconds.is_finite()).sum::<f64>() / jobs as f64;
        let mut text = format!(
            "about {} in total on this machine with --jobs {jobs}, estimated from a few steps of each combination, \
             before and after pruning; densification lengthens later steps, and initialising, baselines and scoring are \
             not included\n",
            format_duration(total)
        );
        if total > LONG_SECONDS {
            let mut slowest: Vec<(usize, f64)> = runs.iter().copied().zip(seconds.iter().copied()).collect();
            slowest.sort_by(|(_, a), (_, b)| b.total_cmp(a));
            let mut seen = BTreeSet::new();
            slowest.retain(|(run, seconds)| seconds.is_finite() && seen.insert(self.runs[*run].combination));
            slowest.truncate(SLOWEST);
            text += "slowest runs; --only RUN runs one of the sweep\n";
            let line = |(run, s): &(usize, f64)| {
                vec![self.runs[*run].folder.clone(), format!("about {}", format_duration(*s))]
            };
            text += &align_columns(&slowest.iter().map(line).collect::<Vec<_>>(), 2);
        }
        text
    }

    /// Returns whether all runs have finished or failed, and some have finished: the process that ends the last run then
    /// writes the report.
    pub fn has_ended(&self) -> bool {
        let states = self.states();
        let is_over = |state: &RunStage| matches!(state, RunStage::Finished(_) | RunStage::Failed(_));
        states.iter().all(is_over) && states.iter().any(|state| matches!(state, RunStage::Finished(_)))
    }
}
