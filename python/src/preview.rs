//! Size and cost of a run before it starts.

use crate::border::{run_stoppable, stop_progress};
use crate::settings::Pipeline;
use pwrfgs::experiment::{Observer, preview};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::atomic::AtomicBool;

/// Observer that ends work after Ctrl-C; a preview returns its warnings.
struct StopObserver<'a>(&'a AtomicBool);

impl Observer for StopObserver<'_> {
    fn on_stage(&mut self, _: &str, done: usize, total: usize) {
        stop_progress(self.0)(done, total);
    }
}

/// Loads and initialises what a run of the pipeline needs and times a few steps: a dict with the fields of `pwrfgs.Check`.
#[pyfunction]
pub(crate) fn check<'py>(py: Python<'py>, pipeline: &Pipeline) -> PyResult<Bound<'py, PyDict>> {
    crate::strategies::forget_objects();
    let (settings, base) = (pipeline.current(), pipeline.base().to_owned());
    let found = run_stoppable(py, |stop| preview(&settings, &base, &mut StopObserver(stop)))?;
    let dict = PyDict::new(py);
    dict.set_item("samples", found.samples)?;
    dict.set_item("gaussians", found.time.start.gaussians)?;
    dict.set_item("weights", found.weights)?;
    dict.set_item("memory_bytes", found.loaded_bytes + found.step_bytes)?;
    dict.set_item("search_s", found.time.search_seconds)?;
    dict.set_item("training_s", found.time.seconds)?;
    dict.set_item("text", found.table())?;
    dict.set_item("warnings", found.warnings)?;
    Ok(dict)
}
