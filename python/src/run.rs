//! `run`, `simulate` and `report`, as on the command line; events of a run are passed to Python.

use crate::arrays;
use crate::border::{reject, run_stoppable, run_with_events, stop_progress, to_exception, without_gil};
use crate::model::Model;
use crate::settings::Pipeline;
use pwrfgs::data::{read_poses, read_transmitters};
use pwrfgs::experiment::sweep::thread_pool;
use pwrfgs::experiment::{Observer, RunOutcome, ScoreTable, Session, Start, Validation, score_model};
use pwrfgs::prelude::StepReport;
use pwrfgs::raytrace::output::{DatasetWriter, OutputLayout, mitsuba};
use pwrfgs::raytrace::{ObservationKind, SceneFile, SimulationRecipe};
use pwrfgs::report::{ReportOptions, Study, write};
use pwrfgs_core::{Error, Result};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::SyncSender;

/// Event of a run: its name, and a function that adds its fields to a dict.
pub(crate) type Event = (&'static str, Box<dyn FnOnce(&Bound<'_, PyDict>) -> PyResult<()> + Send>);

/// Observer that sends events to a channel.
pub(crate) struct EventSender(pub(crate) SyncSender<Event>);

impl EventSender {
    /// Sends the event `name`; `fields` adds its fields to a dict.
    fn send(&self, name: &'static str, fields: impl FnOnce(&Bound<'_, PyDict>) -> PyResult<()> + Send + 'static) {
        _ = self.0.send((name, Box::new(fields))); // a closed channel means that the listener was interrupted
    }
}

impl Observer for EventSender {
    fn on_stage(&mut self, name: &str, done: usize, total: usize) {
        let name = name.to_owned();
        self.send("stage", move |dict| {
            dict.set_item("name", name)?;
            dict.set_item("done", done)?;
            dict.set_item("total", total)
        });
    }

    fn on_start(&mut self, start: &Start<'_>) {
        let Start { title, samples, done, steps, .. } = *start;
        let title = title.to_owned();
        self.send("start", move |dict| {
            dict.set_item("data", title)?;
            dict.set_item("samples", samples.to_vec())?;
            dict.set_item("done", done)?;
            dict.set_item("steps", steps)
        });
    }

    fn on_step(&mut self, report: &StepReport) {
        let report = StepReport { pruned: None, ..report.clone() };
        self.send("step", move |dict| set_step_fields(dict, &report));
    }

    fn on_validation(&mut self, validation: &Validation) {
        let (step, [mean, median, other]) = (validation.step, validation.values);
        self.send("validation", move |dict| {
            dict.set_item("step", step)?;
            dict.set_item("mean", mean)?;
            dict.set_item("median", median)?;
            dict.set_item("other", other)
        });
    }

    fn on_message(&mut self, message: &str) {
        let text = message.to_owned();
        self.send("message", move |dict| dict.set_item("text", text));
    }

    fn on_warning(&mut self, warning: &str) {
        let text = warning.to_owned();
        self.send("warning", move |dict| dict.set_item("text", text));
    }
}

/// Converts an event to a dict with its name under the key `what`.
pub(crate) fn event_dict<'py>(py: Python<'py>, (name, fields): Event) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("what", name)?;
    fields(&dict).map(|()| dict)
}

/// Adds the fields of a step report to a dict.
pub(crate) fn set_step_fields(dict: &Bound<'_, PyDict>, report: &StepReport) -> PyResult<()> {
    dict.set_item("step", report.step)?;
    dict.set_item("phase", report.phase.name())?;
    dict.set_item("loss", report.loss)?;
    dict.set_item("penalty", report.penalty)?;
    dict.set_item("gaussians", report.gaussians)
}

/// Runs a pipeline in `out`; `send_event` is called with every event. Returns `false` if an earlier call had finished the run.
/// With `keep_checkpoint`, the finished run keeps its checkpoint. With `threads`, the run has a separate thread pool.
#[pyfunction]
#[pyo3(signature = (pipeline, out, send_event, keep_checkpoint, threads=None))]
pub(crate) fn run(
    py: Python<'_>,
    pipeline: &Pipeline,
    out: PathBuf,
    send_event: &Bound<'_, PyAny>,
    keep_checkpoint: bool,
    threads: Option<usize>,
) -> PyResult<bool> {
    crate::strategies::forget_objects();
    let inner = pipeline.current();
    let base = pipeline.base().to_owned();
    let send_event = |event| send_event.call1((event_dict(py, event)?,)).map(|_| ());
    let work = |events, stop: &_| {
        let run = || {
            let mut session = Session { observer: &mut EventSender(events), stop, page: pwrfgs::PAGE, keep_checkpoint };
            pwrfgs::experiment::run(&inner, &base, &out, &mut session)
        };
        match threads {
            None => run(),
            Some(threads) => thread_pool(threads)?.install(run),
        }
    };
    match run_with_events(py, work, send_event)? {
        RunOutcome::Finished { already, .. } => Ok(!already),
        RunOutcome::Interrupted { .. } | RunOutcome::Unscored => Err(to_exception(py, Error::Stopped)),
    }
}

/// Scores a model that no run has trained, as `run` does after training.
#[pyfunction]
pub(crate) fn score(
    py: Python<'_>,
    model: &Model,
    pipeline: &Pipeline,
    out: PathBuf,
    send_event: &Bound<'_, PyAny>,
) -> PyResult<()> {
    crate::strategies::forget_objects();
    let (inner, base) = (pipeline.current(), pipeline.base().to_owned());
    let send_event = |event| send_event.call1((event_dict(py, event)?,)).map(|_| ());
    let work = |events, stop: &AtomicBool| {
        let observer = &mut EventSender(events);
        let mut session = Session { stop, page: pwrfgs::PAGE, ..Session::new(observer) };
        score_model(&model.ensemble, &inner, &base, &out, &mut session)
    };
    match run_with_events(py, work, send_event)? {
        RunOutcome::Finished { .. } => Ok(()),
        RunOutcome::Interrupted { .. } | RunOutcome::Unscored => Err(to_exception(py, Error::Stopped)),
    }
}

/// Converts a score table to a dict: `{predictor: {metric: {statistic: number}}}`. A metric of the whole model has one
/// number in place of the statistics, and one that is not applicable has None.
fn score_dict<'py>(py: Python<'py>, table: &ScoreTable) -> PyResult<Bound<'py, PyDict>> {
    let scores = PyDict::new(py);
    for (p, name) in table.predictors.iter().enumerate() {
        let metrics = PyDict::new(py);
        for row in &table.metrics {
            let numbers = row.cells[p].numbers();
            match numbers.as_slice() {
                [] => metrics.set_item(&row.key, py.None())?,
                [one] => metrics.set_item(&row.key, *one)?,
                many => {
                    let cell = PyDict::new(py);
                    // In the order of `ScoreCell::numbers`.
                    for (key, value) in ["mean", "median", "tail10"].iter().zip(many) {
                        cell.set_item(key, *value)?;
                    }
                    metrics.set_item(&row.key, cell)?;
                }
            }
        }
        scores.set_item(name, metrics)?;
    }
    Ok(scores)
}

/// Writes a scene as Mitsuba XML with meshes into a new folder; returns the number of meshes.
#[pyfunction]
pub(crate) fn export_scene(py: Python<'_>, scene: PathBuf, out: PathBuf) -> PyResult<usize> {
    without_gil(py, || mitsuba::export_scene(&SceneFile::read(&scene)?, &out))
}

/// Scores as a dict, and the same as text.
type Scores = (Py<PyDict>, String);

/// Content of `run.json` of a folder: (facts as JSON text, (scores, scores as text)); scores are `None` before the evaluation.
#[pyfunction]
pub(crate) fn facts(py: Python<'_>, folder: PathBuf) -> PyResult<(String, Option<Scores>)> {
    let read = || -> Result<_> {
        let path = folder.join(pwrfgs::experiment::folder::FACTS);
        let text = pwrfgs_core::files::read_text(&path)?;
        let facts: pwrfgs::experiment::Facts =
            serde_json::from_str(&text).map_err(|e| Error::input(&path, format!("is not a valid run.json: {e}")))?;
        Ok((text, facts.scores))
    };
    let (text, table) = read().map_err(|error| to_exception(py, error))?;
    let scores =
        table.map(|table| PyResult::Ok((score_dict(py, &table)?.unbind(), table.to_text(Some("`scores` also has")))));
    Ok((text, scores.transpose()?))
}

/// Reads the name of a layout with its noise, dB. Raises an exception for an unknown layout, or noise that it does not
/// have.
fn read_layout(
    py: Python<'_>,
    layout: &str,
    noise_db: Option<f64>,
    snr_db: Option<f64>,
) -> PyResult<(ObservationKind, OutputLayout)> {
    if snr_db.is_some() && !matches!(layout, "channels" | "csi") {
        let problem =
            "snr_db is only for channels; set layout=\"channels\", or set the `noise` of the scene for spectra";
        return reject(py, problem);
    }
    if noise_db.is_some() && layout != "rssi" {
        return reject(py, "noise_db is only for powers; set layout=\"rssi\"");
    }
    Ok(match layout {
        "spectra" => (ObservationKind::Spectrum, OutputLayout::Images),
        "arrays" => (ObservationKind::Spectrum, OutputLayout::Array),
        "rssi" => (ObservationKind::Power { noise_db: noise_db.unwrap_or(0.0) }, OutputLayout::Rssi),
        "channels" => (ObservationKind::Channel { snr_db }, OutputLayout::Channels),
        "csi" => (ObservationKind::Channel { snr_db }, OutputLayout::Csi),
        "DeepMIMO" => (ObservationKind::Channel { snr_db: None }, OutputLayout::DeepMimo), // `convert.to_deepmimo`
        other => {
            let all = ["spectra", "arrays", "rssi", "channels", "csi"];
            let hint = pwrfgs_core::did_you_mean(other, all);
            return reject(py, &format!("layout: unknown value `{other}`{hint} (use {})", all.join(", ")));
        }
    })
}

/// Simulates a scene; see `pwrfgs.simulate`.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // settings with names, as Python has them
pub(crate) fn simulate(
    py: Python<'_>,
    scene: PathBuf,
    out: PathBuf,
    layout: &str,
    samples: usize,
    seed: u64,
    points: usize,
    noise_db: Option<f64>,
    snr_db: Option<f64>,
    paths: bool,
    tx: Option<&Bound<'_, PyAny>>,
    rx_pose: Option<&Bound<'_, PyAny>>,
    send_event: &Bound<'_, PyAny>,
) -> PyResult<()> {
    let (observe, layout) = read_layout(py, layout, noise_db, snr_db)?;
    let recipe = SimulationRecipe::read(&scene, samples, seed, points).map_err(|error| to_exception(py, error))?;
    let scene = with_stated_positions(recipe.scene.clone(), tx, rx_pose)?;
    let recipe = recipe.with_scene(scene).and_then(|recipe| recipe.observing(observe));
    let recipe = recipe.map_err(|error| to_exception(py, error))?;
    let work = |events: SyncSender<(usize, usize)>, stop: &_| {
        let send = |done, total| _ = events.try_send((done, total));
        DatasetWriter { layout, has_paths: paths, progress: &send, stop }.write(&recipe, &out)
    };
    run_with_events(py, work, |(done, total)| send_event.call1((done, total)).map(|_| ()))
}

/// Returns the scene with the stated transmitter positions `tx`, or receiver poses `rx_pose`, if any: arrays or CSV
/// files. With `rx_pose`, `tx` is the position `[3]` of the fixed transmitter.
fn with_stated_positions(
    scene: SceneFile,
    tx: Option<&Bound<'_, PyAny>>,
    rx_pose: Option<&Bound<'_, PyAny>>,
) -> PyResult<SceneFile> {
    let Some(stated) = rx_pose.or(tx) else { return Ok(scene) };
    let exception = |error| to_exception(stated.py(), error);
    let file = stated.extract::<PathBuf>().ok();
    if rx_pose.is_some() {
        let fixed = tx.map(|tx| arrays::position("tx", tx)).transpose()?;
        let poses = match file {
            Some(file) => read_poses(&file).map_err(exception)?,
            None => arrays::poses("rx_pose", stated).map(|(poses, _)| poses)?,
        };
        return scene.with_receiver_poses(poses, fixed).map_err(exception);
    }
    let positions = match file {
        Some(file) => read_transmitters(&file).map_err(exception)?,
        None if arrays::axis_count(stated)? == 1 => vec![arrays::position("tx", stated)?],
        None => arrays::positions("tx", stated)?,
    };
    scene.with_transmitters(positions).map_err(exception)
}

/// Runs the program `pwrfgs`; the first argument is its path. Returns the exit code.
#[pyfunction]
pub(crate) fn program(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
    py.detach(|| pwrfgs_cli::run(&arguments))
}

/// Compares runs, see `pwrfgs.report`: returns the tables as text.
#[pyfunction]
pub(crate) fn report(
    py: Python<'_>,
    runs: Vec<PathBuf>,
    out: PathBuf,
    reference: Option<String>,
    columns: Vec<String>,
    variants: Vec<String>,
) -> PyResult<String> {
    run_stoppable(py, |stop| {
        let study = Study::read(&runs)?;
        write(&study, &ReportOptions { reference, columns, variants }, &out, &mut Stopping(stop))
    })
}

/// Observer that ends work after Ctrl-C, see [`stop_progress`].
pub(crate) struct Stopping<'a>(pub(crate) &'a AtomicBool);

impl Observer for Stopping<'_> {
    fn on_stage(&mut self, _: &str, done: usize, total: usize) {
        stop_progress(self.0)(done, total);
    }
}
