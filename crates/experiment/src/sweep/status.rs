//! `RunStage`: progress of each run of a sweep, read from its folder.

use super::plan::SweepPlan;
use crate::facts::Facts;
use crate::folder::{CURVE, PIPELINE};
use crate::record::read_series;
use crate::run_folder::RunFolder;
use crate::scores::ScoreTable;
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use std::path::PathBuf;

/// State of a run.
#[derive(Clone, Debug, PartialEq)]
pub enum RunStage {
    /// Its folder does not exist, or contains no step yet.
    Waiting,
    /// Another process is running it.
    Running {
        /// Number of completed steps.
        step: u64,
    },
    /// Started, but not running: it will resume from its last checkpoint, or be scored.
    Stopped {
        /// Number of completed steps according to its curve.
        step: u64,
    },
    /// The last attempt failed, with the reason; it will be tried again.
    Failed(String),
    /// Finished, with scores and facts.
    Finished(Box<(ScoreTable, Facts)>),
}

impl RunStage {
    /// One-word name of the state.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Running { .. } => "running",
            Self::Stopped { .. } => "stopped",
            Self::Failed(_) => "failed",
            Self::Finished(_) => "finished",
        }
    }
}

/// Folder with a file for each failed run, with the reason, relative to the sweep folder.
const FAILURES: &str = "failures";

impl SweepPlan {
    /// State of each run.
    pub fn states(&self) -> Vec<RunStage> {
        (0..self.runs.len()).map(|run| self.state(run)).collect()
    }

    /// State of one run.
    pub fn state(&self, run: usize) -> RunStage {
        let folder = self.folder_of(run);
        match RunFolder::inspect(&folder, &self.runs[run].pipeline).and_then(|state| state.finished(&folder, false)) {
            Ok(Some(end)) => return RunStage::Finished(Box::new(end)),
            Ok(None) => {}
            Err(error) => return RunStage::Failed(error.to_string()),
        }
        let curve = read_series(&folder.join(CURVE));
        let step = curve.last().and_then(|row| *row.first()?).map_or(0, |step| step as u64);
        if RunFolder::is_busy(&folder) {
            return RunStage::Running { step };
        }
        match files::read_string(self.failure_file(run)) {
            Ok(why) => RunStage::Failed(why.trim_end().to_owned()),
            Err(_) if folder.join(PIPELINE).is_file() => RunStage::Stopped { step },
            Err(_) => RunStage::Waiting,
        }
    }

    /// Stores the reason why a run failed.
    pub(super) fn note_failure(&self, run: usize, error: &Error) -> Result<()> {
        let path = self.failure_file(run);
        let folder = self.folder.join(FAILURES);
        std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
        write_atomically(&path, format!("{error}\n").as_bytes())
    }

    /// Removes the stored failure.
    pub(super) fn forget_failure(&self, run: usize) {
        _ = std::fs::remove_file(self.failure_file(run));
        _ = std::fs::remove_dir(self.folder.join(FAILURES)); // where it was the last
    }

    fn failure_file(&self, run: usize) -> PathBuf {
        self.folder.join(FAILURES).join(format!("{}.txt", self.runs[run].folder))
    }
}
