//! `Nerf2Rssi`: received powers at many gateways in the folder layout of NeRF2.

#[cfg(test)]
mod tests;

use super::receivers::read_gateways;
use super::{LocationTable, POSES, index};
use crate::checks::NOT_RECEIVED;
use crate::dialect::{GROWING, TableText};
use crate::folder::{
    check_root, existing_root, find_point_cloud, folder_name, read_missing, read_point_cloud, read_title,
    recognised_root, restore_saved,
};
use crate::text::{DBM_ADVICE, TextRow};
use pwrfgs_core::messages::{quoted, strip_control, text_of};
use pwrfgs_core::{
    DataSource, Dataset, Error, JsonSchema, Pose, Progress, Real, Receiver, Result, Sample, did_you_mean,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const LAYOUT: &str = "a NeRF2 folder of powers holds gateway_position.yml, gateway_rssi.csv and tx_pos.csv";

/// Received powers (RSSI) at many gateways in the layout of NeRF2 (Zhao et al., 2023).
///
/// ```text
/// root/gateway_position.yml    g01: [x, y, z], one line per gateway; metres; with a rotation:
///                              g01: {position: [x, y, z], orientation: [x, y, z, w]}, a unit quaternion
/// root/gateway_rssi.csv        header with the gateway names; row k: received powers, dBm; empty cell, NaN or -100: no signal
/// root/tx_pos.csv              header with x, y, z among others; row k is the transmitter; metres
/// root/rx_pose.csv             instead of tx_pos.csv, if the receivers move: columns x, y, z, qx, qy, qz, qw of their pose;
///                              gateway_position.yml then has the position of the fixed transmitter under each name
/// root/train_index.txt         rows counted from 0, one per line; the files train_index.txt and
/// root/test_index.txt          test_index.txt must both exist or both be absent
/// ```
///
/// A link is a transmitter and a gateway that received it. An empty cell and NaN mark a missing link, and so does -100, unless
/// `manifest.json` declares other values: `"missing": []` if -100 dBm is a reading. Gateways that received nothing are left
/// out with a warning. The id of a transmitter is its row, counted from 0 as in the index files (ids of spectra count from 1),
/// or line k of `ids.txt`, if there is one. The split of the index files assigns all links of a transmitter to one set.
/// Gateways are receivers of the same name, in the order of `gateway_position.yml`.
///
/// Limits of the data released by NeRF2: it is unknown whether rows are in order of time, so `TimeBlock` may not hold
/// out a block of time. The gateways `g08` and `g09` have the same coordinates, so hold out both or neither. The
/// gateways are in three separate areas; each transmitter is received in one of them.
///
/// Data count as simulated if their name contains the word «simulated» or their `manifest.json` declares it.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn DataSource>::parse(r#"Nerf2Rssi(root: "data/ble")"#).is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Nerf2Rssi {
    /// Data folder, relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub root: PathBuf,
    /// Point cloud of the rooms (PLY, XYZ or CSV, metres, world frame), relative to the pipeline file.
    #[schemars(extend("format" = "path"))]
    pub points: Option<PathBuf>,
}

impl Default for Nerf2Rssi {
    fn default() -> Self {
        Self { root: "data/ble".into(), points: None }
    }
}

#[typetag::serde]
impl DataSource for Nerf2Rssi {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(pwrfgs_core::Task::Power)
    }

    /// Loads one link per cell of the table of powers, except for cells without a signal.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = existing_root(base, &self.root, "Nerf2Rssi", LAYOUT)?;
        let gateways = read_gateways(&root.join("gateway_position.yml"), LAYOUT)?;
        let locations = LocationTable::read(&root, &root.join("tx_pos.csv"))?;
        let names: Vec<String> = gateways.iter().map(|(name, _)| name.clone()).collect();
        let missing = read_missing(&root);
        let codes = missing.as_deref().unwrap_or(&[NOT_RECEIVED]);
        let table = if locations.moving.is_receiver() { POSES } else { "tx_pos.csv" };
        let count = locations.poses.len();
        let mut received = read_links(&root.join("gateway_rssi.csv"), &names, codes, (table, count))?;
        warn_of_low_powers(&root, missing.is_some(), &received);
        let rows = index::read_sets(&root, &|word| index::parse_row(word, table, count))?;
        let points = read_point_cloud(base, self.points.as_deref())?;
        let transmitter = gateways[0].1.position; // if the receivers move, all lines have that of the transmitter
        if locations.moving.is_receiver() && gateways.iter().any(|(_, pose)| pose.position != transmitter) {
            let problem = format!("the receivers move ({POSES}), but the position of their transmitter differs");
            return Err(Error::input(&root.join("gateway_position.yml"), format!("{problem}; give one position")));
        }
        let receivers = create_receivers(&root, gateways, &mut received);
        let samples: Vec<Sample> = received
            .iter()
            .map(|link| Sample { receiver: link.gateway, ..Sample::new(link.row as u32, locations.poses[link.row]) })
            .collect();
        let powers: Vec<Real> = received.iter().map(|link| link.dbm as Real).collect();
        let ends = locations.link_ends(receivers, Some(transmitter));
        let name = folder_name(&root);
        let (title, simulation) = read_title(&root, &name, "NeRF2 layout");
        let data = Dataset::of_links(title, ends, points, &samples, powers.into())?;
        let official = rows.map(|(train, test)| (data.links_of(&train), data.links_of(&test)));
        progress(data.len(), data.len());
        restore_saved(&root, Dataset { official, simulation, ..data })
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let root = recognised_root(folder, &["gateway_rssi.csv", "gateway_position.yml"])?;
        Some(Box::new(Self { points: find_point_cloud(&root), root }))
    }

    fn check(&self) -> Result<(), String> {
        check_root(&self.root)
    }
}

/// Received power of one link.
struct PowerRow {
    /// Index of the transmitter, counted from 0.
    row: usize,
    /// Index of the gateway.
    gateway: usize,
    dbm: f64,
}

/// Creates receivers from the gateways that received a transmitter, and renumbers the links; warns of the other gateways.
fn create_receivers(root: &Path, gateways: Vec<(String, Pose)>, received: &mut [PowerRow]) -> Vec<Receiver> {
    let mut is_linked = vec![false; gateways.len()];
    received.iter().for_each(|link| is_linked[link.gateway] = true);
    let unlinked: Vec<String> =
        gateways.iter().zip(&is_linked).filter(|(_, linked)| !**linked).map(|((name, _), _)| quoted(name)).collect();
    if !unlinked.is_empty() {
        let names = unlinked.join(", ");
        tracing::warn!("{}: these gateways received nothing and are left out: {names}", root.display());
    }
    let linked_before = |gateway: usize| is_linked[..gateway].iter().filter(|linked| **linked).count();
    received.iter_mut().for_each(|link| link.gateway = linked_before(link.gateway));
    let linked = gateways.into_iter().zip(is_linked).filter(|(_, linked)| *linked);
    linked.map(|((name, pose), _)| Receiver::new(name, pose)).collect()
}

/// Warns if powers are below [`NOT_RECEIVED`] and the folder declares no missing values: that value may be a reading, too.
fn warn_of_low_powers(root: &Path, is_declared: bool, received: &[PowerRow]) {
    let lower = received.iter().filter(|link| link.dbm < NOT_RECEIVED).count();
    if lower > 0 && !is_declared {
        tracing::warn!(
            "{}: {lower} powers are below {NOT_RECEIVED} dBm, and {NOT_RECEIVED} was read as not received; if it is a \
             reading, write {{\"missing\": []}} to manifest.json",
            root.display()
        );
    }
}

/// Reads all received powers of a table with a column per gateway, by row, then gateway; `codes` are the values that mean that
/// no signal was received. Returns an error unless every gateway has a column, and each of the `count` positions in `file` a
/// row with at least one received power.
fn read_links(path: &Path, names: &[String], codes: &[f64], (file, count): (&str, usize)) -> Result<Vec<PowerRow>> {
    let unknown = ["has no position in gateway_position.yml", "add it there, or remove the column"];
    let unnamed = "a gateway that has a position; add one, or remove its line in gateway_position.yml";
    let table = PowerTable { receivers: names, missing: codes, advice: LAYOUT, unknown, unnamed: Some(unnamed) };
    let table = table.read(path)?;
    let mut received = Vec::new();
    for (row, (line, powers)) in table.iter().enumerate() {
        let links =
            powers.iter().enumerate().filter_map(|(gateway, dbm)| Some(PowerRow { row, gateway, dbm: (*dbm)? }));
        received.extend(links);
        if row < count && powers.iter().all(Option::is_none) {
            let advice = format!("remove the row here and in {file}, and number the index files anew");
            return Err(Error::at(path, *line, 1, format!("no power was received at this position; {advice}")));
        }
    }
    if table.len() != count {
        let problem = format!("holds {} rows of powers, but {file} {count} positions", table.len());
        return Err(Error::input(path, format!("{problem}; give as many of each")));
    }
    Ok(received)
}

/// Received powers in a row of a table, dBm, after its line number.
type TableRow = (usize, Vec<Option<f64>>);

/// Table of received powers with a column per receiver.
#[derive(Clone, Copy)]
struct PowerTable<'a> {
    /// Names of the receivers.
    receivers: &'a [String],
    /// Values that mean that no signal was received.
    missing: &'a [f64],
    /// Next step for a file that is no such table.
    advice: &'a str,
    /// Problem with a column of another name, and the next step.
    unknown: [&'a str; 2],
    /// Description of a receiver without a column, which is an error; `None` if a column may be absent.
    unnamed: Option<&'a str>,
}

impl PowerTable<'_> {
    /// Reads the powers of all receivers, row by row. Returns an error for an invalid column or row.
    fn read(self, path: &Path) -> Result<Vec<TableRow>> {
        let Self { receivers, missing, advice, unknown, unnamed } = self;
        let valid: BTreeSet<&str> = receivers.iter().map(String::as_str).collect();
        let table = TableText::with_names(path, advice, &|cell| valid.contains(cell) || valid.contains(text_of(cell)))?;
        // Each power as read here, and as the caller stores it.
        table.check_rows(GROWING * size_of::<TableRow>() + receivers.len() * size_of::<(Option<f64>, Real)>())?;
        let mut columns = BTreeMap::new();
        for (k, cell) in table.names.iter().enumerate() {
            let name = if valid.contains(text_of(cell)) { text_of(cell) } else { cell };
            if columns.insert(name, k).is_some() {
                let problem = format!("a second column {}; name each receiver once", quoted(cell));
                return Err(table.fault(Some(k), problem));
            }
            if !valid.contains(name) {
                let hint = did_you_mean(cell, receivers.iter().map(String::as_str));
                return Err(table.fault(Some(k), format!("{} {}{hint}; {}", quoted(cell), unknown[0], unknown[1])));
            }
        }
        let column = |name: &String| match (columns.get(name.as_str()), unnamed) {
            (None, Some(unnamed)) => Err(table.fault(None, format!("no column `{}`, {unnamed}", strip_control(name)))),
            (column, _) => Ok(column.copied()),
        };
        let columns = receivers.iter().map(column).collect::<Result<Vec<_>>>()?;
        let power = |row: &TextRow<'_>, (column, name): (&Option<usize>, &String)| match column {
            Some(column) => row.power(row.cell((*column, name), DBM_ADVICE)?, missing),
            None => Ok(None),
        };
        let read = |row: Result<TextRow<'_>>| {
            let row = row?;
            Ok((row.line, columns.iter().zip(receivers).map(|cell| power(&row, cell)).collect::<Result<_>>()?))
        };
        table.rows().map(read).collect()
    }
}

/// Reads received powers `[rows, receivers]` from a table with one column per receiver, dBm; NaN for empty cells and for
/// receivers without a column.
///
/// # Errors
/// The file cannot be read, has no row or an invalid one, or has a column of an unknown receiver; the message has line and
/// column.
pub fn read_powers(path: &Path, receivers: &[String]) -> Result<Vec<Vec<Real>>> {
    const ADVICE: &str =
        "write one column per receiver and one row per transmitter, in dBm; leave unknown powers empty";
    let unknown = ["is no receiver of the model", "name one, or remove the column"];
    let rows = PowerTable { receivers, missing: &[], advice: ADVICE, unknown, unnamed: None }.read(path)?;
    if rows.is_empty() {
        return Err(Error::input(path, format!("has a header but no row; {ADVICE}")));
    }
    let values =
        |(_, powers): TableRow| powers.into_iter().map(|dbm| dbm.map_or(Real::NAN, |dbm| dbm as Real)).collect();
    Ok(rows.into_iter().map(values).collect())
}
