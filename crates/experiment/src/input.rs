//! Reads pipelines from files and `--set` arguments, with absolute paths.

use crate::folder::DATA;
use pwrfgs_core::{Result, ShippedFile, files::MAX_TEXT};
use pwrfgs_pipeline::{Change, EditFault, Pipeline, PipelineEdit};
use std::path::{Path, PathBuf};

/// Reads the pipeline in `path`, or the shipped one of this name, applies `--set` arguments and then `training.scale`.
/// Paths in the file are relative to the file; paths in a shipped pipeline to the current directory.
///
/// # Errors
/// The file cannot be read; [`Error::Input`](pwrfgs_core::Error::Input) with line and column if it is invalid; an
/// argument is invalid.
pub fn read_pipeline(path: &Path, set: &[String]) -> Result<Pipeline> {
    parse_pipeline(&read_pipeline_text(path)?, path, set)
}

/// Reads the text of the pipeline in `path`, or of the shipped one of this name.
///
/// # Errors
/// The file cannot be read.
pub fn read_pipeline_text(path: &Path) -> Result<String> {
    ShippedFile::read(ShippedFile::PIPELINES, path, MAX_TEXT)
}

/// Parses a pipeline as [`read_pipeline`] does, from `text` that was read from `path`.
///
/// # Errors
/// As [`read_pipeline`].
pub(crate) fn parse_pipeline(text: &str, path: &Path, set: &[String]) -> Result<Pipeline> {
    let mut draft = parse_base(text, path)?;
    apply_arguments(&mut draft, set)?;
    draft.finish().map_err(EditFault::in_arguments)?.resolved()
}

/// Reads the pipeline in `path`, relative to `folder`, or the shipped one of this name, without applying its scale; its
/// paths become absolute.
pub(crate) fn read_base(folder: &Path, path: &Path) -> Result<PipelineEdit> {
    if let Some(file) = ShippedFile::find(ShippedFile::PIPELINES, folder, path) {
        return parse_base(&file.text(), path);
    }
    let path = folder.join(path);
    parse_base(&read_pipeline_text(&path)?, &path)
}

/// Parses a pipeline without applying its scale; its paths become absolute. Returns an error for text that is not a
/// valid pipeline.
fn parse_base(text: &str, path: &Path) -> Result<PipelineEdit> {
    let mut draft = PipelineEdit::of(&Pipeline::parse(text, path)?)?;
    apply_changes(&mut draft, &[], path.parent().unwrap_or(Path::new(""))).map_err(EditFault::in_arguments)?;
    Ok(draft)
}

/// Applies changes of a file in `folder`, to which their paths are relative.
///
/// # Errors
/// An invalid change.
pub(crate) fn apply_changes(draft: &mut PipelineEdit, changes: &[Change], folder: &Path) -> Result<(), EditFault> {
    changes.iter().try_for_each(|change| draft.set(change))?;
    draft.rebase(&|path| absolute_path(folder, path))
}

/// Applies `--set` arguments; their paths are relative to the current directory.
///
/// # Errors
/// An invalid argument.
pub(crate) fn apply_arguments(draft: &mut PipelineEdit, set: &[String]) -> Result<()> {
    let changes: Vec<Change> = set.iter().map(|argument| Change::parse_argument(argument)).collect::<Result<_>>()?;
    apply_changes(draft, &changes, Path::new("")).map_err(EditFault::in_arguments)
}

/// Makes a pipeline ready to run: resolves its paths from `base` and applies the scale.
///
/// # Errors
/// Errors of [`Pipeline::rebased`] and [`Pipeline::resolved`].
pub(crate) fn resolve_pipeline(pipeline: &Pipeline, base: &Path) -> Result<Pipeline> {
    rebased(pipeline, base)?.resolved()
}

/// Returns the pipeline with every relative path resolved from `base`.
///
/// # Errors
/// Same as [`Pipeline::rebased`].
pub fn rebased(pipeline: &Pipeline, base: &Path) -> Result<Pipeline> {
    pipeline.rebased(&|path| absolute_path(base, path))
}

/// Returns the absolute form of `path`, relative to `base`; the name of a shipped scene is unchanged. If a run in Python
/// wrote data into its folder, and the folder was moved since, returns the new path of the data in `base`.
pub(crate) fn absolute_path(base: &Path, path: &Path) -> PathBuf {
    if ShippedFile::find(ShippedFile::SCENES, base, path).is_some() {
        return path.into();
    }
    let mut joined = base.join(path);
    if !joined.exists()
        && let (Some(name), true) = (path.file_name(), path.parent().is_some_and(|parent| parent.ends_with(DATA)))
        && let moved = base.join(DATA).join(name)
        && moved.exists()
    {
        joined = moved;
    }
    joined.canonicalize().or_else(|_| std::path::absolute(&joined)).unwrap_or(joined)
}
