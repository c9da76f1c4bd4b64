//! `Trainer`: custom training loops.

use crate::arrays::numbers;
use crate::border::{poll_work, reject, run_stoppable};
use crate::data::Dataset;
use crate::model::Model;
use crate::settings::Pipeline;
use crate::strategies::{PythonLoss, cloud_object, read_cloud, stats_object};
use pwrfgs::model::Ensemble;
use pwrfgs::prelude::Pipeline as Settings;
use pwrfgs::train::Trainer as Inner;
use pwrfgs_core::files::{self, check_file_path, write_atomically};
use pwrfgs_core::{Dataset as Data, Error, Origin, Partition, Result};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use self_cell::self_cell;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, TryLockError};

self_cell!(
    struct TrainerState {
        owner: Arc<Data>,
        #[not_covariant]
        dependent: Inner,
    }
);

impl TrainerState {
    /// Starts the training, or continues that of a checkpoint file; `loss` replaces the loss of the pipeline.
    fn begin(
        pipeline: &Settings,
        data: Arc<Data>,
        partition: &Partition,
        loss: Option<PythonLoss>,
        checkpoint: Option<PathBuf>,
        stop: &AtomicBool,
    ) -> Result<Self> {
        let read = |path: PathBuf| files::read(&path).map_err(|e| Error::read(&path, e));
        let bytes = checkpoint.map(read).transpose()?;
        Self::try_new(data, |data| {
            let mut trainer = match bytes {
                Some(bytes) => Inner::restore(&pipeline.plan()?, data, partition, &bytes)?,
                None => Inner::begin(&pipeline.plan()?, data, partition, &|_, _| {}, stop)?,
            };
            if let Some(loss) = loss {
                trainer.set_objective(Box::new(loss));
            }
            Ok(trainer)
        })
    }
}

/// Training in progress, step by step; see the Python class of that name.
#[pyclass(frozen, module = "pwrfgs._pwrfgs")]
pub(crate) struct Trainer {
    state: Mutex<TrainerState>,
    /// Whether a step failed, which may leave the state inconsistent.
    failed: AtomicBool,
}

impl Trainer {
    /// Calls `work` with exclusive access to the training, without the interpreter lock; waits for it as [`poll_work`].
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut Inner<'_>) -> Result<T> + Send) -> PyResult<T> {
        let mut work = Some(work);
        poll_work(py, || {
            let mut state = match self.state.try_lock() {
                Ok(state) => state,
                Err(TryLockError::Poisoned(state)) => state.into_inner(),
                Err(TryLockError::WouldBlock) => return None,
            };
            let work = work.take()?;
            Some(state.with_dependent_mut(|_, inner| work(inner)))
        })
    }
}

#[pymethods]
impl Trainer {
    /// `train` are the links of the training set, in place of the split of the pipeline, `loss` a function in place of its
    /// loss, `checkpoint` the file to start from.
    #[new]
    #[pyo3(signature = (pipeline, dataset, train=None, loss=None, checkpoint=None))]
    fn new(
        py: Python<'_>,
        pipeline: &Pipeline,
        dataset: &Dataset,
        train: Option<&Bound<'_, PyAny>>,
        loss: Option<Py<PyAny>>,
        checkpoint: Option<PathBuf>,
    ) -> PyResult<Self> {
        let (inner, base) = (pipeline.current(), pipeline.base().to_owned());
        let data = Arc::clone(&dataset.data);
        crate::strategies::forget_objects();
        let train = train.map(|train| dataset.indices("train", train)).transpose()?;
        // Sorted, each link once.
        let train = train.map(|links| links.into_iter().collect::<BTreeSet<_>>().into_iter().collect());
        let begin = move |stop: &AtomicBool| -> Result<TrainerState> {
            let inner = pwrfgs::experiment::rebased(&inner, &base)?;
            let partition = match train {
                Some(train) => Partition { train, ..Partition::default() },
                None => inner.partition(&data)?,
            };
            let loss = loss.map(|function| PythonLoss { function, task: data.task() });
            TrainerState::begin(&inner, data, &partition, loss, checkpoint, stop)
        };
        Ok(Self { state: Mutex::new(run_stoppable(py, begin)?), failed: AtomicBool::new(false) })
    }

    /// Replaces the Gaussians by `columns`, arrays by name; `is_world` for means in the world frame.
    fn set_cloud(&self, py: Python<'_>, columns: &Bound<'_, PyDict>, is_world: bool) -> PyResult<()> {
        let origin = self.with(py, |inner| Ok(inner.origin()))?;
        let cloud = read_cloud(columns, if is_world { origin } else { Origin::ZERO })?;
        self.with(py, |inner| inner.set_cloud(cloud))
    }

    // Runs one step and returns its report; after a failed step, all further ones are errors.
    fn step<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        if self.failed.load(Ordering::Relaxed) {
            return reject(py, "a step of this trainer has failed; create a new trainer");
        }
        let mut begun = false; // an exception while waiting is no failed step
        let report = self.with(py, |inner| {
            begun = true;
            inner.step()
        });
        self.failed.store(begun && report.is_err(), Ordering::Relaxed);
        let dict = PyDict::new(py);
        crate::run::set_step_fields(&dict, &report?)?;
        Ok(dict)
    }

    /// Number of completed steps.
    #[getter]
    fn done(&self, py: Python<'_>) -> PyResult<u64> {
        self.with(py, |inner| Ok(inner.done()))
    }

    /// Whether all steps are completed.
    #[getter]
    fn finished(&self, py: Python<'_>) -> PyResult<bool> {
        self.with(py, |inner| Ok(inner.finished()))
    }

    #[getter]
    fn cloud<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let cloud = self.with(py, |inner| Ok(inner.cloud().clone()))?;
        cloud_object(py, &cloud, false)
    }

    #[getter]
    fn stats<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let stats = self.with(py, |inner| Ok(inner.stats().clone()))?;
        stats_object(py, &stats)
    }

    // Keeps the Gaussians of a mask [N]; returns their number.
    fn prune(&self, py: Python<'_>, keep: &Bound<'_, PyAny>) -> PyResult<usize> {
        let keep = numbers::<bool>("keep", keep, &[None])?;
        self.with(py, |inner| {
            inner.keep(&keep)?;
            Ok(inner.cloud().len())
        })
    }

    fn model(&self, py: Python<'_>) -> PyResult<Model> {
        self.with(py, |inner| Ok(inner.model())).map(|model| Model::new(Ensemble::of(model)))
    }

    /// Write a checkpoint file, complete or not at all.
    fn save_checkpoint(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        if path.as_path() == Path::new("") {
            return reject(py, "path is not a file path");
        }
        self.with(py, |inner| {
            check_file_path(&path)?;
            write_atomically(&path, &inner.checkpoint())
        })
    }
}
