//! Files of a simulated data set, written one transmitter at a time: observations in the layouts of NeRF2 or as arrays,
//! positions, tables and paths.

use super::path_table::PathTable;
use crate::Complex;
use crate::observe::{ObservationKind, ReceiverObservation, SILENT_DBM, SimulatedObservation};
use crate::prepared_receiver::PreparedReceiver;
use crate::recipe::SimulationRecipe;
use crate::simulator::Simulator;
use crate::spectrum::{HEIGHT, WIDTH};
use glam::DVec3;
use image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use pwrfgs_core::files::{self, GrowingFile};
use pwrfgs_core::{Error, Number, Pose, Result};
use pwrfgs_data::{
    CARRIERS, POSES, base_station_yaml, gateway_yaml, npy_header, npy_header_as, poses_csv, receiver_yaml,
    transmitter_yaml,
};
use std::fs;
use std::path::{Path, PathBuf};

/// File of every path of every transmitter.
pub const PATHS: &str = "paths.csv";
/// File of the absolute power of every spectrum.
pub const POWER: &str = "power.csv";
/// File of the array of all spectra.
pub(crate) const SPECTRA: &str = "spectra.npy";
/// Channels, complex64 `[links, antennas, subcarriers]`.
pub(crate) const CHANNELS: &str = "channel.npy";
/// File of readings in dBm: one row per transmitter, one column per receiver.
pub(crate) const POWERS: &str = "gateway_rssi.csv";
/// File of the transmitter positions.
pub(crate) const POSITIONS: &str = "tx_pos.csv";
/// Folder of the images.
const IMAGES: &str = "spectrum";
/// Largest number of images: their names have five digits.
const MOST_IMAGES: usize = 99_999;
/// Every n-th sample belongs to the test list.
const TEST_EVERY: usize = 5;

/// File layout of the observations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputLayout {
    /// Spectra as images, as in NeRF2.
    Images,
    /// Spectra as one array, `spectra.npy`, written without holding all in memory.
    Array,
    /// Powers in a table with one column per receiver, as in the BLE set of NeRF2.
    Rssi,
    /// Channels as one array, `channel.npy`.
    Channels,
    /// Channels as in the MIMO set of NeRF2: the first half of the subcarriers is the uplink.
    Csi,
    /// Paths as a scenario of DeepMIMO v4.
    DeepMimo,
}

impl OutputLayout {
    /// Returns an error if `recipe`, or path tables if `has_paths`, do not fit the layout.
    pub(super) fn check(self, recipe: &SimulationRecipe, has_paths: bool) -> Result<()> {
        let fits = match self {
            Self::Images | Self::Array => recipe.observe == ObservationKind::Spectrum,
            Self::Rssi => matches!(recipe.observe, ObservationKind::Power { .. }),
            Self::Channels | Self::Csi | Self::DeepMimo => matches!(recipe.observe, ObservationKind::Channel { .. }),
        };
        if !fits {
            return Err(Error::Config("the layout does not match the observation type; choose another layout".into()));
        }
        let images = recipe.samples * recipe.scene.carrier_count();
        if self == Self::Images && images > MOST_IMAGES {
            return Err(Error::Config(format!(
                "{images} spectra exceed the limit of {MOST_IMAGES} images; write one array with --npy"
            )));
        }
        let holds_poses = matches!(self, Self::Array | Self::Rssi | Self::Channels);
        if recipe.scene.moving_receiver.is_some() && (!holds_poses || has_paths) {
            return Err(Error::Config(format!(
                "the receiver of scene `{}` moves, which only arrays of spectra, powers and channels without paths support; \
                 add --no-paths, and --npy for spectra (in Python layout=\"arrays\")",
                recipe.scene.name
            )));
        }
        if !recipe.scene.carriers_hz.is_empty() && !matches!(self, Self::Images | Self::Array) {
            return Err(Error::Config(format!(
                "scene `{}` has several carriers, which only spectra support; remove --layout, or select one with --carrier-hz",
                recipe.scene.name
            )));
        }
        let subcarriers = recipe.scene.frequencies().len();
        if self == Self::Csi && !subcarriers.is_multiple_of(2) {
            return Err(Error::Config(format!(
                "scene `{}` has {subcarriers} subcarriers, and half of them are the uplink, half the downlink; give an even \
                 number in `subcarriers`, such as (count: 52, bandwidth_hz: 20e6)",
                recipe.scene.name
            )));
        }
        Ok(())
    }

    /// Returns the number of the first sample, as in NeRF2: 1 for spectra, 0 for powers and channels.
    fn first_id(self) -> usize {
        usize::from(matches!(self, Self::Images | Self::Array))
    }
}

/// Returns whether the `i`th transmitter, counted from 0, is a test sample.
pub(crate) fn is_test_sample(i: usize) -> bool {
    (i + 1).is_multiple_of(TEST_EVERY)
}

/// Name and content of a small file, written at the end.
struct TextFile {
    name: &'static str,
    text: String,
}

/// Open files in an empty folder. With several receivers or carriers, their observations of a transmitter are consecutive.
/// Every carrier is a row.
///
/// All functions return the errors of failed writes.
pub(super) struct DatasetFiles {
    folder: PathBuf,
    layout: OutputLayout,
    /// Array of spectra or channels, unless spectra are images.
    array: Option<GrowingFile>,
    /// Table of powers, or of absolute powers of spectra.
    table: Option<TextFile>,
    /// Metadata of the observations: poses, frequencies, antennas.
    metadata: Option<TextFile>,
    /// Table of positions, or of the poses of a moving receiver.
    positions: TextFile,
    /// Carriers, each with a row per transmitter, Hz; empty for one carrier.
    carriers_hz: Vec<f64>,
    /// Path tables, one per receiver, or none.
    paths: Vec<(PathTable, GrowingFile)>,
}

impl DatasetFiles {
    /// Creates the files of `samples` transmitters with their headers in the empty `folder`.
    pub(super) fn create(folder: &Path, simulator: &Simulator, layout: OutputLayout, samples: usize) -> Result<Self> {
        let (receivers, scene) = (simulator.receivers(), simulator.scene());
        let (links, first) = (samples * receivers.len(), &receivers[0]);
        let create = |name, header: Vec<u8>| GrowingFile::create(folder.join(name), &header).map(Some);
        let shape = [links, first.receiver().array.element_count(), scene.frequencies().len()];
        let array = match layout {
            OutputLayout::Images => {
                let path = folder.join(IMAGES);
                fs::create_dir(&path).map_err(|e| Error::write(&path, e))?;
                None
            }
            OutputLayout::Array => create(SPECTRA, npy_header(Number::U8, &[links, HEIGHT, WIDTH]))?,
            OutputLayout::Channels => create(CHANNELS, npy_header_as("<c8", &shape))?,
            OutputLayout::Csi => create("csidata.npy", npy_header_as("<c8", &shape))?,
            OutputLayout::Rssi | OutputLayout::DeepMimo => None,
        };
        // Only a cached folder has several receivers in one array; its reader takes them from the recipe.
        let is_alone = scene.more_receivers.is_empty();
        let absolute = || TextFile { name: POWER, text: "id,path_gain_db,low,high\n".into() };
        let table = match layout {
            OutputLayout::Images => Some(absolute()),
            OutputLayout::Array => is_alone.then(absolute),
            OutputLayout::Rssi => {
                let names: Vec<&str> = receivers.iter().map(|receiver| &*receiver.receiver().name).collect();
                Some(TextFile { name: POWERS, text: names.join(",") + "\n" })
            }
            OutputLayout::Channels | OutputLayout::Csi | OutputLayout::DeepMimo => None,
        };
        let is_shared = matches!(layout, OutputLayout::Array | OutputLayout::Channels) && !is_alone;
        let metadata = create_metadata(simulator, layout).filter(|_| !is_shared);
        let positions = match scene.moving_receiver {
            Some(_) => TextFile { name: POSES, text: poses_csv(std::iter::empty()) },
            None => TextFile { name: POSITIONS, text: "x,y,z\n".into() },
        };
        let carriers_hz = scene.carriers_hz.clone();
        Ok(Self { folder: folder.into(), layout, array, table, metadata, positions, carriers_hz, paths: Vec::new() })
    }

    /// Creates the path tables with their headers, one per receiver.
    pub(super) fn add_path_tables(&mut self, simulator: &Simulator) -> Result<()> {
        let receivers = simulator.receivers();
        for receiver in receivers.iter().map(PreparedReceiver::receiver) {
            let name = if receivers.len() == 1 { PATHS.into() } else { format!("paths-{}.csv", receiver.name) };
            let file = GrowingFile::create(self.folder.join(name), format!("{}\n", PathTable::HEADER).as_bytes())?;
            self.paths.push((PathTable::new(simulator.world(), receiver.world_from_receiver()), file));
        }
        Ok(())
    }

    /// Adds the observations of the `i`th transmitter, counted from 0, at all receivers; `row` is its row in the table of
    /// positions.
    pub(super) fn add_transmitter(&mut self, i: usize, row: &str, received: &[ReceiverObservation]) -> Result<()> {
        let (rows, first) = (self.carriers_hz.len().max(1), self.layout.first_id());
        self.positions.text += &row.repeat(rows);
        for (receiver, observation) in received.iter().enumerate() {
            // Each of several carriers has a separate receiver and row.
            let id = i * rows + first + if rows == 1 { 0 } else { receiver };
            if let Some((table, file)) = self.paths.get_mut(receiver) {
                file.append(table.format_rows(id, &observation.paths).as_bytes())?;
            }
            self.add_observation(id, &observation.observed)?;
            if let Some(table) = &mut self.table {
                table.text += &format_cells(id, &observation.observed, receiver + 1 == received.len());
            }
        }
        Ok(())
    }

    /// Writes the pixels of a spectrum, as image `id` or to the array, or a channel to the array; powers are only in the
    /// table.
    fn add_observation(&mut self, id: usize, observed: &SimulatedObservation) -> Result<()> {
        match (observed, &mut self.array) {
            (SimulatedObservation::Spectrum(spectrum), Some(array)) => array.append(&spectrum.pixels),
            (SimulatedObservation::Spectrum(spectrum), None) => {
                write_grey_png(&self.folder.join(format!("{IMAGES}/{id:05}.png")), &spectrum.pixels)
            }
            (SimulatedObservation::Channel(channel), Some(array)) => {
                let bytes = |h: &Complex| [(h.re as f32).to_le_bytes(), (h.im as f32).to_le_bytes()];
                array.append(&channel.iter().flat_map(bytes).flatten().collect::<Vec<u8>>())
            }
            _ => Ok(()),
        }
    }

    /// Completes the arrays and path tables, and writes the remaining files of `samples` transmitters: tables, metadata,
    /// carriers and lists of training and test samples.
    pub(super) fn finish(self, samples: usize) -> Result<()> {
        self.array.into_iter().chain(self.paths.into_iter().map(|(_, file)| file)).try_for_each(GrowingFile::finish)?;
        for TextFile { name, text } in self.metadata.into_iter().chain(self.table).chain([self.positions]) {
            files::write(&self.folder.join(name), text)?;
        }
        let rows = self.carriers_hz.len().max(1);
        if !self.carriers_hz.is_empty() {
            let text = self.carriers_hz.iter().map(|hz| format!("{hz:?}\n")).collect::<Vec<_>>().concat();
            files::write(&self.folder.join(CARRIERS), text.repeat(samples))?;
        }
        let lists = [("train_index.txt", false), ("test_index.txt", true)];
        // Readers reject an empty list.
        for (name, is_wanted) in lists.into_iter().filter(|_| samples >= TEST_EVERY) {
            let ids = (0..samples * rows).filter(|i| is_test_sample(i / rows) == is_wanted);
            let line = |i: usize| match self.layout.first_id() {
                0 => format!("{i}\n"),
                first => format!("{:05}\n", i + first),
            };
            files::write(&self.folder.join(name), ids.map(line).collect::<String>())?;
        }
        Ok(())
    }
}

/// Creates the metadata of the observations in a layout: poses, frequencies, antennas; `None` for DeepMIMO.
fn create_metadata(simulator: &Simulator, layout: OutputLayout) -> Option<TextFile> {
    let (receivers, scene) = (simulator.receivers(), simulator.scene());
    let first = &receivers[0];
    let antennas = first.antenna_positions().iter().map(DVec3::to_array).collect::<Vec<[f64; 3]>>();
    match layout {
        OutputLayout::Images | OutputLayout::Array => {
            let text = gateway_yaml(&format!("{} (simulated)", scene.name), &scene.receiver.pose());
            Some(TextFile { name: "gateway_info.yml", text })
        }
        OutputLayout::Rssi => {
            let positions = receivers.iter().map(PreparedReceiver::receiver);
            let positions = positions.map(|receiver| format!("{}: {:?}\n", receiver.name, receiver.position));
            Some(TextFile { name: "gateway_position.yml", text: positions.collect() })
        }
        OutputLayout::Channels => {
            let band = [scene.carrier_hz, scene.subcarriers.as_ref().map_or(0.0, |band| band.spacing_hz())];
            let (name, hz) = (&first.receiver().name, scene.frequencies());
            let text = if scene.moving_receiver.is_none() {
                receiver_yaml(name, &first.pose(), band, &hz, &antennas)
            } else {
                // The table of poses has the receiver axes, in which its antennas do not move.
                let in_receiver: Vec<[f64; 3]> =
                    antennas.iter().map(|antenna| first.pose().to_receiver(*antenna)).collect();
                receiver_yaml(name, &Pose::IDENTITY, band, &hz, &in_receiver)
                    + &transmitter_yaml(Some(scene.receiver.position))
            };
            Some(TextFile { name: "receiver.yml", text })
        }
        OutputLayout::Csi => Some(TextFile { name: "base-station.yml", text: base_station_yaml(&antennas) }),
        OutputLayout::DeepMimo => None, // written by `deepmimo.rs`
    }
}

/// Formats an observation for the table of [`DatasetFiles::create`]: row `id` of absolute powers of a spectrum, or
/// a cell of received power, the last of its row if `is_last`; empty for a channel.
fn format_cells(id: usize, observed: &SimulatedObservation, is_last: bool) -> String {
    match observed {
        SimulatedObservation::Spectrum(spectrum) => {
            let decibel = 10.0 * spectrum.power.log10();
            format!("{id},{decibel:.4},{:.6e},{:.6e}\n", spectrum.low, spectrum.high)
        }
        SimulatedObservation::Power(dbm) => {
            let end = if is_last { "\n" } else { "," };
            if *dbm > SILENT_DBM {
                // Rounded readings must not equal the marker of a missing link.
                format!("{:.3}{end}", dbm.max(SILENT_DBM + 1e-3))
            } else {
                format!("{SILENT_DBM:.1}{end}")
            }
        }
        SimulatedObservation::Channel(_) => String::new(),
    }
}

/// Returns an error for a table of powers in `folder` with transmitters that no receiver receives, or receivers that receive
/// none: readers of the layout would reject it.
pub(super) fn check_power_table(folder: &Path) -> Result<()> {
    let text = files::read_string(folder.join(POWERS)).map_err(|e| Error::read(folder, e))?;
    let silent = format!("{SILENT_DBM:.1}");
    let rows = || text.lines().skip(1);
    let columns = rows().next().map_or(0, |row| row.split(',').count());
    let is_silent = |column: &usize| rows().all(|row| row.split(',').nth(*column) == Some(&*silent));
    if let Some(column) = (0..columns).find(is_silent) {
        let name = text.lines().next().and_then(|names| names.split(',').nth(column)).unwrap_or_default();
        return Err(Error::Config(format!(
            "receiver `{name}` receives no transmitter above {SILENT_DBM} dBm, which the layout cannot say; raise `power_dbm` \
             of the transmitter, or leave the receiver out"
        )));
    }
    match rows().filter(|row| row.split(',').all(|cell| cell == silent)).count() {
        0 => Ok(()),
        silent_rows => Err(Error::Config(format!(
            "{silent_rows} of {} transmitters reach no receiver above {SILENT_DBM} dBm, which the layout cannot say; raise \
             `power_dbm` of the transmitter, or keep it nearer to receivers",
            rows().count()
        ))),
    }
}

/// Writes the pixels of a spectrum as a grey PNG image. Returns an error if the write failed.
fn write_grey_png(path: &Path, pixels: &[u8]) -> Result<()> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(pixels, WIDTH as u32, HEIGHT as u32, ExtendedColorType::L8)
        .map_err(|e| Error::write(path, std::io::Error::other(e)))?;
    files::write(path, bytes)
}
