//! Sweeps: many runs from one experiment file, in one folder, on one machine or many.
//!
//! `experiment.rs` reads the file, `plan.rs` creates all runs, `check.rs` determines their state and tests
//! unfinished runs before the first starts. [`SweepPlan::execute`] performs them, several at once, each with its own
//! threads; with `join: true` it combines all models into one that predicts their mean. All state is in the run folders,
//! so the same command resumes after any interruption.

mod check;
mod experiment;
mod listing;
mod plan;
pub mod slurm;
mod table;

pub use check::{RunStage, check, estimate_run_seconds};
pub use experiment::{Axis, Experiment, Slurm, SweepVariant};
pub use listing::{LISTING, ListedRun, Listing};
pub use plan::{JOINED, PlannedRun, SweepPlan};

use crate::facts::{Facts, FileDigest};
use crate::folder::MODEL_FILE;
use crate::load::{ActiveRun, load_with_findings};
use crate::run_folder::RunFolder;
use crate::runner::{RunOutcome, run};
use crate::session::{NoopObserver, Observer, Session};
use pwrfgs_core::{Error, Result};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Result of a sweep in this process.
#[derive(Debug)]
pub struct SweepEnd {
    /// Runs by index in the plan, with their result: [`Error::Busy`] if another process uses the folder; other failures
    /// are also stored in the sweep folder.
    pub runs: Vec<(usize, Result<RunOutcome>)>,
    /// The joined model, if the plan joins models and all runs have finished.
    pub joined: Option<RunOutcome>,
}

/// Observer of all runs of a sweep.
pub trait SweepObserver: Sync {
    /// Called when a run, an index in the plan, starts; returns the observer of its steps.
    fn on_run_start(&self, run: usize) -> Box<dyn Observer>;

    /// Called when a run ends.
    fn on_run_end(&self, run: usize, end: &Result<RunOutcome>);
}

impl SweepObserver for NoopObserver {
    fn on_run_start(&self, _: usize) -> Box<dyn Observer> {
        Box::new(Self)
    }

    fn on_run_end(&self, _: usize, _: &Result<RunOutcome>) {}
}

/// Creates the thread pool of one of `jobs` runs, one or more, that share the threads of the calling pool.
///
/// # Errors
/// Threads cannot be started.
pub fn run_pool(jobs: usize) -> Result<ThreadPool> {
    thread_pool((rayon::current_num_threads() / jobs).max(1))
}

/// Creates a pool of `threads`.
///
/// # Errors
/// Threads cannot be started.
pub fn thread_pool(threads: usize) -> Result<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| Error::Config(format!("cannot start {threads} threads: {e}")))
}

/// Performs the run `index` of the plan on `pool`, and stores the reason if it fails, unless another process uses the folder. A
/// panic of the run becomes an error.
fn perform_run(plan: &SweepPlan, index: usize, pool: &ThreadPool, session: &mut Session<'_>) -> Result<RunOutcome> {
    let (folder, pipeline) = (plan.run_folder(index), &plan.runs[index].pipeline);
    plan.remove_failure(index);
    // A panic is a bug in one run, for example of a plugin; the other runs are unaffected.
    let work = || pool.install(|| run(pipeline, Path::new(""), &folder, session));
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| Err(panic_error(panic)));
    // Another process may have claimed it meanwhile.
    if let Err(error) = &outcome
        && !matches!(error, Error::Busy(_))
    {
        // The failure is returned in any case.
        _ = plan.store_failure(index, &error.to_string());
    }
    outcome
}

/// Converts the payload of a panic to an error. A plugin panics with an error in methods that cannot return one; otherwise, the
/// error has the message of the panic.
fn panic_error(panic: Box<dyn Any + Send>) -> Error {
    let panic = match panic.downcast::<Error>() {
        Ok(error) => return *error,
        Err(panic) => panic,
    };
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    Error::Config(format!("the program panicked: {text}"))
}

/// Joins the models of a plan with `join: true` in the folder [`JOINED`] and scores the result. Returns `None` if the
/// plan does not join, a run has not finished, or another process joins them.
///
/// # Errors
/// Same as [`crate::run`].
fn join_models(plan: &SweepPlan, session: &mut Session<'_>) -> Result<Option<RunOutcome>> {
    let Some(pipeline) = &plan.joined else { return Ok(None) };
    if !plan.states().iter().all(|state| matches!(state, RunStage::Finished(_))) {
        return Ok(None);
    }
    let out = plan.folder.join(JOINED);
    let mut folder = match RunFolder::claim(&out, pipeline) {
        Err(Error::Busy(_)) => return Ok(None),
        folder => folder?,
    };
    let ended = plan.join_into(pipeline, &mut folder, session);
    folder.settle(ended).map(Some)
}

impl SweepPlan {
    /// Performs `runs` of the plan in order, `jobs` at a time, sharing the threads of the calling pool. A failed run does
    /// not stop the others; stopping the session stops all of them at the next step or during scoring. `board` observes the
    /// runs, and the observer of the session the joining of models.
    ///
    /// # Errors
    /// Errors of [`Self::claim`]; threads cannot be started, or models cannot be joined.
    pub fn execute(
        &self,
        runs: &[usize],
        jobs: usize,
        board: &dyn SweepObserver,
        session: &mut Session<'_>,
    ) -> Result<SweepEnd> {
        drop(self.claim()?);
        let jobs = jobs.clamp(1, runs.len().max(1));
        let pools = (0..jobs).map(|_| run_pool(jobs)).collect::<Result<Vec<_>>>()?;
        let (stop, page, keep_checkpoint) = (session.stop, session.page, session.keep_checkpoint);
        let next = AtomicUsize::new(0);
        let ends = Mutex::new(Vec::new());
        std::thread::scope(|scope| {
            for pool in &pools {
                scope.spawn(|| {
                    while let Some(&run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) {
                        if stop.load(Ordering::Relaxed) {
                            break;
                        }
                        let folder = self.run_folder(run);
                        let end = if RunFolder::is_busy(&folder) {
                            Err(Error::Busy(folder))
                        } else {
                            let mut observer = board.on_run_start(run);
                            let mut session = Session { observer: &mut *observer, stop, page, keep_checkpoint };
                            perform_run(self, run, pool, &mut session)
                        };
                        board.on_run_end(run, &end);
                        ends.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((run, end));
                    }
                });
            }
        });
        let mut ends = ends.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        ends.sort_by_key(|(run, _)| *run);
        Ok(SweepEnd { runs: ends, joined: join_models(self, session)? })
    }

    /// Joins the models in a claimed folder and scores the result, unless the folder has the same model with scores.
    fn join_into(&self, pipeline: &Pipeline, folder: &mut RunFolder, session: &mut Session<'_>) -> Result<RunOutcome> {
        let begun = Instant::now();
        let mut ensemble = self.read_ensemble()?;
        let bytes = file::ensemble_to_bytes(&ensemble);
        // Residual processes and calibration of the same members are kept.
        if let Ok(stored) = file::read_ensemble(&folder.file(MODEL_FILE))
            && file::ensemble_to_bytes(&stored.clone().with_residuals(None)) == bytes
        {
            ensemble = stored;
        }
        let bytes = file::ensemble_to_bytes(&ensemble);
        let is_joined = |earlier: Facts| earlier.files.get(MODEL_FILE) == Some(&FileDigest::of(&bytes));
        if Facts::read(folder.path())?.is_some_and(is_joined)
            && let Some(scores) = folder.state().read_verified(folder.path(), session.page.is_some())?
        {
            return Ok(RunOutcome::Finished { scores: scores.into(), already: true });
        }
        let (split, findings) = load_with_findings(pipeline, None, session.observer)?;
        pipeline.check_data(&split.data)?;
        let members = self.runs.iter().map(|run| run.folder.clone()).collect();
        let mut facts = folder.begin(pipeline, &split, Facts { findings, members, ..Facts::default() })?;
        facts.sum_members((0..self.runs.len()).map(|run| self.run_folder(run)))?;
        file::write_ensemble(&folder.file(MODEL_FILE), &ensemble)?;
        let mut run = ActiveRun { pipeline, split: &split, session, begun };
        match run.score(ensemble, folder, facts) {
            Err(Error::Stopped) => Ok(RunOutcome::Unscored),
            scores => Ok(RunOutcome::Finished { scores: scores?.into(), already: false }),
        }
    }

    /// Reads the trained models, in the order of the plan.
    fn read_ensemble(&self) -> Result<Ensemble> {
        let member = |(index, run): (usize, &PlannedRun)| {
            let folder = self.run_folder(index);
            if let Some(facts) = Facts::read(&folder)? {
                facts.verify_file(&folder, MODEL_FILE)?;
            }
            Ok((run.member_name(), file::read(&folder.join(MODEL_FILE))?))
        };
        let members = self.runs.iter().enumerate().map(member).collect::<Result<_>>()?;
        Ensemble::named(members).map_err(Error::Config)
    }
}
