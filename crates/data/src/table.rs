//! `import --table`: received powers with positions from a table of any shape.
//!
//! A table has a row per reading (long) or a row per transmitter and a column per receiver (wide). Columns are recognised by
//! their names; each can be chosen. Readings of a link that repeat are kept, in a location each at the same position.

mod columns;
mod dialect;
mod finish;
mod names;
mod places;
mod powers;
mod rows;
mod survey;
#[cfg(test)]
mod tests;

pub use columns::ColumnChoice;

use crate::nerf2::read_transmitters;
use crate::table::survey::Survey;
use pwrfgs_core::{Dataset, Error, Geodetic, PowerUnit, Result};
use std::path::{Path, PathBuf};

/// File of a table, or its content under the name of a file.
#[derive(Clone, Debug)]
pub struct TableFile {
    /// Path, for messages too.
    pub path: PathBuf,
    /// Content; `None`: that of the file.
    pub bytes: Option<Vec<u8>>,
}

impl From<PathBuf> for TableFile {
    fn from(path: PathBuf) -> Self {
        Self { path, bytes: None }
    }
}

/// Tables of received powers, and how to read them.
#[derive(Clone, Debug, Default)]
pub struct TableImport {
    /// Tables of readings, one or more; their rows follow each other.
    pub files: Vec<TableFile>,
    /// Tables whose rows are the test set; those of `files` are then the training set.
    pub test: Vec<TableFile>,
    /// Positions of the rows of `files` and `test`, row by row.
    pub tx: Option<TableFile>,
    /// Positions of the places that the rows name.
    pub places: Option<TableFile>,
    /// Positions of the receivers, by name. Receivers without one are estimated from their strongest readings.
    pub receivers: Option<TableFile>,
    /// Chosen columns.
    pub columns: ColumnChoice,
    /// Whether positions are latitude and longitude, also if the columns are not called so.
    pub is_lat_lon: bool,
    /// Height where the table has none, metres; above the floor if it has floors.
    pub height: Option<f64>,
    /// Height of a floor, metres.
    pub floor_height: Option<f64>,
    /// Values that mean "not heard", as the table writes them.
    pub missing: Vec<f64>,
    /// Unit of the powers.
    pub unit: PowerUnit,
    /// Title of the data set.
    pub title: String,
    /// Whether the data are simulated.
    pub is_simulated: bool,
}

/// Data set of a table, and what was understood.
#[derive(Clone, Debug)]
pub struct ImportedTable {
    /// Received powers; receivers of unknown position have an estimated one.
    pub data: Dataset,
    /// What was understood, assumed, joined and left out: a sentence each.
    pub notes: Vec<String>,
    /// First lines of the first table.
    pub before: Vec<String>,
    /// The same rows as they were understood: position, then the powers by receiver.
    pub after: Vec<String>,
}

impl TableImport {
    /// Reads the tables.
    ///
    /// # Errors
    /// A file that cannot be read or is no table; columns that are missing or ambiguous; a cell that is no number; rows without a
    /// position; no received power at all.
    pub fn read(&self) -> Result<ImportedTable> {
        for (option, value) in [("--height", self.height), ("--floor-height", self.floor_height)] {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                return Err(Error::Config(format!("{option} {value}: give metres")));
            }
        }
        let mut survey = Survey::new(self)?;
        self.files.iter().try_for_each(|file| survey.add(file, false))?;
        self.test.iter().try_for_each(|file| survey.add(file, true))?;
        survey.finish()
    }
}

/// Reads the positions `[rows,3]` of a table in the frame of a model, metres: columns x, y and z, or latitude and longitude
/// where the frame has them.
///
/// # Errors
/// A file that cannot be read or is no table, or a row without a position; the message has line and column.
pub fn read_frame_positions(path: &Path, geodetic: Option<Geodetic>) -> Result<Vec<[f64; 3]>> {
    if geodetic.is_none() {
        return read_transmitters(path);
    }
    places::read_rows(&TableImport::default(), &path.to_owned().into(), &mut places::Frame { geodetic })
}
