//! `execute`: several runs at once, each with its own threads.

use super::join::join;
use super::plan::Plan;
use crate::folder::RunFolder;
use crate::observer::{Observer, Silent};
use crate::runner::{Outcome, run};
use crate::session::Session;
use pwrfgs_core::{Error, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// How a sweep ended, as far as this process did it.
#[derive(Debug)]
pub struct SweepEnd {
    /// Each run, by its place in the plan: [`Error::Busy`] if another process is at work in its folder; why another one
    /// failed is kept in the sweep folder too.
    pub runs: Vec<(usize, Result<Outcome>)>,
    /// The joined model, if the plan joins models and all runs have finished.
    pub joined: Option<Outcome>,
}

/// Hears of all runs at once.
pub trait Board: Sync {
    /// A run, a place in the plan, starts; what it gets hears of its steps.
    fn starts(&self, run: usize) -> Box<dyn Observer>;

    /// It ended.
    fn ends(&self, run: usize, end: &Result<Outcome>);
}

impl Board for Silent {
    fn starts(&self, _: usize) -> Box<dyn Observer> {
        Box::new(Self)
    }

    fn ends(&self, _: usize, _: &Result<Outcome>) {}
}

/// Does the runs `runs` of the plan, `jobs` at a time, in their order. They share the threads of the calling pool. A run
/// that fails does not stop the others; the session stops all at their next step, or where they are scored. `board` observes
/// the runs, the observer of the session what follows: joining their models.
///
/// # Errors
/// As [`Plan::claim`], or where threads cannot be started, or models cannot be joined.
pub fn execute(
    plan: &Plan,
    runs: &[usize],
    jobs: usize,
    board: &dyn Board,
    session: &mut Session<'_>,
) -> Result<SweepEnd> {
    drop(plan.claim()?);
    let jobs = jobs.clamp(1, runs.len().max(1));
    let pools = (0..jobs).map(|_| pool(jobs)).collect::<Result<Vec<_>>>()?;
    let (stop, page) = (session.stop, session.page);
    let next = AtomicUsize::new(0);
    let ends = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for pool in &pools {
            scope.spawn(|| {
                while let Some(&run) = runs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let folder = plan.folder_of(run);
                    let end = if RunFolder::is_busy(&folder) {
                        Err(Error::Busy(folder))
                    } else {
                        let mut observer = board.starts(run);
                        pool.install(|| one(plan, run, &mut Session { observer: &mut *observer, stop, page }))
                    };
                    board.ends(run, &end);
                    ends.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((run, end));
                }
            });
        }
    });
    let mut ends = ends.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    ends.sort_by_key(|(run, _)| *run);
    Ok(SweepEnd { runs: ends, joined: join(plan, session)? })
}

/// The threads of one of `jobs` runs that share those of the calling pool.
///
/// # Errors
/// Where threads cannot be started.
pub fn pool(jobs: usize) -> Result<ThreadPool> {
    let threads = (rayon::current_num_threads() / jobs).max(1);
    let pool = ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|e| Error::Config(format!("cannot start {threads} threads: {e}")))
}

/// Does one run.
fn one(plan: &Plan, place: usize, session: &mut Session<'_>) -> Result<Outcome> {
    let (folder, pipeline) = (plan.folder_of(place), &plan.runs[place].pipeline);
    plan.forget_failure(place);
    // A panic is a broken invariant of one run, a plugin's say; the others have none of it.
    let work = || run(pipeline, Path::new(""), &folder, session);
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let said = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        Err(Error::Config(format!("the program panicked: {}", said.unwrap_or("no message"))))
    });
    // Another process may have claimed it since it was looked at.
    if let Err(error) = &outcome
        && !matches!(error, Error::Busy(_))
    {
        // The failure itself is reported in any case.
        _ = plan.note_failure(place, error);
    }
    outcome
}
