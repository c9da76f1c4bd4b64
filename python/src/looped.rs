//! `Trainer`: the training loop in one's own hands.

use crate::arrays::numbers;
use crate::border::{free, wrong};
use crate::data::Dataset;
use crate::model::Model;
use crate::settings::Pipeline;
use crate::strategies::{cloud_object, stats_object};
use pwrfgs::model::Ensemble;
use pwrfgs::train::Trainer as Inner;
use pwrfgs_core::{Dataset as Data, Partition, Result};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use self_cell::self_cell;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

self_cell!(
    struct Held {
        owner: Arc<Data>,
        #[not_covariant]
        dependent: Inner,
    }
);

/// A training under way, step by step; see the Python class of that name.
#[pyclass(frozen, module = "pwrfgs._pwrfgs")]
pub(crate) struct Trainer {
    held: Mutex<Held>,
}

impl Trainer {
    fn with<T>(&self, look: impl FnOnce(&mut Inner<'_>) -> T) -> T {
        self.held.lock().unwrap_or_else(PoisonError::into_inner).with_dependent_mut(|_, inner| look(inner))
    }
}

#[pymethods]
impl Trainer {
    #[new]
    fn new(py: Python<'_>, pipeline: &Pipeline, dataset: &Dataset) -> PyResult<Self> {
        let mut inner = pipeline.now();
        pwrfgs::experiment::rebase(&mut inner, pipeline.base());
        let data = Arc::clone(&dataset.data);
        let begin = move || -> Result<Held> {
            let partition: Partition = inner.partition(&data)?;
            Held::try_new(data, |data| Inner::new(&inner, data, &partition))
        };
        Ok(Self { held: Mutex::new(free(py, begin)?) })
    }

    fn step<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let report = free(py, || {
            self.with(|inner| {
                let report = inner.step()?;
                Ok(report)
            })
        })?;
        let dict = PyDict::new(py);
        crate::run::step(&dict, &report)?;
        Ok(dict)
    }

    #[getter]
    fn done(&self, py: Python<'_>) -> u64 {
        py.detach(|| self.with(|inner| inner.done()))
    }

    #[getter]
    fn finished(&self, py: Python<'_>) -> bool {
        py.detach(|| self.with(|inner| inner.finished()))
    }

    #[getter]
    fn cloud<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let cloud = py.detach(|| self.with(|inner| inner.cloud().clone()));
        cloud_object(py, &cloud, false)
    }

    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let stats = py.detach(|| self.with(|inner| inner.stats().clone()));
        stats_object(py, &stats)
    }

    fn prune(&self, py: Python<'_>, keep: &Bound<'_, PyAny>) -> PyResult<usize> {
        let keep = numbers::<bool>("keep", keep, &[None])?;
        free(py, || {
            self.with(|inner| {
                inner.keep(&keep)?;
                Ok(inner.cloud().len())
            })
        })
    }

    fn model(&self, py: Python<'_>) -> Model {
        Model::new(Ensemble::of(py.detach(|| self.with(|inner| inner.model()))))
    }

    /// The bytes of a checkpoint, written whole or not at all.
    fn save_checkpoint(&self, py: Python<'_>, path: std::path::PathBuf) -> PyResult<()> {
        if path.as_path() == Path::new("") {
            return Err(wrong(py, "give the path of a file"));
        }
        free(py, || pwrfgs_core::files::write_atomically(&path, &self.with(|inner| inner.checkpoint())))
    }
}
