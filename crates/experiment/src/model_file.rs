//! `model_file`: the model that a path names.

use crate::folder::{MODEL_FILE, PIPELINE};
use crate::sweep::{JOINED, Listing};
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

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
