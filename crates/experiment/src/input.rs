//! From files and `--set` arguments to pipelines whose paths hold everywhere.

use pwrfgs_core::{Result, files::read_text};
use pwrfgs_pipeline::{Change, Draft, Fault, Pipeline};
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
    let mut draft = parse_base(text, path)?;
    set_all(&mut draft, set)?;
    draft.finish().map_err(Fault::in_arguments)?.resolved()
}

/// The pipeline in `path` as it stands there, its paths absolute.
pub(crate) fn read_base(path: &Path) -> Result<Draft> {
    parse_base(&read_text(path)?, path)
}

fn parse_base(text: &str, path: &Path) -> Result<Draft> {
    let mut draft = Draft::of(&Pipeline::parse(text, path)?);
    change(&mut draft, &[], path.parent().unwrap_or(Path::new(""))).map_err(Fault::in_arguments)?;
    Ok(draft)
}

/// Makes changes of a file in `here`, from where their paths are meant.
///
/// # Errors
/// What is wrong with a change by itself.
pub(crate) fn change(draft: &mut Draft, changes: &[Change], here: &Path) -> Result<(), Fault> {
    changes.iter().try_for_each(|change| draft.set(change))?;
    draft.rebase(&|path| absolute(here, path))
}

/// Makes the changes of `--set` arguments; their paths are relative to the current directory.
///
/// # Errors
/// What is wrong with an argument by itself.
pub(crate) fn set_all(draft: &mut Draft, set: &[String]) -> Result<()> {
    let changes: Vec<Change> = set.iter().map(|argument| Change::argument(argument)).collect::<Result<_>>()?;
    change(draft, &changes, Path::new("")).map_err(Fault::in_arguments)
}

/// The pipeline as it is run: paths from `base` on, and the scale multiplied in.
///
/// # Errors
/// As [`Pipeline::rebased`] and [`Pipeline::resolved`].
pub(crate) fn prepared(pipeline: &Pipeline, base: &Path) -> Result<Pipeline> {
    rebased(pipeline, base)?.resolved()
}

/// The pipeline with every relative path taken from `base`.
///
/// # Errors
/// As [`Pipeline::rebased`].
pub fn rebased(pipeline: &Pipeline, base: &Path) -> Result<Pipeline> {
    pipeline.rebased(&|path| absolute(base, path))
}

/// `path`, relative to `base`, as one that holds everywhere.
pub(crate) fn absolute(base: &Path, path: &Path) -> PathBuf {
    let joined = base.join(path);
    joined.canonicalize().or_else(|_| std::path::absolute(&joined)).unwrap_or(joined)
}
