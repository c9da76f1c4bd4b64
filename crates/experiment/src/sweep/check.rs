//! `RunStage`: progress of each run of a sweep, read from its folder. Tests the runs before the first starts: loads their
//! data, initialises, and times a few steps if requested.

use super::plan::{JOINED, PlannedRun, SweepPlan};
use crate::facts::Facts;
use crate::folder::{CURVE, PIPELINE, training_folder};
use crate::load::{SplitData, load_split_data};
use crate::record::read_series;
use crate::residuals::check_residuals;
use crate::run_folder::RunFolder;
use crate::samples::data_key;
use crate::scores::ScoreTable;
use crate::session::Observer;
use crate::training::new_trainer;
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use pwrfgs_train::Trainer;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Validates the plan against its folder, and unfinished runs of `runs` (indices in the plan) against their data and
/// initialiser. The observer gets warnings once per combination. Returns the unfinished runs.
///
/// # Errors
/// A run is invalid; the message names the first. No files are written in that case.
pub fn check(plan: &SweepPlan, runs: &[usize], observer: &mut dyn Observer) -> Result<Vec<usize>> {
    let runs = unfinished_runs(plan, runs)?;
    initialise_unfinished(plan, &runs, &|_| false, observer)?;
    Ok(runs)
}

/// Estimates the seconds of each of `runs` on this thread pool, from a few steps (see [`Trainer::estimate_time`]);
/// densification makes later steps slower. A run that has begun takes the rest, and a finished one none. If another seed has
/// finished, its time is used. NaN, with a warning, if the steps fail.
///
/// # Errors
/// Same as [`check`], whose checks it makes.
pub fn estimate_run_seconds(plan: &SweepPlan, runs: &[usize], observer: &mut dyn Observer) -> Result<Vec<f64>> {
    let states = plan.states();
    let finished_seconds = |combination: usize| mean_finished_seconds(plan, &states, combination);
    let open = unfinished_runs(plan, runs)?;
    let measured =
        initialise_unfinished(plan, &open, &|combination| finished_seconds(combination).is_none(), observer)?;
    let seconds = |&run: &usize| {
        let PlannedRun { combination, pipeline, .. } = &plan.runs[run];
        let steps = (pipeline.training.steps * pipeline.members as u64) as f64;
        let left = match states[run] {
            RunStage::Finished(_) => 0.0,
            RunStage::Running { step } | RunStage::Stopped { step } => 1.0 - step as f64 / steps,
            RunStage::Waiting | RunStage::Failed(_) => 1.0,
        };
        let whole = finished_seconds(*combination).or_else(|| measured.get(combination).copied()).unwrap_or(f64::NAN);
        if left == 0.0 { 0.0 } else { left * whole } // 0 also if `whole` is NaN
    };
    Ok(runs.iter().map(seconds).collect())
}

/// Returns the mean wall time of the finished runs of a combination, seconds; `None` without any. `states` are those of all
/// runs of the plan.
fn mean_finished_seconds(plan: &SweepPlan, states: &[RunStage], combination: usize) -> Option<f64> {
    let wall_seconds = |(run, state): (&PlannedRun, &RunStage)| match state {
        RunStage::Finished(end) if run.combination == combination => {
            let (_, facts) = &**end;
            Some(facts.wall_seconds)
        }
        _ => None,
    };
    let seconds: Vec<f64> = plan.runs.iter().zip(states).filter_map(wall_seconds).collect();
    (!seconds.is_empty()).then(|| seconds.iter().sum::<f64>() / seconds.len() as f64)
}

/// Returns the unfinished runs of `runs`, after the checks that need no data.
///
/// # Errors
/// A run without RON form, or a folder that holds something else.
fn unfinished_runs(plan: &SweepPlan, runs: &[usize]) -> Result<Vec<usize>> {
    runs.iter().try_for_each(|&run| plan.runs[run].pipeline.to_ron().map(drop))?;
    // All runs, including those of other shards: runs of one folder are compared.
    for (run, planned) in plan.runs.iter().enumerate() {
        RunFolder::inspect(&plan.run_folder(run), &planned.pipeline)?;
    }
    if let Some(joined) = &plan.joined {
        RunFolder::inspect(&plan.folder.join(JOINED), joined)?;
    }
    plan.listing().inspect(&plan.folder)?;
    Ok(runs.iter().copied().filter(|&r| !matches!(plan.state(r), RunStage::Finished(_))).collect())
}

/// Initialises the first of the `open` runs of each combination, and passes its warnings to the observer. Returns the estimated
/// seconds of a run for each combination that `is_timed` selects, unless the timed steps fail.
fn initialise_unfinished(
    plan: &SweepPlan,
    open: &[usize],
    is_timed: &dyn Fn(usize) -> bool,
    observer: &mut dyn Observer,
) -> Result<BTreeMap<usize, f64>> {
    // Of an initial search, only the shortest and the longest expected time are known.
    let geometric_mean = |[shortest, longest]: [f64; 2]| (shortest * longest).sqrt();
    let tried = initialise_each(plan, &representatives(plan, open), observer, |run, trainer| {
        let (combination, warnings) = (plan.runs[run].combination, trainer.warnings());
        let time = is_timed(combination).then(|| trainer.estimate_time());
        Ok((run, warnings, time))
    })?;
    let mut seconds = BTreeMap::new();
    for (run, warnings, time) in tried {
        let PlannedRun { folder, combination, .. } = &plan.runs[run];
        let failed = time.as_ref().and_then(|time| time.as_ref().err()).map(ToString::to_string);
        warnings.into_iter().chain(failed).for_each(|warning| observer.on_warning(&format!("{folder}: {warning}")));
        if let Some(Ok(time)) = time {
            let models = plan.runs[run].pipeline.members as f64;
            seconds.insert(*combination, models * (time.seconds[1] + geometric_mean(time.search_seconds)));
        }
    }
    Ok(seconds)
}

/// Selects the first of `runs` of each combination: another seed cannot cause other errors.
fn representatives(plan: &SweepPlan, runs: &[usize]) -> Vec<usize> {
    let mut first = runs.to_vec();
    first.sort_by_key(|&run| (plan.runs[run].combination, run));
    first.dedup_by_key(|run| plan.runs[*run].combination);
    first
}

/// Checks and initialises each of `runs`, loading data once for consecutive runs with the same data. Returns the results of
/// `visit`, which gets the index of the run and its trainer.
fn initialise_each<R>(
    plan: &SweepPlan,
    runs: &[usize],
    observer: &mut dyn Observer,
    visit: impl Fn(usize, Trainer<'_>) -> Result<R>,
) -> Result<Vec<R>> {
    let mut results = Vec::new();
    let mut loaded: Option<(String, SplitData)> = None;
    for &run in runs {
        let pipeline = &plan.runs[run].pipeline;
        let key = data_key(pipeline);
        let named = |e: Error| if e.is_input() { plan.start_error(run, e) } else { e };
        if loaded.as_ref().is_none_or(|(k, _)| *k != key) {
            drop(loaded.take()); // before the next is loaded
            loaded = Some((key, load_split_data(pipeline, observer).map_err(named)?));
        }
        if let Some((_, split)) = &loaded {
            // Baselines are scored only with the joined model.
            let mut scored = std::iter::once(pipeline).chain(&plan.joined);
            scored.try_for_each(|pipeline| pipeline.check_data(&split.data)).map_err(named)?;
            plan.joined.iter().try_for_each(|joined| check_residuals(joined, split, true)).map_err(named)?;
            let (member, data) = (pipeline.member(0), &split.data);
            let partition = member.partition(data).map_err(named)?;
            let sketch = || Trainer::sketch(&member.plan()?, data, &partition);
            let trainer = new_trainer(&member, sketch).map_err(named)?;
            results.push(visit(run, trainer).map_err(named)?);
        }
    }
    Ok(results)
}

/// State of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum RunStage {
    /// Its folder does not exist, or contains no step yet.
    Waiting,
    /// Another process is running it.
    Running {
        /// Number of completed steps.
        step: u64,
    },
    /// Started, but not running: it will resume from its last checkpoint, or be scored.
    Stopped {
        /// Number of completed steps according to its curve.
        step: u64,
    },
    /// The last attempt failed, with the reason; it will be tried again.
    Failed(String),
    /// Finished, with scores and facts.
    Finished(Box<(ScoreTable, Facts)>),
}

impl RunStage {
    /// Returns the one-word name of the state.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Running { .. } => "running",
            Self::Stopped { .. } => "stopped",
            Self::Failed(_) => "failed",
            Self::Finished(_) => "finished",
        }
    }
}

/// Folder with a file for each failed run, with the reason, relative to the sweep folder.
const FAILURES: &str = "failures";

impl SweepPlan {
    /// Determines the state of each run.
    pub fn states(&self) -> Vec<RunStage> {
        (0..self.runs.len()).map(|run| self.state(run)).collect()
    }

    /// Determines the state of one run. A folder that cannot be read, is damaged or has another run also counts as failed.
    pub fn state(&self, run: usize) -> RunStage {
        let folder = self.run_folder(run);
        match RunFolder::inspect(&folder, &self.runs[run].pipeline)
            .and_then(|state| state.read_finished(&folder, false))
        {
            Ok(Some(end)) => return RunStage::Finished(Box::new(end)),
            Ok(None) => {}
            Err(error) => return RunStage::Failed(error.to_string()),
        }
        let (before, training) = training_folder(&folder);
        let step =
            read_series(&training.join(CURVE)).last().and_then(|row| *row.first()?).map_or(0, |step| step as u64);
        let step = before as u64 * self.runs[run].pipeline.training.steps + step;
        if RunFolder::is_busy(&folder) {
            return RunStage::Running { step };
        }
        match files::read_string(self.failure_path(run)) {
            Ok(why) => RunStage::Failed(why.trim_end().to_owned()),
            Err(_) if folder.join(PIPELINE).is_file() => RunStage::Stopped { step },
            Err(_) => RunStage::Waiting,
        }
    }

    /// Stores the reason why a run failed, for [`Self::state`].
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn store_failure(&self, run: usize, reason: &str) -> Result<()> {
        let path = self.failure_path(run);
        let folder = self.folder.join(FAILURES);
        std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
        write_atomically(&path, format!("{reason}\n").as_bytes())
    }

    /// Removes the stored failure of a run, if there is one. Errors are ignored.
    pub fn remove_failure(&self, run: usize) {
        _ = std::fs::remove_file(self.failure_path(run));
        _ = std::fs::remove_dir(self.folder.join(FAILURES)); // succeeds after the last one
    }

    /// Returns the path of the stored failure of a run.
    fn failure_path(&self, run: usize) -> PathBuf {
        self.folder.join(FAILURES).join(format!("{}.txt", self.runs[run].folder))
    }
}
