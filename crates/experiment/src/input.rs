//! From files and `--set` arguments to pipelines whose paths hold everywhere.

use crate::runner::rebase;
use pwrfgs_core::{Error, Result};
use pwrfgs_train::Pipeline;
use std::path::Path;

/// Reads the pipeline in `path` and applies `--set` arguments. Paths in the file are relative to the file.
///
/// # Errors
/// [`Error::Input`] with line and column, or what is wrong with an argument.
pub fn read_pipeline(path: &Path, set: &[String]) -> Result<Pipeline> {
    let mut pipeline = Pipeline::parse(&read_text(path)?, path)?;
    rebase(&mut pipeline, path.parent().unwrap_or(Path::new("")));
    set_all(&mut pipeline, set)?;
    Ok(pipeline)
}

/// Applies `--set` arguments to a pipeline whose own paths are absolute; theirs are relative to where one stands.
///
/// # Errors
/// What is wrong with an argument.
pub(crate) fn set_all(pipeline: &mut Pipeline, set: &[String]) -> Result<()> {
    set.iter().try_for_each(|argument| pipeline.set(argument))?;
    rebase(pipeline, Path::new(""));
    Ok(())
}

/// A text file as a person writes it: UTF-8, with or without a byte order mark.
///
/// # Errors
/// Where it cannot be read, or is no such text.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let text = String::from_utf8(bytes).map_err(|e| {
        let line = e.as_bytes()[..e.utf8_error().valid_up_to()].split(|b| *b == b'\n').count();
        Error::at(path, line, 1, "this is not UTF-8 text; save the file as plain text")
    })?;
    Ok(text.trim_start_matches('\u{feff}').to_owned())
}
