//! Columns of received powers: one of all readings, or one per receiver.

use super::columns::{ColumnSearch, PositionColumns};
use super::names::{FLOOR, LAT, LON, OTHER, POWER, RECEIVER, TX_ID, X, Y, Z, is_one_of};
use crate::text::is_empty_cell;
use pwrfgs_core::Result;
use std::collections::{BTreeMap, BTreeSet};

/// Largest absolute power, in any unit.
const LARGEST: f64 = 300.0;

/// Columns of received powers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PowerColumns {
    /// A row per reading: column of the power, of the receiver, and of the position of the receiver.
    Long { power: usize, receiver: Option<usize>, receiver_position: Option<PositionColumns> },
    /// A row per transmitter, a column per receiver.
    Wide(Vec<usize>),
}

impl ColumnSearch<'_> {
    /// Returns the columns of the received powers: those that the user chose, else those recognised outside of `used`. Returns
    /// an error if none or several suit, or if a column of names may be that of the receivers.
    pub(super) fn power_columns(&self, used: &[usize], is_lat_lon: bool) -> Result<PowerColumns> {
        if !self.choice.wide.is_empty() {
            return self.chosen_wide().map(PowerColumns::Wide);
        }
        let power = match self.find("--power", self.choice.power.as_ref(), POWER)? {
            Some(power) => power,
            None => match &self.recognised_wide(used)?[..] {
                // One column of powers under another name.
                [power] => *power,
                columns => return Ok(PowerColumns::Wide(columns.to_vec())),
            },
        };
        let unnumbered = |k: usize| self.names[k].trim_end_matches(|c: char| c.is_ascii_digit());
        let is_similar = |k: &usize| *k != power && self.choice.power.is_none() && is_one_of(unnumbered(*k), POWER);
        let similar: Vec<usize> = (0..self.names.len()).filter(is_similar).collect();
        if !similar.is_empty() {
            let problem = format!("{} could each be the power", self.list([&[power], &similar[..]].concat()));
            let advice = "name one with --power, or those of all receivers with --columns";
            return Err(self.fault(format!("{problem}; {advice}")));
        }
        let is_name = |name: &String| self.named(name).is_none();
        let receiver = match &self.choice.receiver {
            Some(name) if is_name(name) => None, // the only receiver
            choice => self.find("--receiver", choice.as_ref(), RECEIVER)?,
        };
        let may_be_names = |k: &usize| !used.contains(k) && !is_one_of(&self.names[*k], OTHER) && self.has_names(*k);
        if let (None, None, Some(column)) = (&self.choice.receiver, receiver, (0..self.names.len()).find(may_be_names))
        {
            let column = self.list([column]);
            let advice = "name it with --receiver, or give --receiver NAME if there is one receiver";
            return Err(self.fault(format!("{column} may be the column of the receivers; {advice}")));
        }
        let receiver_position = self.receiver_position_columns(is_lat_lon);
        Ok(PowerColumns::Long { power, receiver, receiver_position })
    }

    /// Returns whether a column holds several names, in two rows each on average, and no number.
    fn has_names(&self, k: usize) -> bool {
        let cells = || self.rows.iter().filter_map(|row| row.fields.get(k)).filter(|field| !is_empty_cell(field.text));
        let distinct: BTreeSet<&str> = cells().map(|field| field.text).collect();
        self.values(k).next().is_none() && distinct.len() > 1 && 2 * distinct.len() <= cells().count()
    }

    /// Returns the columns of the receiver's position beside a reading, such as `rx_x`; `None` without them.
    fn receiver_position_columns(&self, is_lat_lon: bool) -> Option<PositionColumns> {
        let prefixed = |ends: &str| self.names.iter().position(|name| is_receiver_column(name, ends));
        let height = prefixed("z height altitude alt");
        let pair = |a: &str, b: &str| Some([prefixed(a)?, prefixed(b)?]);
        let metres = pair("x", "y").map(|plane| PositionColumns::new(plane, height, is_lat_lon));
        metres.or_else(|| {
            pair("lat latitude", "lon longitude lng").map(|plane| PositionColumns::new(plane, height, true))
        })
    }

    /// Returns the columns that match the patterns of the user. Returns an error for a pattern without a column.
    fn chosen_wide(&self) -> Result<Vec<usize>> {
        let indices = 0..self.names.len();
        for pattern in &self.choice.wide {
            if !indices.clone().any(|k| is_match(pattern, &self.table.names[k])) {
                let columns = self.list(indices);
                let problem = format!("--columns {pattern}: no column has such a name; the columns are {columns}");
                return Err(self.fault(problem));
            }
        }
        let is_chosen = |k: &usize| self.choice.wide.iter().any(|pattern| is_match(pattern, &self.table.names[*k]));
        Ok(indices.filter(is_chosen).collect())
    }

    /// Recognises the columns of receivers: the largest group of names that differ in numbers alone, else all columns that hold
    /// powers. Returns an error if there is none, or if two groups are equal in size.
    fn recognised_wide(&self, used: &[usize]) -> Result<Vec<usize>> {
        let is_known =
            |name: &str| [X, Y, Z, LAT, LON, FLOOR, TX_ID, RECEIVER, OTHER].iter().any(|names| is_one_of(name, names));
        let is_free = |k: &usize| !used.contains(k) && !is_known(&self.names[*k]) && self.has_powers(*k);
        let free: Vec<usize> = (0..self.names.len()).filter(is_free).collect();
        let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        free.iter().for_each(|&k| groups.entry(stem(&self.table.names[k])).or_default().push(k));
        let size = groups.values().map(Vec::len).max().unwrap_or(0);
        let largest: Vec<Vec<usize>> = groups.into_values().filter(|group| group.len() == size).collect();
        match &largest[..] {
            [] => {
                let columns = self.list(0..self.names.len());
                let problem = format!("no column of received powers was recognised among {columns}");
                let advice = "name it with --power, or those of all receivers with --columns";
                Err(self.fault(format!("{problem}; {advice}")))
            }
            [group] if size > 1 => Ok(group.clone()),
            [group, other, ..] if size > 1 => {
                let [first, second] = [group[0], other[0]].map(|k| self.list([k]));
                let problem = format!("{first} .. and {second} .. could each be the received powers");
                Err(self.fault(format!("{problem}; name those of one kind with --columns, such as --columns 'AP*'")))
            }
            _ => Ok(free),
        }
    }

    /// Returns whether the cells of a column in the first rows are empty or numbers within [`LARGEST`].
    fn has_powers(&self, k: usize) -> bool {
        let cells = self.rows.iter().filter_map(|row| row.fields.get(k)).filter(|field| !is_empty_cell(field.text));
        cells.count() == self.values(k).count() && self.values(k).all(|v| v.abs() <= LARGEST)
    }
}

/// Returns whether a name is that of a receiver followed by one of `ends`, such as `rx` and `x`.
fn is_receiver_column(name: &str, ends: &str) -> bool {
    let is_prefix = |receiver: &str| name.strip_prefix(receiver).is_some_and(|end| is_one_of(end, ends));
    RECEIVER.split(' ').any(is_prefix)
}

/// Returns a name with 0 for each number inside, and without numbers at its ends. All MAC addresses, of 17 characters, have
/// one stem.
fn stem(name: &str) -> String {
    let is_address = name.len() == 17 && name.chars().all(|c| c.is_ascii_hexdigit() || c == ':' || c == '-');
    let parts = name.split(|c: char| c.is_ascii_digit()).filter(|part| !part.is_empty());
    if is_address { "address".into() } else { parts.collect::<Vec<_>>().join("0") }
}

/// Returns whether a name matches a pattern in which `*` stands for any text; either case.
fn is_match(pattern: &str, name: &str) -> bool {
    let (pattern, name) = (pattern.to_lowercase(), name.to_lowercase());
    let parts: Vec<&str> = pattern.split('*').collect();
    let [first, middle @ .., last] = &parts[..] else { return name == pattern };
    let Some(inner) = name.strip_prefix(first).and_then(|end| end.strip_suffix(last)) else { return false };
    middle.iter().try_fold(inner, |inner, part| inner.find(part).map(|at| &inner[at + part.len()..])).is_some()
}
