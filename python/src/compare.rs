//! `compare`, as on the command line: all methods, baselines and predictions of other programs on one data set.

use crate::arrays::vector;
use crate::border::{log_message, run_stoppable};
use crate::data::Dataset;
use crate::sweep::exception_of;
use crate::tasks::{TaskObserver, read_settings};
use pwrfgs::experiment::sweep::{SweepObserver, SweepPlan, check, estimate_run_seconds};
use pwrfgs::experiment::{NoopObserver, Observer, RunOutcome, Session};
use pwrfgs::report::{ReportOptions, Study, write};
use pwrfgs::tasks::compare::{ComparedRuns, Comparison, check_earlier_runs, without_position};
use pwrfgs::tasks::init::{DataSurvey, pipeline_name};
use pwrfgs_core::{DataSource, Error, Partition, Plugin, Result, check_stopped};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Number of runs at a time: each uses all threads.
const JOBS: usize = 1;

/// Observer that logs the end of each run of a comparison.
struct LoggedRuns<'a>(&'a SweepPlan);

impl SweepObserver for LoggedRuns<'_> {
    fn on_run_start(&self, _: usize) -> Box<dyn Observer> {
        Box::new(NoopObserver)
    }

    fn on_run_end(&self, run: usize, end: &Result<RunOutcome>) {
        log_message(if end.is_err() { "warning" } else { "info" }, &self.0.describe_end(run, end));
    }
}

/// Runs of a comparison, with their ends, and its tables.
struct ComparedData {
    folder: PathBuf,
    partition: Partition,
    runs: Vec<(PathBuf, Result<RunOutcome>)>,
    text: String,
}

/// Performs the runs of a comparison and, if all have ended, writes their report; the text is empty otherwise. With
/// `dry_run`, only estimates their times.
fn perform(comparison: Comparison, dry_run: bool, keep_checkpoint: bool, stop: &AtomicBool) -> Result<ComparedData> {
    let Comparison { plan, partition, reference } = comparison;
    let (observer, indices) = (&mut TaskObserver(stop), (0..plan.runs.len()).collect::<Vec<usize>>());
    if dry_run {
        let seconds = estimate_run_seconds(&plan, &indices, observer).map_err(without_position)?;
        let text = plan.estimate_table(&indices, &seconds, JOBS);
        return Ok(ComparedData { folder: plan.folder, partition, runs: Vec::new(), text });
    }
    check_earlier_runs(&plan)?;
    check(&plan, &indices, observer).map_err(without_position)?;
    let mut session = Session { observer, stop, page: pwrfgs::PAGE, keep_checkpoint };
    let ends = plan.execute(&indices, JOBS, &LoggedRuns(&plan), &mut session)?.runs;
    check_stopped(stop)?;
    let text = if plan.has_ended() {
        let _held = plan.claim()?;
        let study = Study::read(std::slice::from_ref(&plan.folder))?;
        let options = ReportOptions { reference, ..ReportOptions::default() };
        write(&study, &options, &plan.folder.join("report"), &mut TaskObserver(stop))?
    } else {
        String::new()
    };
    let runs = ends.into_iter().map(|(run, end)| (plan.run_folder(run), end));
    Ok(ComparedData { runs: runs.collect(), folder: plan.folder, partition, text })
}

/// Compares methods, see `pwrfgs.compare`. `data` are a data set, which `source` reads, or a data folder; `text` are
/// the settings as RON. Returns a dict with the folder, the runs with their exceptions, the tables as `text`, and the
/// links of each set.
#[pyfunction]
#[pyo3(signature = (data, source, text, changes, accept, out, dry_run, keep_checkpoint))]
#[allow(clippy::too_many_arguments)] // the keywords of `pwrfgs.compare`
pub(crate) fn compare<'py>(
    py: Python<'py>,
    data: &Bound<'py, PyAny>,
    source: Option<String>,
    text: &str,
    changes: Vec<String>,
    accept: Vec<String>,
    out: Option<PathBuf>,
    dry_run: bool,
    keep_checkpoint: bool,
) -> PyResult<Bound<'py, PyDict>> {
    crate::strategies::forget_objects();
    let held = data.cast::<Dataset>().ok().map(|data| Arc::clone(&data.get().data));
    let is_held = held.is_some();
    let path: PathBuf = if is_held { PathBuf::new() } else { data.extract()? };
    let (compared, test_ids) = run_stoppable(py, |stop| {
        let observer = &mut TaskObserver(stop);
        let survey = match (held, source) {
            (Some(data), Some(source)) => {
                let source = Plugin::<dyn DataSource>::parse(&source).map_err(Error::Config)?;
                DataSurvey::of_data(source, (*data).clone(), None, &accept, observer)?
            }
            _ => DataSurvey::read(&path.canonicalize().unwrap_or_else(|_| path.clone()), &accept, observer)?,
        };
        let named_by = if is_held { Path::new(&survey.data.title) } else { &path };
        let compared = ComparedRuns { settings: read_settings(text)?, name: pipeline_name(named_by), changes, out };
        let comparison = compared.plan(&survey, observer)?;
        // Labels, by which the prediction files of other programs name links.
        let test_ids: Vec<u32> = comparison.partition.test.iter().map(|&i| survey.data.label(i)).collect();
        Ok((perform(comparison, dry_run, keep_checkpoint, stop)?, test_ids))
    })?;
    let (dict, indices) = (PyDict::new(py), |set: &[usize]| set.iter().map(|&i| i as i64).collect::<Vec<_>>());
    let Partition { train, validation, test } = &compared.partition;
    dict.set_item("folder", compared.folder)?;
    let runs = compared.runs.into_iter().map(|(folder, end)| (folder, exception_of(py, end)));
    dict.set_item("runs", runs.collect::<Vec<_>>())?;
    dict.set_item("text", compared.text)?;
    dict.set_item("test_ids", vector(py, test_ids)?)?;
    for (name, set) in [("train", train), ("validation", validation), ("test", test)] {
        dict.set_item(name, vector(py, indices(set))?)?;
    }
    Ok(dict)
}
