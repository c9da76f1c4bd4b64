//! Arguments that several commands share: pipelines and changes.

use clap::Args;
use pwrfgs::experiment::folder::PIPELINE;
use pwrfgs::experiment::sweep::Listing;
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(crate) struct ChangeOptions {
    /// Change a setting, such as training.batch=16 or 'split=Random(test: 0.3)'.
    #[arg(
        long = "set",
        value_name = "FIELD=VALUE",
        help = "Change a setting, such as training.batch=16 or\n'split=Random(test: 0.3)'; repeatable; in a sweep, axes override it"
    )]
    set: Vec<String>,
    /// Multiply all step counts, such as 0.25.
    #[arg(
        long,
        value_name = "FACTOR",
        help = "Multiply all step counts by this factor, such as 0.25. A factor below 1\n\
                also raises the learning rates of pruning masks to rate / FACTOR, up to a limit,\n\
                so that they still remove Gaussians; a warning says if training is too short"
    )]
    scale: Option<f64>,
    /// Continue despite a finding on the data, such as lone-value.
    #[arg(
        long,
        value_name = "FINDING",
        help = "Continue despite this finding (a fault in the data that an error names), such\n\
                as lone-value; repeatable"
    )]
    pub(super) accept: Vec<String>,
}

impl ChangeOptions {
    /// Lists the changes of `--set`, `--scale` and `--accept`, each as `FIELD=VALUE`.
    pub(super) fn assignments(&self) -> Vec<String> {
        let scale = self.scale.map(|scale| format!("training.scale={scale:?}"));
        let accept = (!self.accept.is_empty()).then(|| format!("accept={:?}", self.accept));
        self.set.iter().cloned().chain(scale).chain(accept).collect()
    }
}

/// Returns the pipeline file that `path` is or, as a run folder, contains; also the run folder in the second case.
///
/// # Errors
/// A sweep folder, or another folder without a pipeline.
pub(super) fn resolve_pipeline(path: &Path) -> Result<(PathBuf, Option<PathBuf>)> {
    if !path.is_dir() {
        return Ok((path.into(), None));
    }
    let file = path.join(PIPELINE);
    if file.is_file() {
        return Ok((file, Some(path.into())));
    }
    if let Some(listing) = Listing::read(path)? {
        let problem = "folder of a sweep, expected a pipeline or run folder; repeat `pwrfgs sweep` with the experiment, or \
                       name one of its runs";
        return Err(Error::input(path, format!("{problem}: {}", listing.run_names())));
    }
    let why = format!("not a run folder: no {PIPELINE}; name a pipeline file or a run folder");
    Err(Error::input(path, why))
}

/// Returns a function that names `path` in an error that names no file; errors of an option stay as they are.
pub(super) fn in_file(path: &Path) -> impl FnOnce(Error) -> Error {
    move |error| match error {
        Error::Config(message) if !message.starts_with("--") => Error::input(path, message),
        other => other,
    }
}
