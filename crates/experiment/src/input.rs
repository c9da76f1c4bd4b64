//! From files and `--set` arguments to pipelines whose paths hold everywhere.

use crate::runner::rebase;
use pwrfgs_core::{Result, files::read_text};
use pwrfgs_train::Pipeline;
use std::path::Path;

/// Reads the pipeline in `path`, applies `--set` arguments and then its `training.scale`. Paths in the file are relative
/// to the file.
///
/// # Errors
/// [`Error::Input`](pwrfgs_core::Error::Input) with line and column, or what is wrong with an argument.
pub fn read_pipeline(path: &Path, set: &[String]) -> Result<Pipeline> {
    let mut pipeline = read_base(path)?;
    set_all(&mut pipeline, set)?;
    pipeline.resolved()
}

/// The pipeline in `path` as it stands there, with `training.scale` still to be multiplied in.
pub(crate) fn read_base(path: &Path) -> Result<Pipeline> {
    let mut pipeline = Pipeline::parse(&read_text(path)?, path)?;
    rebase(&mut pipeline, path.parent().unwrap_or(Path::new("")));
    Ok(pipeline)
}

/// Applies `--set` arguments to a pipeline whose own paths are absolute; theirs are relative to where one stands.
///
/// # Errors
/// What is wrong with an argument.
pub(crate) fn set_all(pipeline: &mut Pipeline, set: &[String]) -> Result<()> {
    if set.is_empty() {
        return Ok(());
    }
    pipeline.set_all(set)?;
    rebase(pipeline, Path::new(""));
    Ok(())
}
