//! `pwrfgs import`: converts spectra and positions, channels, or tables of powers, into a data folder.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::import::{ChannelImport, Import as SpectraImport};
use pwrfgs::data::{Colormap, ImportedTable, TableImport, save};
use pwrfgs::experiment::{check_findings, describe_observations, run_stage};
use pwrfgs::tasks::init::unknown_folder_error;
use pwrfgs::tasks::plane::{parse_numbers, parse_position};
use pwrfgs_core::{Elevation, Error, Number, Pose, Progress, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Spectra are [M, H, W]: M spectra, H rows of elevation, W columns of azimuth; linear values (not dB)
from 0 to 1. Types: uint8 (255 is 1), uint16 (65535 is 1), float32, and float64, stored as float32.
Training reads up to 512 MB of spectra into memory; more spectra stay in their file.
For spectra, the command writes spectra.npy, tx.npy, gateway_info.yml and manifest.json. For a fixed
split, add train_index.txt and test_index.txt (one row of the spectra per line, from 1).

EXAMPLES
  python3 -c \"from numpy import *; r = random.rand; savez('my.npz', spectra=r(9,90,360), tx=r(9,3))\"
  pwrfgs import --spectra my.npz --receiver 5,1,0 --orientation 0,0,0,1 --out data/my
  pwrfgs import --spectra s.npy --tx tx.npy --receiver 5,1,0 --orientation 0,0,0,1 --out data/my2
  pwrfgs import --spectra images --tx tx.csv --receiver 5,1,0 --orientation 0,0,0,1 --out data/my3
  printf 'x,y,z,receiver,rx_x,rx_y,rx_z,dbm\\n1,2,1,hall,0,0,2,-61\\n2,2,1,hall,0,0,2,-64\\n' > links.csv
  pwrfgs import --table links.csv --out data/my4
  pwrfgs import --table survey.csv --receivers aps.csv --missing 100 --dry-run
  python3 -c \"from numpy import *; r = random.randn; savez('h.npz', channels=r(9,3,8,2), tx=r(9,3))\"
  pwrfgs import --channels h.npz --axes m,a,f,ri --powers --receiver 0,0,2 --out data/my5")]
#[command(group(clap::ArgGroup::new("what").required(true).args(["spectra", "files", "channels"])))]
pub(crate) struct Import {
    /// Spectra: .npy, .npz or .npz:NAME, or folder of grey PNG (8, 16 bits)
    #[arg(long, value_name = "PATH", requires_all = ["receiver", "orientation"])]
    pub(crate) spectra: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) table: TableImport,
    /// Transmitter positions in metres.
    #[arg(
        long,
        value_name = "FILE",
        help = "Transmitter positions in metres: .npy or .npz [M, 3], or .csv with\ncolumns x, y, z [default: array tx of the .npz of spectra or channels]"
    )]
    pub(crate) tx: Option<PathBuf>,
    /// Receiver position in metres; with --table, the column of receivers or the name of the only receiver
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) receiver: Option<String>,
    /// Unit quaternion x,y,z,w from receiver to world axes; 0,0,0,1: no rotation
    #[arg(long, value_name = "QUAT", allow_hyphen_values = true, conflicts_with = "files")]
    pub(crate) orientation: Option<String>,
    /// Elevation of the first row, and of the row after the last one, degrees [default: 0,90]
    #[arg(long, value_name = "FIRST,LAST", allow_hyphen_values = true, conflicts_with = "files")]
    pub(crate) elevation: Option<String>,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR", required_unless_present = "dry_run")]
    pub(crate) out: Option<PathBuf>,
    /// Name of the data set [default: name of the folder]
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Factor for all values, so that they range from 0 to 1
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true, conflicts_with = "files")]
    pub(crate) scale: Option<f64>,
    /// Colour map of a folder of images, inverted to values: jet, turbo or viridis
    #[arg(
        long,
        value_name = "NAME",
        value_enum,
        ignore_case = true,
        hide_possible_values = true,
        conflicts_with = "files"
    )]
    pub(crate) colormap: Option<Colormap>,
    /// Mark the data as simulated in titles and tables
    #[arg(long)]
    pub(crate) simulated: bool,
    /// Continue despite this finding (a fault in the data that an error names), such as lone-value; repeatable
    #[arg(long, value_name = "FINDING")]
    pub(crate) accept: Vec<String>,
    /// Print the recognised columns of a table and some converted rows; write nothing
    #[arg(long, requires = "files")]
    pub(crate) dry_run: bool,
    #[command(flatten)]
    pub(crate) channels: ChannelImport,
}

/// Runs `pwrfgs import`: writes the data folder, or prints some rows with `--dry-run`; warns of findings on the data.
pub(crate) fn import(arguments: &Import, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone();
    let folder = out.as_ref().and_then(|out| out.file_name());
    let folder_name = || folder.map_or_else(|| "unnamed".into(), |n| n.to_string_lossy().into_owned());
    let name = arguments.name.clone().unwrap_or_else(folder_name);
    if !arguments.table.files.is_empty() {
        let tx = arguments.tx.clone().map(|path| path.into_os_string().into());
        let mut import = TableImport { title: name, is_simulated: arguments.simulated, tx, ..arguments.table.clone() };
        import.columns.receiver.clone_from(&arguments.receiver);
        let out = out.as_deref().filter(|_| !arguments.dry_run);
        return import_data(|progress| import.read(progress), out, &arguments.accept, verbosity);
    }
    let out = out.unwrap_or_default();
    let receiver = Pose {
        position: parse_position("--receiver", arguments.receiver.as_deref().unwrap_or_default())?,
        orientation: parse_quaternion(arguments.orientation.as_deref().unwrap_or("0,0,0,1"))?,
    };
    if !arguments.channels.channels.is_empty() {
        let (tx, simulated) = (arguments.tx.clone(), arguments.simulated);
        let import = ChannelImport { tx, receiver, name, simulated, ..arguments.channels.clone() };
        let read = |_: Progress<'_>| {
            import.read().map(|(data, notes)| ImportedTable { data, notes, before: Vec::new(), after: Vec::new() })
        };
        return import_data(read, Some(&out), &arguments.accept, verbosity);
    }
    import_spectra(arguments, &out, name, receiver, verbosity)
}

/// Writes spectra into the folder `out`, and prints their shape and the settings of a pipeline. Removes the folder again if a
/// finding is not accepted.
fn import_spectra(arguments: &Import, out: &Path, name: String, receiver: Pose, verbosity: Verbosity) -> Result<()> {
    let import = SpectraImport {
        spectra: arguments.spectra.clone().unwrap_or_default(),
        tx: arguments.tx.clone(),
        receiver,
        elevation: arguments.elevation.as_deref().map(parse_elevation).transpose()?,
        name,
        scale: arguments.scale,
        colormap: arguments.colormap,
        simulated: arguments.simulated,
    };
    let imported = RunProgress::observe(verbosity, |progress| {
        let imported = run_stage(progress, "spectra", |progress| import.write(out, progress))?;
        let source = recognise(out).ok_or_else(|| unknown_folder_error(out))?;
        let data = run_stage(progress, "new folder", |progress| source.load(Path::new(""), progress))?;
        let checked = check_findings(&data, None, Some(&arguments.accept), progress);
        checked.inspect_err(|_| drop(std::fs::remove_dir_all(out)))?; // was new or empty
        Ok::<_, Error>(imported)
    })?;
    if verbosity != Verbosity::Quiet {
        let ([m, h, w], (low, high)) = (imported.shape, imported.range);
        let kind = match imported.number {
            Number::U8 => "8-bit",
            Number::U16 => "16-bit",
            Number::F32 | Number::F64 => "32-bit floats",
        };
        let folder = out.display();
        output::print_note(&format!(
            "{m} spectra of {w} x {h} pixels ({kind}, {low:.4} to {high:.4}) in {folder}; in a pipeline:"
        ));
        output::print_note(&format!("    data: Arrays(root: {:?}),", out.to_string_lossy()));
        output::print_note("    split: Random(test: 0.2),");
    }
    Ok(())
}

/// Writes the data that `read` returns into the folder `out`; without a folder, prints how they were read. Returns an error for
/// findings that are not `accepted` and make results meaningless.
fn import_data(
    read: impl FnOnce(Progress<'_>) -> Result<ImportedTable>,
    out: Option<&Path>,
    accepted: &[String],
    verbosity: Verbosity,
) -> Result<()> {
    let imported = RunProgress::observe(verbosity, |progress| {
        let mut imported = run_stage(progress, "rows", read)?;
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
    verbosity.print_note(&format!("{} in {out}; next: `pwrfgs init {out}`", describe_observations(&imported.data)));
    Ok(())
}

/// Parses `first,last`, degrees, the value of `--elevation`.
fn parse_elevation(text: &str) -> Result<Elevation> {
    let [first, last] = parse_numbers(text).ok_or_else(|| {
        Error::Config(format!("--elevation {text}: expected two numbers in degrees, such as -90,90 for a full sphere"))
    })?;
    Ok(Elevation { first, last })
}

/// Parses `x,y,z,w`, the value of `--orientation`; the norm is not checked.
fn parse_quaternion(text: &str) -> Result<[f64; 4]> {
    parse_numbers(text).ok_or_else(|| {
        Error::Config(format!(
            "--orientation {text}: expected a unit quaternion x,y,z,w, such as 0,0,0,1 for no rotation"
        ))
    })
}
