//! `pwrfgs import`: converts spectra and positions, channels, or a table of links, into a data folder.

mod channels;

use self::channels::{ChannelOptions, import_channels};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::import::{ChannelImport, Import as Work, read_links};
use pwrfgs::data::save;
use pwrfgs::experiment::{observed, staged, warn_of_findings};
use pwrfgs::tasks::init::unknown_folder_error;
use pwrfgs::tasks::plane::{parse_numbers, parse_position};
use pwrfgs_core::{Elevation, Error, Number, Pose, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Spectra are [M, H, W]: M spectra, H rows of elevation, W columns of azimuth; linear values (not dB)
from 0 to 1, the strongest direction. Types: uint8 (255 is 1), uint16 (65535 is 1), float32, and
float64, stored as float32. The import needs little memory for any number of spectra.
Writes spectra.npy, tx.npy, gateway_info.yml and manifest.json. For a fixed split, add
train_index.txt and test_index.txt (one id per line, from 1).

EXAMPLES
  python3 -c \"from numpy import *; r = random.rand; savez('my.npz', spectra=r(9,90,360), tx=r(9,3))\"
  pwrfgs import --spectra my.npz --receiver 5,1,0 --orientation 0,0,0,1 --out data/my
  pwrfgs import --spectra s.npy --tx tx.npy --receiver 5,1,0 --orientation 0,0,0,1 --out data/my2
  pwrfgs import --spectra images --tx tx.csv --receiver 5,1,0 --orientation 0,0,0,1 --out data/my3
  printf 'x,y,z,receiver,rx_x,rx_y,rx_z,dbm\\n1,2,1,hall,0,0,2,-61\\n2,2,1,hall,0,0,2,-64\\n' > links.csv
  pwrfgs import --links links.csv --out data/my4
  python3 -c \"from numpy import *; r = random.randn; savez('h.npz', channels=r(9,3,8,2), tx=r(9,3))\"
  pwrfgs import --channels h.npz --axes m,a,f,ri --powers --receiver 0,0,2 --out data/my5")]
#[command(group(clap::ArgGroup::new("what").required(true).args(["spectra", "links", "channels"])))]
pub(crate) struct Import {
    /// Spectra: .npy, .npz or .npz:NAME, or folder of grey PNG (8, 16 bits)
    #[arg(long, value_name = "PATH", requires_all = ["receiver", "orientation"])]
    pub(crate) spectra: Option<PathBuf>,
    /// Received powers: .csv with one row per link (columns: see example)
    #[arg(long, value_name = "FILE", conflicts_with_all = ["tx", "receiver", "orientation", "elevation", "scale"])]
    pub(crate) links: Option<PathBuf>,
    /// Transmitter positions in metres.
    #[arg(
        long,
        value_name = "FILE",
        help = "Transmitter positions in metres: .npy or .npz [M, 3], or .csv with\ncolumns x, y, z [default: array tx of the .npz of the spectra]"
    )]
    pub(crate) tx: Option<PathBuf>,
    /// Receiver position in metres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) receiver: Option<String>,
    /// Unit quaternion x,y,z,w, receiver to world; 0,0,0,1: no rotation
    #[arg(long, value_name = "QUAT", allow_hyphen_values = true)]
    pub(crate) orientation: Option<String>,
    /// Elevation of the top and bottom edge, degrees [default: 0,90]
    #[arg(long, value_name = "FIRST,LAST", allow_hyphen_values = true)]
    pub(crate) elevation: Option<String>,
    /// Output folder; must be new or empty
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Name of the data set [default: name of the folder]
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Factor for all values, so that they range from 0 to 1
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true)]
    pub(crate) scale: Option<f64>,
    /// Mark the spectra as simulated in titles and tables
    #[arg(long)]
    pub(crate) simulated: bool,
    #[command(flatten)]
    pub(crate) channels: ChannelOptions,
}

/// Runs `pwrfgs import`: writes the data folder, and warns of findings on its data.
pub(crate) fn import(arguments: &Import, verbosity: Verbosity) -> Result<()> {
    let folder_name =
        || arguments.out.file_name().map_or_else(|| "unnamed".into(), |n| n.to_string_lossy().into_owned());
    let name = arguments.name.clone().unwrap_or_else(folder_name);
    if let Some(path) = &arguments.links {
        return import_links(arguments, path, &name, verbosity);
    }
    let receiver = Pose {
        position: parse_position("--receiver", arguments.receiver.as_deref().unwrap_or_default())?,
        orientation: parse_quaternion(arguments.orientation.as_deref().unwrap_or("0,0,0,1"))?,
    };
    if !arguments.channels.channels.is_empty() {
        let (tx, simulated) = (arguments.tx.clone(), arguments.simulated);
        let import = ChannelImport { tx, receiver, name, simulated, ..arguments.channels.settings() };
        return import_channels(&import, &arguments.out, verbosity);
    }
    let work = Work {
        spectra: arguments.spectra.clone().unwrap_or_default(),
        tx: arguments.tx.clone(),
        receiver,
        elevation: arguments.elevation.as_deref().map(parse_elevation).transpose()?,
        name,
        scale: arguments.scale,
        simulated: arguments.simulated,
    };
    let imported = RunProgress::observe(verbosity, |progress| {
        let imported = staged(progress, "spectra", |progress| work.write(&arguments.out, progress))?;
        let source = recognise(&arguments.out).ok_or_else(|| unknown_folder_error(&arguments.out))?;
        let data = staged(progress, "new folder", |progress| source.load(Path::new(""), progress))?;
        warn_of_findings(&data, None, progress)?;
        Ok::<_, Error>(imported)
    })?;
    if verbosity != Verbosity::Quiet {
        let ([m, h, w], (low, high)) = (imported.shape, imported.range);
        let kind = match imported.number {
            Number::U8 => "8-bit",
            Number::U16 => "16-bit",
            Number::F32 | Number::F64 => "32-bit floats",
        };
        let out = arguments.out.display();
        output::print_note(&format!(
            "{m} spectra of {w} x {h} pixels ({kind}, {low:.4} to {high:.4}) in {out}; in a pipeline:"
        ));
        output::print_note(&format!("    data: Arrays(root: {:?}),", arguments.out.to_string_lossy()));
        output::print_note("    split: Random(test: 0.2),");
    }
    Ok(())
}

/// Converts the table of links in `path` into a data folder called `name`, and warns of findings on its data.
fn import_links(arguments: &Import, path: &Path, name: &str, verbosity: Verbosity) -> Result<()> {
    let (data, silent) = read_links(path, name, arguments.simulated)?;
    save(&data, &arguments.out)?;
    warn_of_findings(&data, None, &mut RunProgress::new(verbosity))?;
    let out = arguments.out.display();
    let left_out = if silent == 0 { String::new() } else { format!("; rows of -100 dBm, not received: {silent}") };
    verbosity.print_note(&format!("{} in {out}{left_out}; next: `pwrfgs init {out}`", observed(&data)));
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
