//! The model that a path names, and its pipeline.

use crate::folder::{MODEL_FILE, PIPELINE};
use crate::sweep::{JOINED, Listing};
use pwrfgs_core::{Error, Result, ShippedModel, did_you_mean};
use pwrfgs_model::{Ensemble, file};
use std::path::{Path, PathBuf};

/// Reads the models that `path` names: those of a file or of a run folder, or else the shipped model of this name.
///
/// # Errors
/// As [`model_file`] and [`file::read_ensemble`]; the message for a missing file without extension suggests a shipped model.
pub fn read_model(path: &Path) -> Result<Ensemble> {
    if let Some(model) = ShippedModel::find(path) {
        return file::from_bytes(model.bytes).map_err(|why| Error::input(path, why));
    }
    let models = ShippedModel::all();
    if path.exists() || path.components().count() != 1 || path.extension().is_some() || models.is_empty() {
        return file::read_ensemble(&model_file(path)?);
    }
    let hint = did_you_mean(&path.to_string_lossy(), models.iter().map(|model| model.name));
    let problem = format!("no such file or folder, and the program ships no model of this name{hint}");
    Err(Error::input(path, problem))
}

/// Returns the pipeline of the model that `path` names: the file next to it, or the name of the shipped pipeline of a shipped
/// model; `None` for a model file alone.
///
/// # Errors
/// As [`model_file`].
pub fn pipeline_of_model(path: &Path) -> Result<Option<PathBuf>> {
    if let Some(model) = ShippedModel::find(path) {
        return Ok(Some(model.pipeline.into()));
    }
    let beside = model_file(path)?.with_file_name(PIPELINE);
    Ok(beside.is_file().then_some(beside))
}

/// Returns the model file that `path` names: the file itself, or the model of a run folder.
///
/// # Errors
/// A folder without a model; the error of a sweep folder lists its runs.
pub fn model_file(path: &Path) -> Result<PathBuf> {
    let model = path.join(MODEL_FILE);
    if !path.is_dir() {
        return Ok(path.into());
    } else if model.is_file() {
        return Ok(model);
    }
    if let Some(listing) = Listing::read(path)? {
        let joined = if path.join(JOINED).join(MODEL_FILE).is_file() { format!("{JOINED}, ") } else { String::new() };
        let runs = listing.run_names();
        let problem = "folder of a sweep, expected a run folder or a model file; name one of its runs";
        return Err(Error::input(path, format!("{problem}: {joined}{runs}")));
    }
    let problem = if path.join(PIPELINE).is_file() {
        format!("this run has no {MODEL_FILE} yet; repeat `pwrfgs run` to finish it")
    } else {
        format!("not a run folder: no {MODEL_FILE}; name a run folder or a model file")
    };
    Err(Error::input(path, problem))
}
