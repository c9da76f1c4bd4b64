//! `import --table`: received powers with positions from a table of any shape.
//!
//! A table has a row per reading (long) or a row per transmitter and a column per receiver (wide). Columns are recognised by
//! their names; each can be chosen. Readings of a link that repeat are kept, in a location each at the same position.

mod columns;
mod finish;
mod names;
mod options;
mod places;
mod powers;
mod rows;
mod survey;
#[cfg(test)]
mod tests;

pub use options::{ColumnChoice, ImportedTable, TableImport};

use self::survey::Survey;
use crate::nerf2::read_transmitters;
use pwrfgs_core::{Error, Geodetic, Progress, Result};
use std::path::Path;

impl TableImport {
    /// Reads the tables; `progress` counts lines.
    ///
    /// # Errors
    /// A file that cannot be read or is no table; columns that are missing or ambiguous; a cell that is no number; rows without a
    /// position; no received power at all.
    pub fn read(&self, progress: Progress<'_>) -> Result<ImportedTable> {
        for (option, value) in [("--height", self.height), ("--floor-height", self.floor_height)] {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                return Err(Error::Config(format!("{option} {value}: give metres")));
            }
        }
        let mut survey = Survey::new(self)?;
        self.files.iter().try_for_each(|file| survey.add(file, false, progress))?;
        self.test.iter().try_for_each(|file| survey.add(file, true, progress))?;
        survey.finish()
    }
}

/// Reads the positions `[rows,3]` of a table in the frame of a model, metres: columns x, y and z, or latitude and longitude
/// if `geodetic` states the zero of the frame. In that case, a table without heights has this `height`, metres.
///
/// # Errors
/// A file that cannot be read or is no table, or a row without a position; the message has line and column.
pub fn read_frame_positions(path: &Path, geodetic: Option<Geodetic>, height: f64) -> Result<Vec<[f64; 3]>> {
    if geodetic.is_none() {
        return read_transmitters(path);
    }
    let import = TableImport { height: Some(height), ..TableImport::default() };
    places::Frame { geodetic }.read_rows(&import, &path.as_os_str().to_owned().into())
}
