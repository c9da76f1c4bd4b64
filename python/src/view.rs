//! Live view of a model: the server of `pwrfgs view`, on a thread of this process.

use crate::border::{check_not_forked, run_stoppable, to_exception};
use crate::model::Model;
use crate::tasks::TaskObserver;
use pwrfgs::viewer::{PageHost, ViewPane, view as serve};
use pwrfgs_core::{Error, Result};
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{JoinHandle, spawn};

/// Interactive page of a model on a port of this machine; ``close()`` stops it, as does deleting this object.
///
/// A notebook shows the page. In a browser on this machine, open ``address``, which has a random token: other programs and
/// users of the machine cannot load the page without it.
#[pyclass(frozen, module = "pwrfgs")]
pub(crate) struct View {
    /// Address of the page.
    #[pyo3(get)]
    address: String,
    stop: Arc<AtomicBool>,
    server: Mutex<Option<JoinHandle<()>>>,
}

#[pymethods]
impl View {
    /// Stop the server and release its port; a second call has no effect.
    fn close(&self, py: Python<'_>) {
        self.stop.store(true, Ordering::Relaxed);
        let server = self.server.lock().unwrap_or_else(PoisonError::into_inner).take();
        _ = py.detach(|| server.map(JoinHandle::join));
    }

    /// Whether the server has stopped.
    #[getter]
    fn closed(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (*_exception))]
    fn __exit__(&self, py: Python<'_>, _exception: &Bound<'_, PyTuple>) {
        self.close(py);
    }

    fn __repr__(&self) -> String {
        format!("<View {}>", if self.closed() { "closed" } else { &self.address })
    }

    fn _repr_html_(&self) -> String {
        if self.closed() {
            return "<p>This view is closed.</p>".into();
        }
        let address = &self.address;
        format!(
            "<iframe src=\"{address}\" width=\"100%\" height=\"640\" style=\"border: 0\"></iframe><br>\
             <a href=\"{address}\" target=\"_blank\" rel=\"noopener\">Open in a browser tab</a>"
        )
    }
}

impl Drop for View {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Serves `panes` until `stop` is set; sends the address, or the error in its place.
fn serve_panes(panes: Vec<ViewPane>, stop: &AtomicBool, started: &Sender<Result<String>>) {
    let ready = |address: &str| _ = started.send(Ok(address.to_owned()));
    if let Err(error) = serve(panes, PageHost::Notebook, ready, stop) {
        _ = started.send(Err(error));
    }
}

/// Starts the live view of a model file, a run folder or a model, with another one or a baseline beside it. A model
/// that was loaded from a file or folder is opened from there, with the data of its run.
#[pyfunction]
#[pyo3(signature = (path, model, beside))]
pub(crate) fn view(
    py: Python<'_>,
    path: Option<PathBuf>,
    model: Option<&Bound<'_, Model>>,
    beside: Option<String>,
) -> PyResult<View> {
    check_not_forked()?;
    let models = model.map(|model| (*model.get().ensemble).clone());
    let path = path.or_else(|| model.and_then(|model| model.get().path.clone()));
    let panes = run_stoppable(py, |stop| {
        let observer = &mut TaskObserver(stop);
        let first = match (path, models) {
            (Some(path), _) => ViewPane::open(&path, observer)?,
            (None, Some(models)) => ViewPane::of_models(models),
            (None, None) => return Err(Error::Config("no model; give a run folder or a model".into())),
        };
        let second = beside.map(|beside| first.open_beside(&beside, observer)).transpose()?;
        Ok(std::iter::once(first).chain(second).collect::<Vec<_>>())
    })?;
    let (stop, (started, address)) = (Arc::new(AtomicBool::new(false)), channel());
    let flag = Arc::clone(&stop);
    let server = spawn(move || serve_panes(panes, &flag, &started));
    let stopped = || Err(Error::Config("the server of the view ended".into()));
    let address =
        py.detach(move || address.recv()).unwrap_or_else(|_| stopped()).map_err(|error| to_exception(py, error))?;
    Ok(View { address, stop, server: Mutex::new(Some(server)) })
}
