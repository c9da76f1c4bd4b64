//! Tasks on data or a finished model; `pwrfgs/_tasks.py` makes methods and functions of these. `text` is the RON of the
//! settings of a task.

use crate::arrays::{array, array_shape, complex_pairs, numbers, positions, vector};
use crate::border::{
    input_error, log_message, reject, replace_flags, run_stoppable, stop_progress, without_gil, without_position,
};
use crate::data::Dataset;
use crate::model::Model;
use crate::settings::{Pipeline, field_list};
use pwrfgs::experiment::{ActiveRun, Observer, Session, SplitData, collect_findings, load_split_data, rebased};
use pwrfgs::localise::Region;
use pwrfgs::model::compress::Bits;
use pwrfgs::planning::floor_grid;
use pwrfgs::raytrace::SceneFile;
use pwrfgs::tasks::compare::CompareSettings;
use pwrfgs::tasks::init::{DataSurvey, Effort};
use pwrfgs::tasks::locate::{
    Localisation, LocateSettings, LocatedRow, ReadFeatures, UnlocatedObservations, read_known_pipeline,
};
use pwrfgs::tasks::place::{PlaceSettings, Placement, place_in_data, place_in_scene};
use pwrfgs::tasks::plan::{PlanInput, PlanSettings};
use pwrfgs::tasks::update::UpdatedModel;
use pwrfgs::tasks::{self, MapSettings};
use pwrfgs_core::docs::Docs;
use pwrfgs_core::plugin::{read_ron, to_ron};
use pwrfgs_core::{DataSource, Partition, Plugin, Real, Result, recognise, rows_of};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use serde::de::DeserializeOwned;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Observer that ends work after Ctrl-C and logs messages and warnings.
pub(crate) struct TaskObserver<'a>(pub(crate) &'a AtomicBool);

impl TaskObserver<'_> {
    /// Creates the session of this observer, which Ctrl-C stops.
    fn session(&mut self) -> Session<'_> {
        Session { stop: self.0, ..Session::new(self) }
    }
}

impl Observer for TaskObserver<'_> {
    fn on_stage(&mut self, _: &str, done: usize, total: usize) {
        stop_progress(self.0)(done, total);
    }

    fn on_message(&mut self, message: &str) {
        log_message("info", message);
    }

    fn on_warning(&mut self, warning: &str) {
        log_message("warning", warning);
    }
}

/// Lists the fields of the settings of each task by [`field_list`].
#[pyfunction]
pub(crate) fn task_settings<'py>(py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
    let fields = PyDict::new(py);
    fields.set_item("map", field_list(py, Docs::of::<MapSettings>().fields())?)?;
    fields.set_item("locate", field_list(py, Docs::of::<LocateSettings>().fields())?)?;
    fields.set_item("plan", field_list(py, Docs::of::<PlanSettings>().fields())?)?;
    fields.set_item("place", field_list(py, Docs::of::<PlaceSettings>().fields())?)?;
    fields.set_item("compare", field_list(py, Docs::of::<CompareSettings>().fields())?)?;
    Ok(fields)
}

/// Reads settings from RON text.
pub(crate) fn read_settings<S: DeserializeOwned>(text: &str) -> Result<S> {
    read_ron(text, Path::new("settings")).map_err(without_position)
}

/// Maps a model over a plane: a dict with the grid, and the layers as (name, description, unit, values `[rows, columns]`).
#[pyfunction]
pub(crate) fn radio_map<'py>(py: Python<'py>, model: &Model, text: &str) -> PyResult<Bound<'py, PyDict>> {
    let map = run_stoppable(py, |stop| tasks::map(&model.ensemble, &read_settings(text)?, &mut TaskObserver(stop)))?;
    let (grid, dict) = (map.grid, PyDict::new(py));
    let along = |axis: usize, count: usize| (0..count).map(|k| grid.first[axis] + grid.step * k as f64).collect();
    dict.set_item("axes", grid.plane.axis_names())?;
    dict.set_item("plane", grid.plane.describe())?;
    dict.set_item("columns", vector::<f64>(py, along(0, grid.columns))?)?;
    dict.set_item("rows", vector::<f64>(py, along(1, grid.rows))?)?;
    let shape = [grid.rows, grid.columns];
    if let Some(training) = &map.training {
        dict.set_item("extrapolated", array(py, training.is_beyond.clone(), &shape)?)?;
    }
    let layers = PyList::empty(py);
    for (name, layer) in map.names().into_iter().zip(map.layers) {
        layers.append((name, layer.words, layer.unit, array(py, layer.values, &shape)?))?;
    }
    dict.set_item("layers", layers)?;
    Ok(dict)
}

/// Reads observations of unknown transmitters: powers `[B, R]`, spectra `[B, H, W]`, or channels `[B, A, F]` as rows of real and
/// imaginary parts.
fn read_observations(model: &Model, value: &Bound<'_, PyAny>) -> PyResult<Vec<Real>> {
    let setup = &model.ensemble.members()[0].stages.setup;
    let (width, height) = (setup.plane.width, setup.plane.height);
    let name = "observations";
    if setup.task.is_scalar {
        return numbers(name, value, &[None, Some(setup.receivers.len())]);
    }
    if setup.task.is_complex {
        // The image of a channel has a row of real and one of imaginary parts per antenna.
        let gains = complex_pairs(name, value, &[None, Some(height / 2), Some(width)])?;
        return Ok(rows_of(&gains, width));
    }
    numbers(name, value, &[None, Some(height), Some(width)])
}

/// Converts located transmitters to a dict with an array per column; without true positions if one is unknown. The area of a
/// missing region is NaN.
fn location_dict<'py>(py: Python<'py>, rows: &[LocatedRow]) -> PyResult<Bound<'py, PyDict>> {
    let (dict, shape) = (PyDict::new(py), [rows.len(), 3]);
    let regions = || rows.iter().map(|row| row.located.region.as_ref());
    let area = |region: Option<&Region>| region.map_or(f64::NAN, Region::area);
    let outlines: Vec<_> = regions().map(|region| region.map(Region::outlines).unwrap_or_default()).collect();
    let estimates: Vec<f64> = rows.iter().flat_map(|row| row.located.position).collect();
    dict.set_item("names", rows.iter().map(|row| row.name.as_str()).collect::<Vec<_>>())?;
    dict.set_item("positions", array(py, estimates, &shape)?)?;
    dict.set_item("misfit", vector(py, rows.iter().map(|row| row.located.misfit).collect::<Vec<f64>>())?)?;
    dict.set_item("region_m2", vector(py, regions().map(area).collect::<Vec<f64>>())?)?;
    dict.set_item("outlines", outlines)?;
    if let Some(truths) = rows.iter().map(|row| row.truth).collect::<Option<Vec<[f64; 3]>>>() {
        dict.set_item("truth", array(py, truths.concat(), &shape)?)?;
    }
    Ok(dict)
}

/// Locates transmitters: a dict with an array per column, and the table as `text`. Without observations, locates the test
/// samples. `set` changes the pipeline of the model, `accept` names accepted findings.
#[pyfunction]
#[pyo3(signature = (model, observations, set, accept, text))]
pub(crate) fn locate<'py>(
    py: Python<'py>,
    model: &Model,
    observations: Option<&Bound<'py, PyAny>>,
    set: Vec<String>,
    accept: Vec<String>,
    text: &str,
) -> PyResult<Bound<'py, PyDict>> {
    if let Some(value) = observations
        && array_shape(value)?.first() == Some(&0)
    {
        return reject(py, "observations is empty; give one row or more");
    }
    let values = observations.map(|value| read_observations(model, value)).transpose()?;
    let Localisation { rows, text, .. } = run_stoppable(py, |stop| {
        let observer = &mut TaskObserver(stop);
        let mut pipeline = read_known_pipeline(model.path.as_deref(), &set, values.is_some())?;
        pipeline.iter_mut().for_each(|pipeline| pipeline.accept.extend(accept.iter().cloned()));
        let split = pipeline.as_ref().map(|pipeline| load_split_data(pipeline, observer)).transpose()?;
        let accepted = pipeline.as_ref().map_or(&accept, |pipeline| &pipeline.accept);
        let read = |features: &_, data: &_| {
            let path = Path::new("observations");
            let values = values.as_deref().unwrap_or_default();
            UnlocatedObservations { path, features, data, accepted }.array_features(values)
        };
        let read = values.is_some().then_some(&read as ReadFeatures<'_>);
        let images = 0; // densities of regions are not returned
        tasks::locate::locate(&model.ensemble, split.as_ref(), read, &read_settings(text)?, images, observer)
    })?;
    let dict = location_dict(py, &rows)?;
    dict.set_item("text", text)?;
    Ok(dict)
}

/// Adds the links of `data` to the residual process of a model. Returns the new model, the number of added links, and a text on
/// their agreement with the model. `accept` names accepted findings.
#[pyfunction]
pub(crate) fn update(
    py: Python<'_>,
    model: &Model,
    data: &Dataset,
    accept: Vec<String>,
) -> PyResult<(Model, usize, String)> {
    let UpdatedModel { ensemble, added, agreement, .. } =
        run_stoppable(py, |stop| tasks::update::update(&model.ensemble, &data.data, &accept, &mut TaskObserver(stop)))?;
    Ok((Model::new(ensemble), added, agreement))
}

/// Fits the residual process of a pipeline to a model trained on the links `train`, and calibrates its intervals on the links
/// `validation`; returns the new model.
#[pyfunction]
pub(crate) fn calibrate(
    py: Python<'_>,
    model: &Model,
    pipeline: &Pipeline,
    data: &Dataset,
    train: &Bound<'_, PyAny>,
    validation: &Bound<'_, PyAny>,
) -> PyResult<Model> {
    let (settings, base) = (pipeline.current(), pipeline.base().to_owned());
    let (train, validation) = (data.indices("train", train)?, data.indices("validation", validation)?);
    let calibrated = run_stoppable(py, |stop| {
        let partition = Partition { train, validation, ..Partition::default() };
        let split = SplitData { data: (*data.data).clone(), partition };
        let (mut observer, pipeline) = (TaskObserver(stop), rebased(&settings, &base)?);
        ActiveRun::new(&pipeline, &split, &mut observer.session()).calibrate_model((*model.ensemble).clone())
    })?;
    Ok(Model::new(calibrated))
}

/// Stores a model with 8 or 16 bits per weight; returns the model of the smaller file, and notes on size and accuracy.
#[pyfunction]
pub(crate) fn compress(py: Python<'_>, model: &Model, bits: u8) -> PyResult<(Model, Vec<String>)> {
    let bits = match bits {
        8 => Bits::Eight,
        16 => Bits::Sixteen,
        other => return reject(py, &format!("bits is {other}, expected 8 or 16")),
    };
    let small = without_gil(py, || tasks::compress::compress(&model.ensemble, bits))?;
    Ok((Model::new_compressed(small.ensemble, small.bytes), small.notes))
}

/// Finds implausible properties of data: (name, problem, mend).
#[pyfunction]
pub(crate) fn findings(py: Python<'_>, data: &Dataset) -> PyResult<Vec<(String, String, String)>> {
    let findings = without_gil(py, || collect_findings(&data.data, None))?;
    Ok(findings.into_iter().map(|finding| (finding.name, finding.problem, replace_flags(&finding.mend))).collect())
}

/// Returns the text of the pipeline that `pwrfgs init` suggests for data; `root` is the folder of their `source`, if there is
/// one.
#[pyfunction]
#[pyo3(signature = (data, source, root, name, effort, accept))]
pub(crate) fn suggest_pipeline(
    py: Python<'_>,
    data: &Dataset,
    source: &str,
    root: Option<PathBuf>,
    name: &str,
    effort: &str,
    accept: Vec<String>,
) -> PyResult<String> {
    run_stoppable(py, |stop| {
        let effort = Effort::parse(effort).map_err(|why| pwrfgs_core::Error::Config(format!("effort: {why}")))?;
        let source = Plugin::<dyn DataSource>::parse(source).map_err(pwrfgs_core::Error::Config)?;
        // Settings of the source may select another point cloud than the command finds.
        let has_source = |root: &PathBuf| recognise(root).is_some_and(|default| to_ron(&default) == to_ron(&source));
        let root = root.filter(has_source);
        let (data, observer) = ((*data.data).clone(), &mut TaskObserver(stop));
        let survey = DataSurvey::of_data(source.clone(), data, root.as_deref(), &accept, observer)?;
        let (pipeline, _) = survey.suggest_pipeline(name, effort, Path::new("pipeline"))?;
        pipeline.to_ron()
    })
}

/// Returns the positions of data, or the training positions of a model.
fn measured_positions(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<PlanInput> {
    if let Ok(data) = source.cast::<Dataset>() {
        let data = (*data.get().data).clone();
        return without_gil(py, || PlanInput::of_data(data));
    }
    let Ok(model) = source.cast::<Model>() else { return reject(py, "source: expected a Dataset or a Model") };
    PlanInput::of_model(&model.get().ensemble, "model")
        .ok_or_else(|| input_error(py, "the model has no training positions; give its data"))
}

/// Selects positions to measure next, see `pwrfgs.plan`. `source` are data or a model, `candidates` positions [C, 3], `floor` a
/// scene file with a grid spacing and a height in metres, which `candidates` replace.
#[pyfunction]
#[pyo3(signature = (source, candidates, floor, text))]
pub(crate) fn plan<'py>(
    py: Python<'py>,
    source: Option<&Bound<'py, PyAny>>,
    candidates: Option<&Bound<'py, PyAny>>,
    floor: Option<(PathBuf, f64, f64)>,
    text: &str,
) -> PyResult<Bound<'py, PyDict>> {
    let measured = source.map_or_else(|| Ok(PlanInput::default()), |source| measured_positions(py, source))?;
    let candidates = candidates.map(|value| positions("candidates", value)).transpose()?;
    let (places, plan) = run_stoppable(py, |stop| {
        let candidates = match (candidates, floor) {
            (None, Some((scene, step, height))) => Some(floor_grid(&SceneFile::read(&scene)?, step, height)?),
            (candidates, _) => candidates,
        };
        let places = match candidates {
            Some(candidates) => measured.with_candidates(candidates, Path::new("candidates"))?,
            None => measured,
        };
        let plan = tasks::plan::plan(&places, &read_settings(text)?, &mut TaskObserver(stop).session())?;
        Ok((places, plan))
    })?;
    let dict = PyDict::new(py);
    let positions: Vec<f64> = plan.order.iter().flat_map(|&j| places.candidates[j]).collect();
    dict.set_item("text", plan.text)?;
    dict.set_item("positions", array(py, positions, &[plan.order.len(), 3])?)?;
    dict.set_item("order", vector(py, plan.order.iter().map(|&j| j as i64).collect::<Vec<_>>())?)?;
    dict.set_item("variances", vector(py, plan.variances)?)?;
    Ok(dict)
}

/// Selects receivers, see `pwrfgs.place`: `source` are data with received powers, their folder, or a scene file or its name. Returns
/// `text`, the table, and `choices`: name, names of the R receivers, positions [R, 3] in metres, coverage in dBm; without choices
/// that were not computed.
#[pyfunction]
pub(crate) fn place<'py>(py: Python<'py>, source: &Bound<'py, PyAny>, text: &str) -> PyResult<Bound<'py, PyDict>> {
    let data = source.cast::<Dataset>().ok().map(|data| std::sync::Arc::clone(&data.get().data));
    let path: Option<PathBuf> = if data.is_none() { Some(source.extract()?) } else { None };
    let placement: Placement = run_stoppable(py, |stop| {
        let (settings, observer) = (read_settings::<PlaceSettings>(text)?, &mut TaskObserver(stop));
        if let Some(data) = data {
            return place_in_data(&data, &settings, observer);
        }
        let path = path.unwrap_or_default();
        match recognise(&path) {
            Some(source) => place_in_data(&source.load(Path::new(""), &stop_progress(stop))?, &settings, observer),
            None => place_in_scene(&SceneFile::read(&path)?, &settings, &mut observer.session()),
        }
    })?;
    let (dict, rows) = (PyDict::new(py), PyList::empty(py));
    for choice in placement.choices.iter().filter(|choice| !choice.receivers.is_empty()) {
        let positions: Vec<f64> = choice.receivers.iter().flat_map(|(_, position)| *position).collect();
        let names: Vec<&str> = choice.receivers.iter().map(|(name, _)| name.as_str()).collect();
        rows.append((choice.short, names, array(py, positions, &[choice.receivers.len(), 3])?, choice.coverage))?;
    }
    dict.set_item("text", placement.table())?;
    dict.set_item("choices", rows)?;
    Ok(dict)
}
