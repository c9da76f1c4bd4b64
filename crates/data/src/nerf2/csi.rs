//! `Nerf2Csi`: channels of a base station in the NeRF2 layout; predicts the downlink from the uplink.

#[cfg(test)]
mod tests;

use super::{index, read_transmitters, receivers};
use crate::checks::{check_frequencies, uniform_subcarriers};
use crate::folder::{check_root, existing_root, folder_name, read_title, recognised_root};
use crate::npy::{ComplexArray, check_magnitudes, read_complex_array};
use pwrfgs_core::{
    Channels, DataSource, Dataset, Error, Features, JsonSchema, Pose, Progress, Real, Receiver, Result, Sample,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const LAYOUT: &str = "a NeRF2 folder of channels holds csidata.npy and base-station.yml";
const SHAPE: &str =
    "channels are [N, A, 2F]: N snapshots, A antennas, F subcarriers of the uplink, then F of the downlink";

/// Channels (CSI) of a base station in the layout of NeRF2 (Zhao et al., 2023): predicts the downlink from the uplink.
///
/// ```text
/// root/csidata.npy         [N, A, 2F], complex64 or complex128: N snapshots at A antennas of the base station, the first
///                          half of the subcarriers is the uplink, the second the downlink (NeRF2: 8 antennas, 26 and 26)
/// root/base-station.yml    base_station: [[x, y, z], ..], one position per antenna; metres
/// root/tx_pos.csv          columns x, y, z, one row per snapshot; metres; optional
/// root/train_index.txt     snapshots counted from 0, one per line; the files train_index.txt and
/// root/test_index.txt      test_index.txt must both exist or both be absent
/// ```
///
/// Every antenna is a receiver, called `antenna 1` and so on, and a link is a snapshot at one antenna. The features of
/// a link replace the transmitter position: they are its uplink, F real parts, then F imaginary parts. Its observation
/// is the downlink, a channel of 1 antenna and F subcarriers. The id of a transmitter is its snapshot, counted from 0
/// as in the index files. Without `tx_pos.csv` transmitter positions are unknown, and plugins that need them, such as
/// the split `Voxel`, return an error.
///
/// The array is divided by its largest modulus in the training part of the index files, or in all snapshots without
/// index files. NeRF2 uses training and test data together; no score depends on this factor.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// let text = r#"Nerf2Csi(root: "data/mimo", carrier_hz: 2.4e9, spacing_hz: 312500)"#;
/// assert!(Plugin::<dyn DataSource>::parse(text).is_ok());
/// assert!(Plugin::<dyn DataSource>::parse("Nerf2Csi(carrier_hz: 0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Nerf2Csi {
    /// Data folder, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Centre frequency of all subcarriers, between uplink and downlink, Hz.
    pub carrier_hz: f64,
    /// Subcarrier spacing, Hz.
    pub spacing_hz: f64,
    /// Whether all antennas form one receiver. A link is then a snapshot; its features are the uplinks of all antennas
    /// in order, and its observation is the downlink at all antennas.
    pub together: bool,
}

impl Default for Nerf2Csi {
    fn default() -> Self {
        Self { root: "data/mimo".into(), carrier_hz: 2.4e9, spacing_hz: 312.5e3, together: false }
    }
}

#[typetag::serde]
impl DataSource for Nerf2Csi {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(pwrfgs_core::Task::Channel)
    }

    /// Loads uplinks as features and downlinks as observations, scaled by the training part of the index files.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = existing_root(base, &self.root, "Nerf2Csi", LAYOUT)?;
        let antennas = receivers::read_antennas(&root.join("base-station.yml"), LAYOUT)?;
        let path = root.join("csidata.npy");
        let mut array = read_channels(&path, antennas.len())?;
        let [snapshots, _, subcarriers] = array.shape;
        let frequencies_hz = uniform_subcarriers(&path, self.carrier_hz, self.spacing_hz, subcarriers)?;
        let frequencies_hz = frequencies_hz[subcarriers / 2..].to_vec(); // of the downlink
        let positions = read_positions(&root, snapshots)?;
        let rows = index::read_sets(&root, &|word| index::parse_row(word, "csidata.npy", snapshots))?;
        array.normalise(&path, rows.as_ref().map(|(train, _)| train.as_slice()))?;
        // The test part may exceed 1 after normalisation: it is divided by the largest modulus of the training part.
        check_magnitudes(&path, array.shape, &array.values)?;
        let (features, gains) = split_links(&mut array);
        let position = |i: usize| positions.as_ref().map_or([0.0; 3], |positions| positions[i]);
        let receivers =
            if self.together { vec![create_base_station(&antennas)] } else { create_antenna_receivers(&antennas) };
        let links = (0..snapshots).flat_map(|i| (0..receivers.len()).map(move |receiver| (i, receiver)));
        let samples: Vec<Sample> =
            links.map(|(i, receiver)| Sample { receiver, ..Sample::new(i as u32, position(i)) }).collect();
        let per_receiver = antennas.len() / receivers.len();
        let channels = Channels { antennas: per_receiver, frequencies_hz, gains };
        let name = folder_name(&root);
        let (title, simulation) = read_title(&root, &name, "NeRF2 layout");
        let data = Dataset::of_links(title, receivers, vec![], &samples, channels.into())?;
        let official = rows.map(|(train, test)| (data.links_of(&train), data.links_of(&test)));
        progress(data.len(), data.len());
        let features = Some(Features { width: subcarriers * per_receiver, values: features });
        Ok(Dataset { official, simulation, features, placed: positions.is_some(), ..data })
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let root = recognised_root(folder, &["csidata.npy", "base-station.yml"])?;
        // One receiver with all antennas, as `pipelines/uplink.ron` has it.
        Some(Box::new(Self { root, together: true, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)?;
        check_frequencies(self.carrier_hz, self.spacing_hz)
    }
}

/// Reads channels `[N,A,2F]` of a base station. Returns an error for another number of antennas than `antennas`, or an
/// odd number of subcarriers.
fn read_channels(path: &Path, antennas: usize) -> Result<ComplexArray> {
    let array = read_complex_array(path, SHAPE)?;
    let [_, count, subcarriers] = array.shape;
    if count != antennas {
        let problem =
            format!("has {count} antennas per snapshot, but base-station.yml {antennas}; give as many of each");
        return Err(Error::input(path, problem));
    }
    if subcarriers % 2 == 1 {
        let expected = format!("an even number: uplink, then downlink; {SHAPE}");
        return Err(Error::input(path, format!("has {subcarriers} subcarriers, expected {expected}")));
    }
    Ok(array)
}

/// Reads the positions of the `snapshots` from `tx_pos.csv`, metres; `None` without the file. Returns an error for an invalid
/// table, or another number of rows.
fn read_positions(root: &Path, snapshots: usize) -> Result<Option<Vec<[f64; 3]>>> {
    let path = root.join("tx_pos.csv");
    if !path.exists() {
        return Ok(None);
    }
    let positions = read_transmitters(&path)?;
    if positions.len() != snapshots {
        let problem = format!("holds {} transmitters, but csidata.npy {snapshots} snapshots", positions.len());
        return Err(Error::input(&path, format!("{problem}; give as many of each, or remove this file")));
    }
    Ok(Some(positions))
}

/// Creates one receiver per antenna, at its position in metres.
fn create_antenna_receivers(antennas: &[[f64; 3]]) -> Vec<Receiver> {
    let receiver = |(k, &position): (usize, &[f64; 3])| {
        Receiver::new(format!("antenna {}", k + 1), Pose { position, ..Pose::IDENTITY })
    };
    antennas.iter().enumerate().map(receiver).collect()
}

/// Creates one receiver of all antennas, at their centre; positions in metres.
fn create_base_station(antennas: &[[f64; 3]]) -> Receiver {
    let centre = std::array::from_fn(|k| antennas.iter().map(|a| a[k]).sum::<f64>() / antennas.len().max(1) as f64);
    let offset = |a: &[f64; 3]| std::array::from_fn(|k| a[k] - centre[k]);
    let pose = Pose { position: centre, ..Pose::IDENTITY };
    Receiver { antennas: antennas.iter().map(offset).collect(), ..Receiver::new("base station", pose) }
}

/// Takes the values of `array` and returns the uplink of every link, `[N A, 2F]`: F real parts, then F imaginary parts; and its
/// downlink, `[N A, F]`.
fn split_links(array: &mut ComplexArray) -> (Vec<Real>, Vec<[Real; 2]>) {
    let subcarriers = array.shape[2];
    let (mut uplinks, mut downlinks) = (Vec::with_capacity(array.values.len()), Vec::new());
    for link in std::mem::take(&mut array.values).chunks_exact(subcarriers) {
        let (up, down) = link.split_at(subcarriers / 2);
        (0..2).for_each(|part| uplinks.extend(up.iter().map(|gain| gain[part])));
        downlinks.extend_from_slice(down);
    }
    (uplinks, downlinks)
}
