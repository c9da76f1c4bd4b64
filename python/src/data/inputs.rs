//! Validation of user arrays for a data set: receivers, spectra, powers, channels.

use crate::arrays::{self, Gain, array_shape, axis_count, input_array, numbers, positions, read_elevation};
use crate::border::{input_error, reject, replace_flags, without_gil};
use numpy::{PyArrayDyn, PyUntypedArrayMethods as _};
use pwrfgs::data::{UnlinkedNode, power_fault, real_channels_fault, shape_fault, unlinked_node};
use pwrfgs::experiment::{collect_findings, reject_findings};
use pwrfgs_core::{
    Channels, Dataset, Elevation, Error, Number, Observations, Origin, Pose, Real, Receiver, Sample, Spectra,
};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

/// Creates the exception for received powers without receiver positions.
pub(super) fn missing_receivers_error(rssi: &Bound<'_, PyAny>) -> PyResult<PyErr> {
    let shape = array_shape(rssi)?;
    let count = shape.get(1).copied().unwrap_or(1);
    let problem = format!("rssi has shape {shape:?}, but receivers is missing; pass receivers=[..] with {count} ");
    Ok(input_error(rssi.py(), &format!("{problem}position{} [x, y, z] in metres", if count == 1 { "" } else { "s" })))
}

/// Reads the poses of the moving end: positions `tx` of a transmitter, or poses of a receiver. Raises an exception unless one of
/// them is given, and for `tx` with a fixed transmitter.
pub(super) fn moving_poses(
    py: Python<'_>,
    tx: Option<&Bound<'_, PyAny>>,
    rx_pose: Option<&Bound<'_, PyAny>>,
    has_transmitter: bool,
) -> PyResult<Vec<Pose>> {
    match (tx, rx_pose) {
        (Some(tx), None) if !has_transmitter => Ok(positions("tx", tx)?.into_iter().map(Pose::from).collect()),
        (None, Some(rx_pose)) => arrays::poses("rx_pose", rx_pose).map(|(poses, _)| poses),
        _ => {
            let form = "give tx: positions [M, 3] of a transmitter that moves, or rx_pose: poses [M, 7] of a receiver that moves";
            reject(py, form)
        }
    }
}

/// Reads the receivers: one or a list of `Receiver`, or positions, whose names are `r0`, `r1` and so on; one at the
/// origin if none are given. A single receiver without a name is called `receiver`.
pub(super) fn read_receivers(py: Python<'_>, value: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<Receiver>> {
    let Some(value) = value else { return Ok(vec![Receiver::new("receiver", Pose::IDENTITY)]) };
    let class = py.import("pwrfgs._types")?.getattr("Receiver")?;
    let items: Vec<Bound<'_, PyAny>> =
        if value.is_instance(&class)? { vec![value.clone()] } else { list_items(value)? };
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
            carrier_hz: item.getattr("carrier_hz")?.extract()?,
            ..Receiver::new(item.getattr("name")?.extract::<String>()?, pose)
        })
    };
    items.iter().enumerate().map(one).collect()
}

/// Returns the items of a list of receivers.
fn list_items<'py>(value: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let form = "give a list of Receiver, or positions [R, 3] in metres";
    value.try_iter().map_err(|error| input_error(value.py(), &format!("receivers: {error}; {form}")))?.collect()
}

/// Creates the object of a receiver, with its pose in the world frame; `class` is the Python class `Receiver`.
pub(super) fn receiver_object<'py>(
    class: &Bound<'py, PyAny>,
    origin: Origin,
    receiver: &Receiver,
) -> PyResult<Bound<'py, PyAny>> {
    let (py, pose) = (class.py(), origin.world_pose(receiver.pose));
    let (position, orientation) = (PyTuple::new(py, pose.position)?, PyTuple::new(py, pose.orientation)?);
    class.call1((&receiver.name, position, orientation, receiver.antennas.clone(), receiver.carrier_hz))
}

/// Warns about valid but implausible data. If `accepted` is given, findings that make results meaningless are errors unless it
/// names them.
pub(super) fn warn_findings(py: Python<'_>, data: &Dataset, accepted: Option<&[String]>) -> PyResult<()> {
    let log = py.import("pwrfgs._log")?;
    let warn = |text| log.call_method1("warn", (text,)).map(drop);
    let findings = without_gil(py, || {
        let findings = collect_findings(data, None)?;
        accepted.map_or(Ok(()), |accepted| reject_findings(&findings, accepted)).map(|()| findings)
    })?;
    findings.iter().map(|finding| replace_flags(&finding.to_string())).try_for_each(warn)
}

/// Reads `count` spectra of one size; bytes stay bytes.
pub(super) fn read_spectra(given_spectra: &Bound<'_, PyAny>, count: usize) -> PyResult<Spectra> {
    let py = given_spectra.py();
    let shape = [Some(count), None, None];
    let size = |shape: &[usize]| (shape[2], shape[1]);
    let exception = |error: Error| crate::border::to_exception(py, error);
    if given_spectra.cast::<PyArrayDyn<u8>>().is_ok() {
        let bytes = input_array::<u8>("spectra", given_spectra, &shape)?;
        let size = size(bytes.shape());
        let bytes = bytes.as_slice().map_err(|e| input_error(py, &e.to_string()))?.to_vec();
        return Spectra::in_memory(size, Number::U8, bytes).map_err(exception);
    }
    let floats = input_array::<f32>("spectra", given_spectra, &shape)?;
    let size = size(floats.shape());
    let pixels = floats.as_slice().map_err(|e| input_error(py, &e.to_string()))?;
    Spectra::float(size, pixels).map_err(exception)
}

/// Returns the elevations of spectra, by default those of the upper half-sphere. Raises an exception for invalid elevations, and
/// if they contradict the size of the spectra.
pub(super) fn spectrum_elevation(
    py: Python<'_>,
    elevation_deg: Option<[f64; 2]>,
    observations: &Observations,
) -> PyResult<Elevation> {
    let elevation = elevation_deg.map_or(Ok(Elevation::UPPER), |angles| read_elevation(py, angles))?;
    if let Some(spectra) = observations.spectra() {
        let (size, setting) = ((spectra.width(), spectra.height()), "elevation_deg=(-90, 90) for a full sphere");
        if let Some(fault) = shape_fault(elevation, elevation_deg.is_some(), size, setting) {
            return reject(py, &format!("a spectrum {fault}"));
        }
    }
    Ok(elevation)
}

/// Reads received powers `[poses, receivers]`, dBm, or `[poses]` for one receiver, as links with their observations.
/// NaN is a missing link.
///
/// # Errors
/// Another shape, an invalid power, or a transmitter or receiver without a link.
pub(super) fn read_powers(
    rssi: &Bound<'_, PyAny>,
    poses: &[Pose],
    receivers: usize,
) -> PyResult<(Vec<Sample>, Observations)> {
    let flat = axis_count(rssi)? == 1;
    let shape: &[Option<usize>] = if flat { &[Some(poses.len())] } else { &[Some(poses.len()), Some(receivers)] };
    if flat && receivers != 1 {
        return reject(rssi.py(), &format!("rssi has one axis, but there are {receivers} receivers; give [M, R]"));
    }
    let table = numbers::<f64>("rssi", rssi, shape)?;
    let (mut samples, mut powers) = (Vec::new(), Vec::new());
    for (k, dbm) in table.iter().enumerate().filter(|(_, dbm)| !dbm.is_nan()) {
        let (i, receiver) = (k / receivers, k % receivers);
        // Checks the rounded power: a finite f64 may be infinite as `Real`.
        if let Some(fault) = power_fault(*dbm as Real as f64) {
            return reject(rssi.py(), &format!("rssi[{i}, {receiver}] {fault}"));
        }
        samples.push(Sample { receiver, ..Sample::new(i as u32, poses[i]) });
        powers.push(*dbm as Real);
    }
    let links = samples.iter().map(|sample| (sample.id as usize, sample.receiver));
    let problem = match unlinked_node(poses.len(), receivers, links) {
        None => return Ok((samples, powers.into())),
        Some(UnlinkedNode::Transmitter(i)) => {
            format!("rssi[{i}] is NaN throughout: leave the transmitter out, in tx too")
        }
        Some(UnlinkedNode::Receiver(r)) => {
            format!("rssi[:, {r}] is NaN throughout: leave the receiver out, in receivers too")
        }
    };
    reject(rssi.py(), &problem)
}

/// Reads the channels `[count, A, F]` of links, with their subcarrier frequencies `[F]`, Hz.
///
/// # Errors
/// Real numbers, another shape, or frequencies that are missing or not above 0.
pub(super) fn read_channels(
    csi: &Bound<'_, PyAny>,
    count: usize,
    frequencies_hz: Option<&Bound<'_, PyAny>>,
) -> PyResult<Observations> {
    let py = csi.py();
    let frequencies_hz =
        frequencies_hz.ok_or_else(|| input_error(py, "csi needs frequencies_hz, the subcarrier frequencies"))?;
    let frequencies_hz = numbers::<f64>("frequencies_hz", frequencies_hz, &[None])?;
    if frequencies_hz.is_empty() || !frequencies_hz.iter().all(|f| f.is_finite() && *f > 0.0) {
        return reject(py, "frequencies_hz: give one frequency above 0 Hz per subcarrier");
    }
    let array = py.import("numpy")?.call_method1("asarray", (csi,))?;
    if "fiu".contains(&array.getattr("dtype")?.getattr("kind")?.extract::<String>()?) {
        return reject(py, &format!("csi {}", real_channels_fault(&array_shape(&array)?)));
    }
    let array = input_array::<Gain>("csi", csi, &[Some(count), None, Some(frequencies_hz.len())])?;
    let antennas = array.shape()[1];
    let gains = array.as_slice().map_err(|e| input_error(py, &e.to_string()))?;
    Ok(Channels { antennas, frequencies_hz, gains: gains.iter().map(|gain| [gain.re, gain.im]).collect() }.into())
}
