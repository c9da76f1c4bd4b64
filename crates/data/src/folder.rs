//! Functions shared by all readers and writers of data folders.

use crate::geometry::read_points;
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{DataSource, Error, Origin, Pose, Receiver, Result, Simulation, files};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// File name of the point cloud in written folders.
pub(crate) const POINTS: &str = "points.csv";

/// Returns an error for an empty `root`.
pub(crate) fn check_root(root: &Path) -> Result<(), String> {
    if root.as_os_str().is_empty() {
        return Err("`root` is empty; name the folder of the data set, or `.` for this one".into());
    }
    Ok(())
}

/// Opens the folder `root` of the data source `plugin`, whose files are described by `layout`.
pub(crate) fn open_root(base: &Path, root: &Path, plugin: &str, layout: &str) -> Result<PathBuf> {
    let root = base.join(root);
    if root.is_dir() {
        return Ok(root);
    }
    let advice = how_to_get(plugin);
    Err(Error::input(&root, format!("no such folder ({layout}); set `root` of {plugin}, or {advice}")))
}

/// How to get data that the data source called `plugin` reads, as the advice of an error.
fn how_to_get(plugin: &str) -> &'static str {
    match plugin {
        "Nerf2Spectrum" | "Nerf2Rssi" => {
            "download the measured data: https://github.com/XPengZhao/NeRF2, see docs/data.md#get-measured-data"
        }
        "Colmap" => "run COLMAP on your images, see docs/data.md#camera-images",
        "Channels" => {
            "get the channels of NeWRF: https://github.com/LuHaofan/NeWRF, see docs/data.md#get-measured-data"
        }
        "Nerf2Csi" => {
            "simulate the data with `pwrfgs simulate SCENE --layout csi --out DIR`, see docs/data.md#simulate"
        }
        _ => "import your spectra with `pwrfgs import`, see docs/data.md#your-own-spectra",
    }
}

/// Creates the source with `read`, using the point cloud of `folder` if one of these files exists.
pub(crate) fn source_in<S: DataSource>(
    folder: &Path,
    files: &[&str],
    read: impl FnOnce(PathBuf, Option<PathBuf>) -> S,
) -> Option<Box<dyn DataSource>> {
    files.iter().find(|name| folder.join(name).exists())?;
    let points = [POINTS, "points.ply"].map(|name| folder.join(name)).into_iter().find(|path| path.exists());
    Some(Box::new(read(folder.to_owned(), points)))
}

/// Reads the point cloud of the setting `points`, metres; empty without the setting.
pub(crate) fn points_of(base: &Path, points: Option<&Path>) -> Result<Vec<[f64; 3]>> {
    points.map_or(Ok(Vec::new()), |points| read_points(&base.join(points)))
}

/// Name of a folder.
pub(crate) fn folder_name(root: &Path) -> String {
    strip_control(&root.file_name().map_or_else(|| "unnamed".into(), |n| n.to_string_lossy()))
}

/// `manifest.json` as written by `pwrfgs simulate`.
#[derive(Deserialize)]
struct Manifest {
    simulated: bool,
    scene: Option<String>,
}

/// Simulation of the data set `name` according to `manifest.json`, else according to its name.
pub(crate) fn simulation(root: &Path, name: &str) -> Option<Simulation> {
    let manifest =
        files::read_string(root.join("manifest.json")).ok().and_then(|text| serde_json::from_str(&text).ok());
    let by_name = || Manifest { simulated: name.to_lowercase().contains("simulated"), scene: None };
    let Manifest { simulated, scene } = manifest.unwrap_or_else(by_name);
    simulated.then_some(Simulation { scene })
}

/// Title of a data set in this layout.
pub(crate) fn title(name: &str, simulation: Option<&Simulation>, layout: &str) -> String {
    format!("{name} ({}{layout})", if simulation.is_some() { "" } else { "measured, " })
}

/// Content of `gateway_info.yml` for a data set called `name`.
pub fn gateway_yaml(name: &str, pose: &Pose) -> String {
    format!(
        "dataset_name: {}\ngateway1:\n  position: [{}]\n  orientation: [{}] # quaternion x, y, z, w\n",
        yaml(name),
        list(&pose.position),
        list(&pose.orientation)
    )
}

/// Content of `gateway_position.yml`: gateway names and positions, metres; orientations only if rotated.
pub fn gateway_positions_yaml<'a>(gateways: impl IntoIterator<Item = (&'a str, Pose)>) -> String {
    let line = |(name, pose): (&str, Pose)| {
        let (name, place) = (yaml(name), list(&pose.position));
        if pose.orientation == Pose::IDENTITY.orientation {
            return format!("{name}: [{place}]\n");
        }
        format!("{name}: {{position: [{place}], orientation: [{}]}}\n", list(&pose.orientation))
    };
    gateways.into_iter().map(line).collect()
}

/// Quotes text for YAML. JSON strings are valid YAML, except for a few characters written as numbers.
pub(crate) fn yaml(text: &str) -> String {
    let is_number = |c: char| c.is_control() || "\u{2028}\u{2029}\u{feff}\u{fffe}\u{ffff}".contains(c);
    let write = |c: char| if is_number(c) { format!("\\u{:04x}", u32::from(c)) } else { c.into() };
    serde_json::Value::from(text).to_string().chars().map(write).collect()
}

/// Content of `base-station.yml`: antenna positions, metres.
pub fn base_station_yaml(antennas: &[[f64; 3]]) -> String {
    let places: Vec<String> = antennas.iter().map(|place| format!("[{}]", list(place))).collect();
    format!("base_station: [{}]\n", places.join(", "))
}

/// Content of `receiver.yml`: pose, frequencies and antenna positions in the world frame; metres and Hz.
pub(crate) fn receiver_yaml(receiver: &Receiver, origin: Origin, frequencies_hz: &[f64]) -> String {
    let [first, last] = [frequencies_hz[0], frequencies_hz[frequencies_hz.len() - 1]];
    let carrier_hz = 0.5 * (first + last);
    let spacing_hz = (last - first) / (frequencies_hz.len() - 1).max(1) as f64;
    let pose = origin.world_pose(receiver.pose);
    let antenna = |about: [f64; 3]| format!("[{}]", list(&[0, 1, 2].map(|k| pose.position[k] + about[k])));
    format!(
        "name: {}\nposition: [{}]\norientation: [{}] # quaternion x, y, z, w\ncarrier_hz: {carrier_hz:?}\n\
         spacing_hz: {spacing_hz:?}\nfrequencies_hz: [{}]\nantennas: [{}] # in the world, metres\n",
        yaml(&receiver.name),
        list(&pose.position),
        list(&pose.orientation),
        list(frequencies_hz),
        receiver.array().into_iter().map(antenna).collect::<Vec<_>>().join(", ")
    )
}

fn list(v: &[f64]) -> String {
    v.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(", ")
}
