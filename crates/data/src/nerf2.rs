//! `Nerf2Spectrum`: measured spectra in the folder layout of NeRF2, and its tables of transmitter positions and receiver
//! poses.

mod csi;
pub(crate) mod index;
pub(crate) mod receivers;
mod rssi;
#[cfg(test)]
mod tests;

pub use csi::Nerf2Csi;
pub use rssi::{Nerf2Rssi, read_powers};

use crate::checks::shape_fault;
use crate::dialect::read_columns;
use crate::folder::{
    check_root, existing_root, find_point_cloud, folder_name, read_point_cloud, read_row_carriers, read_title,
    recognised_root,
};
use crate::pictures;
use pwrfgs_core::{
    DataSource, Dataset, Elevation, End, Ends, Error, JsonSchema, Pose, Progress, Receiver, Result, Sample, Unmatched,
    messages::strip_control,
};
use receivers::Gateway;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

const LAYOUT: &str = "a NeRF2 folder holds gateway_info.yml, tx_pos.csv and spectrum/00001.png ..";

/// Measured spatial spectra in the layout of NeRF2 (Zhao et al., 2023).
///
/// ```text
/// root/gateway_info.yml    gateway1: {position: [x, y, z], orientation: [x, y, z, w]}; metres, unit quaternion
/// root/tx_pos.csv          header with x, y, z among others; row k, counted from 1, is the transmitter of id k
/// root/spectrum/00001.png  8-bit grey, one channel, all of one size; a row is an elevation, a column an azimuth
/// root/freq.txt            optional, for several carriers: line k is the carrier of row k, GHz; numbers from 1e6 are Hz
/// root/train_index.txt     ids, one per line; the files train_index.txt and
/// root/test_index.txt      test_index.txt must both exist or both be absent
/// ```
///
/// The samples are the ids that have a row and an image; index files must not contain other ids. Lines may end in LF or
/// CRLF, and ids may be zero-padded. Images stay 8-bit in memory and set the size of the image plane.
///
/// With `freq.txt`, every carrier is a receiver with a name such as `2400MHz`, and samples at equal positions have one
/// transmitter.
///
/// Images cover 360 degrees of azimuth. Their rows cover elevations 0 to 90 degrees, row 0 in the plane of the array,
/// unless `elevation` here or the key `elevation: [first, last]` of `gateway_info.yml` sets another range: a full
/// sphere has `elevation: (-90, 90)`. Without either, images such as 360 x 180 are rejected, whose pixels have sides
/// that differ by more than a factor of 1.75; with one, the limit is a factor of 4.
///
/// Simulated data are recognised by the `manifest.json` of `pwrfgs simulate`, which also names the scene, or by the
/// word «simulated» in the name of the data set. All other data count as measured.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// let data = Plugin::<dyn DataSource>::parse(r#"Nerf2Spectrum(root: "data/s23", points: "room.ply")"#);
/// assert!(data.is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Nerf2Spectrum {
    /// Data folder, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Point cloud of the room (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub points: Option<PathBuf>,
    /// Receiver to use if `gateway_info.yml` lists more than `gateway1`; required if it lists several. Keys without
    /// `position` that are not called gateway are ignored.
    pub gateway: Option<String>,
    /// Elevations of the upper edge of the top row and the lower edge of the bottom row, degrees. Without it: the value
    /// in `gateway_info.yml`, else 0 and 90.
    pub elevation: Option<Elevation>,
}

impl Default for Nerf2Spectrum {
    fn default() -> Self {
        Self { root: "data/s23".into(), points: None, gateway: None, elevation: None }
    }
}

#[typetag::serde]
impl DataSource for Nerf2Spectrum {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(pwrfgs_core::Task::Spectrum)
    }

    /// Loads the ids that have a row and an image. Index files are checked before images are decoded.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = existing_root(base, &self.root, "Nerf2Spectrum", LAYOUT)?;
        let gateway = Gateway::read(&root.join("gateway_info.yml"), self.gateway.as_deref(), LAYOUT)?;
        let positions = read_transmitters(&root.join("tx_pos.csv"))?;
        let files = pictures::list_images(&root.join("spectrum"), LAYOUT)?;
        let image_ids = files.keys().copied().collect();
        let ids: Vec<u32> = files.keys().copied().filter(|&id| id as usize <= positions.len()).collect();
        let valid_ids =
            index::SpectrumIds { table: "tx_pos.csv", rows: positions.len(), images: &image_ids, samples: &ids };
        let official = index::read_sets(&root, &|word| valid_ids.parse_id(word))?;
        check_matches(&root, ids.len(), files.len())?;
        let points = read_point_cloud(base, self.points.as_deref())?;
        let paths: Vec<&Path> = ids.iter().map(|id| files[id].as_path()).collect();
        let spectra = pictures::load_spectra(
            &paths,
            &|path| pictures::decode_grey_png(path, pictures::Depth::Eight, None),
            progress,
        )?;
        let stated = self.elevation.or(gateway.elevation);
        let elevation = stated.unwrap_or(Elevation::UPPER);
        check_image_size(paths[0], elevation, stated.is_some(), (spectra.width(), spectra.height()))?;
        let unmatched = Unmatched { positions: positions.len() - ids.len(), spectra: files.len() - ids.len() };
        let samples: Vec<Sample> = ids.iter().map(|&id| Sample::new(id, positions[id as usize - 1])).collect();
        let name = gateway.name.as_deref().map_or_else(|| folder_name(&root), strip_control);
        let (title, simulation) = read_title(&root, &name, "NeRF2 layout");
        let data = Dataset::of_links(title, vec![gateway.create_receiver()], points, &samples, spectra.into())?;
        let data = Dataset { elevation, official, simulation, unmatched, ..data };
        match read_row_carriers(&root, "tx_pos.csv", positions.len())? {
            Some(rows) => data.with_carriers(&ids.iter().map(|&id| rows[id as usize - 1]).collect::<Vec<f64>>()),
            None => Ok(data),
        }
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let root = recognised_root(folder, &["spectrum", "gateway_info.yml"])?;
        Some(Box::new(Self { points: find_point_cloud(&root), root, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)?;
        self.elevation.and_then(Elevation::fault).map_or(Ok(()), Err)
    }
}

/// Warns of images in the folder `root` that have no row in `tx_pos.csv`: all but `matched` of `images`. Returns an error if
/// no image has one.
fn check_matches(root: &Path, matched: usize, images: usize) -> Result<()> {
    if matched == 0 {
        let problem = format!("no image matches a row of tx_pos.csv; {LAYOUT}");
        return Err(Error::input(&root.join("spectrum"), problem));
    }
    if matched < images {
        let count = images - matched;
        tracing::warn!("{count} images of {} have no row in tx_pos.csv and are left out", root.display());
    }
    Ok(())
}

/// Returns an error, which names `path`, if the `size` of spectra, width and height in pixels, does not suit their elevations.
/// `stated`: the elevations come from a setting or a file.
pub(crate) fn check_image_size(path: &Path, elevation: Elevation, stated: bool, size: (usize, usize)) -> Result<()> {
    let advice =
        "`elevation: (-90, 90)` of the data source for a full sphere, or `elevation: [-90, 90]` in gateway_info.yml";
    shape_fault(elevation, stated, size, advice).map_or(Ok(()), |fault| Err(Error::input(path, fault)))
}

/// Reads transmitter positions `[rows,3]` from a table with the columns x, y and z, metres, such as `tx_pos.csv`.
///
/// # Errors
/// The file cannot be read, or has no row or an invalid one; the message has line and column.
pub fn read_transmitters(path: &Path) -> Result<Vec<[f64; 3]>> {
    let advice = "give every row x, y and z in metres";
    read_columns(path, ["x", "y", "z"], advice, |row| row.position(row.fields, advice))
}

/// Poses of moving receivers, instead of the table of transmitter positions.
pub const POSES: &str = "rx_pose.csv";

/// Locations of the moving end in a folder.
pub(crate) struct LocationTable {
    /// File for messages: the path of the positions, or [`POSES`].
    pub(crate) name: String,
    /// End that moves.
    pub(crate) moving: End,
    /// Poses in file order; transmitters have world axes.
    pub(crate) poses: Vec<Pose>,
}

impl LocationTable {
    /// Reads [`POSES`] in the folder `root` if it exists, else the positions in the table `transmitters`, such as
    /// `tx_pos.csv`. Returns an error for an invalid table.
    pub(crate) fn read(root: &Path, transmitters: &Path) -> Result<Self> {
        let poses = root.join(POSES);
        if poses.exists() {
            return Ok(Self { name: POSES.into(), moving: End::Receiver, poses: read_poses(&poses)? });
        }
        let poses = read_transmitters(transmitters)?.into_iter().map(Pose::from).collect();
        Ok(Self { name: transmitters.display().to_string(), moving: End::Transmitter, poses })
    }

    /// Returns the ends of the links at `receivers`; `transmitter` is the position of the fixed one if the receivers move.
    pub(crate) fn link_ends(&self, receivers: Vec<Receiver>, transmitter: Option<[f64; 3]>) -> Ends {
        match self.moving {
            End::Transmitter => receivers.into(),
            End::Receiver => Ends::of_moving_receivers(receivers, transmitter),
        }
    }
}

/// Reads the poses of a moving receiver: a table with the columns x, y, z in metres and the quaternion qx, qy, qz, qw from
/// receiver axes to world axes, in any order among other columns.
///
/// # Errors
/// The file cannot be read, or has no row or an invalid one; the message has line and column.
pub fn read_poses(path: &Path) -> Result<Vec<Pose>> {
    let advice = "give every row x, y and z in metres, and the unit quaternion qx, qy, qz and qw";
    read_columns(path, ["x", "y", "z", "qx", "qy", "qz", "qw"], advice, |row| {
        let [x, y, z, quaternion @ ..] = row.fields;
        let [qx, qy, qz, qw] = quaternion.map(|field| row.coordinate(field, advice));
        let pose = Pose { position: row.position([x, y, z], advice)?, orientation: [qx?, qy?, qz?, qw?] };
        pose.fault().map_or(Ok(pose), |(_, fault)| Err(row.fault(quaternion[0].column, fault)))
    })
}
