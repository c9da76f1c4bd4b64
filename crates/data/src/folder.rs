//! Functions shared by all readers and writers of data folders.

use crate::geometry::read_points;
use crate::text::{TextRow, read_text, unreadable_error};
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::{Dataset, Error, Geodetic, Pose, Receiver, Result, Simulation, carrier_fault, files, position_fault};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
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

/// Returns the path of the folder `root`, relative to `base`, of the data source `plugin`. Returns an error with its `layout`
/// if there is no such folder.
pub(crate) fn existing_root(base: &Path, root: &Path, plugin: &str, layout: &str) -> Result<PathBuf> {
    let root = base.join(root);
    if root.is_dir() {
        return Ok(root);
    }
    let advice = download_advice(plugin);
    Err(Error::input(&root, format!("no such folder ({layout}); set `root` of {plugin}, or {advice}")))
}

/// Returns the advice of an error message: how to get data that the data source called `plugin` reads.
fn download_advice(plugin: &str) -> &'static str {
    match plugin {
        "Nerf2Spectrum" | "Nerf2Rssi" => {
            "download the measured data: https://github.com/XPengZhao/NeRF2, see docs/data.md#get-measured-data"
        }
        "Colmap" => "run COLMAP on your images, see docs/data.md#camera-images",
        "Channels" => {
            "get the channels of NeWRF: https://github.com/LuHaofan/NeWRF, see docs/data.md#get-measured-data"
        }
        "Nerf2Csi" => "simulate the data with `pwrfgs simulate SCENE --layout csi --out DIR`, see docs/simulator.md",
        _ => "import your spectra with `pwrfgs import`, see docs/data.md#your-own-spectra",
    }
}

/// Returns `folder` as the `root` of a data source if it holds one of these files, otherwise `None`.
pub(crate) fn recognised_root(folder: &Path, files: &[&str]) -> Option<PathBuf> {
    files.iter().any(|name| folder.join(name).exists()).then(|| folder.to_owned())
}

/// Returns the path of the point cloud in a data folder; `None` without one.
pub(crate) fn find_point_cloud(root: &Path) -> Option<PathBuf> {
    [POINTS, "points.ply"].map(|name| root.join(name)).into_iter().find(|path| path.exists())
}

/// Reads the point cloud of the setting `points`, a path relative to `base`: `[P,3]` in metres, empty without the
/// setting. Returns the errors of [`read_points`].
pub(crate) fn read_point_cloud(base: &Path, points: Option<&Path>) -> Result<Vec<[f64; 3]>> {
    points.map_or(Ok(Vec::new()), |points| read_points(&base.join(points)))
}

/// Returns the name of a folder, without control characters; `unnamed` for a path without a name, such as `..`.
pub(crate) fn folder_name(root: &Path) -> String {
    strip_control(&root.file_name().map_or_else(|| "unnamed".into(), |n| n.to_string_lossy()))
}

/// Returns the paths of the files in a folder by id: those named by a number with this `extension`. `advice` is the next
/// step if the folder does not exist. Returns an error for a repeated id.
pub(crate) fn list_numbered_files(folder: &Path, extension: &str, advice: &str) -> Result<BTreeMap<u32, PathBuf>> {
    let mut files = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(|e| unreadable_error(folder, e, "folder", advice))? {
        let path = entry.map_err(|e| Error::read(folder, e))?.path();
        let Some(id) = parse_file_id(&path, extension) else { continue };
        if let Some(other) = files.insert(id, path.clone()) {
            // The folder order is arbitrary; the message must not depend on it.
            let (first, second) = if other < path { (other, path) } else { (path, other) };
            let name = first.file_name().unwrap_or_default().to_string_lossy();
            return Err(Error::input(&second, format!("{name} is id {id} as well; remove one of the two")));
        }
    }
    Ok(files)
}

/// Parses the id in a file name such as `00012.png`; `None` for other names and other extensions.
fn parse_file_id(path: &Path, extension: &str) -> Option<u32> {
    let stem = path.file_stem()?.to_str()?;
    let has_extension = path.extension()?.eq_ignore_ascii_case(extension);
    (has_extension && stem.bytes().all(|b| b.is_ascii_digit())).then(|| stem.parse().ok())?
}

/// Unit of received powers of receivers that are not calibrated.
pub(crate) const RELATIVE: &str = "dB (relative)";

/// `manifest.json` as written by `pwrfgs simulate`, `pwrfgs import` and [`save`](crate::save()), which must use the names of
/// the fields as keys.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Manifest {
    simulated: Option<bool>,
    scene: Option<String>,
    /// Title and bounds of the scene (metres, user's frame) of saved data.
    title: Option<String>,
    bounds: Option<[[f64; 3]; 2]>,
    /// Values of a table of powers that mean "not received", beside empty cells; absent in folders that declare none.
    missing: Option<Vec<f64>>,
    /// Latitude and longitude of the zero of the frame.
    geodetic: Option<Geodetic>,
    /// Receivers whose position is an estimate.
    estimated_receivers: Vec<String>,
    /// Findings that the user accepted.
    accepted: Vec<String>,
    /// Unit of the powers, if it is not dBm: [`RELATIVE`].
    unit: Option<String>,
    /// Height of the transmitters on each floor, metres.
    floors: BTreeMap<String, f64>,
}

impl Manifest {
    /// Reads the manifest in `root`; `None` without a valid one.
    fn read(root: &Path) -> Option<Self> {
        serde_json::from_str(&files::read_string(root.join("manifest.json")).ok()?).ok()
    }
}

/// Returns the values of a table of powers that mean "not received" according to `manifest.json` in `root`; `None` if it declares
/// none.
pub(crate) fn read_missing(root: &Path) -> Option<Vec<f64>> {
    Manifest::read(root)?.missing
}

/// Returns the simulation of the data set `name` according to `manifest.json` in `root`, else according to its name; `None`
/// for measured data.
pub(crate) fn read_simulation(root: &Path, name: &str) -> Option<Simulation> {
    let Manifest { simulated, scene, .. } = Manifest::read(root).unwrap_or_default();
    simulated.unwrap_or_else(|| name.to_lowercase().contains("simulated")).then_some(Simulation { scene })
}

/// File of the IDs of the transmitter positions, or of the poses of a moving receiver, one per line.
pub(crate) const IDS: &str = "ids.txt";

/// Restores the properties that [`save`](crate::save()) writes in addition to the layout in `root`: IDs from [`IDS`]; title,
/// bounds and zero of the scene, floors, estimated receivers, unit and accepted findings from `manifest.json`. Data of folders
/// without these files stay as they are.
///
/// # Errors
/// A line of [`IDS`] is not an ID above that of the line before, or there is another number of lines than of locations; the
/// message has the line.
pub(crate) fn restore_saved(root: &Path, mut data: Dataset) -> Result<Dataset> {
    let path = root.join(IDS);
    if path.exists() {
        let ids = read_ascending(&path, "ID")?;
        if ids.len() != data.locations.len() {
            let (lines, locations) = (ids.len(), data.locations.len());
            let problem =
                format!("has {lines} lines, but the data have {locations} positions; write one ID per position");
            return Err(Error::input(&path, problem));
        }
        data.locations.iter_mut().zip(ids).for_each(|(location, id)| location.id = id);
    }
    if let Some(Manifest { title, bounds, geodetic, estimated_receivers, accepted, unit, floors, .. }) =
        Manifest::read(root)
    {
        (data.accepted, data.scene.floors) = (accepted, floors);
        data.scene.geodetic = geodetic.filter(|geodetic| geodetic.is_valid());
        let is_estimated = |receiver: &Receiver| estimated_receivers.contains(&receiver.name);
        for receiver in &mut data.scene.receivers {
            receiver.is_estimated = is_estimated(receiver);
            receiver.is_relative = unit.as_deref() == Some(RELATIVE);
        }
        if let Some(title) = title {
            data.title = strip_control(&title);
            data.title = data.marked_title();
        }
        let is_valid = |[low, high]: &[[f64; 3]; 2]| {
            [low, high].iter().all(|corner| position_fault(**corner).is_none()) && (0..3).all(|k| low[k] <= high[k])
        };
        if let Some(bounds) = bounds.filter(is_valid) {
            data.scene.bounds = bounds.map(|corner| data.scene.origin.local(corner)).into();
        }
    }
    Ok(data)
}

/// Formats numbers, one per line.
pub(crate) fn format_lines(numbers: impl IntoIterator<Item = usize>) -> String {
    let mut text = String::new();
    numbers.into_iter().for_each(|number| writeln!(text, "{number}").expect("text grows"));
    text
}

/// Reads numbers in ascending order, one `noun` per line.
///
/// # Errors
/// The file cannot be read, or a line is no number above that of the line before; the message has the line.
pub(crate) fn read_ascending(path: &Path, noun: &str) -> Result<Vec<u32>> {
    let advice = format!("write one {noun} per line, in ascending order, such as 17");
    let text = read_text(path, MAX_TEXT, &advice)?;
    let mut numbers: Vec<u32> = Vec::new();
    for (line, word) in (1..).zip(text.trim_end().lines()) {
        let fault = |problem: &str| Error::at(path, line, 1, format!("{} is {problem}; {advice}", quoted(word)));
        let number = word.trim().parse().ok().ok_or_else(|| fault("not a number from 0"))?;
        if numbers.last().is_some_and(|last| *last >= number) {
            return Err(fault("not above the number before"));
        }
        numbers.push(number);
    }
    Ok(numbers)
}

/// Returns the title of the data set `name` in a layout, as [`dataset_title`], and its simulation, as [`read_simulation`];
/// `None` for measured data.
pub(crate) fn read_title(root: &Path, name: &str, layout: &str) -> (String, Option<Simulation>) {
    let simulation = read_simulation(root, name);
    (dataset_title(name, simulation.as_ref(), layout), simulation)
}

/// Returns the title of a data set in a layout such as `arrays`; it says whether the data are measured.
pub(crate) fn dataset_title(name: &str, simulation: Option<&Simulation>, layout: &str) -> String {
    format!("{name} ({}{layout})", if simulation.is_some() { "" } else { "measured, " })
}

/// Returns the content of `gateway_info.yml` for a data set called `name` and the pose of its receiver, metres.
pub fn gateway_yaml(name: &str, Pose { position, orientation }: &Pose) -> String {
    let name = quote_yaml(name);
    format!(
        "dataset_name: {name}\ngateway1:\n  position: {position:?}\n  orientation: {orientation:?} # quaternion x, y, z, w\n"
    )
}

/// Returns the content of `gateway_position.yml`: gateway names and positions, metres; orientations only if rotated.
pub fn gateway_positions_yaml<'a>(gateways: impl IntoIterator<Item = (&'a str, Pose)>) -> String {
    let line = |(name, Pose { position, orientation }): (&str, Pose)| {
        let name = quote_yaml(name);
        if orientation == Pose::IDENTITY.orientation {
            return format!("{name}: {position:?}\n");
        }
        format!("{name}: {{position: {position:?}, orientation: {orientation:?}}}\n")
    };
    gateways.into_iter().map(line).collect()
}

/// Returns text as a quoted YAML scalar. JSON strings are valid YAML, except for a few characters, written as numbers.
pub(crate) fn quote_yaml(text: &str) -> String {
    let is_number = |c: char| c.is_control() || "\u{2028}\u{2029}\u{feff}\u{fffe}\u{ffff}".contains(c);
    let write = |c: char| if is_number(c) { format!("\\u{:04x}", u32::from(c)) } else { c.into() };
    serde_json::Value::from(text).to_string().chars().map(write).collect()
}

/// Returns the content of `base-station.yml`: antenna positions, metres.
pub fn base_station_yaml(antennas: &[[f64; 3]]) -> String {
    format!("base_station: {antennas:?}\n")
}

/// Returns the content of `receiver.yml` for [`Channels`](crate::Channels): the `name`, which must be a YAML scalar, the pose in
/// the world frame (metres), the carrier and the subcarrier spacing (Hz), the subcarriers `[F]` (Hz), and antenna positions
/// `[A,3]` (metres) in the world frame, or in the frame of a moving receiver.
pub fn receiver_yaml(
    name: &str,
    Pose { position, orientation }: &Pose,
    [carrier_hz, spacing_hz]: [f64; 2],
    frequencies_hz: &[f64],
    antennas: &[[f64; 3]],
) -> String {
    format!(
        "name: {name}\nposition: {position:?}\norientation: {orientation:?} # quaternion x, y, z, w\ncarrier_hz: {carrier_hz:?}\n\
         spacing_hz: {spacing_hz:?}\nfrequencies_hz: {frequencies_hz:?}\n\
         antennas: {antennas:?} # metres; in the world, or in the frame of a moving receiver\n"
    )
}

/// Returns the line of `receiver.yml` for the fixed transmitter of a moving receiver, metres; empty if it is unknown.
pub fn transmitter_yaml(position: Option<[f64; 3]>) -> String {
    position.map_or_else(String::new, |position| format!("transmitter: {position:?}\n"))
}

/// File of the carriers.
pub const CARRIERS: &str = "freq.txt";
/// Smallest number that is in Hz; smaller ones are in GHz.
const LEAST_HZ: f64 = 1e6;

/// Reads the carriers of the rows of `table`, Hz, from `freq.txt` in the folder `root`, one line per row; `None` without
/// the file.
///
/// # Errors
/// Those of [`read_carriers`], or another number of lines than `rows`.
pub(crate) fn read_row_carriers(root: &Path, table: &str, rows: usize) -> Result<Option<Vec<f64>>> {
    let path = root.join(CARRIERS);
    if !path.exists() {
        return Ok(None);
    }
    let carriers = read_carriers(&path)?;
    if carriers.len() != rows {
        let problem = format!("has {} lines, but {table} has {rows} rows; write one line per row", carriers.len());
        return Err(Error::input(&path, problem));
    }
    Ok(Some(carriers))
}

/// Reads one carrier per line, Hz: numbers are in GHz, and from 1e6 in Hz.
///
/// # Errors
/// The file cannot be read, or a line has another number of fields than one or an invalid carrier; the message has line
/// and column.
pub fn read_carriers(path: &Path) -> Result<Vec<f64>> {
    let advice = "write the carrier of one sample per line, in GHz, such as 2.4";
    let text = read_text(path, MAX_TEXT, advice)?;
    let carrier = |line| {
        let row = TextRow::split_at_blanks(path, line);
        let [field] = row.fields[..] else {
            return Err(row.fault(1, format!("{} numbers, expected 1; {advice}", row.fields.len())));
        };
        let value = row.number(field, advice)?;
        let hz = if value < LEAST_HZ { (value * 1e9).round() } else { value };
        carrier_fault(hz).map_or(Ok(hz), |fault| Err(row.fault(field.column, format!("{fault}, or in GHz"))))
    };
    (1..).zip(text.trim_end().lines()).map(carrier).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_str(text: &str, rows: usize) -> Result<Option<Vec<f64>>, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(CARRIERS), text).unwrap();
        let message = |e: Error| e.to_string().replace(&folder.path().display().to_string(), "DIR");
        read_row_carriers(folder.path(), "tx_pos.csv", rows).map_err(message)
    }

    #[test]
    fn reads_gigahertz_and_hertz() {
        assert_eq!(read_str("1\r\n2.412\n24.25\n928e6\n\n", 4).unwrap().unwrap(), [1e9, 2.412e9, 24.25e9, 928e6]);
        assert_eq!(read_row_carriers(Path::new("/none"), "tx_pos.csv", 4).unwrap(), None);
    }

    #[test]
    fn reports_line_and_next_step() {
        let advice = "write the carrier of one sample per line, in GHz, such as 2.4";
        let cases = [
            ("2.4\nabc\n", format!("DIR/freq.txt:2:1: `abc` is not a number; {advice}")),
            ("2.4\n\n2.4\n", format!("DIR/freq.txt:2:1: 0 numbers, expected 1; {advice}")),
            ("2.4 2.5\n", format!("DIR/freq.txt:1:1: 2 numbers, expected 1; {advice}")),
            ("inf\n", format!("DIR/freq.txt:1:1: `inf` is not finite; {advice}")),
            (
                "2.4\n -1\n",
                "DIR/freq.txt:2:2: the carrier is -1000000000.0 Hz; give a frequency between 1e6 and 1e12 Hz, or in GHz".into(),
            ),
            ("2.4\n", "DIR/freq.txt: has 1 lines, but tx_pos.csv has 2 rows; write one line per row".into()),
            ("", "DIR/freq.txt: has 0 lines, but tx_pos.csv has 2 rows; write one line per row".into()),
        ];
        for (text, message) in cases {
            let error = read_str(text, 2).unwrap_err();
            assert!(error.contains(&message), "{error}");
        }
    }
}
