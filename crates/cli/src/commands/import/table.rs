//! `pwrfgs import --table`: received powers from anybody's table.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::{ColumnChoice, TableFile, TableImport, save};
use pwrfgs::experiment::{check_findings, observed, staged};
use pwrfgs_core::{Error, PowerUnit, Result};
use std::path::{Path, PathBuf};

/// Options of `--table`.
#[derive(Debug, Default, Args)]
#[command(next_help_heading = "Tables of received powers")]
pub(crate) struct TableArguments {
    /// Tables of powers: a row per reading, or a column per receiver
    #[arg(long, alias = "links", value_name = "FILE", num_args = 1.., conflicts_with_all = ["orientation", "elevation", "scale"])]
    pub(crate) table: Vec<PathBuf>,
    /// Tables of the test set; the others are then the training set
    #[arg(long, value_name = "FILE", num_args = 1.., requires = "table")]
    test: Vec<PathBuf>,
    /// Positions of the receivers: columns name, x, y, z
    #[arg(long, value_name = "FILE", requires = "table")]
    receivers: Option<PathBuf>,
    /// Positions of places that rows name: columns name, x, y, z
    #[arg(long, value_name = "FILE", requires = "table")]
    places: Option<PathBuf>,
    /// Receivers' columns; * is any text [default: recognised]
    #[arg(long, value_name = "PATTERN", num_args = 1.., requires = "table")]
    columns: Vec<String>,
    /// Column of x, a name or a number from 1 [default: recognised]
    #[arg(long, value_name = "COLUMN", requires = "table")]
    x: Option<String>,
    /// Column of y
    #[arg(long, value_name = "COLUMN", requires = "table")]
    y: Option<String>,
    /// Column of the height
    #[arg(long, value_name = "COLUMN", requires = "table")]
    z: Option<String>,
    /// Column of the latitude, degrees
    #[arg(long, value_name = "COLUMN", requires = "table")]
    lat: Option<String>,
    /// Column of the longitude, degrees
    #[arg(long, value_name = "COLUMN", requires = "table")]
    lon: Option<String>,
    /// Positions are latitude, longitude in degrees
    #[arg(long, requires = "table")]
    lat_lon: bool,
    /// Column of the floor, a number
    #[arg(long, value_name = "COLUMN", requires = "table")]
    floor: Option<String>,
    /// Height of a floor in metres
    #[arg(long, value_name = "METRES", requires = "table", allow_hyphen_values = true)]
    floor_height: Option<f64>,
    /// Height where the table has none, in metres [default: 0]
    #[arg(long, value_name = "METRES", requires = "table", allow_hyphen_values = true)]
    height: Option<f64>,
    /// Column that identifies a transmitter
    #[arg(long, value_name = "COLUMN", requires = "table")]
    tx_id: Option<String>,
    /// Column of the power
    #[arg(long, value_name = "COLUMN", requires = "table")]
    power: Option<String>,
    /// Column of the time: readings of one place and time belong together
    #[arg(long, value_name = "COLUMN", requires = "table")]
    time: Option<String>,
    /// Value that means "not heard", such as 100; may repeat
    #[arg(long, value_name = "VALUE", requires = "table", allow_hyphen_values = true)]
    missing: Vec<f64>,
    /// dBm, positive-dBm, percent, dB:FLOOR, mW or W [default: dBm]
    #[arg(long, value_name = "UNIT", requires = "table")]
    unit: Option<String>,
    /// Print what was understood, and write nothing
    #[arg(long, requires = "table")]
    pub(super) dry_run: bool,
}

impl TableArguments {
    /// Returns the import that the options describe, of data without a title. Returns an error for an unknown unit.
    pub(super) fn settings(&self, tx: Option<&PathBuf>, receiver: Option<&String>) -> Result<TableImport> {
        let unit = self.unit.as_deref().map_or(Ok(PowerUnit::Dbm), str::parse);
        let file = |path: Option<&PathBuf>| path.cloned().map(TableFile::from);
        let files = |paths: &[PathBuf]| paths.iter().cloned().map(TableFile::from).collect();
        let Self { x, y, z, lat, lon, floor, tx_id, power, time, columns, .. } = self;
        let [x, y, z, lat, lon, floor, tx_id, power, time] =
            [x, y, z, lat, lon, floor, tx_id, power, time].map(Clone::clone);
        let receiver = receiver.cloned();
        Ok(TableImport {
            files: files(&self.table),
            test: files(&self.test),
            tx: file(tx),
            places: file(self.places.as_ref()),
            receivers: file(self.receivers.as_ref()),
            columns: ColumnChoice { x, y, z, lat, lon, floor, tx_id, receiver, power, time, wide: columns.clone() },
            is_lat_lon: self.lat_lon,
            height: self.height,
            floor_height: self.floor_height,
            missing: self.missing.clone(),
            unit: unit.map_err(|fault| Error::Config(format!("--unit {fault}")))?,
            title: String::new(),
            is_simulated: false,
        })
    }
}

/// Converts the tables into the data folder `out`, unless findings on its data are errors that are not `accepted`; without a
/// folder, prints what was understood.
pub(super) fn import_table(
    import: &TableImport,
    out: Option<&Path>,
    accepted: &[String],
    verbosity: Verbosity,
) -> Result<()> {
    let imported = RunProgress::observe(verbosity, |progress| {
        let mut imported = staged(progress, "rows", |_| import.read())?;
        imported.notes.iter().for_each(|note| verbosity.print_note(note));
        check_findings(&imported.data, None, Some(accepted), progress)?;
        imported.data.accepted = accepted.to_vec();
        out.map(|out| save(&imported.data, out)).transpose()?;
        Ok::<_, Error>(imported)
    })?;
    let Some(out) = out else {
        let [before, after] = [&imported.before, &imported.after].map(|lines| lines.join("\n  "));
        return output::print_result(&format!("before:\n  {before}\nafter:\n  {after}\n"));
    };
    let out = out.display();
    verbosity.print_note(&format!("{} in {out}; next: `pwrfgs init {out}`", observed(&imported.data)));
    Ok(())
}
