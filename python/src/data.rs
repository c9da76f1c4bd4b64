//! `Dataset`: data sets in Python.

mod inputs;
mod rows;
mod stored;
mod table;

use crate::arrays::{array, numbers, observation_array, plane_angles, positions, vector};
use crate::border::{parse_plugin, plugin_text, reject, run_stoppable, stop_progress, to_exception, without_gil};
use numpy::PyArrayDyn;
use pwrfgs::data::{check_dataset, save};
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{
    DataSource, Dataset as Data, End, Ends, Error, Observations, Plugin, Pose, Real, Receiver, Sample, Simulation,
    recognise,
};
use pyo3::IntoPyObjectExt as _;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyList, PyTuple};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Transmitters, receivers, and the observation of each link.
///
/// Load one with `Dataset.load(path)`, or create one with `Dataset.from_arrays(...)`. Its length is the number of links
/// L: one per transmitter if there is one receiver.
#[pyclass(frozen, weakref, module = "pwrfgs")]
pub(crate) struct Dataset {
    pub(crate) data: Arc<Data>,
    /// Data source as RON; `None` until it is saved.
    source: Mutex<Option<String>>,
    /// Source and link indices of the data set of which this is a part; `None` if it has no source.
    subset_of: Option<(String, Vec<usize>)>,
    /// Read-only array of all observations, once it has been requested.
    all: PyOnceLock<Py<PyAny>>,
    /// Digest of the content, once it has been requested.
    digest: PyOnceLock<String>,
}

impl Dataset {
    /// Wraps a data set; `source` is its data source as RON, if it has one.
    pub(crate) fn new(data: Data, source: Option<String>) -> Self {
        let (all, digest) = (PyOnceLock::new(), PyOnceLock::new());
        Self { data: Arc::new(data), source: Mutex::new(source), subset_of: None, all, digest }
    }
}

#[pymethods]
impl Dataset {
    /// Load a data folder in any layout of the command line, or a data source such as
    /// `pwrfgs.Nerf2Spectrum(root="data/s23")` or `pwrfgs.Simulated(...)`.
    #[staticmethod]
    fn load(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<Self> {
        let path: Result<PathBuf, _> = source.extract();
        let (text, reader): (String, Plugin<dyn DataSource>) = if let Ok(path) = path {
            let folder = py.import("os.path")?.call_method1("abspath", (&path,))?.extract::<PathBuf>()?;
            if !folder.is_dir() {
                let problem = "no such folder; pass a data source such as pwrfgs.Arrays(root=..) as a value";
                return Err(to_exception(py, Error::input(&path, problem)));
            }
            let Some(reader) = recognise(&folder) else {
                let problem = "no data of a known layout; see docs/data.md, or use Dataset.from_arrays for arrays";
                return Err(to_exception(py, Error::input(&path, problem)));
            };
            (to_ron(&reader), reader)
        } else {
            let text = plugin_text("DataSource", source, None)?;
            let reader = parse_plugin::<dyn DataSource>(py, &text)?;
            (text, reader)
        };
        let data = run_stoppable(py, |stop| reader.load(Path::new(""), &stop_progress(stop)))?;
        inputs::warn_findings(py, &data, None)?;
        Ok(Self::new(data, Some(text)))
    }

    /// Create a data set from arrays. Give one of the three:
    ///
    /// * `spectra` [M, H, W]: spatial spectra from 0 to 1 (or bytes of 0 to 255) at one receiver; rows are elevations,
    ///   columns azimuths that go once around.
    /// * `rssi` [M, R]: received powers in dBm at R `receivers`; NaN for a missing link. Every row and column needs a
    ///   power.
    /// * `csi` [M, A, F]: channels at one receiver with A antennas, whose positions are in `Receiver(antennas=..)`, and
    ///   F subcarriers of `frequencies_hz` [F].
    ///
    /// `tx` [M, 3] are the transmitter positions in metres. `receivers` is a list of `Receiver`, or of positions [R, 3]; `rssi`
    /// needs it, and the default for other observations is one receiver at the origin. If the receiver moves instead, `rx_pose`
    /// [M, 7] are its poses (metres, and a quaternion: x, y, z, qx, qy, qz, qw), `transmitter` [3] is the position of the fixed
    /// transmitter, if it is known, and the positions of `receivers` are ignored. `carriers_hz` [M] are the carriers of spectra
    /// or channels at one receiver: each carrier then is a receiver, with a name such as `2400MHz`. `points` [P, 3] are surface
    /// points of the room. `elevation_deg` are the elevations of the upper edge of the top row and the lower edge of the bottom
    /// row of spectra, (0, 90) by default. Set `simulated=True` for data that were not measured; the title then says so.
    #[staticmethod]
    #[pyo3(signature = (tx=None, spectra=None, rssi=None, csi=None, *, rx_pose=None, transmitter=None, receivers=None,
        carriers_hz=None, frequencies_hz=None, points=None, elevation_deg=None, title="arrays", simulated=false))]
    #[allow(clippy::too_many_arguments)] // arguments with names, as Python has them
    fn from_arrays(
        py: Python<'_>,
        tx: Option<&Bound<'_, PyAny>>,
        spectra: Option<&Bound<'_, PyAny>>,
        rssi: Option<&Bound<'_, PyAny>>,
        csi: Option<&Bound<'_, PyAny>>,
        rx_pose: Option<&Bound<'_, PyAny>>,
        transmitter: Option<[f64; 3]>,
        receivers: Option<&Bound<'_, PyAny>>,
        carriers_hz: Option<&Bound<'_, PyAny>>,
        frequencies_hz: Option<&Bound<'_, PyAny>>,
        points: Option<&Bound<'_, PyAny>>,
        elevation_deg: Option<[f64; 2]>,
        title: &str,
        simulated: bool,
    ) -> PyResult<Self> {
        let poses = inputs::moving_poses(py, tx, rx_pose, transmitter.is_some())?;
        let points = points.map_or(Ok(Vec::new()), |points| positions("points", points))?;
        let has_receivers = receivers.is_some() || rx_pose.is_some();
        let receivers = inputs::read_receivers(py, receivers)?;
        let first_id = u32::from(spectra.is_some()); // ids of spectra count from 1, as in files of spectra
        let sample = |(i, pose): (usize, &Pose)| Sample::new(i as u32 + first_id, *pose);
        let links: Vec<Sample> = poses.iter().enumerate().map(sample).collect();
        let (samples, observations) = match (spectra, rssi, csi) {
            (Some(_), None, None) | (None, None, Some(_)) if receivers.len() != 1 => {
                let problem = format!("spectra and csi need one receiver, but there are {}", receivers.len());
                return reject(py, &format!("{problem}; create one data set per receiver"));
            }
            (Some(spectra), None, None) => (links, Observations::from(inputs::read_spectra(spectra, poses.len())?)),
            (None, Some(rssi), None) if !has_receivers => return Err(inputs::missing_receivers_error(rssi)?),
            (None, Some(rssi), None) => inputs::read_powers(rssi, &poses, receivers.len())?,
            (None, None, Some(csi)) => (links, inputs::read_channels(csi, poses.len(), frequencies_hz)?),
            _ => return reject(py, "give one of spectra, rssi and csi"),
        };
        for (name, is_given, is_used, kind) in [
            ("elevation_deg", elevation_deg.is_some(), spectra.is_some(), "spectra"),
            ("frequencies_hz", frequencies_hz.is_some(), csi.is_some(), "csi"),
        ] {
            if is_given && !is_used {
                return reject(py, &format!("{name}: only valid for {kind}; remove it"));
            }
        }
        let elevation = inputs::spectrum_elevation(py, elevation_deg, &observations)?;
        let carriers = carriers_hz.map(|all| numbers::<f64>("carriers_hz", all, &[None])).transpose()?;
        let simulation = simulated.then(Simulation::default);
        let ends = match rx_pose {
            None => Ends::from(receivers),
            Some(_) => Ends::of_moving_receivers(receivers, transmitter),
        };
        let data = without_gil(py, || {
            let data = Data::of_links(title, ends, points, &samples, observations)?;
            let data = Data { elevation, simulation, ..data };
            let data = Data { title: data.marked_title(), ..data };
            let data = if let Some(carriers) = carriers { data.with_carriers(&carriers)? } else { data };
            check_dataset(&data).map(|()| data)
        })?;
        inputs::warn_findings(py, &data, None)?;
        Ok(Self::new(data, None))
    }

    /// Create a data set from a table of received powers with positions: a pandas `DataFrame`, the path of a file (CSV, TSV,
    /// with gzip or not), or a list of these, whose rows follow each other. Rows are readings, or transmitters with a column per
    /// receiver. Columns are recognised by their names; pass the name of one to choose it. The options are those of `pwrfgs
    /// import --table`:
    ///
    /// * `x`, `y`, `z`, or `lat`, `lon`, `floor`, `receiver`, `power`, `time`, `tx_id`: names of columns. `receiver` can also be
    ///   the name of the only receiver.
    /// * `columns`: the columns of the receivers, a list of names in which `*` stands for any text.
    /// * `tx`, `places`, `receivers`, `test`: tables of positions row by row, of named places, of receivers, and of the test set.
    /// * `missing`: values that mean "not received". Empty cells and NaN always do.
    /// * `unit`: "dBm", "positive-dBm", "percent", "dB:FLOOR", "mW" or "W".
    /// * `lat_lon`: positions are degrees. `height` (metres, where there is none) and `floor_height`.
    /// * `title`, `simulated`.
    /// * `accept`: names of findings that are right, such as `["lone-value"]`. Others that make results meaningless are errors.
    ///
    /// What was understood is logged to the logger `pwrfgs` at level INFO.
    #[staticmethod]
    #[pyo3(signature = (table, **options))]
    #[pyo3(
        text_signature = "(table, *, x=None, y=None, z=None, lat=None, lon=None, floor=None, receiver=None, power=None, \
                          time=None, tx_id=None, columns=None, tx=None, places=None, receivers=None, test=None, \
                          missing=None, unit='dBm', lat_lon=False, height=None, floor_height=None, title='table', \
                          simulated=False, accept=())"
    )]
    fn from_table(table: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let data = table::read(table, options)?;
        inputs::warn_findings(table.py(), &data, Some(&data.accepted))?;
        Ok(Self::new(data, None))
    }

    /// Pose of a moving receiver in each link [L, 7]: x, y, z in metres, quaternion qx, qy, qz, qw; None for fixed receivers.
    #[getter]
    fn rx_pose<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        if self.data.scene.moving == End::Transmitter {
            return Ok(None);
        }
        let row = |Pose { position: [x, y, z], orientation: [qx, qy, qz, qw] }| [x, y, z, qx, qy, qz, qw];
        array(py, self.data.samples().flat_map(|sample| row(sample.pose)).collect(), &[self.data.len(), 7]).map(Some)
    }

    /// Position [3] of the fixed transmitter of a moving receiver, metres; None if it is unknown or moves.
    #[getter]
    fn transmitter<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        let scene = &self.data.scene;
        let world = |position: [f64; 3]| scene.origin.world_pose(position.into()).position;
        scene.transmitter.map(|position| array(py, world(position).to_vec(), &[3])).transpose()
    }

    /// Write a new folder for `Dataset.load` and the command line: spectra as arrays, powers and channels in the
    /// layouts of NeRF2's BLE set and of `pwrfgs simulate`. IDs, title and bounds of the room are kept in `ids.txt` and
    /// `manifest.json`, which other programs ignore. A folder that is not empty is an error.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let out: PathBuf = py.import("os.path")?.call_method1("abspath", (&path,))?.extract()?;
        let text = without_gil(py, || save(&self.data, &out).map(|source| to_ron(&Plugin::from(source))))?;
        *self.source.lock().unwrap_or_else(PoisonError::into_inner) = Some(text);
        Ok(())
    }

    /// Write the data of a run to the new folder `path`, unless an earlier call has; returns their source as RON.
    #[pyo3(name = "_store")]
    fn store(&self, py: Python<'_>, path: PathBuf) -> PyResult<String> {
        without_gil(py, || self.write_for_run(&path))
    }

    /// Data source as RON, from which it was loaded or to which it was saved; `None` for data made in memory.
    #[getter(_source)]
    pub(crate) fn source(&self) -> Option<String> {
        self.source.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// First 16 digits of the SHA-256 of the content.
    #[getter(_digest)]
    fn digest(&self, py: Python<'_>) -> PyResult<String> {
        self.digest.get_or_try_init(py, || without_gil(py, || stored::digest_of(&self.data))).cloned()
    }

    fn __len__(&self) -> usize {
        self.data.len()
    }

    /// Link `index` as a named tuple (tx [3], observation, receiver, id); a slice, a list of links or a mask gives a
    /// data set of these links, as `subset` does.
    fn __getitem__<'py>(slf: &Bound<'py, Self>, index: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let (py, dataset) = (slf.py(), slf.get());
        match index.extract::<isize>() {
            Ok(i) => dataset.link_object(py, i),
            Err(_) => dataset.select_links(py, index)?.into_bound_py_any(py),
        }
    }

    /// Iterate over the links.
    fn __iter__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let builtins = slf.py().import("builtins")?;
        let indices = builtins.call_method1("range", (slf.len()?,))?;
        builtins.call_method1("map", (slf.getattr("__getitem__")?, indices))
    }

    /// Data set of these links: indices, or a mask [L]. The order is that of this data set. IDs, receivers and bounds of
    /// the room stay those of all links.
    fn subset(&self, py: Python<'_>, links: &Bound<'_, PyAny>) -> PyResult<Self> {
        self.select_links(py, links)
    }

    #[staticmethod]
    fn _restore(py: Python<'_>, state: &Bound<'_, PyDict>) -> PyResult<Self> {
        Self::restore(py, state)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyDict>,))> {
        Ok((py.get_type::<Self>().getattr("_restore")?, (self.pickled_state(py)?,)))
    }

    fn _repr_html_<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        slf.py().import("pwrfgs._html")?.call_method1("dataset", (slf,))
    }

    fn __repr__(&self) -> String {
        let several = |n: usize, noun: &str| format!("{n} {noun}{}", if n == 1 { "" } else { "s" });
        let moves = self.data.scene.moving.is_receiver();
        format!(
            "<Dataset {:?}: {}, {}, {}, {}>",
            self.data.title,
            pwrfgs::experiment::describe_observations(&self.data),
            several(self.data.locations.len(), if moves { "receiver pose" } else { "transmitter" }),
            several(self.data.scene.receivers.len(), "receiver"),
            if self.data.is_simulated() { "simulated" } else { "measured" }
        )
    }

    /// Title of the data set.
    #[getter]
    fn title(&self) -> &str {
        &self.data.title
    }

    /// Kind of observation: "spectrum", "power" or "channel".
    #[getter]
    fn kind(&self) -> &'static str {
        self.data.task().name
    }

    /// Whether the data are simulated.
    #[getter]
    fn simulated(&self) -> bool {
        self.data.is_simulated()
    }

    /// Transmitter position of each link, [L, 3] float64, metres. Raises an error if the receiver moves: see `rx_pose`.
    #[getter]
    fn tx<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        if self.data.scene.moving.is_receiver() {
            return reject(py, "tx: the receiver of these data moves; use rx_pose [L, 7] or positions [L, 3]");
        }
        self.positions(py)
    }

    /// Position of the end that moves in each link, [L, 3] float64, metres: of the transmitter, or of the receiver.
    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        array(py, self.data.samples().flat_map(|s| s.position()).collect(), &[self.data.len(), 3])
    }

    /// Id of the transmitter position, or of the pose of a moving receiver, of each link, [L].
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u32>>> {
        vector(py, self.data.samples().map(|s| s.id).collect())
    }

    /// Receiver index of each link, [L], into `receivers`.
    #[getter]
    fn receiver<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        vector(py, self.data.samples().map(|s| s.receiver as i64).collect())
    }

    /// The receivers.
    #[getter]
    fn receivers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let class = py.import("pwrfgs._types")?.getattr("Receiver")?;
        let origin = self.data.scene.origin;
        let one = |receiver: &Receiver| inputs::receiver_object(&class, origin, receiver);
        PyList::new(py, self.data.scene.receivers.iter().map(one).collect::<PyResult<Vec<_>>>()?)
    }

    /// Spatial spectra [L, H, W], float32 from 0 to 1, as a read-only view of one array, which the first access
    /// creates; None for other observations.
    #[getter]
    fn spectra<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.observation_view(py, self.data.observations.spectra().is_some())
    }

    /// Received powers [L], dBm, as a read-only view; None for other observations.
    #[getter]
    fn rssi<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.observation_view(py, self.data.observations.powers().is_some())
    }

    /// Channels [L, A, F], complex64, as a read-only view; None for other observations.
    #[getter]
    fn csi<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.observation_view(py, self.data.observations.channels().is_some())
    }

    /// Subcarrier frequencies of channels [F], Hz; None for other observations.
    #[getter]
    fn frequencies_hz<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        let Some(channels) = self.data.observations.channels() else { return Ok(None) };
        vector(py, channels.frequencies_hz.clone()).map(Some)
    }

    /// Observations of these links: a spectrum [H, W], a power or a channel [A, F] each.
    fn observations<'py>(&self, py: Python<'py>, links: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        observation_array(py, &self.data, &self.indices("links", links)?)
    }

    /// Link features that replace the transmitter position, [L, width]; None without features.
    #[getter]
    fn features<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<Real>>>> {
        let features = self.data.features.as_ref();
        features.map(|features| array(py, features.values.clone(), &[self.data.len(), features.width])).transpose()
    }

    /// Surface points of the room [P, 3], metres; P is 0 if none are known.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let scene = &self.data.scene;
        let all: Vec<f64> = scene.points.iter().flat_map(|point| scene.origin.world(*point)).collect();
        array(py, all, &[scene.points.len(), 3])
    }

    /// Angles of the rows and columns of a spectrum, degrees: (elevations [H], azimuths [W]); None for other
    /// observations.
    #[getter]
    fn angles_deg<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        plane_angles(py, &self.data.plane())
    }

    /// Split the links: a named tuple (train, validation, test) of sorted, disjoint link indices. `how` is a split such
    /// as `pwrfgs.Voxel(size_m=0.2)`, or its name with settings: `split("voxel", size_m=0.2)`; without it, the split of
    /// the data.
    #[pyo3(signature = (how=None, *, seed=0, **settings))]
    fn split<'py>(
        &self,
        py: Python<'py>,
        how: Option<&Bound<'py, PyAny>>,
        seed: u64,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        rows::split(py, &self.data, how, seed, settings)
    }
}
