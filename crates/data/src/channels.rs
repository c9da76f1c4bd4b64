//! `Channels`: channels of one receiver as a NumPy array, with transmitter positions in a table.

#[cfg(test)]
mod tests;

use crate::checks::{check_frequencies, name_fault, uniform_subcarriers};
use crate::folder::{
    check_root, dataset_title, existing_root, find_point_cloud, folder_name, read_point_cloud, read_simulation,
    recognised_root, restore_saved,
};
use crate::nerf2::{LocationTable, index};
use crate::npy::{ComplexFile, check_magnitudes, read_all};
use crate::text::{read_yaml, yaml_fault};
use pwrfgs_core::{
    Channels as ObservedChannels, DataSource, Dataset, End, Error, JsonSchema, Observations, Pose, Progress, Receiver,
    Result, Sample, Simulation, Unmatched, carrier_fault,
};
use serde::{Deserialize, Serialize};
use serde_saphyr::Spanned;
use std::path::{Path, PathBuf};

const LAYOUT: &str = "a folder of channels holds channel.npy, tx_pos.csv and receiver.yml";
const SHAPE: &str = "channels are [M, A, F]: M transmitters, A antennas of the receiver, F subcarriers";

/// Channels (CSI) at one receiver as a NumPy array, with a table of transmitter positions.
///
/// ```text
/// root/file         [M, A, F], complex64 or complex128: M positions of the transmitter, A antennas of the receiver, F
///                   subcarriers
/// root/positions    header naming x, y, z among others; row k is position k of the array; metres
/// root/rx_pose.csv  instead of positions, if the receiver moves: columns x, y, z, qx, qy, qz, qw of its pose; antennas in
///                   receiver.yml are then in its frame, and `transmitter: [x, y, z]` there may state the fixed transmitter
/// ```
///
/// The id of a transmitter is its row, counted from 0 as in NumPy. Channels that are zero were not received and are left
/// out with a warning. Values are not scaled. Subcarriers are evenly spaced
/// about `carrier_hz`. By reciprocity, uplink and downlink are equal: if the fixed node is the transmitter, enter it as
/// the receiver.
///
/// Carrier, spacing and receiver that are left out are read from `root/receiver.yml`, which `pwrfgs simulate --layout
/// channels` writes. If neither carrier nor spacing is set, its `frequencies_hz` are used, which need not be evenly
/// spaced. If `train_index.txt` and `test_index.txt` exist, they hold the rows for `split: Official()`, counted from 0. If
/// `ids.txt` exists, line k is the id of row k.
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
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Channels {
    /// Data folder, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Channel array (`.npy`), relative to `root`.
    pub file: PathBuf,
    /// Table of transmitter positions, relative to `root`.
    pub positions: PathBuf,
    /// Point cloud of the room (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub points: Option<PathBuf>,
    /// Centre frequency of the subcarriers, Hz.
    pub carrier_hz: Option<f64>,
    /// Subcarrier spacing, Hz; not needed for a single subcarrier.
    pub spacing_hz: Option<f64>,
    /// Arrays of further carriers, of the same shape and at the same positions. Every carrier is then a receiver with a
    /// name such as `928MHz`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub more_carriers: Vec<CarrierFile>,
    /// Position, orientation and antennas of the receiver.
    pub receiver: Option<ReceiverPlace>,
    /// Whether the channels are simulated although no file says so. Scores of simulated data are never labelled as
    /// measured.
    pub simulated: bool,
}

/// Channels at a further carrier.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CarrierFile {
    /// Channel array (`.npy`), relative to `root`.
    pub file: PathBuf,
    /// Centre frequency of its subcarriers, Hz.
    pub carrier_hz: f64,
}

/// Position, orientation and antennas of a receiver.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ReceiverPlace {
    /// Receiver position in metres, world frame.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w turning receiver axes into world axes.
    pub orientation: [f64; 4],
    /// Antenna positions in the receiver's frame, metres, in the order of the array; not needed for a single antenna.
    pub antennas: Vec<[f64; 3]>,
}

impl Default for ReceiverPlace {
    fn default() -> Self {
        let Pose { position, orientation } = Pose::IDENTITY;
        Self { position, orientation, antennas: Vec::new() }
    }
}

impl ReceiverPlace {
    /// Returns the receiver pose, world frame.
    pub fn pose(&self) -> Pose {
        Pose { position: self.position, orientation: self.orientation }
    }
}

impl Default for Channels {
    fn default() -> Self {
        Self {
            root: "data/channels".into(),
            file: "channel.npy".into(),
            positions: "tx_pos.csv".into(),
            points: None,
            carrier_hz: None,
            spacing_hz: None,
            more_carriers: Vec::new(),
            receiver: None,
            simulated: false,
        }
    }
}

#[typetag::serde]
impl DataSource for Channels {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(pwrfgs_core::Task::Channel)
    }

    /// Loads all carriers. Rows of further carriers follow those of the first up to [`Dataset::with_carriers`], which sorts the
    /// links by position and carrier.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = existing_root(base, &self.root, "Channels", LAYOUT)?;
        let (path, table) = (root.join(&self.file), root.join(&self.positions));
        let locations = LocationTable::read(&root, &table)?;
        let more: Vec<PathBuf> = self.more_carriers.iter().map(|carrier| root.join(&carrier.file)).collect();
        let files = self.open_carriers(&path, &more)?;
        let [count, antennas, width] = files[0].shape;
        if count != locations.poses.len() {
            let (table, rows) = (&locations.name, locations.poses.len());
            let problem = format!("holds channels of {count} positions, but {table} {rows}");
            return Err(Error::input(&path, format!("{problem}; give as many of each")));
        }
        let metadata = ChannelMetadata::read(self, &root, locations.moving)?;
        let frequencies_hz = metadata.subcarrier_frequencies(&path, width)?;
        let carrier_hz = frequencies_hz.iter().sum::<f64>() / width.max(1) as f64; // the middle of the band
        let receiver = metadata.create_receiver(&path, antennas, self.receiver.is_none())?;
        let rows = index::read_sets(&root, &|word| index::parse_row(word, &locations.name, count))?;
        let carriers = files.len();
        let official =
            rows.map(|(train, test)| (repeat_rows(&train, carriers, count), repeat_rows(&test, carriers, count)));
        let poses = locations.poses.repeat(carriers);
        let (shape, size) = (files[0].shape, files[0].count());
        let gains = read_all(files)?;
        let paths = std::iter::once(&path).chain(&more);
        paths.zip(gains.chunks(size)).try_for_each(|(path, gains)| check_magnitudes(path, shape, gains))?;
        let samples: Vec<Sample> = (0..).zip(poses).map(|(id, pose)| Sample::new(id, pose)).collect();
        let channels = ObservedChannels { antennas, frequencies_hz, gains };
        let name = folder_name(&root);
        let simulation = read_simulation(&root, &name).or_else(|| self.simulated.then(Simulation::default));
        let title = dataset_title(&name, simulation.as_ref(), "channels");
        let points = read_point_cloud(base, self.points.as_deref())?;
        let ends = locations.link_ends(vec![receiver], metadata.transmitter);
        let data = Dataset::of_links(title, ends, points, &samples, channels.into())?;
        progress(data.len(), data.len());
        let mut data = Dataset { simulation, official, ..data };
        if carriers > 1 {
            let lowest_hz = data.observations.frequencies_hz().iter().copied().fold(carrier_hz, f64::min);
            let carriers_hz = self.all_carriers(&path, carrier_hz, lowest_hz)?;
            data = data.with_carriers(&carriers_hz.iter().flat_map(|hz| vec![*hz; count]).collect::<Vec<f64>>())?;
        }
        without_zeros(restore_saved(&root, data)?, &path)
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let root = recognised_root(folder, &["channel.npy", "receiver.yml"])?;
        Some(Box::new(Self { points: find_point_cloud(&root), root, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)?;
        for (name, path) in [("file", &self.file), ("positions", &self.positions)] {
            if path.as_os_str().is_empty() {
                return Err(format!("`{name}` is empty; name a file in `root`"));
            }
        }
        // Valid numbers stand for settings that are missing.
        check_frequencies(self.carrier_hz.unwrap_or(1e9), self.spacing_hz.unwrap_or(1.0))?;
        if let Some(fault) = self.more_carriers.iter().find_map(|file| carrier_fault(file.carrier_hz)) {
            return Err(format!("`more_carriers`: {fault}"));
        }
        match self.receiver.as_ref().and_then(|receiver| receiver.pose().fault()) {
            Some((field, fault)) => Err(format!("`receiver.{field}`: {fault}")),
            None => Ok(()),
        }
    }
}

impl Channels {
    /// Opens the array at `path` and those of further carriers, `more`. Returns an error for an invalid array, or one of another
    /// shape than the first.
    fn open_carriers<'a>(&self, path: &'a Path, more: &'a [PathBuf]) -> Result<Vec<ComplexFile<'a>>> {
        let mut files = vec![ComplexFile::open(path, SHAPE)?];
        for path in more {
            let (file, shape) = (ComplexFile::open(path, SHAPE)?, files[0].shape);
            if file.shape != shape {
                let problem = format!("has the shape {:?}, but {} has {shape:?}", file.shape, self.file.display());
                let advice = "give arrays of the same positions, or remove this one";
                return Err(Error::input(path, format!("{problem}; {advice}")));
            }
            files.push(file);
        }
        Ok(files)
    }

    /// Returns `carrier_hz` and the carriers of `more_carriers`, Hz. Returns an error, which names the array at `path`, if
    /// two are equal, or if the lowest subcarrier of one would not be above 0. That of `carrier_hz` is `lowest_hz`; the
    /// subcarriers of the others have the same spacing.
    fn all_carriers(&self, path: &Path, carrier_hz: f64, lowest_hz: f64) -> Result<Vec<f64>> {
        let more = self.more_carriers.iter().map(|file| file.carrier_hz);
        let carriers: Vec<f64> = std::iter::once(carrier_hz).chain(more).collect();
        let offset = carrier_hz - lowest_hz;
        let refuse = |problem: String| Err(Error::input(path, format!("`more_carriers`: {problem}")));
        for (k, hz) in carriers.iter().enumerate() {
            if *hz <= offset {
                let lowest = hz - offset;
                let problem = format!("with the carrier {hz} Hz, the lowest subcarrier would be at {lowest} Hz");
                return refuse(format!("{problem}; correct it"));
            }
            if carriers[..k].contains(hz) {
                return refuse(format!("the carrier {hz} Hz occurs twice; remove one"));
            }
        }
        Ok(carriers)
    }
}

/// Returns the indices of `rows` at each of the `carriers`, in the joined array of `count` rows per carrier.
fn repeat_rows(rows: &[usize], carriers: usize, count: usize) -> Vec<usize> {
    (0..carriers).flat_map(|carrier| rows.iter().map(move |row| carrier * count + row)).collect()
}

/// Leaves out the links whose channel is zero, which was not received, and counts them in `unmatched`. Returns an error if all
/// are zero; it names the array at `path`.
fn without_zeros(data: Dataset, path: &Path) -> Result<Dataset> {
    let Observations::Channels(channels) = &data.observations else { return Ok(data) };
    let is_received = |link: &usize| channels.of(*link).iter().flatten().any(|part| *part != 0.0);
    let links: Vec<usize> = (0..data.len()).filter(is_received).collect();
    match data.len() - links.len() {
        0 => Ok(data),
        _ if links.is_empty() => Err(Error::input(path, "is zero throughout; give channels that were received")),
        zeros => {
            let unmatched = Unmatched { positions: zeros, ..Unmatched::default() };
            Ok(Dataset { unmatched, ..data.into_subset(&links)? })
        }
    }
}

/// Settings, completed from `receiver.yml`.
struct ChannelMetadata {
    carrier_hz: f64,
    /// Subcarrier spacing, Hz; NaN if it is missing.
    spacing_hz: f64,
    /// Frequencies of the subcarriers, Hz, if listed one by one.
    frequencies_hz: Option<Vec<f64>>,
    name: String,
    receiver: ReceiverPlace,
    /// Position of the fixed transmitter if the receiver moves, metres.
    transmitter: Option<[f64; 3]>,
}

/// Content of `receiver.yml`, as [`receiver_yaml`](crate::receiver_yaml) writes it; antenna positions are in the world frame, or
/// in the frame of a moving receiver.
#[derive(Deserialize)]
struct ReceiverFile {
    name: Spanned<String>,
    position: Spanned<[f64; 3]>,
    orientation: Spanned<[f64; 4]>,
    antennas: Vec<[f64; 3]>,
    carrier_hz: f64,
    spacing_hz: f64,
    /// Frequencies of all subcarriers, Hz; need not be evenly spaced.
    frequencies_hz: Option<Vec<f64>>,
    /// Position of the fixed transmitter if the receiver moves, metres.
    transmitter: Option<[f64; 3]>,
}

impl ReceiverFile {
    /// Reads `receiver.yml` at `path`. Returns an error for a missing file, or a missing or invalid value.
    fn read(path: &Path) -> Result<Self> {
        let advice = "Channels reads it for what its `carrier_hz`, `spacing_hz` and `receiver` leave out; say all three, or \
                      give the file";
        let expected = "expected name, position, orientation, antennas, carrier_hz and spacing_hz";
        let file: Self = read_yaml(path, advice, expected)?;
        if let Some(fault) = name_fault(&file.name.value) {
            return Err(yaml_fault(path, &file.name, fault));
        }
        match file.pose().fault() {
            Some(("position", fault)) => return Err(yaml_fault(path, &file.position, fault)),
            Some((_, fault)) => return Err(yaml_fault(path, &file.orientation, fault)),
            None => {}
        }
        let is_finite = |antenna: &[f64; 3]| antenna.iter().all(|x| x.is_finite());
        if !(file.antennas.iter().all(is_finite) && file.carrier_hz.is_finite() && file.spacing_hz.is_finite()) {
            return Err(Error::input(path, format!("holds a number that is not finite; {expected}")));
        }
        carrier_fault(file.carrier_hz).map_or(Ok(file), |fault| Err(Error::input(path, fault)))
    }

    /// Returns the pose of the receiver, world frame.
    fn pose(&self) -> Pose {
        Pose { position: self.position.value, orientation: self.orientation.value }
    }
}

impl ChannelMetadata {
    /// Completes the settings of `source` from `receiver.yml` in the folder `root`. The file is read only if a setting is
    /// missing, and need not exist if that is the spacing. Returns an error for a missing or invalid file.
    fn read(source: &Channels, root: &Path, moving: End) -> Result<Self> {
        let path = root.join("receiver.yml");
        if let Channels { carrier_hz: Some(carrier_hz), spacing_hz, receiver: Some(receiver), .. } = source
            && (spacing_hz.is_some() || !path.exists())
        {
            // A missing spacing matters only with several subcarriers.
            let (carrier_hz, spacing_hz) = (*carrier_hz, spacing_hz.unwrap_or(f64::NAN));
            return Ok(Self {
                carrier_hz,
                spacing_hz,
                frequencies_hz: None,
                name: "receiver".into(),
                receiver: receiver.clone(),
                transmitter: None,
            });
        }
        let file = ReceiverFile::read(&path)?;
        let Pose { position, orientation } = file.pose();
        // Antennas of a moving receiver are in its frame already.
        let pose = if moving.is_receiver() { Pose::IDENTITY } else { file.pose() };
        let antennas = file.antennas.iter().map(|antenna| pose.to_receiver(*antenna)).collect();
        let receiver = ReceiverPlace { position, orientation, antennas };
        let is_band_unset = source.carrier_hz.is_none() && source.spacing_hz.is_none();
        Ok(Self {
            frequencies_hz: file.frequencies_hz.filter(|_| is_band_unset),
            carrier_hz: source.carrier_hz.unwrap_or(file.carrier_hz),
            spacing_hz: source.spacing_hz.unwrap_or(file.spacing_hz),
            name: if source.receiver.is_some() { "receiver".into() } else { file.name.value },
            receiver: source.receiver.clone().unwrap_or(receiver),
            transmitter: file.transmitter,
        })
    }

    /// Returns the frequencies of the `width` subcarriers of the array at `path`, Hz: those listed, else evenly spaced about the
    /// carrier. Returns an error if another number is listed, and the errors of [`uniform_subcarriers`].
    fn subcarrier_frequencies(&self, path: &Path, width: usize) -> Result<Vec<f64>> {
        match &self.frequencies_hz {
            Some(listed) if listed.len() == width => Ok(listed.clone()),
            Some(listed) => {
                let count = listed.len();
                let problem = format!("has {width} subcarriers, but receiver.yml lists {count} `frequencies_hz`");
                Err(Error::input(path, format!("{problem}; give as many of each")))
            }
            None => uniform_subcarriers(path, self.carrier_hz, self.spacing_hz, width),
        }
    }

    /// Creates the receiver. Returns an error unless it lists as many antennas as the array at `path` has (`antennas`); a
    /// single antenna need not be listed. `is_from_file`: the receiver is that of `receiver.yml`.
    fn create_receiver(&self, path: &Path, antennas: usize, is_from_file: bool) -> Result<Receiver> {
        let receiver = Receiver::new(&self.name, self.receiver.pose());
        match self.receiver.antennas.len() {
            0 if antennas == 1 => Ok(receiver),
            n if n == antennas => Ok(Receiver { antennas: self.receiver.antennas.clone(), ..receiver }),
            n => {
                let (list, advice) = if is_from_file {
                    let frame = "in the world frame, or in that of a moving receiver";
                    ("`antennas` in receiver.yml", format!("give the position of each there, metres, {frame}"))
                } else {
                    ("`receiver.antennas`", "give the position of each in the receiver's frame, metres".to_owned())
                };
                Err(Error::input(path, format!("has {antennas} antennas, but {list} lists {n}; {advice}")))
            }
        }
    }
}
