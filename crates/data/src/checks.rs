//! Validation of data sets from folders, `import` or arrays in memory. A data set that passes [`check`] can be saved
//! and read back unchanged.

use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::{Dataset, Elevation, Error, Real, Receiver, Result, Spectra};
use rayon::prelude::*;
use std::path::Path;

/// Tolerance for spectrum values outside 0 to 1, due to rounding.
pub(crate) const ROUNDING: f64 = 1e-6;
/// Entry of a power table if no signal was received, dBm.
pub(crate) const NOT_RECEIVED: f64 = -100.0;
/// Largest plausible absolute power, dBm; larger values have another unit.
const LARGEST_DBM: f64 = 300.0;
/// Longest receiver name, characters.
const LONGEST_NAME: usize = 100;

/// Returns an error for a data set that [`save`](crate::save()) cannot write or that could not be read back.
///
/// # Errors
/// [`Error::Config`] with the problem and the next step.
pub fn check(data: &Dataset) -> Result<()> {
    fault(data).map_or(Ok(()), |what| Err(Error::Config(format!("data set `{}`: {what}", data.title))))
}

fn fault(data: &Dataset) -> Option<String> {
    let receivers = &data.scene.receivers;
    let links = data.links.iter().map(|link| (link.location, link.receiver));
    let spectra = data.observations.spectra();
    let of_spectra = spectra.and_then(|spectra| elevation_fault(data).or_else(|| first_value_fault(spectra)));
    let fault = |(i, dbm): (usize, &Real)| Some(format!("powers[{i}] {}", power_fault(*dbm as f64)?));
    let of_powers = || data.observations.powers()?.iter().enumerate().find_map(fault);
    let name = receivers.iter().find_map(|receiver| name_fault(&receiver.name));
    let silent = || Some(unlinked_node(data.locations.len(), receivers.len(), links)?.words(receivers));
    of_spectra.or_else(of_powers).or(name).or_else(|| antennas_fault(data)).or_else(silent)
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
    fn words(self, receivers: &[Receiver]) -> String {
        match self {
            Self::Transmitter(i) => format!("no receiver received transmitter {i}; leave it out"),
            Self::Receiver(i) => {
                format!("receiver {} received no transmitter; leave it out", quoted(&receivers[i].name))
            }
        }
    }
}

/// The first transmitter without a link, else the first receiver without one; `links` are (transmitter, receiver)
/// pairs.
pub fn unlinked_node(
    transmitters: usize,
    receivers: usize,
    links: impl IntoIterator<Item = (usize, usize)>,
) -> Option<UnlinkedNode> {
    let (mut sends, mut receives) = (vec![false; transmitters], vec![false; receivers]);
    links.into_iter().for_each(|(transmitter, receiver)| (sends[transmitter], receives[receiver]) = (true, true));
    let missing = |all: &[bool]| all.iter().position(|has_link| !has_link);
    missing(&sends).map(UnlinkedNode::Transmitter).or_else(|| missing(&receives).map(UnlinkedNode::Receiver))
}

/// Problem with a received power, dBm.
pub fn power_fault(dbm: f64) -> Option<String> {
    if dbm == NOT_RECEIVED {
        let what = "marks a missing link in a power table";
        return Some(format!("is {dbm} dBm, which {what}; leave the link out, or give -99.99 if it was measured"));
    }
    (dbm.is_nan() || dbm.abs() > LARGEST_DBM).then(|| format!("is {dbm}, no power in dBm; give dBm"))
}

/// Problem with the elevations and the size of spectra; `say` is the setting for elevations that are not `stated`, with
/// an example.
pub fn shape_fault(elevation: Elevation, stated: bool, (width, height): (usize, usize), say: &str) -> Option<String> {
    let factor = if stated { 4.0 } else { 1.75 };
    let what = elevation.misfit((width, height), factor)?;
    let turned = height > width && elevation.misfit((height, width), factor).is_none();
    let advice = match (turned, stated) {
        (true, _) => "rows are elevations and columns are azimuths: save s.transpose(0, 2, 1)".into(),
        (false, true) => "correct `elevation`, or resample the spectra".into(),
        (false, false) => {
            format!("set the elevations of the top and bottom edge, such as {say}")
        }
    };
    Some(format!("{what}; {advice}"))
}

fn elevation_fault(data: &Dataset) -> Option<String> {
    if data.camera().is_some() {
        return None;
    }
    let size = (data.width, data.height);
    let misfit = || shape_fault(data.elevation, true, size, "").map(|what| format!("a spectrum {what}"));
    data.elevation.fault().or_else(misfit)
}

/// Whether a value of a spectrum is from 0 to 1, up to rounding.
pub fn is_linear(value: f64) -> bool {
    (-ROUNDING..=1.0 + ROUNDING).contains(&value)
}

/// Problem with spectrum `i`: the first value outside 0 to 1.
pub(crate) fn value_fault(spectra: &Spectra, i: usize) -> Option<String> {
    if !spectra.number().is_float() {
        return None;
    }
    let (mut at, mut wrong) = (0, None);
    spectra.number().each(&spectra.raw(i), |v| {
        if !is_linear(v) && wrong.is_none() {
            wrong = Some((at, v));
        }
        at += 1;
    });
    let (at, value) = wrong?;
    let (row, column) = (at / spectra.width(), at % spectra.width());
    let what = "spectra are linear, from 0 to 1: `pwrfgs import` brings others into shape";
    Some(format!("spectra[{i}, {row}, {column}] is {value}; {what}"))
}

fn first_value_fault(spectra: &Spectra) -> Option<String> {
    (0..spectra.len()).into_par_iter().find_map_first(|i| value_fault(spectra, i))
}

/// Problem with a receiver name: not usable as a column heading, or control characters.
pub(crate) fn name_fault(name: &str) -> Option<String> {
    let fits =
        strip_control(name) == name && !name.is_empty() && !name.contains('"') && name.chars().count() <= LONGEST_NAME;
    let what = "1 to 100 characters without quotes, control characters or blanks at the ends";
    (!fits).then(|| format!("receiver name {} is invalid; use {what}", quoted(name)))
}

/// Problem with the antennas: their count must match the observations.
fn antennas_fault(data: &Dataset) -> Option<String> {
    let (given, is_scalar) = (data.observations.antennas()?, data.task().is_scalar);
    let what = if is_scalar {
        "a power is received by one antenna at the position of the receiver"
    } else {
        "give the position of each in the receiver's frame, metres"
    };
    let receiver = data.scene.receivers.iter().find(|receiver| {
        let is_elsewhere = is_scalar && receiver.antennas.iter().any(|place| *place != [0.0; 3]);
        receiver.antennas.len() != given || is_elsewhere
    })?;
    let (name, placed) = (quoted(&receiver.name), receiver.antennas.len());
    let things = data.task().plural;
    Some(format!("the {things} have {given} antennas, and receiver {name} has {placed}; {what}"))
}

/// Frequencies of the `count` subcarriers of the array at `path`, evenly spaced about the carrier, Hz.
pub(crate) fn subcarriers(path: &Path, carrier_hz: f64, spacing_hz: f64, count: usize) -> Result<Vec<f64>> {
    let middle = (count as f64 - 1.0) / 2.0;
    if count > 1 && (spacing_hz.is_nan() || spacing_hz <= 0.0) {
        return Err(Error::input(
            path,
            format!("has {count} subcarriers, but `spacing_hz` is missing; set the subcarrier spacing in Hz"),
        ));
    }
    let offset = |i: usize| if count > 1 { (i as f64 - middle) * spacing_hz } else { 0.0 };
    let all: Vec<f64> = (0..count).map(|i| carrier_hz + offset(i)).collect();
    match all.first() {
        Some(lowest) if *lowest <= 0.0 => {
            let what = format!("has {count} subcarriers, of which the lowest would be at {lowest} Hz");
            Err(Error::input(path, format!("{what}; correct `carrier_hz` or `spacing_hz`")))
        }
        _ => Ok(all),
    }
}

/// Returns an error unless both are valid frequencies, Hz.
pub(crate) fn check_frequencies(carrier_hz: f64, spacing_hz: f64) -> Result<(), String> {
    for (name, hz, example) in [("carrier_hz", carrier_hz, "2.4e9"), ("spacing_hz", spacing_hz, "312500")] {
        if !(hz.is_finite() && hz > 0.0) {
            return Err(format!("`{name}` is {hz}; give Hz above 0, such as {example}"));
        }
    }
    Ok(())
}
