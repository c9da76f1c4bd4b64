//! `Survey`: collects readings from tables.

use super::columns::ColumnSearch;
use super::names::Affixes;
use super::options::TableImport;
use super::places::{Frame, PositionList, SAME_M};
use super::powers::PowerColumns;
use super::rows::{RowPosition, RowReader};
use crate::checks::power_fault;
use crate::dialect::{SPLIT_ADVICE, TableFile, TableText};
use crate::text::{TextField, TextRow, is_empty_cell};
use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Error, Progress, Real, Result, check_memory};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Memory of a reading, bytes: measured until the data set is written.
const READING: u64 = 90;
/// Memory of a row or its position, bytes: measured until the data set is written.
const ROW: u64 = 170;

/// Number of rows in a preview.
pub(super) const PREVIEW: usize = 10;

/// Power of a link.
#[derive(Clone, Copy)]
pub(super) struct Reading {
    pub(super) location: u32,
    pub(super) receiver: u32,
    pub(super) dbm: Real,
}

/// Transmitter, or one of its repeated readings.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    /// Index of the position.
    pub(super) position: u32,
    pub(super) is_test: bool,
}

/// Receiver under its first spelling.
pub(super) struct NamedReceiver {
    pub(super) name: String,
    pub(super) position: Option<[f64; 3]>,
}

/// Readings so far.
pub(super) struct Survey<'a> {
    pub(super) import: &'a TableImport,
    pub(super) frame: Frame,
    /// Positions by the name of a place, if the rows name places.
    pub(super) named: BTreeMap<String, [f64; 3]>,
    /// Positions row by row, if they are in another file.
    pub(super) rows: Option<std::vec::IntoIter<[f64; 3]>>,
    pub(super) positions: PositionList,
    pub(super) spots: Vec<Spot>,
    /// Transmitters of rows of one reading each: position, cells of its ID and time, test set.
    pub(super) groups: HashMap<(u32, Box<str>, bool), u32>,
    /// Receivers, those of --receivers first.
    pub(super) receivers: Vec<NamedReceiver>,
    /// Number of receivers of --receivers.
    pub(super) placed_count: usize,
    /// Text around the names of receivers in columns.
    affixes: Option<Affixes>,
    pub(super) receiver_indices: HashMap<String, u32>,
    pub(super) readings: Vec<Reading>,
    /// Height on each floor, metres.
    pub(super) floors: BTreeMap<String, f64>,
    /// Spellings of receiver names that were joined with another one.
    pub(super) respelled: BTreeSet<String>,
    /// Number of cells with each code for "not received".
    pub(super) coded: Vec<usize>,
    /// Number of cells that are empty or have no power.
    pub(super) silent: usize,
    /// Number of readings that repeat a link.
    pub(super) repeated: usize,
    /// Number of rows without a reading.
    pub(super) unreceived_rows: usize,
    pub(super) notes: Vec<String>,
    pub(super) before: Vec<String>,
}

impl<'a> Survey<'a> {
    /// Creates a survey; reads the files of places, rows and receivers. Returns the errors of their readers.
    pub(super) fn new(import: &'a TableImport) -> Result<Self> {
        let mut frame = Frame::default();
        let named = import.places.as_ref().map(|file| frame.read_named(import, file)).transpose()?;
        let rows = import.tx.as_ref().map(|file| frame.read_rows(import, file)).transpose()?;
        let placed = import.receivers.as_ref().map(|file| frame.read_named(import, file)).transpose()?;
        let mut survey = Self {
            import,
            frame,
            named: named.unwrap_or_default(),
            rows: rows.map(Vec::into_iter),
            positions: PositionList::default(),
            spots: Vec::new(),
            groups: HashMap::new(),
            receivers: Vec::new(),
            placed_count: 0,
            affixes: None,
            receiver_indices: HashMap::new(),
            readings: Vec::new(),
            floors: BTreeMap::new(),
            respelled: BTreeSet::new(),
            coded: vec![0; import.missing.len()],
            silent: 0,
            repeated: 0,
            unreceived_rows: 0,
            notes: Vec::new(),
            before: Vec::new(),
        };
        for (name, position) in placed.unwrap_or_default() {
            let receiver = survey.receiver_index(&name);
            survey.receivers[receiver as usize].position = Some(position);
        }
        survey.placed_count = survey.receivers.len();
        Ok(survey)
    }

    /// Adds the readings of a table, of the test set or not; `progress` counts lines. Returns an error for a table without the
    /// needed columns, with an invalid row, or with more readings than fit into memory.
    pub(super) fn add(&mut self, file: &TableFile, is_test: bool, progress: Progress<'_>) -> Result<()> {
        let table = TableText::read(file)?;
        self.notes.push(table.describe());
        if self.before.is_empty() {
            self.before = table.head(PREVIEW);
        }
        let search = ColumnSearch::new(&table, &self.import.columns)?;
        let reader = RowReader::new(self.import, &self.named, &search)?;
        self.check_memory(&reader)?;
        self.notes.push(reader.describe(self.import, &search));
        match &reader.powers {
            PowerColumns::Long { .. } => self.add_long(&reader, is_test, progress),
            PowerColumns::Wide(_) => self.add_wide(&reader, is_test, progress),
        }
    }

    /// Rejects a table whose readings do not fit into memory with those so far.
    fn check_memory(&self, reader: &RowReader<'_>) -> Result<()> {
        let rows = reader.table.line_count();
        let check = |readings: usize| {
            let [rows, readings] = [self.spots.len() + rows, self.readings.len() + readings].map(|count| count as u64);
            check_memory(ROW * rows + READING * readings, SPLIT_ADVICE)
        };
        let PowerColumns::Wide(columns) = &reader.powers else {
            return check(rows).map_err(|fault| Error::input(reader.table.path, fault));
        };
        // Cells are read only if all of them would not fit.
        if check(rows.saturating_mul(columns.len())).is_ok() {
            return Ok(());
        }
        let is_filled = |row: &TextRow<'_>, k: &usize| row.fields.get(*k).is_some_and(|f| !is_empty_cell(f.text));
        let filled = |row: &TextRow<'_>| columns.iter().filter(|k| is_filled(row, k)).count();
        let readings = reader.table.rows().flatten().map(|row| filled(&row)).sum();
        check(readings).map_err(|fault| Error::input(reader.table.path, fault))
    }

    /// Adds a table with a row per transmitter. Returns an error for an invalid row.
    fn add_wide(&mut self, reader: &RowReader<'_>, is_test: bool, progress: Progress<'_>) -> Result<()> {
        let PowerColumns::Wide(columns) = &reader.powers else { return Ok(()) };
        let names: Vec<&str> = columns.iter().map(|k| &*reader.table.names[*k]).collect();
        let receivers = self.column_receivers(&names);
        for row in reader.table.counted_rows(progress) {
            let row = row?;
            let position = self.position_index(reader, &row)?;
            let location = self.spots.len() as u32;
            self.spots.push(Spot { position, is_test });
            for (&column, &receiver) in columns.iter().zip(&receivers) {
                // A row may end early: its last cells are empty.
                let Some(field) = row.fields.get(column) else { break };
                if let Some(dbm) = self.read_power(&row, *field)? {
                    self.readings.push(Reading { location, receiver, dbm });
                }
            }
        }
        Ok(())
    }

    /// Returns the indices of the receivers in columns. Columns may have the names of --receivers within a text that all
    /// share, as `RSSI_AP1` and `RSSI_AP2`; columns of later tables then have this text too.
    fn column_receivers(&mut self, columns: &[&str]) -> Vec<u32> {
        if self.affixes.is_none() {
            let placed: Vec<&str> =
                self.receivers[..self.placed_count].iter().map(|receiver| &*receiver.name).collect();
            self.affixes = Affixes::find(columns, &placed);
            let example = self.affixes.as_ref().zip(columns.first());
            let example = example.and_then(|(affixes, column)| Some((column, affixes.strip(column)?)));
            let note = example
                .map(|(column, name)| format!("column {} is receiver {}, and so on", quoted(column), quoted(name)));
            self.notes.extend(note);
        }
        let affixes = self.affixes.clone();
        let name =
            |column: &&'_ str| affixes.as_ref().and_then(|affixes| affixes.strip(column)).unwrap_or(column).to_owned();
        columns.iter().map(name).map(|name| self.receiver_index(&name)).collect()
    }

    /// Adds a table with a row per reading. Returns an error for an invalid row.
    fn add_long(&mut self, reader: &RowReader<'_>, is_test: bool, progress: Progress<'_>) -> Result<()> {
        let PowerColumns::Long { power, receiver, receiver_position } = reader.powers else { return Ok(()) };
        for row in reader.table.counted_rows(progress) {
            let row = row?;
            let position = self.position_index(reader, &row)?;
            let cell = |k: usize| row.cell((k, &reader.table.names[k]), "give every row all columns");
            let name = receiver.map_or(Ok(&*reader.receiver_name), |k| cell(k).map(|field| field.text))?;
            let receiver = self.receiver_index(name);
            if let Some(columns) = receiver_position {
                let placed = self.frame.read(reader.table, &row, columns, self.import.height.unwrap_or(0.0))?;
                let first = self.receivers[receiver as usize].position.get_or_insert(placed);
                if distance(*first, placed) > SAME_M {
                    let problem = format!("receiver {} has another position in an earlier row", quoted(name));
                    return Err(row.fault(1, format!("{problem}; give one position per receiver")));
                }
            }
            let Some(dbm) = self.read_power(&row, cell(power)?)? else { continue };
            let cells =
                reader.transmitter.iter().map(|k| cell(*k).map(|field| field.text)).collect::<Result<Vec<_>>>()?;
            let group = (position, cells.join("\u{1f}").into(), is_test); // U+001F: unit separator
            let location = *self.groups.entry(group).or_insert_with(|| {
                self.spots.push(Spot { position, is_test });
                self.spots.len() as u32 - 1
            });
            self.readings.push(Reading { location, receiver, dbm });
        }
        Ok(())
    }

    /// Returns the index of the position of a row in `positions`, where a new one is added, and adds its floor to `floors`.
    /// Returns an error if the position is missing or invalid, or for a floor that is no number.
    fn position_index(&mut self, reader: &RowReader<'_>, row: &TextRow<'_>) -> Result<u32> {
        let TableImport { height, floor_height, .. } = self.import;
        let mut height = height.unwrap_or(0.0);
        if let Some(column) = reader.floor {
            let field = row.cell((column, &reader.table.names[column]), "give every row a floor")?;
            let floor = row.optional(field, "give the floor as a number, or leave the cell empty")?.unwrap_or(0.0);
            height += floor * floor_height.unwrap_or(0.0);
            self.floors.insert(field.text.to_owned(), height);
        }
        let position = match reader.position {
            RowPosition::Columns(columns) => self.frame.read(reader.table, row, columns, height)?,
            RowPosition::Name(column) => {
                let field = row.cell((column, &reader.table.names[column]), "give every row a place")?;
                *self.named.get(field.text).ok_or_else(|| {
                    row.fault(field.column, format!("{} is no place of --places; add it there", quoted(field.text)))
                })?
            }
            RowPosition::Next => {
                let next = self.rows.as_mut().and_then(Iterator::next);
                next.ok_or_else(|| row.fault(1, "the file of --tx has fewer rows; give a position per row"))?
            }
        };
        Ok(self.positions.index(position))
    }

    /// Returns the index of a receiver, which is added if it is new. Spellings that differ by case are one receiver; all but
    /// the first are added to `respelled`.
    fn receiver_index(&mut self, name: &str) -> u32 {
        let (name, next) = (strip_control(name), self.receivers.len() as u32);
        let index = *self.receiver_indices.entry(name.to_lowercase()).or_insert(next);
        if index == next {
            self.receivers.push(NamedReceiver { name, position: None });
        } else if self.receivers[index as usize].name != name {
            self.respelled.insert(name);
        }
        index
    }

    /// Reads the power in a cell, dBm; counts a cell that was not received and returns `None` for it. Returns an error for other
    /// text or an implausible power.
    fn read_power(&mut self, row: &TextRow<'_>, field: TextField<'_>) -> Result<Option<Real>> {
        let Some(value) = row.optional(field, "give the power as a number, or leave the cell empty")? else {
            self.silent += 1;
            return Ok(None);
        };
        if let Some(k) = self.import.missing.iter().position(|code| *code == value) {
            self.coded[k] += 1;
            return Ok(None);
        }
        let Some(dbm) = self.import.unit.dbm(value) else {
            self.silent += 1;
            return Ok(None);
        };
        power_fault(dbm).map_or(Ok(Some(dbm as Real)), |fault| {
            Err(row.fault(field.column, format!("the power {fault}, or set --unit")))
        })
    }
}
