//! Simulated data set as a folder, in the layouts of NeRF2, with ground truth.

mod deepmimo;
mod files;
pub mod mitsuba;
mod path_table;

pub(crate) use files::{CHANNELS, POSITIONS, POWERS, SPECTRA, is_test_sample};
use files::{DatasetFiles, check_power_table};
pub use files::{OutputLayout, PATHS, POWER};

use crate::observe::ObservationKind;
use crate::recipe::SimulationRecipe;
use crate::simulator::{SimulationRequest, Simulator, simulate_links};
use crate::surface_points;
use pwrfgs_core::files::{NewFolder, refuse_occupied, write};
use pwrfgs_core::{Error, Progress, Result, check_stopped};
use pwrfgs_data::pose_row;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Recipe of the folder; written last, so that its presence marks a complete folder.
pub const MANIFEST: &str = "manifest.json";
/// Point cloud of the scene.
pub const POINTS: &str = "points.ply";

/// Form of a simulated data set, and its observers.
#[derive(Clone, Copy)]
pub struct DatasetWriter<'a> {
    /// Layout of the files.
    pub layout: OutputLayout,
    /// Whether tables of all paths are written.
    pub has_paths: bool,
    /// Counts the transmitters of all folders.
    pub progress: Progress<'a>,
    /// Flag that ends the simulation.
    pub stop: &'a AtomicBool,
}

impl DatasetWriter<'_> {
    /// Simulates `recipe` into the new folder `out`.
    ///
    /// ```text
    /// out/tx_pos.csv            x,y,z; one row per transmitter; rx_pose.csv for a moving receiver
    /// out/train_index.txt, test_index.txt    every fifth sample is a test sample; only from five samples
    /// out/paths.csv             one row per path, with `has_paths`; paths-NAME.csv for several receivers in one folder
    /// out/points.ply            points on all surfaces, with normals
    /// out/manifest.json         the recipe
    ///
    /// out/gateway_info.yml      spectra: pose of the receiver; the data set name contains «simulated»
    /// out/freq.txt              with `carriers_hz` of the scene: the carrier of each spectrum, Hz; the carriers of a transmitter
    ///                           are consecutive rows of all tables
    /// out/spectrum/00001.png    8-bit grey, 360x90; or
    /// out/spectra.npy           all spectra, 8-bit grey [M, 90, 360]
    /// out/power.csv             id, path gain in dB (mean over the antennas), lowest and highest value of the spectrum
    ///
    /// out/gateway_position.yml  powers: name: [x, y, z] of every receiver
    /// out/gateway_rssi.csv      dBm, one column per receiver, one row per transmitter; -100.0: no signal
    ///
    /// out/channel.npy           channels: complex64 [M, antennas, subcarriers]
    /// out/receiver.yml          pose, frequencies, antenna positions
    ///
    /// out/csidata.npy           CSI: the same array, first half of the subcarriers uplink, second half downlink
    /// out/base-station.yml      antenna positions
    ///
    /// out/params.json, power_t000_tx000_r001.npz, ..    DeepMIMO: only these matrices of paths, and the recipe
    /// ```
    ///
    /// Ids are counted from 1 in the layout of spectra and from 0 in the others, as in NeRF2. With several receivers, each
    /// has its own complete folder inside `out`, named after it, as if the scene had this receiver alone. Only powers share
    /// one table, and base stations of DeepMIMO share a folder.
    ///
    /// The folder is written under a temporary name and renamed at the end, so that `out` is complete or absent. Remains of
    /// killed attempts are removed.
    ///
    /// # Errors
    /// `out` is not empty, a write failed, the layout does not fit, the scene cannot be simulated, powers leave a
    /// receiver or transmitter without a signal, or `stop` is set ([`Error::Stopped`]). Nothing is left behind.
    pub fn write(&self, recipe: &SimulationRecipe, out: &Path) -> Result<()> {
        let Self { layout, has_paths, progress, stop } = *self;
        layout.check(recipe, has_paths)?;
        refuse_occupied(out)?; // before the scene is prepared
        let simulator = Simulator::new(&recipe.scene)?; // reports errors of all receivers before the first is simulated
        let new_folder = NewFolder::begin(out)?;
        if layout == OutputLayout::DeepMimo {
            deepmimo::write_scenario(recipe, &simulator, new_folder.path(), progress, stop)?;
            new_folder.put(MANIFEST, recipe.to_json())?;
            return new_folder.publish();
        }
        let receivers = recipe.scene.receivers().count();
        if receivers == 1 || layout == OutputLayout::Rssi {
            self.simulate_into(recipe, &simulator, new_folder.path())?;
            if layout == OutputLayout::Rssi {
                check_power_table(new_folder.path())?;
            }
            return new_folder.publish();
        }
        drop(simulator);
        for (i, receiver) in recipe.scene.receivers().enumerate() {
            let recipe = recipe.with_receiver(receiver);
            let simulator = Simulator::new(&recipe.scene)?;
            let folder = new_folder.path().join(&receiver.name);
            fs::create_dir(&folder).map_err(|e| Error::write(&folder, e))?;
            let progress = |done, all| progress(i * all + done, receivers * all);
            DatasetWriter { progress: &progress, ..*self }.simulate_into(&recipe, &simulator, &folder)?;
        }
        new_folder.put(MANIFEST, recipe.to_json())?;
        new_folder.publish()
    }

    /// Simulates `recipe` into the existing, empty `folder`: observations, tables, points and manifest, and the path tables.
    /// Returns an error for a failed simulation or write, or if `stop` is set.
    fn simulate_into(&self, recipe: &SimulationRecipe, simulator: &Simulator, folder: &Path) -> Result<()> {
        let Self { layout, has_paths, progress, stop } = *self;
        let &SimulationRecipe { samples, seed, observe, .. } = recipe;
        let mut files = DatasetFiles::create(folder, simulator, layout, samples)?;
        if has_paths {
            files.add_path_tables(simulator)?;
        }
        simulate_links(simulator, &SimulationRequest { kind: observe, samples, seed }, stop, |i, tx, received| {
            check_stopped(stop)?;
            let pose = recipe.scene.moved_receiver(i, tx, seed).map(|receiver| receiver.pose());
            let row = pose.map_or_else(|| format!("{},{},{}\n", tx.x, tx.y, tx.z), pose_row);
            files.add_transmitter(i, &row, &received)?;
            progress(i + 1, samples);
            Ok(())
        })?;
        files.finish(samples)?;
        write_point_cloud(recipe, simulator, folder)?;
        write(&folder.join(MANIFEST), recipe.to_json())?;
        check_stopped(stop)
    }
}

/// Simulates `recipe` into the new folder `out` as arrays and tables of all links; the receivers of a transmitter are
/// consecutive.
///
/// # Errors
/// `out` is not empty, the scene cannot be simulated, or a write failed.
pub(crate) fn write_links(recipe: &SimulationRecipe, out: &Path, progress: Progress<'_>) -> Result<()> {
    let (simulator, new_folder) = (Simulator::new(&recipe.scene)?, NewFolder::begin(out)?);
    let layout = match recipe.observe {
        ObservationKind::Spectrum => OutputLayout::Array,
        ObservationKind::Power { .. } => OutputLayout::Rssi,
        ObservationKind::Channel { .. } => OutputLayout::Channels,
    };
    let writer = DatasetWriter { layout, has_paths: false, progress, stop: &AtomicBool::new(false) };
    writer.simulate_into(recipe, &simulator, new_folder.path())?;
    new_folder.publish()
}

/// Writes the points on all surfaces of the scene into `folder`. Returns an error if the write failed.
fn write_point_cloud(recipe: &SimulationRecipe, simulator: &Simulator, folder: &Path) -> Result<()> {
    let cloud = simulator.surface_points(recipe.points, recipe.seed);
    let comment = format!("simulated by pwrfgs: surfaces of {}", recipe.scene.name);
    let path = folder.join(POINTS);
    let result = fs::File::create(&path).and_then(|file| {
        let mut file = BufWriter::new(file);
        surface_points::write_ply(&cloud, &comment, &mut file)?;
        file.flush()
    });
    result.map_err(|e| Error::write(&path, e))
}
