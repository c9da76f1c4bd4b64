//! Positions in tables: of rows, places and receivers, in metres or degrees.

use super::columns::{ColumnSearch, PositionColumns};
use super::options::{ColumnChoice, TableImport};
use crate::dialect::{GROWING, TableFile, TableText};
use crate::text::TextRow;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Geodetic, Result, position_fault};
use std::collections::{BTreeMap, HashMap};
use std::num::NonZero;

/// Positions closer than this are one, metres.
pub(super) const SAME_M: f64 = 1e-3;

/// Memory of a named position, bytes: name, position and their share of the tree.
const NAMED_PLACE: usize = 150;

/// Frame of the positions, set by the first position in degrees.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Frame {
    /// Zero of the frame; `None` while all positions are in metres.
    pub(super) geodetic: Option<Geodetic>,
}

impl Frame {
    /// Reads the position in a row, metres, with `height` if the table has none; the first one in degrees sets the zero. Returns
    /// an error for an empty or invalid coordinate.
    pub(super) fn read(
        &mut self,
        table: &TableText<'_>,
        row: &TextRow<'_>,
        columns: PositionColumns,
        height: f64,
    ) -> Result<[f64; 3]> {
        let coordinate = |k: usize| -> Result<f64> {
            let field = row.cell((k, &table.names[k]), "give every row a position")?;
            let value = row.optional(field, "give the coordinate as a number")?;
            value.ok_or_else(|| row.fault(field.column, "no coordinate; give every row a position, or remove the row"))
        };
        let [a, b] = [coordinate(columns.plane[0])?, coordinate(columns.plane[1])?];
        let z = columns.height.map_or(Ok(height), coordinate)?;
        let [x, y] = if columns.is_geodetic { self.metres(row, [b, a])? } else { [a, b] };
        let position = [x + 0.0, y + 0.0, z + 0.0]; // no negative zero
        position_fault(position).map_or(Ok(position), |fault| Err(row.fault(1, format!("a coordinate {fault}"))))
    }

    /// Reads a table of names and positions: places, or receivers.
    ///
    /// # Errors
    /// A table without a name or a position, or with two positions for one name.
    pub(super) fn read_named(&mut self, import: &TableImport, file: &TableFile) -> Result<BTreeMap<String, [f64; 3]>> {
        let table = TableText::read(file)?;
        let choice = ColumnChoice::default();
        let search = ColumnSearch::new(&table, &choice)?;
        let columns = search.position_columns(import.is_lat_lon)?;
        let columns =
            columns.ok_or_else(|| search.fault("no position; write a table with the columns name, x, y and z"))?;
        let name = search.name_column(columns)?;
        table.check_rows(NAMED_PLACE)?;
        let mut places = BTreeMap::new();
        for row in table.rows() {
            let row = row?;
            let field = row.cell((name, &table.names[name]), "give every row a name")?;
            let position = self.read(&table, &row, columns, import.height.unwrap_or(0.0))?;
            if places
                .insert(field.text.to_owned(), position)
                .is_some_and(|earlier| distance(earlier, position) > SAME_M)
            {
                return Err(row.fault(field.column, "a second position for this name; give one"));
            }
        }
        Ok(places)
    }

    /// Reads the positions of rows, metres, one per row of the readings. Without a header, the first columns are x, y and z, or
    /// latitude, longitude and height. Returns an error for a table or a row without a position.
    pub(super) fn read_rows(&mut self, import: &TableImport, file: &TableFile) -> Result<Vec<[f64; 3]>> {
        let table = TableText::read(file)?;
        let search = ColumnSearch::new(&table, &import.columns)?;
        let columns = match search.position_columns(import.is_lat_lon)? {
            Some(columns) => columns,
            None if table.header.is_none() && table.names.len() >= 2 => {
                let height = (table.names.len() > 2).then_some(2);
                PositionColumns::new([0, 1], height, import.is_lat_lon)
            }
            None => return Err(search.fault("no position; write the columns x, y and z")),
        };
        let height = import.height.unwrap_or(0.0);
        table.check_rows(GROWING * size_of::<[f64; 3]>())?;
        table.rows().map(|row| self.read(&table, &row?, columns, height)).collect()
    }

    /// Converts latitude and longitude to metres east and north. The first position, rounded to a hundredth of a degree, is the
    /// zero. Returns an error for degrees out of range.
    fn metres(&mut self, row: &TextRow<'_>, [latitude, longitude]: [f64; 2]) -> Result<[f64; 2]> {
        let rounded = |degrees: f64| (degrees * 100.0).round() / 100.0;
        let zero = self.geodetic.unwrap_or(Geodetic { latitude: rounded(latitude), longitude: rounded(longitude) });
        if !zero.is_valid() || !(Geodetic { latitude, longitude }).is_valid() {
            let problem = format!("latitude {latitude} and longitude {longitude} are no place on the Earth");
            return Err(row.fault(1, format!("{problem}; exchange the two, or leave --lat-lon out")));
        }
        self.geodetic = Some(zero);
        Ok(zero.metres([latitude, longitude]))
    }
}

/// Positions so far, each once within [`SAME_M`].
#[derive(Default)]
pub(super) struct PositionList {
    pub(super) list: Vec<[f64; 3]>,
    /// First position in each cube of that edge, and the next one in the cube of each position.
    pub(super) first: HashMap<[i64; 3], u32>,
    next: Vec<Option<NonZero<u32>>>,
    /// Number of positions that were joined with another one.
    pub(super) joined: usize,
}

impl PositionList {
    /// Returns the index of a position so far within [`SAME_M`], else of this position, which is added.
    pub(super) fn index(&mut self, position: [f64; 3]) -> u32 {
        let cell = position.map(|v| (v / SAME_M).floor() as i64);
        // The cube of the position and those around it.
        let offsets = (0..27).map(|k| [k / 9 - 1, k / 3 % 3 - 1, k % 3 - 1]);
        let is_same = |index: &u32| distance(self.list[*index as usize], position) < SAME_M;
        let same = offsets.flat_map(|offset| self.cube([0, 1, 2].map(|k| cell[k] + offset[k]))).find(is_same);
        if let Some(index) = same {
            self.joined += usize::from(self.list[index as usize] != position);
            return index;
        }
        let index = self.list.len() as u32;
        self.list.push(position);
        let last = self.cube(cell).last();
        match last {
            Some(last) => self.next[last as usize] = NonZero::new(index),
            None => _ = self.first.insert(cell, index),
        }
        self.next.push(None);
        index
    }

    /// Returns the indices of the positions in a cube, in ascending order.
    fn cube(&self, cell: [i64; 3]) -> impl Iterator<Item = u32> {
        let next = |index: &u32| self.next[*index as usize].map(NonZero::get);
        std::iter::successors(self.first.get(&cell).copied(), next)
    }
}
