//! Validation of data sets from folders, `import` or arrays in memory, and of frequencies.

use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::{Dataset, Elevation, Error, Real, Receiver, Result, Spectra, carrier_fault};
use rayon::prelude::*;
use std::path::Path;

/// Tolerance for spectrum values outside 0 to 1, due to rounding.
pub(crate) const ROUNDING: f64 = 1e-6;
/// Cell of a table of powers for a link without a signal, in folders that declare nothing else, dBm.
pub(crate) const NOT_RECEIVED: f64 = -100.0;
/// Largest plausible absolute power, dBm; larger values have another unit.
const LARGEST_DBM: f64 = 300.0;
/// Longest receiver name, characters.
const LONGEST_NAME: usize = 100;

/// Returns an error for a data set whose values, receivers or links could not be read back from a folder. Some others have no
/// layout, such as images of a camera: [`save`](crate::save()) rejects these.
///
/// # Errors
/// [`Error::Config`] for such a data set, with the problem and the next step.
pub fn check_dataset(data: &Dataset) -> Result<()> {
    dataset_fault(data).map_or(Ok(()), |fault| Err(Error::Config(format!("data set `{}`: {fault}", data.title))))
}

/// Returns the first problem with the values, the receivers or the links of a data set; `None` if they could be read back.
fn dataset_fault(data: &Dataset) -> Option<String> {
    let receivers = &data.scene.receivers;
    let links = data.links.iter().map(|link| (link.location, link.receiver));
    let spectra = data.observations.spectra();
    // The first fault, independent of the number of threads.
    let value = |spectra: &Spectra| (0..spectra.len()).into_par_iter().find_map_first(|i| spectrum_fault(spectra, i));
    let spectrum = spectra.and_then(|spectra| elevation_fault(data).or_else(|| value(spectra)));
    let fault = |(i, dbm): (usize, &Real)| Some(format!("powers[{i}] {}", power_fault(*dbm as f64)?));
    let power = || data.observations.powers()?.iter().enumerate().find_map(fault);
    let name = receivers.iter().find_map(|receiver| name_fault(&receiver.name));
    let unlinked = || Some(unlinked_node(data.locations.len(), receivers.len(), links)?.describe(receivers));
    spectrum.or_else(power).or(name).or_else(|| antenna_fault(data)).or_else(unlinked)
}

/// Transmitter or receiver without any link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnlinkedNode {
    /// Index of the transmitter, counted from 0.
    Transmitter(usize),
    /// Index of the receiver, counted from 0.
    Receiver(usize),
}

impl UnlinkedNode {
    /// Describes the problem that the node is unlinked, with the next step.
    fn describe(self, receivers: &[Receiver]) -> String {
        match self {
            Self::Transmitter(i) => format!("no receiver received transmitter {i}; leave it out"),
            Self::Receiver(i) => {
                format!("receiver {} received no transmitter; leave it out", quoted(&receivers[i].name))
            }
        }
    }
}

/// Returns the first transmitter without a link, else the first receiver without one; `None` if all have links. `links` are
/// (transmitter, receiver) pairs of indices below the two numbers.
pub fn unlinked_node(
    transmitters: usize,
    receivers: usize,
    links: impl IntoIterator<Item = (usize, usize)>,
) -> Option<UnlinkedNode> {
    let (mut sends, mut receives) = (vec![false; transmitters], vec![false; receivers]);
    links.into_iter().for_each(|(transmitter, receiver)| (sends[transmitter], receives[receiver]) = (true, true));
    let unlinked = |nodes: &[bool]| nodes.iter().position(|has_link| !has_link);
    unlinked(&sends).map(UnlinkedNode::Transmitter).or_else(|| unlinked(&receives).map(UnlinkedNode::Receiver))
}

/// Returns the problem with a received power in dBm that is NaN or beyond 300 in size; `None` if it is valid.
pub fn power_fault(dbm: f64) -> Option<String> {
    (dbm.is_nan() || dbm.abs() > LARGEST_DBM).then(|| format!("is {dbm}, no power in dBm; give dBm"))
}

/// Returns the problem if the elevations of spectra do not suit their `size`, width and height in pixels; `None` if they
/// do. `stated`: the elevations are set; otherwise, the advice is to set them, such as `setting`. The text begins with `is`:
/// the caller names the spectrum.
pub fn shape_fault(elevation: Elevation, stated: bool, size: (usize, usize), setting: &str) -> Option<String> {
    // Elongated pixels are plausible if stated; otherwise the rows probably cover another range of elevations.
    let factor = if stated { 4.0 } else { 1.75 }; // also in the docs of `Nerf2Spectrum`
    let misfit = elevation.misfit(size, factor)?;
    let (width, height) = size;
    let is_transposed = height > width && elevation.misfit((height, width), factor).is_none();
    let advice = match (is_transposed, stated) {
        (true, _) => "rows are elevations and columns are azimuths: save s.transpose(0, 2, 1)".into(),
        (false, true) => "correct `elevation`, or resample the spectra".into(),
        (false, false) => format!("set the elevations of the top and bottom edge, such as {setting}"),
    };
    Some(format!("{misfit}; {advice}"))
}

/// Returns the problem with the elevations of spectra; `None` if they are valid, and for images of a camera.
fn elevation_fault(data: &Dataset) -> Option<String> {
    if data.camera().is_some() {
        return None;
    }
    let size = (data.width, data.height);
    let misfit = || shape_fault(data.elevation, true, size, "").map(|fault| format!("a spectrum {fault}"));
    data.elevation.fault().or_else(misfit)
}

/// Returns whether a value of a spectrum is linear: from 0 to 1, up to rounding.
pub fn is_linear(value: f64) -> bool {
    (-ROUNDING..=1.0 + ROUNDING).contains(&value)
}

/// Returns the problem with spectrum `i`, its first value outside 0 to 1; `None` if it is valid, as integers always are.
pub(crate) fn spectrum_fault(spectra: &Spectra, i: usize) -> Option<String> {
    if !spectra.number().is_float() {
        return None;
    }
    let (mut pixel, mut invalid) = (0, None);
    spectra.number().for_each_value(&spectra.raw(i), |value| {
        if !is_linear(value) && invalid.is_none() {
            invalid = Some((pixel, value));
        }
        pixel += 1;
    });
    let (pixel, value) = invalid?;
    let (row, column) = (pixel / spectra.width(), pixel % spectra.width());
    let advice = "spectra are linear, from 0 to 1: `pwrfgs import` brings others into shape";
    Some(format!("spectra[{i}, {row}, {column}] is {value}; {advice}"))
}

/// Returns the problem with a receiver name that cannot head a column: empty or too long, with quotes or control
/// characters, or with blanks at its ends; `None` if it is valid.
pub(crate) fn name_fault(name: &str) -> Option<String> {
    let fits =
        strip_control(name) == name && !name.is_empty() && !name.contains('"') && name.chars().count() <= LONGEST_NAME;
    let valid = "characters without quotes, control characters or blanks at the ends";
    (!fits).then(|| format!("receiver name {} is invalid; use 1 to {LONGEST_NAME} {valid}", quoted(name)))
}

/// Returns the problem with the first receiver whose antennas do not match the observations; `None` if all match, and for
/// spectra.
fn antenna_fault(data: &Dataset) -> Option<String> {
    let (antennas, is_scalar) = (data.observations.antennas()?, data.task().is_scalar);
    let advice = if is_scalar {
        "a power is received by one antenna at the position of the receiver"
    } else {
        "give the position of each in the receiver's frame, metres"
    };
    let receiver = data.scene.receivers.iter().find(|receiver| {
        let is_displaced = is_scalar && receiver.antennas.iter().any(|position| *position != [0.0; 3]);
        receiver.antennas.len() != antennas || is_displaced
    })?;
    let (name, count) = (quoted(&receiver.name), receiver.antennas.len());
    let observations = data.task().plural;
    Some(format!("the {observations} have {antennas} antennas, and receiver {name} has {count}; {advice}"))
}

/// Returns the frequencies of the `count` subcarriers of the array at `path`, evenly spaced about the carrier, Hz. Returns
/// an error if a frequency would not be above 0, or if there are several and the spacing is missing (NaN) or not above 0.
pub(crate) fn uniform_subcarriers(path: &Path, carrier_hz: f64, spacing_hz: f64, count: usize) -> Result<Vec<f64>> {
    let middle = (count as f64 - 1.0) / 2.0;
    if count > 1 && (spacing_hz.is_nan() || spacing_hz <= 0.0) {
        let problem = format!("has {count} subcarriers, but `spacing_hz` is missing");
        return Err(Error::input(path, format!("{problem}; set the subcarrier spacing in Hz")));
    }
    let offset = |i: usize| if count > 1 { (i as f64 - middle) * spacing_hz } else { 0.0 };
    let frequencies: Vec<f64> = (0..count).map(|i| carrier_hz + offset(i)).collect();
    match frequencies.first() {
        Some(lowest) if *lowest <= 0.0 => {
            let problem = format!("has {count} subcarriers, of which the lowest would be at {lowest} Hz");
            Err(Error::input(path, format!("{problem}; correct `carrier_hz` or `spacing_hz`")))
        }
        _ => Ok(frequencies),
    }
}

/// Returns an error unless the carrier is from 1e6 to 1e12 Hz and the subcarrier spacing finite and above 0 Hz.
pub(crate) fn check_frequencies(carrier_hz: f64, spacing_hz: f64) -> Result<(), String> {
    if let Some(fault) = carrier_fault(carrier_hz) {
        return Err(format!("`carrier_hz`: {fault}"));
    }
    if !(spacing_hz.is_finite() && spacing_hz > 0.0) {
        return Err(format!("`spacing_hz` is {spacing_hz}; give Hz above 0, such as 312500"));
    }
    Ok(())
}
