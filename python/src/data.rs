//! `Dataset`: data in and out.

use crate::arrays::{Gain, array, axes, complex, given, numbers, places};
use crate::border::{free, wrong};
use crate::settings::{plugin, text_of};
use numpy::PyArrayDyn;
use numpy::PyReadonlyArrayDyn;
use pwrfgs::data::{save, source_in};
use pwrfgs_core::{
    Channels, DataSource, Dataset as Data, Elevation, Error, Kind, Number, Observations, Partition, Plugin, Pose, Real,
    Receiver, Sample, Simulation, Spectra, Split, rng,
};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

/// Transmitters, receivers, and what was observed of each link of one with the other.
///
/// Load one with `Dataset.load(path)`, or make one with `Dataset.from_arrays(...)`. Its length is the number of links L,
/// one a transmitter where there is one receiver.
#[pyclass(frozen, module = "pwrfgs")]
pub(crate) struct Dataset {
    pub(crate) data: Arc<Data>,
    /// What reads it, as RON; none until it is saved.
    source: Mutex<Option<String>>,
}

/// Takes data apart into NumPy's arrays, link by link.
pub(crate) fn observed<'py>(py: Python<'py>, data: &Data, links: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let count = links.len();
    match &data.observations {
        Observations::Pictures(spectra) => {
            let shape = [count, spectra.height(), spectra.width()];
            let all = free(py, || Ok(links.iter().flat_map(|&i| data.image(i).pixels).collect::<Vec<Real>>()))?;
            array(py, all, &shape).map(Bound::into_any)
        }
        Observations::Powers(powers) => {
            array(py, links.iter().map(|&i| powers[i]).collect::<Vec<Real>>(), &[count]).map(Bound::into_any)
        }
        Observations::Channels(channels) => {
            let gains: Vec<Gain> = links.iter().flat_map(|&i| complex(channels.of(i))).collect();
            array(py, gains, &[count, channels.antennas, channels.frequencies_hz.len()]).map(Bound::into_any)
        }
    }
}

impl Dataset {
    pub(crate) fn new(data: Data, source: Option<String>) -> Self {
        Self { data: Arc::new(data), source: Mutex::new(source) }
    }

    fn all_of<'py>(&self, py: Python<'py>, kind: Kind) -> PyResult<Option<Bound<'py, PyAny>>> {
        if self.data.kind() != kind {
            return Ok(None);
        }
        observed(py, &self.data, &(0..self.data.len()).collect::<Vec<_>>()).map(Some)
    }
}

#[pymethods]
impl Dataset {
    /// Reads a folder of data, in any layout that the command line knows, or what a data source such as
    /// `pwrfgs.Nerf2Spectrum(root="data/s23")` or `pwrfgs.Simulated(...)` gives.
    #[staticmethod]
    fn load(py: Python<'_>, source: &Bound<'_, PyAny>) -> PyResult<Self> {
        let path: Result<PathBuf, _> = source.extract();
        let (text, reader): (String, Plugin<dyn DataSource>) = if let Ok(path) = path {
            let there = py.import("os.path")?.call_method1("abspath", (&path,))?.extract::<PathBuf>()?;
            if !there.is_dir() {
                let what = "there is no such folder; a data source such as pwrfgs.Arrays(root=..) is given as a value";
                return Err(crate::border::raised(py, Error::input(&path, what)));
            }
            let Some((_, _, reader)) = source_in(&there) else {
                let what = "holds no data of a layout that is known; docs/data.md says which there are, and \
                            Dataset.from_arrays takes arrays";
                return Err(crate::border::raised(py, Error::input(&path, what)));
            };
            let reader = Plugin::from(reader);
            (pwrfgs_core::plugin::to_ron(&reader), reader)
        } else {
            let text = text_of("DataSource", source, None)?;
            let reader = plugin::<dyn DataSource>(py, &text)?;
            (text, reader)
        };
        let data = free(py, || reader.load(std::path::Path::new(""), &|_, _| {}))?;
        Ok(Self::new(data, Some(text)))
    }

    /// A data set of one's own arrays. Give one of the three:
    ///
    /// * `spectra` [M, H, W]: spatial spectra from 0 to 1 (or bytes of 0 to 255) at one receiver; rows are elevations,
    ///   columns azimuths that go once around.
    /// * `rssi` [M, R]: received powers in dBm; NaN where a receiver heard nothing.
    /// * `csi` [M, A, F]: channels at one receiver with A antennas, whose places its `Receiver(antennas=..)` has, and F
    ///   subcarriers of `frequencies_hz` [F] (evenly spaced and rising, if they are to be saved).
    ///
    /// `tx` [M, 3] are the transmitters' positions in metres. `receivers` is a list of `Receiver`, or of positions [R, 3];
    /// one at the origin where it is left out. `points` [P, 3] are surface points of the room. Say `simulated=True` of what
    /// was not measured.
    #[staticmethod]
    #[pyo3(signature = (tx, spectra=None, rssi=None, csi=None, *, receivers=None, frequencies_hz=None, points=None, elevation_deg=[0.0, 90.0], title="arrays", simulated=false))]
    #[allow(clippy::too_many_arguments)] // arguments with names, as Python has them
    fn from_arrays(
        py: Python<'_>,
        tx: &Bound<'_, PyAny>,
        spectra: Option<&Bound<'_, PyAny>>,
        rssi: Option<&Bound<'_, PyAny>>,
        csi: Option<&Bound<'_, PyAny>>,
        receivers: Option<&Bound<'_, PyAny>>,
        frequencies_hz: Option<&Bound<'_, PyAny>>,
        points: Option<&Bound<'_, PyAny>>,
        elevation_deg: [f64; 2],
        title: &str,
        simulated: bool,
    ) -> PyResult<Self> {
        let txs = places("tx", tx)?;
        let points = points.map_or(Ok(Vec::new()), |points| places("points", points))?;
        let receivers = receivers_of(py, receivers)?;
        let first = u32::from(spectra.is_some());
        let sample = |(i, tx): (usize, &[f64; 3])| Sample::new(i as u32 + first, *tx);
        let alone: Vec<Sample> = txs.iter().enumerate().map(sample).collect();
        let (samples, observations) = match (spectra, rssi, csi) {
            (Some(_), None, None) | (None, None, Some(_)) if receivers.len() != 1 => {
                let what = "spectra and csi are those of one receiver";
                return Err(wrong(py, &format!("{what}, and there are {}; make a data set of each", receivers.len())));
            }
            (Some(spectra), None, None) => (alone, Observations::from(pictures(spectra, txs.len())?)),
            (None, Some(rssi), None) => heard(rssi, &txs, receivers.len())?,
            (None, None, Some(csi)) => (alone, gains(csi, txs.len(), frequencies_hz)?),
            _ => return Err(wrong(py, "give one of spectra, rssi and csi")),
        };
        check_antennas(py, &observations, &receivers)?;
        warn_of_milliwatts(py, &observations)?;
        let elevation = Elevation { first: elevation_deg[0], last: elevation_deg[1] };
        let made = Data::of_links(title, receivers, points, &samples, observations);
        let data = made.map_err(|error| crate::border::raised(py, error))?;
        let simulation = simulated.then(Simulation::default);
        if let Some(fault) = elevation.fault() {
            return Err(wrong(py, &format!("elevation_deg {fault}")));
        }
        Ok(Self::new(Data { elevation, simulation, ..data }, None))
    }

    /// Writes a new folder that `Dataset.load` and the command line read: spectra as arrays, powers and channels in the
    /// layouts of NeRF2's BLE set and of `pwrfgs simulate`. A folder that holds anything is not touched.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let out: PathBuf = py.import("os.path")?.call_method1("abspath", (&path,))?.extract()?;
        let text =
            free(py, || save(&self.data, &out).map(|source| pwrfgs_core::plugin::to_ron(&Plugin::from(source))))?;
        *self.source.lock().unwrap_or_else(PoisonError::into_inner) = Some(text);
        Ok(())
    }

    /// What a pipeline reads it by, as RON: where it was loaded from, or saved to.
    #[getter]
    fn _source(&self) -> Option<String> {
        self.source.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn __len__(&self) -> usize {
        self.data.len()
    }

    fn __repr__(&self) -> String {
        let several = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
        format!(
            "<Dataset {:?}: {}, {}, {}, {}>",
            self.data.title,
            pwrfgs::experiment::observed(&self.data),
            several(self.data.transmitters.len(), "transmitter"),
            several(self.data.scene.receivers.len(), "receiver"),
            if self.data.is_simulated() { "simulated" } else { "measured" }
        )
    }

    /// What the data call themselves.
    #[getter]
    fn title(&self) -> &str {
        &self.data.title
    }

    /// "spectrum", "power" or "channel".
    #[getter]
    fn kind(&self) -> &'static str {
        kind_name(self.data.kind())
    }

    /// Whether they were computed, not measured.
    #[getter]
    fn simulated(&self) -> bool {
        self.data.is_simulated()
    }

    /// Where the transmitter of each link stood, [L, 3] float64, metres.
    #[getter]
    fn tx<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        array(py, self.data.samples().flat_map(|s| s.tx).collect(), &[self.data.len(), 3])
    }

    /// The number that the data give the transmitter of each link, [L].
    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<u32>>> {
        array(py, self.data.samples().map(|s| s.id).collect(), &[self.data.len()])
    }

    /// Which receiver heard each link, [L]: places in `receivers`.
    #[getter]
    fn receiver<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<i64>>> {
        array(py, self.data.samples().map(|s| s.receiver as i64).collect(), &[self.data.len()])
    }

    /// The receivers.
    #[getter]
    fn receivers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let class = py.import("pwrfgs._types")?.getattr("Receiver")?;
        let origin = self.data.scene.origin;
        let one = |receiver: &Receiver| {
            let Pose { position, orientation } = origin.world_pose(receiver.pose);
            class.call1((&receiver.name, tuple(py, &position)?, tuple(py, &orientation)?, receiver.antennas.clone()))
        };
        PyList::new(py, self.data.scene.receivers.iter().map(one).collect::<PyResult<Vec<_>>>()?)
    }

    /// Spatial spectra [L, H, W], float32 from 0 to 1; None where something else was observed.
    #[getter]
    fn spectra<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.all_of(py, Kind::Spectrum)
    }

    /// Received powers [L], dBm; None where something else was observed.
    #[getter]
    fn rssi<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.all_of(py, Kind::Power)
    }

    /// Channels [L, A, F], complex64; None where something else was observed.
    #[getter]
    fn csi<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.all_of(py, Kind::Channel)
    }

    /// Frequencies of the subcarriers of channels [F], Hz; None where something else was observed.
    #[getter]
    fn frequencies_hz<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<f64>>>> {
        let Observations::Channels(channels) = &self.data.observations else { return Ok(None) };
        let all = channels.frequencies_hz.clone();
        let count = all.len();
        array(py, all, &[count]).map(Some)
    }

    /// What was observed of these links: a picture [H, W], a power or a channel [A, F] each.
    fn observations<'py>(&self, py: Python<'py>, links: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        observed(py, &self.data, &self.indices("links", links)?)
    }

    /// What stands where the transmitter's position stands elsewhere, [L, width]; None where it is the position.
    #[getter]
    fn features<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArrayDyn<Real>>>> {
        let features = self.data.features.as_ref();
        features.map(|own| array(py, own.values.clone(), &[self.data.len(), own.width])).transpose()
    }

    /// Surface points of the room [P, 3], metres; P is 0 where none are known.
    #[getter]
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let scene = &self.data.scene;
        let all: Vec<f64> = scene.points.iter().flat_map(|point| scene.origin.world(*point)).collect();
        array(py, all, &[scene.points.len(), 3])
    }

    /// Degrees of the rows and of the columns of a spectrum: (elevations [H], azimuths [W]); None of anything else.
    #[getter]
    fn angles_deg<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyTuple>>> {
        angles(py, &self.data.plane())
    }

    /// Divides the links: a named tuple (train, validation, test) of sorted places, disjoint. `how` is a split such as
    /// `pwrfgs.Voxel(size_m=0.2)`, or its name with settings: `split("voxel", size_m=0.2)`.
    #[pyo3(signature = (how=None, *, seed=0, **settings))]
    fn split<'py>(
        &self,
        py: Python<'py>,
        how: Option<&Bound<'py, PyAny>>,
        seed: u64,
        settings: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        crate::strategies::forget();
        let text = match how {
            Some(how) => text_of("Split", how, settings)?,
            None => "Official()".into(),
        };
        let split = plugin::<dyn Split>(py, &text)?;
        let partition = free(py, || split.split(&self.data, &mut rng::stream(seed, "split", 0)))?;
        parts(py, &partition)
    }
}

impl Dataset {
    /// Places of links that a user names, each of which is there.
    pub(crate) fn indices(&self, what: &str, links: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
        let count = self.data.len();
        if let Ok(mask) = numbers::<bool>(what, links, &[Some(count)]) {
            return Ok((0..count).filter(|&i| mask[i]).collect());
        }
        let all = numbers::<i64>(what, links, &[None])?;
        let fits = |i: i64| usize::try_from(i).ok().filter(|i| *i < count);
        let wanted: Option<Vec<usize>> = all.iter().map(|i| fits(*i)).collect();
        wanted.ok_or_else(|| {
            let bad = all.iter().find(|i| fits(**i).is_none()).copied().unwrap_or_default();
            wrong(links.py(), &format!("{what}: there is no link {bad}; there are {count}, counted from 0"))
        })
    }
}

/// A partition as the named tuple `Split`.
fn parts<'py>(py: Python<'py>, partition: &Partition) -> PyResult<Bound<'py, PyAny>> {
    let list = |part: &[usize]| array(py, part.iter().map(|i| *i as i64).collect::<Vec<i64>>(), &[part.len()]);
    let all = (list(&partition.train)?, list(&partition.validation)?, list(&partition.test)?);
    py.import("pwrfgs._types")?.getattr("Partition")?.call1(all)
}

/// As Python calls a kind.
pub(crate) fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Spectrum => "spectrum",
        Kind::Power => "power",
        Kind::Channel => "channel",
    }
}

/// Degrees of rows and columns.
pub(crate) fn angles<'py>(py: Python<'py>, plane: &pwrfgs_core::ImagePlane) -> PyResult<Option<Bound<'py, PyTuple>>> {
    let Some((azimuth, elevation)) = plane.angles else { return Ok(None) };
    let degrees = |axis: pwrfgs_core::Axis, n: usize| (0..n).map(|i| axis.first + i as f64 * axis.step).collect();
    let rows = array::<f64>(py, degrees(elevation, plane.height), &[plane.height])?;
    let columns = array::<f64>(py, degrees(azimuth, plane.width), &[plane.width])?;
    PyTuple::new(py, [rows, columns]).map(Some)
}

fn tuple<'py>(py: Python<'py>, numbers: &[f64]) -> PyResult<Bound<'py, PyTuple>> {
    PyTuple::new(py, numbers)
}

/// What a user says of receivers.
fn receivers_of(py: Python<'_>, given: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Receiver>> {
    let Some(given) = given else { return Ok(vec![Receiver::new("receiver", Pose::IDENTITY)]) };
    let class = py.import("pwrfgs._types")?.getattr("Receiver")?;
    let items: Vec<Bound<'_, PyAny>> = if given.is_instance(&class)? { vec![given.clone()] } else { listed(given)? };
    let one = |(i, item): (usize, &Bound<'_, PyAny>)| {
        if !item.is_instance(&class)? {
            let position = numbers::<f64>("a receiver", item, &[Some(3)])?;
            let pose = Pose { position: [position[0], position[1], position[2]], ..Pose::IDENTITY };
            return Ok(Receiver::new(if items.len() == 1 { "receiver".into() } else { format!("r{i}") }, pose));
        }
        let pose = Pose {
            position: item.getattr("position")?.extract()?,
            orientation: item.getattr("orientation")?.extract()?,
        };
        Ok(Receiver {
            antennas: item.getattr("antennas")?.extract()?,
            ..Receiver::new(item.getattr("name")?.extract::<String>()?, pose)
        })
    };
    items.iter().enumerate().map(one).collect()
}

fn listed<'py>(given: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let form = "give a list of Receiver, or places [R, 3] in metres";
    given.try_iter().map_err(|error| wrong(given.py(), &format!("receivers: {error}; {form}")))?.collect()
}

/// Refuses channels of other antennas than the receiver has: what is learned rests on where they are.
fn check_antennas(py: Python<'_>, observations: &Observations, receivers: &[Receiver]) -> PyResult<()> {
    let (Observations::Channels(channels), [receiver]) = (observations, receivers) else { return Ok(()) };
    let (given, placed) = (channels.antennas, receiver.antennas.len());
    if given == placed {
        return Ok(());
    }
    let what = format!(
        "csi has {given} antennas, and the receiver has {placed}; say where they are: \
         receivers=[Receiver(position=(x, y, z), antennas=[(0, 0, 0), ..])], {given} places in metres, in its own frame"
    );
    Err(wrong(py, &what))
}

/// Who hears nothing but more than a milliwatt has likely given milliwatts.
fn warn_of_milliwatts(py: Python<'_>, observations: &Observations) -> PyResult<()> {
    let Observations::Powers(powers) = observations else { return Ok(()) };
    if powers.is_empty() || powers.iter().any(|dbm| *dbm < 0.0) {
        return Ok(());
    }
    let text = "every power is 0 dBm or more, which is a milliwatt; of powers in mW give 10 * log10(mW)";
    py.import("warnings")?.call_method1("warn", (text, py.get_type::<PyUserWarning>(), 2)).map(drop)
}

/// Spectra as they are given: bytes stay bytes.
fn pictures(given_spectra: &Bound<'_, PyAny>, count: usize) -> PyResult<Spectra> {
    let py = given_spectra.py();
    let shape = [Some(count), None, None];
    let bytes: Option<PyReadonlyArrayDyn<'_, u8>> = given_spectra
        .cast::<PyArrayDyn<u8>>()
        .ok()
        .map(|_| given::<u8>("spectra", given_spectra, &shape))
        .transpose()?;
    let said = |error: Error| crate::border::raised(py, error);
    if let Some(bytes) = bytes {
        let size = bytes.shape_of();
        let bytes = bytes.as_slice().map_err(|e| wrong(py, &e.to_string()))?.to_vec();
        return Spectra::in_memory(size, Number::U8, bytes).map_err(said);
    }
    let floats = given::<f32>("spectra", given_spectra, &shape)?;
    let size = floats.shape_of();
    let pixels = floats.as_slice().map_err(|e| wrong(py, &e.to_string()))?;
    if let Some(i) = pixels.iter().position(|v| !(-1e-6..=1.000_001).contains(v)) {
        let of_one = size.0 * size.1;
        let (s, r, c) = (i / of_one, i % of_one / size.0, i % size.0);
        return Err(wrong(py, &format!("spectra[{s}, {r}, {c}] is {}; give amplitudes from 0 to 1", pixels[i])));
    }
    Spectra::float(size, pixels).map_err(said)
}

/// Columns and rows of a stack of pictures.
trait ShapeOf {
    fn shape_of(&self) -> (usize, usize);
}

impl<T: numpy::Element> ShapeOf for PyReadonlyArrayDyn<'_, T> {
    fn shape_of(&self) -> (usize, usize) {
        use numpy::PyUntypedArrayMethods as _;
        (self.shape()[2], self.shape()[1])
    }
}

/// Links of whoever was heard, and their powers.
fn heard(rssi: &Bound<'_, PyAny>, txs: &[[f64; 3]], receivers: usize) -> PyResult<(Vec<Sample>, Observations)> {
    let flat = axes(rssi)? == 1;
    let shape: &[Option<usize>] = if flat { &[Some(txs.len())] } else { &[Some(txs.len()), Some(receivers)] };
    if flat && receivers != 1 {
        return Err(wrong(rssi.py(), &format!("rssi has one axis, and there are {receivers} receivers; give [M, R]")));
    }
    let all = numbers::<f64>("rssi", rssi, shape)?;
    let (mut samples, mut powers) = (Vec::new(), Vec::new());
    for (k, dbm) in all.iter().enumerate().filter(|(_, dbm)| !dbm.is_nan()) {
        let i = k / receivers;
        samples.push(Sample { id: i as u32, tx: txs[i], receiver: k % receivers });
        powers.push(*dbm as Real);
    }
    Ok((samples, Observations::Powers(powers)))
}

/// Channels with their subcarriers.
fn gains(csi: &Bound<'_, PyAny>, count: usize, frequencies_hz: Option<&Bound<'_, PyAny>>) -> PyResult<Observations> {
    let py = csi.py();
    let frequencies_hz =
        frequencies_hz.ok_or_else(|| wrong(py, "csi wants frequencies_hz, those of its subcarriers"))?;
    let frequencies_hz = numbers::<f64>("frequencies_hz", frequencies_hz, &[None])?;
    if frequencies_hz.is_empty() || !frequencies_hz.iter().all(|f| f.is_finite() && *f > 0.0) {
        return Err(wrong(py, "frequencies_hz: give Hz above 0, one a subcarrier"));
    }
    let all = given::<Gain>("csi", csi, &[Some(count), None, Some(frequencies_hz.len())])?;
    let antennas = {
        use numpy::PyUntypedArrayMethods as _;
        all.shape()[1]
    };
    let gains = all.as_slice().map_err(|e| wrong(py, &e.to_string()))?;
    Ok(Observations::Channels(Channels {
        antennas,
        frequencies_hz,
        gains: gains.iter().map(|gain| [gain.re, gain.im]).collect(),
    }))
}
