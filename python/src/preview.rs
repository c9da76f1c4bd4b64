//! Size and cost of a run before it starts.

use crate::border::run_stoppable;
use crate::run::Stopping;
use crate::settings::Pipeline;
use pwrfgs::experiment::preview;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Loads and initialises what a run of the pipeline needs and times a few steps: a dict with the fields of `pwrfgs.Check`.
#[pyfunction]
pub(crate) fn check<'py>(py: Python<'py>, pipeline: &Pipeline) -> PyResult<Bound<'py, PyDict>> {
    crate::strategies::forget_objects();
    let (settings, base) = (pipeline.current(), pipeline.base().to_owned());
    let preview = run_stoppable(py, |stop| preview(&settings, &base, &mut Stopping(stop)))?;
    let dict = PyDict::new(py);
    dict.set_item("samples", preview.samples)?;
    dict.set_item("gaussians", preview.time.start.gaussians)?;
    dict.set_item("weights", preview.weights)?;
    dict.set_item("memory_bytes", preview.loaded_bytes + preview.step_bytes)?;
    dict.set_item("search_s", preview.time.search_seconds)?;
    dict.set_item("training_s", preview.time.seconds)?;
    dict.set_item("text", preview.table())?;
    dict.set_item("warnings", preview.warnings)?;
    Ok(dict)
}
