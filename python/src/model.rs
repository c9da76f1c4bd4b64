//! `Model`: a trained model, or several that predict together.

use crate::arrays::{Gain, array, axes, numbers, observations, place, places, room};
use crate::border::{LOOK, carried, free, wrong};
use crate::data::angles;
use numpy::PyArrayDyn;
use pwrfgs::model::export;
use pwrfgs::model::{Ensemble, Prepared, Stages, file};
use pwrfgs_core::files::{check_file_place, write_atomically};
use pwrfgs_core::{Activated, Error, Frame, Query, Real, Result};
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};
use rayon::prelude::*;
use self_cell::self_cell;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

/// Links of one call of the library: as many as its own groups hold, so that what they gave is still in cache.
const CHUNK: usize = 16;

self_cell!(
    /// Models, and what they worked out once.
    struct Ready {
        owner: Arc<Ensemble>,
        #[covariant]
        dependent: Prepared,
    }
);

/// A trained model: predicts what is observed of a transmitter anywhere. Load one with `Model.load(path)`.
///
/// Several models of one scene predict as an ensemble: the mean of what they say. Two threads may predict at once.
#[pyclass(frozen, module = "pwrfgs")]
pub(crate) struct Model {
    ensemble: Arc<Ensemble>,
    ready: OnceLock<Ready>,
}

/// Which links a call is about.
struct Links {
    txs: Vec<[f64; 3]>,
    features: Vec<Real>,
    receivers: Vec<usize>,
    /// The axes before those of an observation.
    lead: Vec<usize>,
}

impl Links {
    fn query(&self, k: usize) -> Query<'_> {
        let (i, receiver) = (k / self.receivers.len(), self.receivers[k % self.receivers.len()]);
        let width = self.features.len() / self.txs.len().max(1);
        Query { tx: self.txs[i], receiver, features: &self.features[i * width..][..width] }
    }
}

impl Model {
    pub(crate) fn new(ensemble: Ensemble) -> Self {
        Self { ensemble: Arc::new(ensemble), ready: OnceLock::new() }
    }

    fn prepared(&self) -> &Prepared<'_> {
        let ready = self.ready.get_or_init(|| Ready::new(Arc::clone(&self.ensemble), |own| own.prepare()));
        ready.borrow_dependent()
    }

    fn stages(&self) -> &Stages {
        &self.ensemble.members()[0].stages
    }

    /// What a call asks for.
    fn links(
        &self,
        py: Python<'_>,
        tx: Option<&Bound<'_, PyAny>>,
        receiver: Option<&Bound<'_, PyAny>>,
        features: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Links> {
        let (stages, there) = (self.stages(), &self.stages().frame.receivers);
        let inputs = stages.method.traits().inputs;
        let (txs, features, one) = match (tx, features) {
            (Some(tx), None) if inputs == 3 => {
                let one = axes(tx)? == 1;
                let txs = if one { vec![place("tx", tx)?] } else { places("tx", tx)? };
                (txs, Vec::new(), one)
            }
            (None, Some(features)) if inputs != 3 => {
                let one = axes(features)? == 1;
                let shape: &[Option<usize>] = if one { &[Some(inputs)] } else { &[None, Some(inputs)] };
                let all = numbers::<Real>("features", features, shape)?;
                (vec![[0.0; 3]; all.len() / inputs], all, one)
            }
            _ if inputs == 3 => return Err(wrong(py, "give tx, positions [B, 3] in metres")),
            _ => {
                return Err(wrong(
                    py,
                    &format!("this model knows transmitters by features; give features=[B, {inputs}]"),
                ));
            }
        };
        let mut lead = if one { vec![] } else { vec![txs.len()] };
        let receivers = match receiver {
            Some(receiver) => vec![self.find(receiver)?],
            None if there.len() == 1 => vec![0],
            None => {
                lead.push(there.len());
                (0..there.len()).collect()
            }
        };
        Ok(Links { txs, features, receivers, lead })
    }

    /// A receiver by its name or its place.
    fn find(&self, receiver: &Bound<'_, PyAny>) -> PyResult<usize> {
        let (py, there) = (receiver.py(), &self.stages().frame.receivers);
        if let Ok(name) = receiver.extract::<String>() {
            return there.iter().position(|own| own.name == name).ok_or_else(|| {
                let hint = pwrfgs_core::did_you_mean(&name, there.iter().map(|own| own.name.as_str()));
                wrong(py, &format!("there is no receiver `{name}`{hint}"))
            });
        }
        let place: usize = receiver.extract()?;
        if place < there.len() {
            return Ok(place);
        }
        Err(wrong(py, &format!("there is no receiver {place}; there are {}, counted from 0", there.len())))
    }

    /// An array of the kind that the model predicts; `work` fills the numbers of a chunk, one observation after the other.
    fn observed<'py>(
        &self,
        py: Python<'py>,
        links: &Links,
        work: impl Fn(&[Query<'_>], &mut [Real]) + Send,
    ) -> PyResult<Bound<'py, PyAny>> {
        let Frame { plane, task, .. } = &self.stages().frame;
        let (size, lead) = ((plane.width, plane.height), &links.lead);
        room::<Real>(&[&lead[..], &[size.0 * size.1]].concat())?;
        let all = free(py, || {
            let mut all = vec![0.0; lead.iter().product::<usize>() * size.0 * size.1];
            self.fill(links, &mut all, work).map(|()| all)
        })?;
        if lead.is_empty() && task.is_scalar {
            return Ok(all[0].into_pyobject(py)?.into_any());
        }
        observations(py, *task, size, lead, all)
    }

    /// `all` in chunks, and what is not finite refused.
    fn fill(&self, links: &Links, all: &mut [Real], work: impl Fn(&[Query<'_>], &mut [Real])) -> Result<()> {
        let of_each = self.stages().plane.width * self.stages().plane.height;
        let mut looked = Instant::now();
        for (chunk, numbers) in all.chunks_mut(CHUNK * of_each).enumerate() {
            let queries: Vec<Query<'_>> =
                (0..numbers.len() / of_each).map(|k| links.query(chunk * CHUNK + k)).collect();
            work(&queries, numbers);
            if looked.elapsed() > LOOK {
                #[allow(clippy::redundant_closure_for_method_calls)] // the method itself is of one lifetime
                Python::attach(|py| py.check_signals()).map_err(carried)?;
                looked = Instant::now();
            }
            // Without a way out in its middle the loop is done by vectors.
            let finite = |numbers: &[Real]| numbers.iter().fold(true, |all, v| all & v.is_finite());
            if let Some(k) = numbers.par_chunks_exact(of_each).position_first(|own| !finite(own)) {
                return Err(Error::Config(format!(
                    "what is predicted for a transmitter at {:?} is not finite: numbers of the model overflow there; \
                     leave the position out if it is far from all that the model has seen",
                    queries[k].tx
                )));
            }
        }
        Ok(())
    }
}

#[pymethods]
impl Model {
    /// Reads a model file, or a run folder; several together are an ensemble.
    #[staticmethod]
    #[pyo3(signature = (*paths))]
    fn load(py: Python<'_>, paths: Vec<PathBuf>) -> PyResult<Self> {
        let read = || {
            let mut members = Vec::new();
            for path in &paths {
                let file_in =
                    if path.is_dir() { path.join(pwrfgs::experiment::folder::MODEL_FILE) } else { path.clone() };
                let ensemble = file::read_ensemble(&file_in)?;
                let called = |(name, model): (&String, &pwrfgs::model::Model)| {
                    let alone = ensemble.members().len() == 1;
                    (
                        if alone { path.display().to_string() } else { format!("{}/{name}", path.display()) },
                        model.clone(),
                    )
                };
                members.extend(ensemble.names().iter().zip(ensemble.members()).map(called));
            }
            Ensemble::named(members).and_then(Ensemble::distinct).map_err(Error::Config)
        };
        if paths.is_empty() {
            return Err(wrong(py, "give the path of a model or of a run folder"));
        }
        free(py, read).map(Self::new)
    }

    /// What is observed of transmitters at `tx`, [3] or [B, 3], metres: spectra [B, H, W] (float32, not clamped; of an
    /// ensemble the mean of pictures clamped to 0..1), powers [B, R] in dBm, or channels [B, R, A, F] (complex64). The axis B
    /// is there where `tx` has it, and R where the model knows several receivers and none is named by `receiver`, a name or
    /// a place. A model that knows transmitters by features wants `features` [B, width] in place of `tx`.
    #[pyo3(signature = (tx=None, receiver=None, *, features=None))]
    fn predict<'py>(
        &self,
        py: Python<'py>,
        tx: Option<&Bound<'py, PyAny>>,
        receiver: Option<&Bound<'py, PyAny>>,
        features: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let links = self.links(py, tx, receiver, features)?;
        // One alone as the command line does it, many in groups that share their work: the same bits.
        self.observed(py, &links, |queries, numbers| match queries {
            [query] => numbers.copy_from_slice(&self.prepared().predict_timed(*query).0.pixels),
            queries => self.prepared().predict_into(queries, numbers),
        })
    }

    /// How far the members of an ensemble differ there: the standard deviation of every number, in the shape of
    /// `predict`; 0 for one model alone. Do not trust a prediction where it is large.
    #[pyo3(signature = (tx=None, receiver=None, *, features=None))]
    fn spread<'py>(
        &self,
        py: Python<'py>,
        tx: Option<&Bound<'py, PyAny>>,
        receiver: Option<&Bound<'py, PyAny>>,
        features: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let links = self.links(py, tx, receiver, features)?;
        self.observed(py, &links, |queries, numbers| {
            let of_each = numbers.len() / queries.len();
            for (query, numbers) in queries.iter().zip(numbers.chunks_exact_mut(of_each)) {
                numbers.copy_from_slice(&self.prepared().predict_with_deviation(*query).1.pixels);
            }
        })
    }

    /// The Gaussians in space, a named tuple of arrays: means [N, 3] (metres), quats [N, 4] (w, x, y, z), scales [N, 3]
    /// (metres), opacities [N], signals [N] (complex64). Of the base parameters, or as they are for a transmitter at `tx`.
    #[pyo3(signature = (tx=None, member=0))]
    fn gaussians<'py>(
        &self,
        py: Python<'py>,
        tx: Option<&Bound<'py, PyAny>>,
        member: usize,
    ) -> PyResult<Bound<'py, PyAny>> {
        let count = self.ensemble.members().len();
        let Some(model) = self.ensemble.members().get(member) else {
            return Err(wrong(py, &format!("there is no member {member}; there are {count}, counted from 0")));
        };
        let tx = tx.map(|tx| place("tx", tx)).transpose()?;
        let Activated { primitives, signals, .. } = free(py, || Ok(model.gaussians(tx)))?;
        let (n, origin) = (primitives.len(), model.stages.origin);
        let channels = signals.len().checked_div(n).unwrap_or(2);
        let signal = |own: &[Real]| Gain::new(own[0], own.get(1).copied().unwrap_or(0.0));
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

    /// Writes the model file, whole or not at all, in the place of one that is there; with `half` the networks in 16-bit
    /// numbers, which halves it.
    #[pyo3(signature = (path, *, half=false))]
    fn save(&self, py: Python<'_>, path: PathBuf, half: bool) -> PyResult<()> {
        free(py, || {
            check_file_place(&path)?;
            if half {
                return write_atomically(&path, &file::to_bytes_half(&self.ensemble)?);
            }
            file::write_ensemble(&path, &self.ensemble)
        })
    }

    /// Writes the Gaussians as a PLY file that splat viewers open, as they are for a transmitter at `tx`.
    #[pyo3(signature = (path, tx=None))]
    fn to_ply(&self, py: Python<'_>, path: PathBuf, tx: Option<[f64; 3]>) -> PyResult<()> {
        free(py, || {
            check_file_place(&path)?;
            write_atomically(&path, &export::ply(&self.ensemble, tx)?)
        })
    }

    /// "spectrum", "power" or "channel".
    #[getter]
    fn kind(&self) -> &'static str {
        self.stages().task.name
    }

    /// Gaussians, of all members together.
    #[getter]
    fn n(&self) -> usize {
        self.ensemble.gaussians()
    }

    /// Bytes of the model file's numbers.
    #[getter]
    fn bytes(&self) -> usize {
        self.ensemble.gaussian_bytes() + self.ensemble.network_bytes()
    }

    /// What the members are called, of an ensemble.
    #[getter]
    fn members(&self) -> Vec<String> {
        self.ensemble.names().to_vec()
    }

    /// Names of the receivers.
    #[getter]
    fn receivers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        PyList::new(py, self.stages().frame.receivers.iter().map(|receiver| receiver.name.as_str()))
    }

    /// Frequencies of the subcarriers [F], Hz; empty but for channels.
    #[getter]
    fn frequencies_hz<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let all = self.stages().frame.frequencies_hz.clone();
        let count = all.len();
        array(py, all, &[count])
    }

    /// Degrees of the rows and of the columns of a spectrum: (elevations [H], azimuths [W]); None of anything else.
    #[getter]
    fn angles_deg<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        angles(py, &self.stages().plane)
    }

    fn __repr__(&self) -> String {
        let several = if self.ensemble.members().len() > 1 {
            format!("{} members, ", self.ensemble.members().len())
        } else {
            String::new()
        };
        format!("<Model: {}{} Gaussians, predicts a {}>", several, self.n(), self.kind())
    }
}
