//! `pwrfgs export`: a trained model for splat viewers and for Python.

use super::predict::position;
use crate::args::{Export, Verbosity};
use crate::output;
use pwrfgs::experiment::export::{npz, ply};
use pwrfgs::model::{Model, file};
use pwrfgs_core::{Error, Real, Result};
use std::path::Path;
use std::process::ExitCode;

/// A way to turn a model into a file.
type Writer = fn(&Model, Option<[Real; 3]>) -> Result<Vec<u8>>;

pub(crate) fn export(arguments: &Export, verbosity: Verbosity) -> Result<ExitCode> {
    let tx = arguments.tx.as_deref().map(position).transpose()?;
    let half: Writer = |model, _| file::to_bytes_half(model);
    let files: Vec<(&Path, Writer)> =
        [(&arguments.ply, ply as Writer), (&arguments.npz, npz as Writer), (&arguments.half, half)]
            .into_iter()
            .filter_map(|(path, writer)| path.as_deref().map(|path| (path, writer)))
            .collect();
    let mut names: Vec<&Path> = files.iter().map(|(path, _)| *path).collect();
    names.sort_unstable();
    names.dedup();
    if names.len() < files.len() {
        return Err(Error::Config("two exports name the same file; give each a name of its own".into()));
    }
    files.iter().try_for_each(|(path, _)| check_new(path))?;
    let model = file::read(&arguments.model)?;
    // All are made before the first is written: what cannot be exported leaves nothing behind.
    let made: Vec<Vec<u8>> = files.iter().map(|(_, writer)| writer(&model, tx)).collect::<Result<_>>()?;
    for ((path, _), bytes) in files.iter().zip(made) {
        file::write_atomically(path, &bytes)?;
        if verbosity != Verbosity::Quiet {
            output::note(&format!("{} Gaussians in {}", model.cloud.len(), path.display()));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Refuses what exists, a broken link included: it may be anything.
fn check_new(path: &Path) -> Result<()> {
    match path.symlink_metadata() {
        Ok(_) => Err(Error::Config(format!("{} exists; choose another name or remove it", path.display()))),
        Err(_) => Ok(()),
    }
}
