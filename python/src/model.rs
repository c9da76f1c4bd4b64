//! `Model`: a trained model or an ensemble.

mod links;
pub(crate) mod made;
mod observed;

use crate::arrays::{Gain, array, plane_angles, position, vector};
use crate::border::{reject, without_gil};
use numpy::PyArrayDyn;
use pwrfgs::model::export;
use pwrfgs::model::{Ensemble, Prepared, Stages, file};
use pwrfgs::tasks::read_models;
use pwrfgs_core::files::{check_file_path, write_atomically};
use pwrfgs_core::{Activated, End, Error, Real, ShippedModel};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList, PyTuple};
use self_cell::self_cell;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

self_cell!(
    /// Models with their cached results.
    struct PreparedEnsemble {
        owner: Arc<Ensemble>,
        #[covariant]
        dependent: Prepared,
    }
);

/// Function that restores a model, and its arguments.
type Pickle<'py> = (Bound<'py, PyAny>, (Bound<'py, PyBytes>, bool));

/// Trained model: predicts the observation for a transmitter at any position. Load one with `pwrfgs.load(path)`.
///
/// Several models of one scene predict as an ensemble: the mean of their predictions. Prediction is thread-safe.
#[pyclass(frozen, module = "pwrfgs")]
pub(crate) struct Model {
    pub(crate) ensemble: Arc<Ensemble>,
    ready: OnceLock<PreparedEnsemble>,
    /// Model file, run folder or name from which it was loaded.
    pub(crate) path: Option<PathBuf>,
    /// Content of the model file, of a compressed model: its numbers have fewer bits than those in memory.
    compressed: Option<Vec<u8>>,
}

impl Model {
    /// Wraps a model or an ensemble.
    pub(crate) fn new(ensemble: Ensemble) -> Self {
        Self { ensemble: Arc::new(ensemble), ready: OnceLock::new(), path: None, compressed: None }
    }

    /// Wraps a compressed model with the content of its file.
    pub(crate) fn new_compressed(ensemble: Ensemble, bytes: Vec<u8>) -> Self {
        Self { compressed: Some(bytes), ..Self::new(ensemble) }
    }

    /// Returns the models with their cached results, which the first call computes.
    fn prepared(&self) -> &Prepared<'_> {
        let ready =
            self.ready.get_or_init(|| PreparedEnsemble::new(Arc::clone(&self.ensemble), |ensemble| ensemble.prepare()));
        ready.borrow_dependent()
    }

    /// Returns method and setup of the first member.
    fn stages(&self) -> &Stages {
        &self.ensemble.members()[0].stages
    }
}

#[pymethods]
impl Model {
    /// Load a model file, a run folder or a model of the package, such as "s23"; several form an ensemble.
    #[staticmethod]
    #[pyo3(signature = (*paths))]
    fn load(py: Python<'_>, paths: Vec<PathBuf>) -> PyResult<Self> {
        if paths.is_empty() {
            return reject(py, "path is missing; pass a model file or a run folder");
        }
        let ensemble = without_gil(py, || read_models(&paths))?;
        let absolute = |path: PathBuf| match ShippedModel::find(&path) {
            Some(_) => path,
            None => std::path::absolute(&path).unwrap_or(path),
        };
        let path = <[PathBuf; 1]>::try_from(paths).ok().map(|[path]| absolute(path));
        Ok(Self { path, ..Self::new(ensemble) })
    }

    /// Create a model of spectra at one receiver from arrays, with the names of `gaussians()`:
    ///
    /// * `means` [N, 3] and `scales` [N, 3] in metres, `quats` [N, 4] as w, x, y, z, `opacities` [N] below 1, and
    ///   `signals` [N], complex or real;
    /// * `pose`: a `Pose`, a `Receiver`, or (position [3], orientation x, y, z, w).
    ///
    /// `predict` then gives spectra [height, width]: `readout` ("Magnitude", "Power", "Real", "MinMax") of the image
    /// that `pwrfgs.rasterize` renders. Without `deformation` the spectrum is equal for all transmitters; with a
    /// network, such as an object of your class of `pwrfgs.Deformation`, it depends on the transmitter. `weights` are
    /// the weights of the network by name; default: its initial values. `tx` [M, 3] are the transmitter positions of
    /// the training set, by which predictions are marked as extrapolations.
    #[staticmethod]
    #[pyo3(signature = (means, quats, scales, opacities, signals, pose, height=90, width=360, *, projector=None,
        rasterizer=None, readout=None, deformation=None, weights=None, elevation_deg=(0.0, 90.0), tx=None))]
    #[allow(clippy::too_many_arguments)] // arguments with names, as Python has them
    fn from_arrays<'py>(
        py: Python<'py>,
        means: Bound<'py, PyAny>,
        quats: Bound<'py, PyAny>,
        scales: Bound<'py, PyAny>,
        opacities: Bound<'py, PyAny>,
        signals: Bound<'py, PyAny>,
        pose: Bound<'py, PyAny>,
        height: usize,
        width: usize,
        projector: Option<Bound<'py, PyAny>>,
        rasterizer: Option<Bound<'py, PyAny>>,
        readout: Option<Bound<'py, PyAny>>,
        deformation: Option<Bound<'py, PyAny>>,
        weights: Option<Bound<'py, PyAny>>,
        elevation_deg: (f64, f64),
        tx: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let gaussians = (means, quats, scales, opacities, signals);
        let stages = (projector, rasterizer, readout, deformation);
        let view = (pose, (height, width), elevation_deg);
        py.import("pwrfgs._arrays")?.call_method1("model", (gaussians, stages, view, weights, tx))
    }

    /// Model from the bytes of a model file, which `save` writes again if the model is compressed.
    #[staticmethod]
    #[pyo3(signature = (bytes, is_compressed=false))]
    fn _from_bytes(py: Python<'_>, bytes: &[u8], is_compressed: bool) -> PyResult<Self> {
        let ensemble = without_gil(py, || file::from_bytes(bytes).map_err(Error::Config))?;
        Ok(if is_compressed { Self::new_compressed(ensemble, bytes.to_vec()) } else { Self::new(ensemble) })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Pickle<'py>> {
        let bytes = match &self.compressed {
            Some(bytes) => PyBytes::new(py, bytes),
            None => PyBytes::new(py, &without_gil(py, || Ok(file::ensemble_to_bytes(&self.ensemble)))?),
        };
        Ok((py.get_type::<Self>().getattr("_from_bytes")?, (bytes, self.compressed.is_some())))
    }

    fn _repr_html_<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("pwrfgs._html")?.call_method1("model", (slf,))
    }

    /// Positions of the training set, thinned, [K, 3] in metres; None if they are unknown. Those of the first member of
    /// an ensemble.
    #[getter]
    fn training_positions<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        let model = &self.ensemble.members()[0];
        let Some(training) = &model.training_positions else { return Ok(None) };
        let all: Vec<f64> = training.positions().iter().flat_map(|tx| model.stages.origin.world(*tx)).collect();
        array(py, all, &[training.positions().len(), 3]).map(Some)
    }

    /// Predict the observations for transmitters at `tx`, [3] or [B, 3], metres: spectra [B, H, W] (float32, not clamped; for an
    /// ensemble the mean of spectra clamped to 0..1), powers [B, R] in dBm, or channels [B, R, A, F] (complex64). The axis B is
    /// present if `tx` has it. The axis R is present if the model has several receivers and `receiver`, a name or an index, is
    /// not given. Models of a moving receiver need its poses `rx_pose` (x, y, z, qx, qy, qz, qw), [7] or [B, 7], in place of
    /// `tx`; models of link features need `features` [B, width].
    ///
    /// With `vjp`, the gradient of a real loss in the observations (their shape; ∂/∂Re + i ∂/∂Im for channels), it gives
    /// (observations, gradient in `tx` or `rx_pose`, in its shape); the length of an orientation has no effect.
    /// A model of link features, or with a network in Python, has no gradient; the calibration `AsReleased` has none in
    /// orientations.
    ///
    /// With `interval`, such as 0.9, it gives a named tuple (prediction, lower, upper): the ends of the intervals that hold with
    /// this probability. The model needs a calibration, from a run with validation samples. Not for channels.
    ///
    /// With `batch_size`, it gives an iterator over the predictions of this many positions each, for more predictions than fit
    /// into memory: 10,000 spectra of 90 x 360 pixels are 1.3 GB, batches of 256 of them 33 MB each.
    ///
    /// Without `vjp`, a warning counts extrapolations: positions farther from all training positions than 3 times their spacing.
    #[pyo3(signature = (tx=None, receiver=None, *, rx_pose=None, features=None, vjp=None, interval=None, batch_size=None))]
    #[allow(clippy::too_many_arguments)] // arguments with names, as Python has them
    fn predict<'py>(
        slf: &Bound<'py, Self>,
        tx: Option<&Bound<'py, PyAny>>,
        receiver: Option<&Bound<'py, PyAny>>,
        rx_pose: Option<&Bound<'py, PyAny>>,
        features: Option<&Bound<'py, PyAny>>,
        vjp: Option<&Bound<'py, PyAny>>,
        interval: Option<f64>,
        batch_size: Option<usize>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (model, py) = (slf.get(), slf.py());
        let links = model.read_links(py, receiver, [tx, rx_pose, features])?;
        if vjp.is_none() {
            model.warn_of_extrapolations(py, &links)?; // a loop that descends would repeat it
        }
        match (vjp, batch_size) {
            (Some(_), Some(_)) => reject(py, "give one of vjp and batch_size"),
            (Some(_), None) if interval.is_some() => reject(py, "give one of vjp and interval"),
            (Some(cotangents), None) => model.predict_vjp(&links, cotangents),
            (None, Some(size)) => Self::start_batches(slf, links, size, interval),
            (None, None) => model.predict_links(py, &links, interval),
        }
    }

    /// Standard deviation between ensemble members, in the shape of `predict`; 0 for a single model. Large values mark
    /// unreliable predictions.
    #[pyo3(signature = (tx=None, receiver=None, *, rx_pose=None, features=None))]
    fn spread<'py>(
        &self,
        py: Python<'py>,
        tx: Option<&Bound<'py, PyAny>>,
        receiver: Option<&Bound<'py, PyAny>>,
        rx_pose: Option<&Bound<'py, PyAny>>,
        features: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let links = self.read_links(py, receiver, [tx, rx_pose, features])?;
        self.predicted_array(py, &links, |queries, numbers| {
            let count = numbers.len() / queries.len();
            for (query, numbers) in queries.iter().zip(numbers.chunks_exact_mut(count)) {
                let (_, deviation, _) = self.prepared().predict_with_deviation(*query);
                numbers.copy_from_slice(&deviation.pixels);
            }
        })
    }

    /// Gaussians in space, a named tuple of arrays: means [N, 3] (metres), quats [N, 4] (w, x, y, z), scales [N, 3]
    /// (metres), opacities [N], signals [N] (complex64). Base parameters, or deformed for a transmitter at `tx` [3],
    /// metres. `member` is the index of an ensemble member.
    #[pyo3(signature = (tx=None, member=0))]
    fn gaussians<'py>(
        &self,
        py: Python<'py>,
        tx: Option<&Bound<'py, PyAny>>,
        member: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let count = self.ensemble.members().len();
        let Some(model) = self.ensemble.members().get(member) else {
            return reject(py, &format!("invalid member index {member} (expected 0 to below {count})"));
        };
        let tx = tx.map(|tx| position("tx", tx)).transpose()?;
        let Activated { primitives, signals, .. } = without_gil(py, || Ok(model.gaussians(tx)))?;
        let (n, origin) = (primitives.len(), model.stages.origin);
        let channels = signals.len().checked_div(n).unwrap_or(2); // 1: real signals; 2: real and imaginary parts
        let signal = |pair: &[Real]| Gain::new(pair[0], pair.get(1).copied().unwrap_or(0.0));
        let signals: Vec<Gain> = signals.chunks_exact(channels.max(1)).map(signal).collect();
        let means: Vec<f64> = primitives.means.iter().flat_map(|mean| origin.world(*mean)).collect();
        let fields = (
            array(py, means, &[n, 3])?,
            array(py, primitives.quats.into_flattened(), &[n, 4])?,
            array(py, primitives.scales.into_flattened(), &[n, 3])?,
            array(py, primitives.opacities, &[n])?,
            array(py, signals, &[n])?,
        );
        py.import("pwrfgs._types")?.getattr("Gaussians")?.call1(fields)
    }

    /// Write the model file, complete or not at all; replaces an existing file. `half` stores the networks in 16-bit
    /// numbers, at half the size. A result of `compress` is stored as it is.
    #[pyo3(signature = (path, *, half=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, half: bool) -> PyResult<()> {
        without_gil(py, || {
            check_file_path(&path)?;
            match &self.compressed {
                Some(bytes) => write_atomically(&path, bytes),
                None if half => write_atomically(&path, &file::to_bytes_half(&self.ensemble)?),
                None => file::write_ensemble(&path, &self.ensemble),
            }
        })
    }

    /// Write the Gaussians as a PLY file for splat viewers: base parameters, or deformed for a transmitter at `tx` [3],
    /// metres.
    #[pyo3(signature = (path, tx=None))]
    fn to_ply(&self, py: Python<'_>, path: PathBuf, tx: Option<[f64; 3]>) -> PyResult<()> {
        without_gil(py, || {
            check_file_path(&path)?;
            write_atomically(&path, &export::ply(&self.ensemble, tx)?)
        })
    }

    /// Kind of observation: "spectrum", "power" or "channel".
    #[getter]
    fn kind(&self) -> &'static str {
        self.stages().task.name
    }

    /// End of the links that moves: "transmitter", whose positions `predict` takes as `tx`, or "receiver", whose poses it takes
    /// as `rx_pose`.
    #[getter]
    fn moving(&self) -> &'static str {
        match self.stages().setup.moving {
            End::Transmitter => "transmitter",
            End::Receiver => "receiver",
        }
    }

    /// Number of Gaussians, of all members together.
    #[getter]
    fn n(&self) -> usize {
        self.ensemble.gaussians()
    }

    /// Size of Gaussians and networks in a model file without compression, bytes.
    #[getter]
    fn bytes(&self) -> usize {
        self.ensemble.gaussian_bytes() + self.ensemble.network_bytes()
    }

    /// Names of the ensemble members.
    #[getter]
    fn members(&self) -> Vec<String> {
        self.ensemble.names().to_vec()
    }

    /// Names of the receivers.
    #[getter]
    fn receivers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        PyList::new(py, self.stages().setup.receivers.iter().map(|receiver| receiver.name.as_str()))
    }

    /// Subcarrier frequencies [F], Hz; empty unless the model predicts channels.
    #[getter]
    fn frequencies_hz<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        vector(py, self.stages().setup.frequencies_hz.clone())
    }

    /// Angles of the rows and columns of a spectrum, degrees: (elevations [H], azimuths [W]); None for other
    /// observations.
    #[getter]
    fn angles_deg<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        plane_angles(py, &self.stages().plane)
    }

    fn __repr__(&self) -> String {
        let members = if self.ensemble.members().len() > 1 {
            format!("{} members, ", self.ensemble.members().len())
        } else {
            String::new()
        };
        format!("<Model: {}{} Gaussians, predicts a {}>", members, self.n(), self.kind())
    }
}
