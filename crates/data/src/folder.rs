//! What every reader of a data folder reads alike.

use crate::points::read_points;
use pwrfgs_core::{DataSource, Error, Result, Simulation, files, words::clean};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The point cloud of a folder that is written here.
pub(crate) const POINTS: &str = "points.csv";

/// Refuses an empty `root`.
pub(crate) fn check_root(root: &Path) -> Result<(), String> {
    if root.as_os_str().is_empty() {
        return Err("`root` is empty; name the folder of the data set, or `.` for this one".into());
    }
    Ok(())
}

/// The folder `root` of the data source called `plugin`, whose files are those of `layout`.
pub(crate) fn open_root(base: &Path, root: &Path, plugin: &str, layout: &str) -> Result<PathBuf> {
    let root = base.join(root);
    if root.is_dir() {
        return Ok(root);
    }
    Err(Error::input(&root, format!("no such folder; set `root` of {plugin} ({layout})")))
}

/// The source that `read` makes of `folder` and its point cloud, if the folder holds one of these files.
pub(crate) fn source_in<S: DataSource>(
    folder: &Path,
    files: &[&str],
    read: impl FnOnce(PathBuf, Option<PathBuf>) -> S,
) -> Option<Box<dyn DataSource>> {
    files.iter().find(|name| folder.join(name).exists())?;
    let points = [POINTS, "points.ply"].map(|name| folder.join(name)).into_iter().find(|path| path.exists());
    Some(Box::new(read(folder.to_owned(), points)))
}

/// The point cloud that the setting `points` names, metres; empty if it names none.
pub(crate) fn points_of(base: &Path, points: Option<&Path>) -> Result<Vec<[f64; 3]>> {
    points.map_or(Ok(Vec::new()), |points| read_points(&base.join(points)))
}

/// The name of a folder.
pub(crate) fn folder_name(root: &Path) -> String {
    clean(&root.file_name().map_or_else(|| "unnamed".into(), |n| n.to_string_lossy()))
}

/// `manifest.json`, as `pwrfgs simulate` writes it.
#[derive(Deserialize)]
struct Manifest {
    simulated: bool,
    scene: Option<String>,
}

/// What the data set called `name` says of itself: in `manifest.json`, or in its name if there is none.
pub(crate) fn simulation(root: &Path, name: &str) -> Option<Simulation> {
    let manifest =
        files::read_string(root.join("manifest.json")).ok().and_then(|text| serde_json::from_str(&text).ok());
    let by_name = || Manifest { simulated: name.to_lowercase().contains("simulated"), scene: None };
    let Manifest { simulated, scene } = manifest.unwrap_or_else(by_name);
    simulated.then_some(Simulation { scene })
}

/// Title of a data set of this layout.
pub(crate) fn title(name: &str, simulation: Option<&Simulation>, layout: &str) -> String {
    format!("{name} ({}{layout})", if simulation.is_some() { "" } else { "measured, " })
}
