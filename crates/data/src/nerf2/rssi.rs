//! `Nerf2Rssi`: received powers at many gateways in the folder layout of NeRF2.

#[cfg(test)]
mod tests;

use super::receivers::gateways;
use super::{LocationTable, POSES, index};
use crate::checks::{NOT_RECEIVED, UnlinkedNode, unlinked_node};
use crate::folder::{check_root, folder_name, open_root, points_of, simulation, source_in, title};
use crate::text::{TextField, cell, dbm, lines, no_longer, power, read_text, split_commas};
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::messages::{quoted, strip_control, text_of};
use pwrfgs_core::{DataSource, Dataset, Error, JsonSchema, Progress, Real, Receiver, Result, Sample, did_you_mean};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const LAYOUT: &str = "a NeRF2 folder of powers holds gateway_position.yml, gateway_rssi.csv and tx_pos.csv";

/// Received powers (RSSI) at many gateways in the layout of NeRF2 (Zhao et al., 2023).
///
/// ```text
/// root/gateway_position.yml    g01: [x, y, z], one line per gateway; metres; with a rotation:
///                              g01: {position: [x, y, z], orientation: [x, y, z, w]}, a unit quaternion
/// root/gateway_rssi.csv        header with the gateway names; row k: received powers, dBm; -100: no signal
/// root/tx_pos.csv              header with x, y, z among others; row k is the transmitter; metres
/// root/rx_pose.csv             instead of tx_pos.csv, if the receivers move: columns x, y, z, qx, qy, qz, qw of their pose;
///                              gateway_position.yml then has the position of the fixed transmitter under each name
/// root/train_index.txt         rows counted from 0, one per line; the files train_index.txt and
/// root/test_index.txt          test_index.txt must both exist or both be absent
/// ```
///
/// A link is a transmitter and a gateway that received it; -100 dBm marks a missing link. The id of a transmitter is
/// its row, counted from 0 as in the index files (ids of spectra count from 1). The split of the index files assigns
/// all links of a transmitter to one set. Gateways are receivers of the same name, in the order of
/// `gateway_position.yml`.
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

    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset> {
        let root = open_root(base, &self.root, "Nerf2Rssi", LAYOUT)?;
        let gateways = gateways(&root.join("gateway_position.yml"), LAYOUT)?;
        let locations = LocationTable::read(&root, &root.join("tx_pos.csv"))?;
        let names: Vec<String> = gateways.iter().map(|(name, _)| name.clone()).collect();
        let received = read_table(&root.join("gateway_rssi.csv"), &names, locations.poses.len(), LAYOUT)?;
        let table = if locations.moving.is_receiver() { POSES } else { "tx_pos.csv" };
        let rows = index::read(&root, &|word| index::row(word, table, locations.poses.len()))?;
        let points = points_of(base, self.points.as_deref())?;
        let samples: Vec<Sample> = received
            .iter()
            .map(|link| Sample { receiver: link.gateway, ..Sample::new(link.row as u32, locations.poses[link.row]) })
            .collect();
        let powers: Vec<Real> = received.iter().map(|link| link.dbm as Real).collect();
        let transmitter = gateways[0].1.position;
        if locations.moving.is_receiver() && gateways.iter().any(|(_, pose)| pose.position != transmitter) {
            let what = format!(
                "the receivers move ({POSES}), but the position of their transmitter differs; give one position"
            );
            return Err(Error::input(&root.join("gateway_position.yml"), what));
        }
        let receivers = gateways.into_iter().map(|(name, pose)| Receiver::new(name, pose)).collect();
        let ends = locations.ends(receivers, Some(transmitter));
        let name = folder_name(&root);
        let simulation = simulation(&root, &name);
        let title = title(&name, simulation.as_ref(), "NeRF2 layout");
        let data = Dataset::of_links(title, ends, points, &samples, powers.into())?;
        let official = rows.map(|(train, test)| (data.links_of(&train), data.links_of(&test)));
        progress(data.len(), data.len());
        Ok(Dataset { official, simulation, ..data })
    }

    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        source_in(folder, &["gateway_rssi.csv", "gateway_position.yml"], |root, points| Self { root, points })
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

/// Reads all received powers, by row, then gateway. Every gateway must have a column, each of the `rows` transmitters a
/// row, and each of them at least one received power.
fn read_table(path: &Path, gateways: &[String], rows: usize, advice: &str) -> Result<Vec<PowerRow>> {
    let text = read_text(path, MAX_TEXT, advice)?;
    let mut contents = lines(&text);
    let Some((line, header)) = contents.next() else {
        return Err(Error::input(
            path,
            "is empty; write a header with the names of the gateways and one row per transmitter",
        ));
    };
    let header = split_commas(header);
    let column_of = columns(path, line, &header, gateways)?;
    let (mut received, mut lines_of): (Vec<PowerRow>, Vec<usize>) = (Vec::new(), Vec::new());
    for (row, (line, content)) in contents.enumerate() {
        let fields = split_commas(content);
        no_longer(path, line, &fields, header.len())?;
        for (gateway, &column) in column_of.iter().enumerate() {
            let dbm = power(path, line, &fields, (column, &gateways[gateway]))?;
            received.extend((dbm != NOT_RECEIVED).then_some(PowerRow { row, gateway, dbm }));
        }
        lines_of.push(line);
    }
    let count = lines_of.len();
    if count != rows {
        let what = format!("holds {count} rows of powers, but tx_pos.csv {rows} transmitters; give as many of each");
        return Err(Error::input(path, what));
    }
    match unlinked_node(rows, gateways.len(), received.iter().map(|link| (link.row, link.gateway))) {
        Some(UnlinkedNode::Transmitter(row)) => {
            let what = "no gateway heard this transmitter (-100 in all columns); remove the row here and in tx_pos.csv, \
                        and number the index files anew";
            Err(Error::at(path, lines_of[row], 1, what))
        }
        Some(UnlinkedNode::Receiver(g)) => {
            let what = format!("{} received no transmitter (-100 in all rows)", quoted(&gateways[g]));
            let what = format!("{what}; remove its column here and its line in gateway_position.yml");
            Err(Error::at(path, line, header[column_of[g]].column, what))
        }
        None => Ok(received),
    }
}

/// Column index of each gateway.
fn columns(path: &Path, line: usize, header: &[TextField<'_>], gateways: &[String]) -> Result<Vec<usize>> {
    let advice = ("has no position in gateway_position.yml", "add it there, or remove the column");
    let column_of = named_columns(path, line, header, gateways, advice)?;
    let column = |name: &String| {
        column_of.get(name.as_str()).copied().ok_or_else(|| {
            let what = "add one, or remove its line in gateway_position.yml";
            Error::at(
                path,
                line,
                1,
                format!("no column `{}`, a gateway that has a position; {what}", strip_control(name)),
            )
        })
    };
    gateways.iter().map(column).collect()
}

/// Columns by name, all of which must be in `known`; for another name, `unknown` are the problem and the next step.
fn named_columns<'a>(
    path: &Path,
    line: usize,
    header: &[TextField<'a>],
    known: &[String],
    unknown: (&str, &str),
) -> Result<BTreeMap<&'a str, usize>> {
    let names: BTreeSet<&str> = known.iter().map(String::as_str).collect();
    let mut column_of = BTreeMap::new();
    for (k, field) in header.iter().enumerate() {
        let at = |what| Error::at(path, line, field.column, what);
        let text = text_of(field.text);
        let name = if names.contains(text) { text } else { field.text };
        if column_of.insert(name, k).is_some() {
            return Err(at(format!("a second column {}; name each receiver once", quoted(field.text))));
        }
        if !names.contains(name) {
            let near = did_you_mean(field.text, known.iter().map(String::as_str));
            return Err(at(format!("{} {}{near}; {}", quoted(field.text), unknown.0, unknown.1)));
        }
    }
    Ok(column_of)
}

/// Reads received powers `[rows, receivers]` from a table with one column per receiver, dBm; NaN for empty cells and for
/// receivers without a column.
///
/// # Errors
/// An invalid table, with line and column.
pub fn read_powers(path: &Path, receivers: &[String]) -> Result<Vec<Vec<Real>>> {
    const ADVICE: &str =
        "write one column per receiver and one row per transmitter, in dBm; leave unknown powers empty";
    let text = read_text(path, MAX_TEXT, ADVICE)?;
    let mut rows = lines(&text);
    let (first, header) = rows.next().ok_or_else(|| Error::input(path, format!("is empty; {ADVICE}")))?;
    let header = split_commas(header);
    let advice = ("is no receiver of the model", "name one, or remove the column");
    let column_of = named_columns(path, first, &header, receivers, advice)?;
    let read = |(line, row)| {
        let row = split_commas(row);
        no_longer(path, line, &row, header.len())?;
        let power = |name: &String| match column_of.get(name.as_str()) {
            Some(column) => match cell(path, line, &row, (*column, name), ADVICE)? {
                field if field.text.is_empty() || field.text.eq_ignore_ascii_case("nan") => Ok(Real::NAN),
                field => Ok(dbm(path, line, field)? as Real),
            },
            None => Ok(Real::NAN),
        };
        receivers.iter().map(power).collect()
    };
    let powers = rows.map(read).collect::<Result<Vec<Vec<Real>>>>()?;
    if powers.is_empty() { Err(Error::input(path, format!("has a header but no row; {ADVICE}"))) } else { Ok(powers) }
}
