//! `TableImport`: tables and how to read them, which are also the options of `import --table`, and what comes of it.

use crate::dialect::TableFile;
use clap::Args;
use pwrfgs_core::{Dataset, PowerUnit};

/// Columns that the user chose: names, or numbers from 1. `None`: recognised by name.
#[derive(Clone, Debug, Default, Args)]
pub struct ColumnChoice {
    /// Columns of receivers, by name; * stands for any text [default: recognised]
    #[arg(long = "columns", value_name = "PATTERN", num_args = 1.., requires = "files")]
    pub wide: Vec<String>,
    /// Column of x, a name or a number from 1 [default: recognised]
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub x: Option<String>,
    /// Column of y
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub y: Option<String>,
    /// Column of the height
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub z: Option<String>,
    /// Column of the latitude, degrees
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub lat: Option<String>,
    /// Column of the longitude, degrees
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub lon: Option<String>,
    /// Column of the floor number
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub floor: Option<String>,
    /// Column that identifies a transmitter
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub tx_id: Option<String>,
    /// Column of the receiver in a table with a row per reading; else the name of the only receiver.
    #[arg(skip)]
    pub receiver: Option<String>,
    /// Column of the power
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub power: Option<String>,
    /// Column of the time; readings at one position and time form one transmitter
    #[arg(long, value_name = "COLUMN", requires = "files")]
    pub time: Option<String>,
}

/// Tables of received powers, and how to read them.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Tables of received powers")]
pub struct TableImport {
    /// Tables of powers: one row per reading, or one column per receiver
    #[arg(long = "table", alias = "links", value_name = "FILE", num_args = 1..)]
    pub files: Vec<TableFile>,
    /// Tables of the test set; those of --table are then the training set
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "files")]
    pub test: Vec<TableFile>,
    /// Positions of the rows of `files` and `test`, row by row.
    #[arg(skip)]
    pub tx: Option<TableFile>,
    /// Positions of the receivers: columns name, x, y, z
    #[arg(long, value_name = "FILE", requires = "files")]
    pub receivers: Option<TableFile>,
    /// Positions of the places named in the rows: columns name, x, y, z
    #[arg(long, value_name = "FILE", requires = "files")]
    pub places: Option<TableFile>,
    /// Chosen columns.
    #[command(flatten)]
    pub columns: ColumnChoice,
    /// Read positions as latitude and longitude in degrees
    #[arg(long = "lat-lon", requires = "files")]
    pub is_lat_lon: bool,
    /// Height of one storey in metres, multiplied by the floor number
    #[arg(long, value_name = "METRES", requires = "files", allow_hyphen_values = true)]
    pub floor_height: Option<f64>,
    /// Height in metres if the table has none [default: 0]
    #[arg(long, value_name = "METRES", requires = "files", allow_hyphen_values = true)]
    pub height: Option<f64>,
    /// Value that means "not received", such as 100; repeatable
    #[arg(long, value_name = "VALUE", requires = "files", allow_hyphen_values = true)]
    pub missing: Vec<f64>,
    /// Unit of powers: dBm, positive-dBm (without sign), percent, dB:FLOOR (dB over a floor in dBm), mW or W
    #[arg(long, value_name = "UNIT", requires = "files", default_value = "dBm")]
    pub unit: PowerUnit,
    /// Title of the data set.
    #[arg(skip)]
    pub title: String,
    /// Whether the data are simulated.
    #[arg(skip)]
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
