//! Metrics, baselines and repeatability for any arrays.

use crate::arrays::{CHUNK, ObservationShape, array_shape, positions, vector};
use crate::border::{input_error, parse_plugin, plugin_text, reject, run_stoppable, without_gil};
use crate::data::Dataset;
use pwrfgs::experiment::append_measurements;
use pwrfgs::experiment::repeatability::measure_repeatability;
use pwrfgs_core::{
    Baseline, Elevation, End, Evaluation, FittingSet, Image, ImagePlane, Measurement, Metric, ModelFacts, Origin,
    Plugin, Pose, Query, Real, Receiver, Scene, Scope, Task, Values, check_stopped,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Reads observations `[.., axes of one]` of `task`, one image each; `name` begins messages.
fn read_images(name: &str, value: &Bound<'_, PyAny>, task: Task) -> PyResult<Vec<Image>> {
    // Any size gives the number of axes; a channel has two rows per antenna.
    let (py, shape, axes) = (value.py(), array_shape(value)?, task.shape((1, 2)).len());
    let Some(lead) = shape.len().checked_sub(axes) else {
        return reject(py, &format!("{name} has {} axes, but a {} has {axes}", shape.len(), task.singular));
    };
    let (width, height) = task.size(&shape[lead..]);
    if width * height == 0 {
        return reject(py, &format!("{name} is empty"));
    }
    let rows = ObservationShape { task, size: (width, height), lead: &shape[..lead] }.read(name, value)?;
    Ok(rows.chunks_exact(width * height).map(|rows| Image { width, height, pixels: rows.to_vec() }).collect())
}

/// Valid range of true spectra, with tolerance for rounding.
const AMPLITUDES: RangeInclusive<Real> = -1e-6..=1.000_001;

/// Scores predictions by a metric: (key, unit, per-sample values or one value) per measurement. `kind` is the name of a
/// task.
#[pyfunction]
pub(crate) fn measure<'py>(
    py: Python<'py>,
    metric: &Bound<'py, PyAny>,
    kind: &str,
    predictions: &Bound<'py, PyAny>,
    truths: &Bound<'py, PyAny>,
    elevation_deg: [f64; 2],
) -> PyResult<Bound<'py, PyList>> {
    crate::strategies::forget_objects();
    let metric = parse_plugin::<dyn Metric>(py, &plugin_text("Metric", metric, None)?)?;
    let task = Task::named(kind).ok_or_else(|| input_error(py, &format!("unknown task `{kind}`")))?;
    let (predictions, truths) = (read_images("prediction", predictions, task)?, read_images("truth", truths, task)?);
    let size = |images: &[Image]| images.first().map(|image| (image.height, image.width));
    if (predictions.len(), size(&predictions)) != (truths.len(), size(&truths)) {
        let describe =
            |images: &[Image]| size(images).map_or("0".into(), |(h, w)| format!("{} of {h} by {w}", images.len()));
        let (predictions, truths) = (describe(&predictions), describe(&truths));
        return reject(py, &format!("prediction and truth differ in shape: {predictions} and {truths}"));
    }
    let Some((height, width)) = size(&truths) else { return reject(py, "prediction and truth are empty") };
    let plane = task.plane((width, height), Elevation { first: elevation_deg[0], last: elevation_deg[1] });
    let mut pixels = truths.iter().flat_map(|truth| &truth.pixels);
    if let Some(bad) = pixels.find(|v| task.has_pixels && !AMPLITUDES.contains(*v)) {
        return reject(py, &format!("truth holds {bad}, expected 0 to 1 (divide bytes by 255)"));
    }
    let scene = create_scene(vec![]);
    let evaluate = |images: [&[Image]; 2]| metric.evaluate(&Evaluation { task, ..evaluation(images, &plane, &scene) });
    let measurements = run_stoppable(py, |stop| {
        if metric.scope() != Scope::Sample {
            return evaluate([&predictions, &truths]);
        }
        let mut measurements: Vec<Measurement> = Vec::new();
        for (predictions, truths) in predictions.chunks(CHUNK).zip(truths.chunks(CHUNK)) {
            check_stopped(stop)?;
            append_measurements(&mut measurements, evaluate([predictions, truths])?, truths.len())?;
        }
        Ok(measurements)
    })?;
    measurement_list(py, measurements)
}

/// Creates the evaluation of images on a plane, without links and model, and of the default task.
fn evaluation<'a>([predictions, truths]: [&'a [Image]; 2], plane: &'a ImagePlane, scene: &'a Scene) -> Evaluation<'a> {
    let task = Task::default();
    Evaluation {
        predictions,
        truths,
        task,
        energies: &[],
        links: &[],
        plane,
        scene,
        model: None,
        timed_prediction: None,
    }
}

/// Creates a scene with surface points and one receiver at the origin.
fn create_scene(points: Vec<[Real; 3]>) -> Scene {
    Scene {
        geodetic: None,
        floors: BTreeMap::new(),
        origin: Origin::ZERO,
        moving: End::Transmitter,
        transmitter: None,
        receivers: vec![Receiver::new("receiver", Pose::IDENTITY)],
        bounds: ([0.0; 3], [0.0; 3]),
        points,
    }
}

/// Converts measurements to tuples (key, unit, values or one value).
///
/// # Errors
/// A measurement is not applicable.
fn measurement_list(py: Python<'_>, measurements: Vec<Measurement>) -> PyResult<Bound<'_, PyList>> {
    let list = PyList::empty(py);
    for one in measurements {
        match one.values {
            Values::PerSample(values) => list.append((one.key, one.unit, vector(py, values)?))?,
            Values::Whole(value) => list.append((one.key, one.unit, value))?,
            Values::NotApplicable(why) => return reject(py, &format!("{}: {why}", one.key)),
        }
    }
    Ok(list)
}

/// Chamfer distance of two point sets [N, 3] and [P, 3], m².
#[pyfunction]
pub(crate) fn chamfer(py: Python<'_>, first: &Bound<'_, PyAny>, second: &Bound<'_, PyAny>) -> PyResult<f64> {
    let real = |points: Vec<[f64; 3]>| points.into_iter().map(|p| p.map(|v| v as Real)).collect::<Vec<_>>();
    let (means, points) = (real(positions("first", first)?), real(positions("second", second)?));
    if means.is_empty() || points.is_empty() {
        return reject(py, "one of the two point sets is empty");
    }
    let metric = parse_plugin::<dyn Metric>(py, "Chamfer()")?;
    let scene = create_scene(points);
    let plane = ImagePlane::plain(1, 1); // not used by this metric
    let measurements = without_gil(py, || {
        let model = Some(ModelFacts { means: &means, gaussian_bytes: 0, file_bytes: 0 });
        metric.evaluate(&Evaluation { model, ..evaluation([&[], &[]], &plane, &scene) })
    })?;
    match measurements.first().map(|one| &one.values) {
        Some(Values::Whole(value)) => Ok(*value),
        _ => reject(py, "the distance is undefined for these points"),
    }
}

/// Predicts with a baseline fitted to the links `train`, for transmitters at `tx` [B, 3], metres, and the receiver of this index.
#[pyfunction]
#[pyo3(signature = (baseline, dataset, train, tx, receiver))]
pub(crate) fn predict_baseline<'py>(
    py: Python<'py>,
    baseline: &Bound<'py, PyAny>,
    dataset: &Dataset,
    train: &Bound<'py, PyAny>,
    tx: &Bound<'py, PyAny>,
    receiver: usize,
) -> PyResult<Bound<'py, PyAny>> {
    crate::strategies::forget_objects();
    let baseline: Plugin<dyn Baseline> = parse_plugin(py, &plugin_text("Baseline", baseline, None)?)?;
    if baseline.is_external() {
        return reject(py, "predictions of another program have no other positions; use them in a pipeline");
    }
    let train = dataset.indices("train", train)?;
    if train.is_empty() {
        return reject(py, "train: no training links");
    }
    let data = &dataset.data;
    if data.features.is_some() {
        return reject(py, "these data use link features, but baselines here need positions");
    }
    if data.scene.moving.is_receiver() {
        return reject(py, "the receiver of these data moves; score baselines with pwrfgs.evaluate or a pipeline");
    }
    if receiver >= data.scene.receivers.len() {
        let count = data.scene.receivers.len();
        return reject(py, &format!("invalid receiver index {receiver} (expected 0 to below {count})"));
    }
    let txs = positions("tx", tx)?;
    let images: Vec<Image> = run_stoppable(py, |stop| {
        let predictor = baseline.fit(data, FittingSet::train(&train).stopped_by(stop))?;
        let mut images = Vec::new();
        for txs in txs.chunks(CHUNK) {
            check_stopped(stop)?;
            images.par_extend(txs.par_iter().map(|tx| predictor.predict(Query::at(*tx, receiver))));
        }
        Ok(images)
    })?;
    let count = images.len();
    let rows = images.into_iter().flat_map(|image| image.pixels).collect();
    ObservationShape::of_data(data, &[count]).array(py, rows)
}

/// Estimates the repeatability; see `pwrfgs.repeatability`.
#[pyfunction]
pub(crate) fn repeatability<'py>(
    py: Python<'py>,
    dataset: &Dataset,
    metrics: Vec<String>,
) -> PyResult<Bound<'py, PyDict>> {
    let metrics = metrics.iter().map(|text| parse_plugin::<dyn Metric>(py, text)).collect::<PyResult<Vec<_>>>()?;
    let repeatability = run_stoppable(py, |stop| measure_repeatability(&dataset.data, &metrics, stop))?;
    let summaries = PyDict::new(py);
    for (name, similarity) in [("near", &repeatability.near), ("far", &repeatability.far)] {
        let summary = PyDict::new(py);
        summary.set_item("pairs", similarity.closest)?;
        summary.set_item("reach_m", similarity.reach_m)?;
        for metric in &similarity.metrics {
            let entry = PyDict::new(py);
            entry.set_item("unrelated", metric.unrelated)?;
            match &metric.at_zero {
                Ok(zero) => {
                    entry.set_item("mean", zero.summary.mean)?;
                    entry.set_item("median", zero.summary.median)?;
                    entry.set_item("interval", zero.interval.to_vec())?;
                }
                Err(why) => entry.set_item("why_not", why)?,
            }
            summary.set_item(&metric.key, entry)?;
        }
        summaries.set_item(name, summary)?;
    }
    Ok(summaries)
}
