//! `run`: from a pipeline to a run folder, with its events told to Python.

use crate::border::{raised, waited};
use crate::settings::Pipeline;
use pwrfgs::experiment::{Observer, Outcome, ScoreTable, Start, Validation};
use pwrfgs::prelude::StepReport;
use pwrfgs_core::{Error, Result};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;

/// What happens in a run.
enum Event {
    Stage(String, usize, usize),
    Start { title: String, samples: [usize; 3], done: u64, steps: u64 },
    Step(StepReport),
    Validation { step: u64, values: [f64; 3] },
    Message(String),
}

/// Hands events over.
struct Teller(SyncSender<Event>);

impl Teller {
    fn tell(&self, event: Event) {
        _ = self.0.send(event); // who does not listen any more has been interrupted
    }
}

impl Observer for Teller {
    fn on_stage(&mut self, name: &str, done: usize, total: usize) {
        self.tell(Event::Stage(name.to_owned(), done, total));
    }

    fn on_start(&mut self, start: &Start<'_>) {
        let Start { title, samples, done, steps, .. } = *start;
        self.tell(Event::Start { title: title.to_owned(), samples, done, steps });
    }

    fn on_step(&mut self, report: &StepReport) {
        self.tell(Event::Step(StepReport { pruned: None, ..report.clone() }));
    }

    fn on_validation(&mut self, seen: &Validation) {
        self.tell(Event::Validation { step: seen.step, values: seen.values });
    }

    fn on_message(&mut self, message: &str) {
        self.tell(Event::Message(message.to_owned()));
    }
}

/// An event as a dict with a `what`.
fn told<'py>(py: Python<'py>, event: Event) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    match event {
        Event::Stage(name, done, total) => {
            dict.set_item("what", "stage")?;
            dict.set_item("name", name)?;
            dict.set_item("done", done)?;
            dict.set_item("total", total)?;
        }
        Event::Start { title, samples, done, steps } => {
            dict.set_item("what", "start")?;
            dict.set_item("data", title)?;
            dict.set_item("samples", samples.to_vec())?;
            dict.set_item("done", done)?;
            dict.set_item("steps", steps)?;
        }
        Event::Step(report) => {
            dict.set_item("what", "step")?;
            step(&dict, &report)?;
        }
        Event::Validation { step, values } => {
            dict.set_item("what", "validation")?;
            dict.set_item("step", step)?;
            dict.set_item("mean", values[0])?;
            dict.set_item("median", values[1])?;
            dict.set_item("other", values[2])?;
        }
        Event::Message(text) => {
            dict.set_item("what", "message")?;
            dict.set_item("text", text)?;
        }
    }
    Ok(dict)
}

/// The fields of a step.
pub(crate) fn step(dict: &Bound<'_, PyDict>, report: &StepReport) -> PyResult<()> {
    dict.set_item("step", report.step)?;
    dict.set_item("phase", report.phase.name())?;
    dict.set_item("loss", report.loss)?;
    dict.set_item("penalty", report.penalty)?;
    dict.set_item("gaussians", report.gaussians)
}

/// Runs a pipeline in `out`; `hear` is called with every event. Gives whether there was anything left to do.
#[pyfunction]
pub(crate) fn run(py: Python<'_>, pipeline: &Pipeline, out: PathBuf, hear: &Bound<'_, PyAny>) -> PyResult<bool> {
    crate::strategies::forget();
    let inner = pipeline.now();
    let base = pipeline.base().to_owned();
    let hear = |event| hear.call1((told(py, event)?,)).map(|_| ());
    let outcome = waited(py, |events, stop| pwrfgs::run(&inner, &base, &out, &mut Teller(events), stop), hear)?;
    match outcome {
        Outcome::Finished { already, .. } => Ok(!already),
        Outcome::Interrupted { .. } | Outcome::Unscored => Err(raised(py, Error::Stopped)),
    }
}

/// A table of scores as Python has it: `{predictor: {metric: {statistic: number}}}`.
pub(crate) fn scores<'py>(py: Python<'py>, table: &ScoreTable) -> PyResult<Bound<'py, PyDict>> {
    let all = PyDict::new(py);
    for (p, name) in table.predictors.iter().enumerate() {
        let own = PyDict::new(py);
        for row in &table.metrics {
            let numbers = row.cells[p].numbers();
            match numbers.as_slice() {
                [] => own.set_item(&row.key, py.None())?,
                [one] => own.set_item(&row.key, *one)?,
                many => {
                    let cell = PyDict::new(py);
                    for (key, value) in ["mean", "median", "bad_tail"].iter().zip(many) {
                        cell.set_item(key, *value)?;
                    }
                    own.set_item(&row.key, cell)?;
                }
            }
        }
        all.set_item(name, own)?;
    }
    Ok(all)
}

/// What `run.json` of a folder says: (facts as JSON text, scores, the scores as text), the latter none before they are known.
#[pyfunction]
pub(crate) fn facts(py: Python<'_>, folder: PathBuf) -> PyResult<(String, Option<Py<PyDict>>, Option<String>)> {
    let read = || -> Result<_> {
        let path = folder.join(pwrfgs::experiment::folder::FACTS);
        let text = pwrfgs_core::files::read_text(&path)?;
        let facts: pwrfgs::experiment::Facts =
            serde_json::from_str(&text).map_err(|e| Error::input(&path, format!("is no run.json: {e}")))?;
        Ok((text, facts.scores))
    };
    let (text, table) = read().map_err(|error| raised(py, error))?;
    match table {
        None => Ok((text, None, None)),
        Some(table) => Ok((text, Some(scores(py, &table)?.unbind()), Some(table.to_text()))),
    }
}
