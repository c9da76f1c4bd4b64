//! `Arrays`: spectra and transmitter positions stored as NumPy arrays.

#[cfg(test)]
mod tests;

use crate::checks::spectrum_fault;
use crate::folder::{
    check_root, existing_root, find_point_cloud, folder_name, read_point_cloud, read_row_carriers, read_title,
    recognised_root, restore_saved,
};
use crate::nerf2::{LocationTable, POSES, check_image_size, index, receivers::Gateway};
use crate::npy;
use pwrfgs_core::{DataSource, Dataset, Elevation, End, Error, JsonSchema, Pose, Progress, Result, Sample, Spectra};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

const LAYOUT: &str = "a folder of arrays holds gateway_info.yml, tx.npy and spectra.npy; `pwrfgs import` writes one";
/// Largest spectra array that is read into memory, bytes. Later changes of its file do not affect a run.
const IN_MEMORY: u64 = 1 << 29;

/// Spectra and transmitter positions as NumPy arrays. `pwrfgs import` creates such a folder from your files.
///
/// ```text
/// root/gateway_info.yml    gateway1: {position: [x, y, z], orientation: [x, y, z, w]}; metres, unit quaternion
/// root/tx.npy              [M, 3], float64 or float32, metres; or tx_pos.csv with columns x, y, z
/// root/rx_pose.csv         instead of both, if the receiver moves: columns x, y, z, qx, qy, qz, qw of its pose, one row per
///                          spectrum; gateway_info.yml then has the position of the fixed transmitter
/// root/spectra.npy         [M, H, W]: a row is an elevation, a column an azimuth; uint8 (255 is 1), uint16 (65535 is 1),
///                          or float32 and float64 from 0 to 1
/// root/freq.txt            optional, for several carriers: line k is the carrier of spectrum k, GHz; numbers from 1e6 are
///                          Hz. Every carrier is a receiver with a name such as `2400MHz`
/// root/ids.txt             optional: id of each transmitter position, ascending; without it, rows are counted from 1
/// root/train_index.txt     rows, one per line, counted from 1; the files train_index.txt and
/// root/test_index.txt      test_index.txt must both exist or both be absent
/// ```
///
/// Spectra of up to 512 MB are read into memory. Larger arrays stay in their file, which must not change during a run;
/// each spectrum is read when it is needed, so memory use does not depend on their number. Floats are validated when
/// they are loaded.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn DataSource>::parse(r#"Arrays(root: "data/mine")"#).is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Arrays {
    /// Data folder, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Point cloud of the room (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub points: Option<PathBuf>,
    /// Elevations of the upper edge of the top row and the lower edge of the bottom row, degrees. Without it: the value
    /// in `gateway_info.yml`, else 0 and 90.
    pub elevation: Option<Elevation>,
}

impl Default for Arrays {
    fn default() -> Self {
        Self { root: "data/mine".into(), points: None, elevation: None }
    }
}

#[typetag::serde]
impl DataSource for Arrays {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(pwrfgs_core::Task::Spectrum)
    }

    /// Loads the folder. Positions, index files and points are checked before the values of the spectra, which take longest.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = existing_root(base, &self.root, "Arrays", LAYOUT)?;
        let gateway = Gateway::read(&root.join("gateway_info.yml"), None, LAYOUT)?;
        let (csv, npy) = (root.join("tx_pos.csv"), root.join("tx.npy"));
        // Without any of the three files, the error names tx.npy.
        let locations = if !root.join(POSES).exists() && (npy.exists() || !csv.exists()) {
            let poses = npy::read_positions(&npy)?.into_iter().map(Pose::from).collect();
            LocationTable { name: "tx.npy".into(), moving: End::Transmitter, poses }
        } else {
            LocationTable::read(&root, &csv)?
        };
        let table = locations.name.rsplit(['/', '\\']).next().unwrap_or_default();
        let path = root.join("spectra.npy");
        let spectra = npy::open_spectra(&path)?;
        let ids: Vec<u32> = (1..=locations.poses.len() as u32).collect();
        if spectra.len() != ids.len() {
            let problem = format!("holds {} spectra, but {table} {} positions", spectra.len(), ids.len());
            return Err(Error::input(&path, format!("{problem}; give as many of each")));
        }
        let images = ids.iter().copied().collect();
        let valid_ids = index::SpectrumIds { table, rows: ids.len(), images: &images, samples: &ids };
        let official = index::read_sets(&root, &|word| valid_ids.parse_id(word))?;
        let points = read_point_cloud(base, self.points.as_deref())?;
        let spectra = validate_spectra(spectra, &path, progress)?;
        let stated = self.elevation.or(gateway.elevation);
        let elevation = stated.unwrap_or(Elevation::UPPER);
        check_image_size(&path, elevation, stated.is_some(), (spectra.width(), spectra.height()))?;
        let samples: Vec<Sample> = ids.iter().zip(&locations.poses).map(|(&id, pose)| Sample::new(id, *pose)).collect();
        let name = gateway.name.clone().unwrap_or_else(|| folder_name(&root));
        let (title, simulation) = read_title(&root, &name, "arrays");
        let ends = locations.link_ends(vec![gateway.create_receiver()], Some(gateway.pose.position));
        let data = Dataset::of_links(title, ends, points, &samples, spectra.into())?;
        let data = Dataset { elevation, official, simulation, ..data };
        let data = match read_row_carriers(&root, table, data.len())? {
            Some(carriers) => data.with_carriers(&carriers)?,
            None => data,
        };
        restore_saved(&root, data)
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let root = recognised_root(folder, &["spectra.npy"])?;
        Some(Box::new(Self { points: find_point_cloud(&root), root, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)?;
        self.elevation.and_then(Elevation::fault).map_or(Ok(()), Err)
    }
}

/// Returns the spectra of the file `path`, in memory if they have at most [`IN_MEMORY`] bytes. Returns an error for the first
/// float spectrum with an invalid value, or if the file cannot be read. `progress` counts spectra.
fn validate_spectra(spectra: Spectra, path: &Path, progress: Progress<'_>) -> Result<Spectra> {
    let bytes = spectra.len() * spectra.width() * spectra.height() * spectra.number().bytes();
    let spectra = if bytes as u64 <= IN_MEMORY { spectra.into_memory()? } else { spectra };
    let count = spectra.len();
    if spectra.number().is_float() {
        let done = AtomicUsize::new(0);
        let fault = |i: usize| {
            let fault = spectrum_fault(&spectra, i);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, count);
            fault
        };
        // The first error, independent of the number of threads.
        if let Some(fault) = (0..count).into_par_iter().find_map_first(fault) {
            return Err(Error::input(path, fault));
        }
        spectra.check()?;
    }
    progress(count, count);
    Ok(spectra)
}
