//! `TableImport`: tables and how to read them, and what comes of it.

use crate::dialect::TableFile;
use pwrfgs_core::{Dataset, PowerUnit};

/// Columns that the user chose: names, or numbers from 1. `None`: recognised by name.
#[derive(Clone, Debug, Default)]
#[allow(missing_docs, reason = "each is the column of that quantity")]
pub struct ColumnChoice {
    pub x: Option<String>,
    pub y: Option<String>,
    pub z: Option<String>,
    pub lat: Option<String>,
    pub lon: Option<String>,
    pub floor: Option<String>,
    pub tx_id: Option<String>,
    /// Column of the receiver in a table with a row per reading; else the name of the only receiver.
    pub receiver: Option<String>,
    pub power: Option<String>,
    pub time: Option<String>,
    /// Columns of receivers in a table with a row per transmitter: names, in which `*` stands for any text.
    pub wide: Vec<String>,
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
