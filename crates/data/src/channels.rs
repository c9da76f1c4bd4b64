//! `Channels`: channels of one receiver in an array of NumPy, with the places of the transmitter in a table.

#[cfg(test)]
mod tests;

use crate::nerf2::{check_root, folder_name, read_transmitters, simulation};
use crate::npy::read_complex;
use pwrfgs_core::{
    Channels as Observed, DataSource, Dataset, Documented, Error, Observations, Pose, Progress, Real, Receiver, Result,
    Sample,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const SHAPE: &str = "channels are [M, A, F]: M transmitters, A antennas of the receiver, F subcarriers";

/// Channels (CSI) at one receiver as an array of NumPy, with a table of the transmitter's places.
///
/// ```text
/// root/file         [M, A, F], complex64 or complex128: M places of the transmitter, A antennas of the receiver, F
///                   subcarriers
/// root/positions    header naming x, y, z among others; row k is place k of the array; metres
/// ```
///
/// The id of a transmitter is its row, counted from 0 as NumPy does. Numbers are taken as they are. Subcarriers are evenly
/// spaced about `carrier_hz`. By reciprocity it is all the same which end sends: where the fixed node is the transmitter,
/// call it the receiver.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// let text = r#"Channels(
///     root: "data/newrf", file: "csi_2400MHz.npy", positions: "tx_pos.csv",
///     carrier_hz: 2.412e9, receiver: (position: (-1.5, 0.0, 1.7)),
/// )"#;
/// assert!(Plugin::<dyn DataSource>::parse(text).is_ok());
/// assert!(Plugin::<dyn DataSource>::parse("Channels(spacing_hz: -1)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct Channels {
    /// The folder, relative to the pipeline file.
    #[serde(with = "pwrfgs_core::paths")]
    pub root: PathBuf,
    /// The array, relative to `root`.
    #[serde(with = "pwrfgs_core::paths")]
    pub file: PathBuf,
    /// The table of places, relative to `root`.
    #[serde(with = "pwrfgs_core::paths")]
    pub positions: PathBuf,
    /// Frequency in the middle of the subcarriers, Hz.
    pub carrier_hz: f64,
    /// From one subcarrier to the next, Hz; nothing depends on it where there is one subcarrier.
    pub spacing_hz: f64,
    /// Where the receiver is.
    pub receiver: ReceiverPlace,
}

/// Where a receiver is, how it is turned, and where its antennas are.
#[derive(Clone, Debug, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct ReceiverPlace {
    /// Metres, world frame.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w turning receiver axes into world axes.
    pub orientation: [f64; 4],
    /// Places of the antennas in the receiver's frame, metres, in the order of the array; a receiver with one antenna
    /// needs none.
    pub antennas: Vec<[f64; 3]>,
}

impl Default for ReceiverPlace {
    fn default() -> Self {
        let Pose { position, orientation } = Pose::IDENTITY;
        Self { position, orientation, antennas: Vec::new() }
    }
}

impl ReceiverPlace {
    fn pose(&self) -> Pose {
        Pose { position: self.position, orientation: self.orientation }
    }
}

impl Default for Channels {
    fn default() -> Self {
        Self {
            root: "data/newrf".into(),
            file: "csi_2400MHz.npy".into(),
            positions: "tx_pos.csv".into(),
            carrier_hz: 2.412e9,
            spacing_hz: 312.5e3,
            receiver: ReceiverPlace::default(),
        }
    }
}

#[typetag::serde]
impl DataSource for Channels {
    fn kind(&self) -> Option<pwrfgs_core::Kind> {
        Some(pwrfgs_core::Kind::Channel)
    }

    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = base.join(&self.root);
        if !root.is_dir() {
            return Err(Error::input(&root, "no such folder; set `root` of Channels"));
        }
        let (path, table) = (root.join(&self.file), root.join(&self.positions));
        let positions = read_transmitters(&table)?;
        let array = read_complex(&path, SHAPE)?;
        let [count, antennas, width] = array.shape;
        if count != positions.len() {
            let what = format!("holds channels of {count} transmitters, but {} {}", table.display(), positions.len());
            return Err(Error::input(&path, format!("{what}; give as many of each")));
        }
        let frequencies_hz = subcarriers(&path, self.carrier_hz, self.spacing_hz, width)?;
        let receiver = self.receiver(&path, antennas)?;
        let samples: Vec<Sample> = (0..).zip(positions).map(|(id, tx)| Sample::new(id, tx)).collect();
        let gains = array.values.into_iter().map(|gain| gain.map(|v| v as Real)).collect();
        let channels = Observations::Channels(Observed { antennas, frequencies_hz, gains });
        let name = folder_name(&root);
        let simulation = simulation(&root, &name);
        let title = format!("{name} ({}channels)", if simulation.is_some() { "" } else { "measured, " });
        let data = Dataset::of_links(title, vec![receiver], vec![], &samples, channels)?;
        progress(data.len(), data.len());
        Ok(Dataset { simulation, ..data })
    }

    fn rebased(&self, absolute: &dyn Fn(&Path) -> PathBuf) -> Option<Box<dyn DataSource>> {
        Some(Box::new(Self { root: absolute(&self.root), ..self.clone() }))
    }

    fn about(&self) -> &'static str {
        "channels at one receiver as an array of NumPy, with a table of places"
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)?;
        for (name, path) in [("file", &self.file), ("positions", &self.positions)] {
            if path.as_os_str().is_empty() {
                return Err(format!("`{name}` is empty; name a file in `root`"));
            }
        }
        check_frequencies(self.carrier_hz, self.spacing_hz)?;
        match self.receiver.pose().fault() {
            Some((field, fault)) => Err(format!("`receiver.{field}`: {fault}")),
            None => Ok(()),
        }
    }
}

impl Channels {
    /// The receiver, with as many antennas as the array has.
    fn receiver(&self, path: &Path, antennas: usize) -> Result<Receiver> {
        let receiver = Receiver::new("receiver", self.receiver.pose());
        match self.receiver.antennas.len() {
            0 if antennas == 1 => Ok(receiver),
            n if n == antennas => Ok(Receiver { antennas: self.receiver.antennas.clone(), ..receiver }),
            n => {
                let what = format!("has {antennas} antennas, and `receiver.antennas` names {n}");
                Err(Error::input(path, format!("{what}; give the place of each in the receiver's frame, metres")))
            }
        }
    }
}

/// Frequencies of `count` subcarriers of the array at `path`, evenly spaced about the carrier, Hz.
pub(crate) fn subcarriers(path: &Path, carrier_hz: f64, spacing_hz: f64, count: usize) -> Result<Vec<f64>> {
    let middle = (count as f64 - 1.0) / 2.0;
    let all: Vec<f64> = (0..count).map(|i| carrier_hz + (i as f64 - middle) * spacing_hz).collect();
    match all.first() {
        Some(lowest) if *lowest <= 0.0 => {
            let what = format!("has {count} subcarriers, of which the lowest would be at {lowest} Hz");
            Err(Error::input(path, format!("{what}; correct `carrier_hz` or `spacing_hz`")))
        }
        _ => Ok(all),
    }
}

/// Refuses what is no frequency.
pub(crate) fn check_frequencies(carrier_hz: f64, spacing_hz: f64) -> Result<(), String> {
    for (name, hz, example) in [("carrier_hz", carrier_hz, "2.4e9"), ("spacing_hz", spacing_hz, "312500")] {
        if !(hz.is_finite() && hz > 0.0) {
            return Err(format!("`{name}` is {hz}; give Hz above 0, such as {example}"));
        }
    }
    Ok(())
}
