//! `pwrfgs import`: positions and spectra of other programs become a data folder.

use super::options::{numbers, position};
use crate::output::{self, Verbosity};
use crate::progress::Progress;
use clap::Args;
use pwrfgs::data::import::Import as Work;
use pwrfgs::experiment::{equality_warning, position_warning, staged};
use pwrfgs_core::{Elevation, Error, Number, Pose, Result};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(
    after_long_help = "Spectra are [M, H, W]: M pictures of H rows (elevation) and W columns (azimuth), linear (no \
    decibels), 1 the strongest direction. uint8 (255 is 1), uint16 (65535 is 1), float32 and float64 keep their \
    precision (float64 becomes float32). Any number of them passes through little memory. The folder holds spectra.npy, \
    tx.npy, gateway_info.yml and manifest.json; add train_index.txt and test_index.txt (ids, one a line, counted from 1) \
    for a split of its own. A folder that holds anything is never touched.\n\nEXAMPLES\n  In Python: \
    numpy.save(\"s.npy\", spectra); numpy.save(\"tx.npy\", positions)\n      pwrfgs import --spectra s.npy --tx tx.npy \
    --receiver 5,0.26,0 --orientation 0,0,0,1 --out data/mine\n  numpy.savez(\"all.npz\", spectra=s, tx=p)\n      \
    pwrfgs import --spectra all.npz --receiver 5,0.26,0 --orientation 0,0,0,1 --out data/mine\n  16-bit pictures \
    00001.png .. and a table with columns x, y, z:\n      pwrfgs import --spectra pictures --tx tx.csv --receiver \
    5,0.26,0 --orientation 0,0,0,1 --out data/mine\n  Floats from 0 to 255:\n      pwrfgs import --spectra s.npy --tx \
    tx.npy --receiver 5,0.26,0 --orientation 0,0,0,1 --scale 0.00392156862745098 --out data/mine"
)]
pub(crate) struct Import {
    /// The spectra: array .npy, archive .npz (FILE.npz:NAME names an array), or folder of grey PNG, 8 or 16 bits
    #[arg(long, value_name = "PATH")]
    pub(crate) spectra: PathBuf,
    /// The transmitters in metres: .npy or .npz [M, 3], or .csv with columns x, y, z [default: `tx` of the same .npz]
    #[arg(long, value_name = "FILE")]
    pub(crate) tx: Option<PathBuf>,
    /// Position of the receiver in metres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) receiver: String,
    /// Orientation of the receiver: the unit quaternion that turns its axes into the world's; 0,0,0,1 for none
    #[arg(long, value_name = "X,Y,Z,W", allow_hyphen_values = true)]
    pub(crate) orientation: String,
    /// Elevations where the top row begins and the bottom row ends, degrees [default: 0,90]
    #[arg(long, value_name = "FIRST,LAST", allow_hyphen_values = true)]
    pub(crate) elevation: Option<String>,
    /// The folder to make
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// What the data set is called [default: the folder's name]
    #[arg(long)]
    pub(crate) name: Option<String>,
    /// Multiply every value, so that they are from 0 to 1
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true)]
    pub(crate) scale: Option<f64>,
    /// The spectra are simulated: titles and tables say so
    #[arg(long)]
    pub(crate) simulated: bool,
}

pub(crate) fn import(arguments: &Import, verbosity: Verbosity) -> Result<()> {
    let name = || arguments.out.file_name().map_or_else(|| "unnamed".into(), |n| n.to_string_lossy().into_owned());
    let work = Work {
        spectra: arguments.spectra.clone(),
        tx: arguments.tx.clone(),
        receiver: Pose {
            position: position("--receiver", &arguments.receiver)?,
            orientation: quaternion(&arguments.orientation)?,
        },
        elevation: arguments.elevation.as_deref().map(elevation).transpose()?,
        name: arguments.name.clone().unwrap_or_else(name),
        scale: arguments.scale,
        simulated: arguments.simulated,
    };
    let imported = Progress::during(verbosity, |progress| {
        staged(progress, "spectra", |progress| work.write(&arguments.out, progress))
    })?;
    if verbosity != Verbosity::Quiet {
        let equality = equality_warning("spectra", imported.tx.len(), imported.are_equal);
        position_warning(&imported.tx).iter().chain(&equality).for_each(|warning| output::warning(warning));
        let ([m, h, w], (low, high)) = (imported.shape, imported.range);
        let kind = match imported.number {
            Number::U8 => "8-bit",
            Number::U16 => "16-bit",
            Number::F32 | Number::F64 => "32-bit floats",
        };
        let out = arguments.out.display();
        output::note(&format!(
            "{m} spectra of {w} x {h} pixels ({kind}, {low:.4} to {high:.4}) in {out}; in a pipeline:"
        ));
        output::note(&format!("    data: Arrays(root: {:?}),", arguments.out.to_string_lossy()));
        output::note("    split: Random(test: 0.2),");
    }
    Ok(())
}

/// `first,last` of the command line.
fn elevation(text: &str) -> Result<Elevation> {
    let [first, last] = numbers(text).ok_or_else(|| {
        Error::Config(format!("--elevation {text}: give two numbers in degrees, such as -90,90 for a full sphere"))
    })?;
    Ok(Elevation { first, last })
}

/// `x,y,z,w` of the command line.
fn quaternion(text: &str) -> Result<[f64; 4]> {
    numbers(text).ok_or_else(|| {
        Error::Config(format!("--orientation {text}: give a unit quaternion x,y,z,w, such as 0,0,0,1 for no rotation"))
    })
}
