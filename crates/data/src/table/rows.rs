//! `RowReader`: where the rows of one table have their position and their powers.

use super::columns::{ColumnSearch, PositionColumns, list};
use super::options::TableImport;
use super::powers::PowerColumns;
use crate::dialect::TableText;
use pwrfgs_core::Result;
use pwrfgs_core::messages::quoted;
use std::collections::BTreeMap;

/// Position of a row.
pub(super) enum RowPosition {
    Columns(PositionColumns),
    /// Column with the name of a place.
    Name(usize),
    /// Next row of another file.
    Next,
}

/// Columns of one table.
pub(super) struct RowReader<'a> {
    pub(super) table: &'a TableText<'a>,
    pub(super) position: RowPosition,
    pub(super) floor: Option<usize>,
    pub(super) powers: PowerColumns,
    /// Columns that identify a transmitter.
    pub(super) transmitter: Vec<usize>,
    /// Name of the receiver of a table without such a column.
    pub(super) receiver_name: String,
}

impl<'a> RowReader<'a> {
    /// Recognises the columns of a table; `named` are the positions of places. Returns an error for missing or ambiguous columns.
    pub(super) fn new(
        import: &TableImport,
        named: &BTreeMap<String, [f64; 3]>,
        search: &ColumnSearch<'a>,
    ) -> Result<Self> {
        let table = search.table;
        let position = if import.tx.is_some() {
            RowPosition::Next
        } else if import.places.is_some() {
            RowPosition::Name(search.place_column(named)?)
        } else {
            let advice = "name its columns with --x and --y or --lat and --lon, give the positions row by row with --tx \
                          FILE, or of places with --places FILE. Positions in another table that share only the time \
                          must be joined first";
            let columns = search.position_columns(import.is_lat_lon)?;
            RowPosition::Columns(columns.ok_or_else(|| search.fault(format!("no position was recognised; {advice}")))?)
        };
        let has_height = matches!(position, RowPosition::Columns(columns) if columns.height.is_some());
        let floor = if has_height { None } else { search.floor_column()? };
        let transmitter = search.transmitter_columns()?;
        let mut used: Vec<usize> = floor.into_iter().chain(transmitter.iter().copied()).collect();
        match position {
            RowPosition::Columns(columns) => used.extend(columns.all()),
            RowPosition::Name(column) => used.push(column),
            RowPosition::Next => {}
        }
        let powers = search.power_columns(&used, import.is_lat_lon)?;
        // A file per receiver has its name; a single file may have it in the header.
        let receiver_name = match (&import.columns.receiver, &powers) {
            (Some(name), _) => name.clone(),
            (None, PowerColumns::Long { power, .. }) if import.files.len() == 1 && table.header.is_some() => {
                table.names[*power].clone()
            }
            _ => table.path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        Ok(Self { table, position, floor, powers, transmitter, receiver_name })
    }

    /// Describes the columns in one sentence, with those that are not used.
    pub(super) fn describe(&self, import: &TableImport, search: &ColumnSearch<'_>) -> String {
        let mut used: Vec<usize> = self.floor.into_iter().chain(self.transmitter.iter().copied()).collect();
        let position = match self.position {
            RowPosition::Columns(columns) => {
                used.extend(columns.all());
                let unit = if columns.is_geodetic { "degrees" } else { "metres" };
                let given = format!("height {} m (set --height METRES)", import.height.unwrap_or(0.0));
                let height = match (columns.height, self.floor) {
                    (Some(k), _) => format!("height in {}", search.list([k])),
                    (None, Some(k)) if import.floor_height.is_some() => {
                        format!("height by the floor in {}", search.list([k]))
                    }
                    (None, Some(k)) => format!("{given}, floor in {}", search.list([k])),
                    (None, None) => given,
                };
                format!("positions in {} ({unit}), {height}", search.list(columns.plane))
            }
            RowPosition::Name(column) => {
                used.push(column);
                format!("places in {}", search.list([column]))
            }
            RowPosition::Next => "positions row by row from another file".into(),
        };
        let powers = match &self.powers {
            PowerColumns::Long { power, receiver, receiver_position } => {
                used.extend([*power].into_iter().chain(*receiver));
                used.extend(receiver_position.iter().flat_map(|columns| columns.all()));
                let at =
                    receiver.map_or(quoted(&self.receiver_name), |k| format!("the receivers in {}", search.list([k])));
                format!("powers in {} at {at}", search.list([*power]))
            }
            PowerColumns::Wide(columns) => {
                used.extend(columns);
                format!("powers of {} receivers in columns: {}", columns.len(), search.list(columns.iter().copied()))
            }
        };
        let unused = (0..self.table.names.len()).filter(|k| !used.contains(k)).map(|k| &*self.table.names[k]);
        let unused = list(unused);
        let unused = if unused.is_empty() { unused } else { format!("; not used: {unused}") };
        format!("{position}; {powers}{unused}")
    }
}
