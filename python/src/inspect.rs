//! `pwrfgs.inspect`: properties of data, and the scores of baselines by split.

use crate::arrays::{array, vector};
use crate::border::{run_stoppable, without_gil};
use crate::data::Dataset;
use crate::settings::Pipeline;
use crate::tasks::TaskObserver;
use pwrfgs::experiment::Session;
use pwrfgs::experiment::inspect::{Inspection, PoseCheck, SplitScores};
use pwrfgs::tasks::init;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Returns the text of the pipeline of `pwrfgs inspect` for data with a `source` (RON).
#[pyfunction]
pub(crate) fn default_pipeline(py: Python<'_>, data: &Dataset, source: &str) -> PyResult<String> {
    without_gil(py, || init::default_pipeline(source, &data.data, "pipeline")?.to_ron())
}

/// Inspects data with split, baselines, metrics and seed of a pipeline: a dict of facts, pose, and a table of splits.
#[pyfunction]
pub(crate) fn inspect<'py>(py: Python<'py>, data: &Dataset, pipeline: &Pipeline) -> PyResult<Bound<'py, PyDict>> {
    crate::strategies::forget_objects();
    let inner = pipeline.current();
    let inspection = run_stoppable(py, |stop| {
        let session = &mut Session { observer: &mut TaskObserver(stop), stop, page: None, keep_checkpoint: false };
        Inspection::of(&inner, &data.data, session)
    })?;
    let dict = PyDict::new(py);
    dict.set_item("text", inspection.to_text())?;
    let Inspection { title, facts, pose, baselines, metric, splits, refused, .. } = inspection;
    dict.set_item("title", title)?;
    dict.set_item("facts", facts)?;
    dict.set_item("pose", pose.map(|pose| pose_dict(py, &pose)).transpose()?)?;
    dict.set_item("metric", metric)?;
    dict.set_item("splits", splits.iter().map(|split| split.name.as_str()).collect::<Vec<_>>())?;
    let counts = |count: fn(&SplitScores) -> usize| {
        vector(py, splits.iter().map(|split| count(split) as i64).collect::<Vec<i64>>())
    };
    dict.set_item("train", counts(|split| split.train)?)?;
    dict.set_item("test", counts(|split| split.test)?)?;
    dict.set_item("nearest_m", vector::<f64>(py, splits.iter().map(|split| split.nearest_m).collect())?)?;
    let means = splits.iter().flat_map(|split| split.means.iter().copied()).collect();
    dict.set_item("scores", array::<f64>(py, means, &[splits.len(), baselines.len()])?)?;
    dict.set_item("ceiling", vector::<f64>(py, splits.iter().map(|split| split.ceiling).collect())?)?;
    dict.set_item("baselines", baselines)?;
    dict.set_item("refused", refused)?;
    Ok(dict)
}

/// Converts a check of the recorded pose to a dict; angles in degrees.
fn pose_dict<'py>(py: Python<'py>, pose: &PoseCheck) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("verdict", pose.verdict.title())?;
    dict.set_item("spectra", pose.pairs)?;
    for (name, degrees) in [
        ("recorded_deg", pose.recorded),
        ("turned_deg", pose.turned),
        ("constant_deg", pose.constant),
        ("turn_deg", pose.turn),
        ("spread_deg", pose.spread),
    ] {
        dict.set_item(name, degrees)?;
    }
    dict.set_item("orientation", vector::<f64>(py, pose.orientation.to_vec())?)?;
    Ok(dict)
}
