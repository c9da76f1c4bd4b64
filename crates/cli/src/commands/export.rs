//! `pwrfgs export`: converts a trained model for splat viewers and Python.

use crate::output::Verbosity;
use clap::Args;
use pwrfgs::model::export::{npz, ply};
use pwrfgs::model::{Ensemble, file};
use pwrfgs::tasks::plane::parse_position;
use pwrfgs::tasks::{check_positions, read_models};
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

/// Function that converts a model, for an optional transmitter position, into the bytes of a file.
type Writer = fn(&Ensemble, Option<[f64; 3]>) -> Result<Vec<u8>>;

#[derive(Debug, Args)]
#[command(after_help = "\
PLY   binary layout of 3D Gaussian splatting: x y z (metres from `origin` in the header, else from
      0 0 0), nx ny nz (0), f_dc_0..2 (colour), opacity (logit), scale_0..2 (ln of metres),
      rot_0..3 (w x y z). For spectra, the colour shows the pixel value of a Gaussian if it were
      opaque and alone, from dark violet (0) to yellow (1): f_dc = (rgb - 0.5) / 0.28209479177387814
NPZ   Gaussians, network, receivers and image plane, without residuals and intervals
      (docs/model-format.md)
--tx  Without it, the PLY file has the base parameters before the network's changes (mid-grey if the
      network sets the signal). With it, the PLY file has the values for that transmitter, and the
      NPZ file has them in addition.
The PLY file of an ensemble has the Gaussians of all members, with a property `member` (0, 1, ..).
Viewers blend all Gaussians, so delete those of other members before you view one. The NPZ file of
an ensemble has the arrays members.0.means, ..
Existing files are never overwritten.

EXAMPLES
  pwrfgs export runs/quickstart --ply office.ply
  pwrfgs export runs/quickstart --tx 3.5,2.2,1.2 --ply at.ply --npz at.npz")]
#[command(group(clap::ArgGroup::new("what").required(true).multiple(true).args(["ply", "npz", "half"])))]
pub(crate) struct Export {
    /// Run folder, model file or name of a model in `pwrfgs pipelines`, such as s23
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Write the Gaussians as PLY for splat viewers
    #[arg(long, value_name = "FILE")]
    pub(crate) ply: Option<PathBuf>,
    /// Write Gaussians, network and receivers for numpy.load
    #[arg(long, value_name = "FILE")]
    pub(crate) npz: Option<PathBuf>,
    /// Write the model file with 16-bit network weights, about half the size if the network is large
    #[arg(long, value_name = "FILE")]
    pub(crate) half: Option<PathBuf>,
    /// Transmitter position of --ply and --npz in metres, world frame
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) tx: Option<String>,
}

/// Runs `pwrfgs export`: writes all requested files, or none if one of them cannot be made.
pub(crate) fn export(arguments: &Export, verbosity: Verbosity) -> Result<()> {
    let tx = arguments.tx.as_deref().map(|text| parse_position("--tx", text)).transpose()?;
    let half: Writer = |model, _| file::to_bytes_half(model);
    let files: Vec<(&Path, Writer)> =
        [(&arguments.ply, ply as Writer), (&arguments.npz, npz as Writer), (&arguments.half, half)]
            .into_iter()
            .filter_map(|(path, writer)| path.as_deref().map(|path| (path, writer)))
            .collect();
    let mut names: Vec<PathBuf> = files.iter().map(|(path, _)| normalise_path(path)).collect();
    names.sort_unstable();
    names.dedup();
    if names.len() < files.len() {
        return Err(Error::Config("two exports have the same file name; set different names".into()));
    }
    files.iter().try_for_each(|(path, _)| check_new_file(path))?;
    let model = read_models(std::slice::from_ref(&arguments.model))?;
    if tx.is_some() {
        check_positions(&model)?;
    }
    if arguments.ply.is_some() && model.gaussians() == 0 {
        let problem = "model without Gaussians cannot be exported as PLY; use --npz";
        return Err(Error::input(&arguments.model, problem));
    }
    // All files are made before the first one is written: a failed export writes nothing.
    let contents: Vec<Vec<u8>> = files.iter().map(|(_, writer)| writer(&model, tx)).collect::<Result<_>>()?;
    let origin = model.members()[0].stages.origin;
    if arguments.ply.is_some() && !origin.is_zero() {
        let [x, y, z] = origin.0;
        verbosity.print_note(&format!(
            "positions in the PLY file are relative to {x}, {y}, {z}, because viewers compute in single precision"
        ));
    }
    for ((path, _), bytes) in files.iter().zip(contents) {
        create(path, &bytes)?;
        let count = model.gaussians();
        let content = if count == 0 { "the network".into() } else { format!("{count} Gaussians") };
        verbosity.print_note(&format!("{content} in {}", path.display()));
    }
    Ok(())
}

/// Resolves the folder in the path of a file that may not exist yet, such as `./a.npz`, so that equal files have equal
/// paths.
fn normalise_path(path: &Path) -> PathBuf {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    folder.canonicalize().unwrap_or_else(|_| folder.into()).join(path.file_name().unwrap_or_default())
}
