//! Single links, subsets, splits and pickling of a data set.

use super::{Dataset, inputs};
use crate::arrays::{self, ObservationShape, array, link_indices, numbers, observation_array, positions, vector};
use crate::border::{
    input_error, parse_plugin, plugin_text, reject, run_stoppable, stop_progress, to_exception, without_gil,
};
use pwrfgs_core::{
    Camera, Dataset as Data, Elevation, End, Ends, Features, Geodetic, Number, Observations, Partition, Pose, Real,
    Sample, Scene, Simulation, Spectra, Split, rng,
};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

/// Formats of spectra by name, as in NumPy.
const FORMATS: [(&str, Number); 4] =
    [("u1", Number::U8), ("u2", Number::U16), ("f4", Number::F32), ("f8", Number::F64)];

impl Dataset {
    /// Returns all observations as a read-only array, which the first call creates; `None` unless `is_requested`.
    pub(super) fn observation_view<'py>(
        &self,
        py: Python<'py>,
        is_requested: bool,
    ) -> PyResult<Option<Bound<'py, PyAny>>> {
        let convert = || {
            let array = observation_array(py, &self.data, &(0..self.data.len()).collect::<Vec<_>>())?;
            array.getattr("flags")?.setattr("writeable", false)?;
            PyResult::Ok(array.unbind())
        };
        is_requested.then(|| Ok(self.all.get_or_try_init(py, convert)?.bind(py).clone())).transpose()
    }

    /// Reads valid link indices given by a user; `name` begins messages.
    pub(crate) fn indices(&self, name: &str, links: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
        link_indices(name, links, self.data.len())
    }

    /// Returns the link `i` as the Python class `Sample`, or `ReceiverSample` of a moving receiver. Uses no thread
    /// pool, so it also works in a forked process.
    pub(super) fn link_object<'py>(&self, py: Python<'py>, i: isize) -> PyResult<Bound<'py, PyAny>> {
        let data = &self.data;
        let index = if i < 0 { i + data.len() as isize } else { i };
        let Some(index) = usize::try_from(index).ok().filter(|index| *index < data.len()) else {
            let message =
                format!("invalid link index {i} (expected {} to below {})", -(data.len() as isize), data.len());
            return Err(PyIndexError::new_err(message));
        };
        let Sample { id, pose, receiver } = data.sample(index);
        let pixels = data.image(index).pixels;
        data.observations.check().map_err(|error| to_exception(py, error))?;
        let observation = ObservationShape::of_data(data, &[]).array(py, pixels)?;
        let (class, pose) = match data.scene.moving {
            End::Transmitter => ("Sample", pose.position.to_vec()),
            End::Receiver => ("ReceiverSample", [&pose.position[..], &pose.orientation].concat()),
        };
        let width = pose.len();
        let fields = (array(py, pose, &[width])?, observation, receiver, id);
        py.import("pwrfgs._types")?.getattr(class)?.call1(fields)
    }

    /// Returns the data set of the links of a list, a mask or a slice, in ascending order. Raises an exception for a
    /// repeated link.
    pub(super) fn select_links(&self, py: Python<'_>, links: &Bound<'_, PyAny>) -> PyResult<Self> {
        let links = py.import("pwrfgs._types")?.call_method1("as_indices", (links, self.data.len()))?;
        let mut links = self.indices("links", &links)?;
        links.sort_unstable();
        if let Some([twice, _]) = links.array_windows().find(|[a, b]| a == b) {
            return reject(py, &format!("link {twice} is listed twice; list it once"));
        }
        let data = without_gil(py, || self.data.subset(&links))?;
        let subset_of = match (self.source(), &self.subset_of) {
            (Some(source), _) => Some((source, links)),
            (None, Some((source, outer))) => Some((source.clone(), links.iter().map(|&i| outer[i]).collect())),
            (None, None) => None,
        };
        Ok(Self { subset_of, ..Self::new(data, None) })
    }

    /// Returns the state for [`Self::restore`]: the source of data that stay in their file, otherwise all columns, by
    /// the keys that [`Self::restore_columns`] reads.
    pub(super) fn pickled_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (data, state) = (&self.data, PyDict::new(py));
        let is_in_file = data.observations.bytes_in_memory() == 0;
        if let Some(source) = self.source().filter(|_| is_in_file) {
            state.set_item("source", source)?;
            return Ok(state);
        }
        state.set_item("origin", self.source())?;
        state.set_item("title", &data.title)?;
        state.set_item("receivers", self.receivers(py)?)?;
        state.set_item("points", self.points(py)?)?;
        state.set_item("positions", self.positions(py)?)?;
        state.set_item("rx_pose", self.rx_pose(py)?)?;
        state.set_item("transmitter", self.transmitter(py)?)?;
        state.set_item("ids", data.samples().map(|s| s.id).collect::<Vec<_>>())?;
        state.set_item("receiver", data.samples().map(|s| s.receiver).collect::<Vec<_>>())?;
        let bounds: [[Real; 3]; 2] = data.scene.bounds.into();
        state.set_item("bounds", bounds.map(|corner| data.scene.origin.world(corner)))?;
        state.set_item("elevation", (data.elevation.first, data.elevation.last))?;
        state.set_item("placed", data.placed)?;
        let marks = data.scene.receivers.iter().map(|r| (r.is_estimated, r.is_relative));
        state.set_item("marks", marks.collect::<Vec<_>>())?;
        state.set_item("floors", &data.scene.floors)?;
        state.set_item("geodetic", data.scene.geodetic.map(|zero| (zero.latitude, zero.longitude)))?;
        state.set_item("accepted", &data.accepted)?;
        state.set_item("official", data.official.clone())?;
        // A tuple, since simulated data may have no scene.
        state.set_item("simulation", data.simulation.as_ref().map(|simulation| (simulation.scene.clone(),)))?;
        state.set_item("features", self.features(py)?)?;
        state.set_item("camera", data.camera().map(|camera| (camera.focal, camera.centre)))?;
        self.pickle_observations(&state)?;
        Ok(state)
    }

    /// Adds the observations to the `state`, from which [`pickled_observations`] reads them.
    fn pickle_observations(&self, state: &Bound<'_, PyDict>) -> PyResult<()> {
        let (py, data) = (state.py(), &self.data);
        let number = data.observations.number();
        match &data.observations {
            Observations::Spectra(spectra) => {
                let bytes = without_gil(py, || {
                    let bytes: Vec<u8> = (0..data.len()).flat_map(|i| spectra.raw(i).into_owned()).collect();
                    spectra.check().map(|()| bytes)
                })?;
                let format = FORMATS.iter().find(|(_, format)| *format == number).map_or("f4", |(name, _)| name);
                state.set_item("spectra", (PyBytes::new(py, &bytes), format, data.width, data.height))
            }
            Observations::Powers(_) => state.set_item("rssi", self.rssi(py)?),
            Observations::Channels(_) => {
                state.set_item("csi", self.csi(py)?)?;
                state.set_item("frequencies_hz", self.frequencies_hz(py)?)
            }
        }
    }

    /// Restores a data set from the state of [`Self::pickled_state`].
    pub(super) fn restore(py: Python<'_>, state: &Bound<'_, PyDict>) -> PyResult<Self> {
        if let Some(source) = state.get_item("source")? {
            let text: String = source.extract()?;
            let reader = crate::border::parse_plugin::<dyn pwrfgs_core::DataSource>(py, &text)?;
            let data = run_stoppable(py, |stop| reader.load(std::path::Path::new(""), &stop_progress(stop)))?;
            return Ok(Self::new(data, Some(text)));
        }
        Self::restore_columns(py, state)
    }

    /// Restores a data set from the columns of [`Self::pickled_state`].
    fn restore_columns(py: Python<'_>, state: &Bound<'_, PyDict>) -> PyResult<Self> {
        let get = |name: &str| state.as_any().get_item(name);
        let (ids, receiver): (Vec<u32>, Vec<usize>) = (get("ids")?.extract()?, get("receiver")?.extract()?);
        let rx_pose = get("rx_pose")?;
        let poses: Vec<Pose> = if rx_pose.is_none() {
            positions("positions", &get("positions")?)?.into_iter().map(Pose::from).collect()
        } else {
            arrays::poses("rx_pose", &rx_pose).map(|(poses, _)| poses)?
        };
        let links = ids.iter().zip(poses).zip(receiver);
        let samples: Vec<Sample> =
            links.map(|((id, pose), receiver)| Sample { receiver, ..Sample::new(*id, pose) }).collect();
        let mut receivers = inputs::read_receivers(py, Some(&get("receivers")?))?;
        let camera: Option<([f64; 2], [f64; 2])> = get("camera")?.extract()?;
        receivers[0].camera = camera.map(|(focal, centre)| Camera { focal, centre });
        let ends = if rx_pose.is_none() {
            Ends::from(receivers)
        } else {
            Ends::of_moving_receivers(receivers, get("transmitter")?.extract()?)
        };
        let points = positions("points", &get("points")?)?;
        let (first, last) = get("elevation")?.extract()?;
        let simulation: Option<(Option<String>,)> = get("simulation")?.extract()?;
        let features = pickled_features(&get("features")?, samples.len())?;
        let is_damaged = |error: &PyErr| error.is_instance_of::<pyo3::exceptions::PyKeyError>(py);
        let observations = pickled_observations(state)
            .map_err(|error| if is_damaged(&error) { input_error(py, "damaged data set") } else { error })?;
        let title: String = get("title")?.extract()?;
        let made = without_gil(py, || Data::of_links(title, ends, points, &samples, observations))?;
        let data = Data {
            scene: restore_scene(made.scene.clone(), state)?,
            elevation: Elevation { first, last },
            features,
            placed: get("placed")?.extract()?,
            accepted: get("accepted")?.extract()?,
            official: get("official")?.extract()?,
            simulation: simulation.map(|(scene,)| Simulation { scene }),
            ..made
        };
        Ok(Self::new(data, get("origin")?.extract()?))
    }
}

/// Converts a partition to the named tuple `Partition`.
pub(super) fn partition_object<'py>(py: Python<'py>, partition: &Partition) -> PyResult<Bound<'py, PyAny>> {
    let list = |set: &[usize]| vector(py, set.iter().map(|i| *i as i64).collect::<Vec<i64>>());
    let sets = (list(&partition.train)?, list(&partition.validation)?, list(&partition.test)?);
    py.import("pwrfgs._types")?.getattr("Partition")?.call1(sets)
}

/// Returns the scene with the pickled bounds, floors, geodetic zero, and marks of receivers.
fn restore_scene(mut scene: Scene, state: &Bound<'_, PyDict>) -> PyResult<Scene> {
    let get = |name: &str| state.as_any().get_item(name);
    let bounds: [[f64; 3]; 2] = get("bounds")?.extract()?;
    // The origin of a part may differ from that of the whole.
    scene.bounds = bounds.map(|corner| scene.origin.local(corner)).into();
    let marks: Vec<(bool, bool)> = get("marks")?.extract()?;
    for (receiver, marks) in scene.receivers.iter_mut().zip(marks) {
        (receiver.is_estimated, receiver.is_relative) = marks;
    }
    scene.floors = get("floors")?.extract()?;
    let geodetic: Option<(f64, f64)> = get("geodetic")?.extract()?;
    scene.geodetic = geodetic.map(|(latitude, longitude)| Geodetic { latitude, longitude });
    Ok(scene)
}

/// Returns the link features of a pickled data set with `count` links; `None` without features.
fn pickled_features(features: &Bound<'_, PyAny>, count: usize) -> PyResult<Option<Features>> {
    if features.is_none() {
        return Ok(None);
    }
    let values = numbers::<Real>("features", features, &[Some(count), None])?;
    Ok(Some(Features { width: values.len() / count.max(1), values }))
}

/// Returns the observations of a pickled data set, from its `state`.
fn pickled_observations(state: &Bound<'_, PyDict>) -> PyResult<Observations> {
    let py = state.py();
    if let Some(spectra) = state.get_item("spectra")? {
        let (bytes, format, width, height): (Vec<u8>, String, usize, usize) = spectra.extract()?;
        let number = FORMATS.iter().find(|(name, _)| *name == format).map_or(Number::F32, |(_, number)| *number);
        return Ok(Spectra::in_memory((width, height), number, bytes).map_err(|error| to_exception(py, error))?.into());
    }
    if let Some(powers) = state.get_item("rssi")? {
        return Ok(Observations::Powers(numbers::<Real>("rssi", &powers, &[None])?));
    }
    let csi = state.as_any().get_item("csi")?;
    let count = csi.len()?;
    inputs::read_channels(&csi, count, Some(&state.as_any().get_item("frequencies_hz")?))
}

/// Splits the links of `data` by a split with settings; without one, by the split of the data.
pub(super) fn split<'py>(
    py: Python<'py>,
    data: &Data,
    how: Option<&Bound<'py, PyAny>>,
    seed: u64,
    settings: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    crate::strategies::forget_objects();
    let text = match how {
        Some(how) => plugin_text("Split", how, settings)?,
        None if settings.is_some_and(|settings| !settings.is_empty()) => {
            return reject(py, "split: settings need a split name, such as split(\"random\", test=0.2)");
        }
        None => "Official()".into(),
    };
    let split = parse_plugin::<dyn Split>(py, &text)?;
    let partition = without_gil(py, || split.split(data, &mut rng::stream(seed, "split", 0)))?;
    partition_object(py, &partition)
}
