//! `sweep`: many runs, in this process or by an executor.

use crate::border::{run_stoppable, run_with_events, to_exception};
use crate::run::{Event, EventSender, Stopping, event_dict};
use pwrfgs::experiment::sweep::{JOINED, RunStage, SweepEnd, SweepObserver, SweepPlan, check};
use pwrfgs::experiment::{Observer, RunOutcome, Session};
use pwrfgs::prelude::NoopObserver;
use pwrfgs::report::{ReportOptions, Study, write};
use pwrfgs_core::{Error, Result};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::SyncSender;

/// Folder of a run, and its exception if it failed.
type End<'py> = (PathBuf, Option<Bound<'py, PyAny>>);

/// Run for an executor: index, folder, and pipeline as RON with absolute paths.
type Task = (usize, PathBuf, String);

/// Observer of a sweep that sends the number of ended runs as a stage.
struct RunCounter {
    events: SyncSender<Event>,
    ended: AtomicUsize,
    total: usize,
}

impl RunCounter {
    /// Sends the number of ended runs.
    fn send(&self, ended: usize) {
        EventSender(self.events.clone()).on_stage("runs", ended, self.total);
    }
}

impl SweepObserver for RunCounter {
    fn on_run_start(&self, _: usize) -> Box<dyn Observer> {
        Box::new(NoopObserver)
    }

    fn on_run_end(&self, _: usize, _: &Result<RunOutcome>) {
        self.send(self.ended.fetch_add(1, Ordering::Relaxed) + 1);
    }
}

/// Performs a sweep, see `pwrfgs.sweep`; `send_event` is called with the number of ended runs. Returns the folder of every
/// run, and of the joined model, with the exception of a failure. With `failures`, an executor has performed the runs of
/// [`prepare_sweep`]: indices and reasons of those that failed, whose exceptions the caller has.
#[pyfunction]
#[pyo3(signature = (experiment, arguments, out, jobs, send_event, keep_checkpoint, failures=None))]
#[allow(clippy::too_many_arguments)] // the keywords of `pwrfgs.sweep`
pub(crate) fn sweep<'py>(
    py: Python<'py>,
    experiment: PathBuf,
    arguments: Vec<String>,
    out: Option<PathBuf>,
    jobs: usize,
    send_event: &Bound<'_, PyAny>,
    keep_checkpoint: bool,
    failures: Option<Vec<(usize, String)>>,
) -> PyResult<Vec<End<'py>>> {
    let plan = SweepPlan::read(&experiment, &arguments, out.as_deref()).map_err(|error| to_exception(py, error))?;
    let send_event = |event| send_event.call1((event_dict(py, event)?,)).map(|_| ());
    let work = |events, stop: &AtomicBool| {
        let runs: Vec<usize> = if failures.is_some() { Vec::new() } else { (0..plan.runs.len()).collect() };
        if failures.is_none() {
            check(&plan, &runs, &mut Stopping(stop))?;
        }
        for (run, reason) in failures.into_iter().flatten() {
            plan.store_failure(run, &reason)?;
        }
        let mut session = Session { observer: &mut NoopObserver, stop, page: pwrfgs::PAGE, keep_checkpoint };
        let counter = RunCounter { events, ended: AtomicUsize::new(0), total: runs.len() };
        if !runs.is_empty() {
            counter.send(0);
        }
        let end = plan.execute(&runs, jobs, &counter, &mut session)?;
        if plan.states().iter().all(|state| matches!(state, RunStage::Finished(_))) {
            let _held = plan.claim()?;
            let study = Study::read(std::slice::from_ref(&plan.folder))?;
            write(&study, &ReportOptions::default(), &plan.folder.join("report"), &mut Stopping(stop))?;
        }
        Ok(end)
    };
    let SweepEnd { runs, joined } = run_with_events(py, work, send_event)?;
    let mut ends: Vec<End<'py>> = (0..plan.runs.len()).map(|run| (plan.run_folder(run), None)).collect();
    for (run, end) in runs {
        ends[run].1 = exception_of(py, end);
    }
    ends.extend(joined.map(|end| (plan.folder.join(JOINED), exception_of(py, Ok(end)))));
    Ok(ends)
}

/// Returns the exception of a run that failed or was stopped; `None` for a finished one.
pub(crate) fn exception_of(py: Python<'_>, end: Result<RunOutcome>) -> Option<Bound<'_, PyAny>> {
    let error = match end {
        Ok(RunOutcome::Finished { .. }) => return None,
        Ok(RunOutcome::Interrupted { .. } | RunOutcome::Unscored) => {
            Error::Config("stopped; repeat the call to resume".into())
        }
        Err(error) => error,
    };
    Some(to_exception(py, error).into_value(py).into_bound(py).into_any())
}

/// Checks a sweep, creates its folder and removes the stored failures of its unfinished runs. Returns these runs, and the number
/// of threads of each, `slurm.cpus` of the experiment.
#[pyfunction]
pub(crate) fn prepare_sweep(
    py: Python<'_>,
    experiment: PathBuf,
    arguments: Vec<String>,
    out: Option<PathBuf>,
) -> PyResult<(Vec<Task>, usize)> {
    run_stoppable(py, |stop| {
        let plan = SweepPlan::read(&experiment, &arguments, out.as_deref())?;
        let all: Vec<usize> = (0..plan.runs.len()).collect();
        let unfinished = check(&plan, &all, &mut Stopping(stop))?;
        drop(plan.claim()?); // creates the folder; the executor works without the lock
        unfinished.iter().for_each(|&run| plan.remove_failure(run));
        let task = |run: usize| Ok((run, plan.run_folder(run), plan.runs[run].pipeline.to_ron()?));
        Ok((unfinished.into_iter().map(task).collect::<Result<_>>()?, plan.slurm.cpus))
    })
}
