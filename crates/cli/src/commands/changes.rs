//! Which pipeline, and what is changed in it: what `run`, `check` and `sweep` are told alike.

use clap::Args;
use pwrfgs::experiment::folder::PIPELINE;
use pwrfgs::experiment::sweep::LISTING;
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(crate) struct Changes {
    /// Change a setting, such as training.batch=16 or pruners.LearnableMask.lambda=0.05; a plugin with other fields is
    /// given whole, such as 'split=Random(test: 0.3)'. What the axis of a sweep says wins
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    set: Vec<String>,
    /// Multiply every count of steps, the schedules' too: 0.25 for a quarter of the training. Below 1 it also divides the
    /// learning rates of masks, up to 0.1, so that they close in time
    #[arg(long, value_name = "FACTOR")]
    scale: Option<f64>,
}

impl Changes {
    /// All of them as `--set` takes them.
    pub(super) fn all(&self) -> Vec<String> {
        let scale = self.scale.map(|scale| format!("training.scale={scale:?}"));
        self.set.iter().cloned().chain(scale).collect()
    }
}

/// The pipeline file that `path` names, and the run folder where it is one.
pub(super) fn named(path: &Path) -> Result<(PathBuf, Option<PathBuf>)> {
    if !path.is_dir() {
        return Ok((path.into(), None));
    }
    let own = path.join(PIPELINE);
    if own.is_file() {
        return Ok((own, Some(path.into())));
    }
    if path.join(LISTING).is_file() {
        return Err(Error::input(
            path,
            "is the folder of a sweep; repeat `pwrfgs sweep` with its file, or give the folder of a run in it",
        ));
    }
    let why = format!("is a folder without {PIPELINE}, so no run folder; give a pipeline file, or the folder of a run");
    Err(Error::input(path, why))
}
