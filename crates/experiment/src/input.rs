//! From files and `--set` arguments to pipelines whose paths hold everywhere.

use pwrfgs_core::{Result, files::read_text};
use pwrfgs_pipeline::{Changes, Draft, Fault, Pipeline};
use std::path::{Path, PathBuf};

/// Reads the pipeline in `path`, applies `--set` arguments and then `training.scale`. Paths in the file are relative to the
/// file.
///
/// # Errors
/// [`Error::Input`](pwrfgs_core::Error::Input) with line and column, or what is wrong with an argument.
pub fn read_pipeline(path: &Path, set: &[String]) -> Result<Pipeline> {
    parse(&read_text(path)?, path, set)
}

/// [`read_pipeline`] of text that was read from `path`.
pub(crate) fn parse(text: &str, path: &Path, set: &[String]) -> Result<Pipeline> {
    let mut pipeline = parse_base(text, path)?;
    set_all(&mut pipeline, set)?;
    pipeline.resolved()
}

/// The pipeline in `path` as it stands there, with `training.scale` still to be multiplied in.
pub(crate) fn read_base(path: &Path) -> Result<Pipeline> {
    parse_base(&read_text(path)?, path)
}

fn parse_base(text: &str, path: &Path) -> Result<Pipeline> {
    let mut pipeline = Pipeline::parse(text, path)?;
    rebase(&mut pipeline, path.parent().unwrap_or(Path::new("")));
    Ok(pipeline)
}

/// Makes the changes of a file in `here` in a draft whose own paths are absolute.
///
/// # Errors
/// What is wrong with a change by itself.
pub(crate) fn change(draft: &mut Draft, changes: &Changes, here: &Path) -> Result<(), Fault> {
    changes.0.iter().try_for_each(|change| draft.set(change))?;
    if ["data", "initializer", "baselines"].iter().any(|field| changes.change(field)) {
        draft.rebase(&|path| absolute(here, path))?;
    }
    Ok(())
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

/// The pipeline as it is run: paths from `base` on, the scale multiplied in, and fit to be written down.
///
/// # Errors
/// As [`Pipeline::resolved`] and [`Pipeline::check_text`].
pub(crate) fn prepared(pipeline: &Pipeline, base: &Path) -> Result<Pipeline> {
    let mut pipeline = pipeline.clone();
    rebase(&mut pipeline, base);
    let pipeline = pipeline.resolved()?;
    pipeline.check_text()?;
    Ok(pipeline)
}

/// Takes every relative path of the pipeline from `base` and makes it absolute.
pub fn rebase(pipeline: &mut Pipeline, base: &Path) {
    if let Some(rebased) = pipeline.data.rebased(&|path| absolute(base, path)) {
        pipeline.data = rebased.into();
    }
    if let Some(rebased) = pipeline.initializer.rebased(&|path| absolute(base, path)) {
        pipeline.initializer = rebased.into();
    }
    for baseline in &mut pipeline.baselines {
        if let Some(rebased) = baseline.rebased(&|path| absolute(base, path)) {
            *baseline = rebased.into();
        }
    }
}

/// `path`, relative to `base`, as one that holds everywhere.
pub(crate) fn absolute(base: &Path, path: &Path) -> PathBuf {
    let joined = base.join(path);
    joined.canonicalize().or_else(|_| std::path::absolute(&joined)).unwrap_or(joined)
}
