//! From a file and `--set` arguments to a pipeline whose paths hold everywhere.

use pwrfgs::experiment::{rebase, rebase_baselines, rebase_data};
use pwrfgs::train::Pipeline;
use pwrfgs_core::{Error, Result};
use std::path::Path;

/// Reads `path` and applies `--set`. Paths in the file are relative to the file, those of `--set data=..` and
/// `--set baselines=..` to where one stands.
pub(crate) fn load(path: &Path, set: &[String]) -> Result<Pipeline> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let text = String::from_utf8(bytes).map_err(|e| {
        let line = e.as_bytes()[..e.utf8_error().valid_up_to()].split(|b| *b == b'\n').count();
        Error::at(path, line, 1, "this is not UTF-8 text; save the pipeline as plain text")
    })?;
    let mut pipeline = Pipeline::parse(text.trim_start_matches('\u{feff}'), path)?;
    rebase(&mut pipeline, path.parent().unwrap_or(Path::new("")));
    for argument in set {
        pipeline.set(argument)?;
        match argument.split('=').next().map(str::trim) {
            Some("data") => rebase_data(&mut pipeline.data, Path::new("")),
            Some("baselines") => rebase_baselines(&mut pipeline.baselines, Path::new("")),
            _ => {}
        }
    }
    Ok(pipeline)
}
