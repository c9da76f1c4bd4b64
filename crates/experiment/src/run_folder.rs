//! `RunFolder`: one folder per run, locked by one process at a time.

use crate::facts::Facts;
use crate::folder::{CHECKPOINT, DATA, FACTS, PIPELINE, sealed_files};
use crate::input;
use crate::load::SplitData;
use crate::scores::ScoreTable;
use pwrfgs_core::files::{self, HeldFolder, refuse_foreign, write_new};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Error, Result};
use pwrfgs_pipeline::Pipeline;
use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Files without a seal: `pipeline.ron` is compared with the current pipeline, and the checkpoint has its own digest.
const UNSEALED: [&str; 3] = [PIPELINE, CHECKPOINT, FACTS];

/// State of a folder for the run of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// Empty: the run can start.
    New,
    /// The run, unfinished or finished.
    Begun,
    /// The same run with other baselines or metrics, or with residuals added: it must be scored again.
    ScoredOtherwise,
}

impl RunState {
    /// Reads scores and facts of the finished run in `path`; `None` if it must still be run or scored, or if `reported` and
    /// it has no report.
    ///
    /// # Errors
    /// Same as [`Facts::read`].
    pub(crate) fn read_finished(self, path: &Path, reported: bool) -> Result<Option<(ScoreTable, Facts)>> {
        let end = if self == Self::Begun { Facts::read_finished(path)? } else { None };
        Ok(end.filter(|(_, facts)| facts.report || !reported))
    }

    /// Reads the scores as [`Self::read_finished`] does, with all files verified; `None` in the same cases.
    ///
    /// # Errors
    /// A damaged or missing file.
    pub(crate) fn read_verified(self, path: &Path, reported: bool) -> Result<Option<ScoreTable>> {
        let Some((scores, facts)) = self.read_finished(path, reported)? else { return Ok(None) };
        facts.verify(path).map(|()| Some(scores))
    }
}

/// Run folder locked by this process.
#[derive(Debug)]
pub struct RunFolder {
    folder: HeldFolder,
    /// `pipeline.ron`, locked during the run. The lock is released on drop and at the end of the process.
    lock: File,
    is_new: bool,
    state: RunState,
}

impl RunFolder {
    /// Determines the state of `path` for the run of this pipeline; read-only.
    ///
    /// # Errors
    /// It is not a folder, or it holds other files or a run of another pipeline.
    pub fn inspect(path: &Path, pipeline: &Pipeline) -> Result<RunState> {
        let file = path.join(PIPELINE);
        match files::if_found(&file, files::read_string(&file))? {
            Some(text) => compare_pipelines(path, &file, &text, pipeline),
            None => match refuse_foreign(path, "a run folder", DATA) {
                // Another process has created the run since.
                Err(_) if file.is_file() => Self::inspect(path, pipeline),
                foreign => foreign.map(|()| RunState::New),
            },
        }
    }

    /// Creates the folder if needed, writes `pipeline.ron` and locks it. If several processes claim a folder, one
    /// succeeds.
    ///
    /// # Errors
    /// Errors of [`Self::inspect`]; [`Error::Busy`] if another process uses it; [`Error::Write`].
    pub fn claim(path: &Path, pipeline: &Pipeline) -> Result<Self> {
        Self::inspect(path, pipeline)?;
        std::fs::create_dir_all(path).map_err(|e| Error::write(path, e))?;
        let folder = HeldFolder::open(path)?;
        let (lock, is_new, state) = lock_pipeline(folder.path(), pipeline).map_err(|e| folder.name_in_error(e))?;
        remove_leftovers(folder.path());
        Ok(Self { folder, lock, is_new, state })
    }

    /// Writes `run.json` for another start on the data, with the findings and members of `new`, and returns its facts. Then
    /// replaces `pipeline.ron` if its baselines or metrics changed, or residuals were added. From now on the run counts as
    /// unfinished, since earlier checksums and baselines may become invalid.
    ///
    /// The new `pipeline.ron` is locked before it is renamed, so that no other process can lock the folder in between.
    ///
    /// # Errors
    /// A damaged `run.json`; [`Error::Write`], the file that cannot be written is then unchanged.
    pub(crate) fn begin(&mut self, pipeline: &Pipeline, split: &SplitData, new: Facts) -> Result<Facts> {
        let facts = Facts {
            data: split.data.title.clone(),
            simulated: split.data.is_simulated(),
            samples: split.partition.sizes(),
            findings: new.findings,
            members: new.members,
            ..Facts::open(self.path(), pipeline.seed)?
        };
        facts.write(self.path())?;
        if self.state == RunState::ScoredOtherwise {
            self.lock = files::replace(&self.file(PIPELINE), pipeline.to_ron()?.as_bytes())?;
        }
        Ok(facts)
    }

    /// Returns whether a process runs or reports the run in `path`.
    pub fn is_busy(path: &Path) -> bool {
        files::open(path.join(PIPELINE))
            .is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// Returns whether this claim created the run: it wrote `pipeline.ron`.
    pub fn is_new(&self) -> bool {
        self.is_new
    }

    /// Returns the state of the folder when it was claimed.
    pub(crate) fn state(&self) -> RunState {
        self.state
    }

    /// Returns the path for file access, independent of later renames of the folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Returns the path given by the user, for messages.
    pub fn name(&self) -> &Path {
        self.folder.name()
    }

    /// Returns the path of a file in the folder.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// Adds the folder name to the error of a `result`, and checks that the name still leads to this folder.
    ///
    /// # Errors
    /// The error of `result`, or a folder that was moved or replaced.
    pub fn settle<T>(&self, result: Result<T>) -> Result<T> {
        let value = result.map_err(|e| self.folder.name_in_error(e))?;
        self.folder.check_name().map(|()| value)
    }
}

/// Locks `pipeline.ron` in `folder`, writing it if needed. Returns the locked file, whether it was written, and the state.
///
/// # Errors
/// As [`RunFolder::claim`].
fn lock_pipeline(folder: &Path, pipeline: &Pipeline) -> Result<(File, bool, RunState)> {
    let file = folder.join(PIPELINE);
    loop {
        let is_new = write_new(&file, pipeline.to_ron()?.as_bytes())?;
        match files::try_lock(&file) {
            Ok(None) => return Err(Error::Busy(folder.into())),
            // The locked file may have been written by another process meanwhile.
            Ok(Some(lock)) => return RunFolder::inspect(folder, pipeline).map(|state| (lock, is_new, state)),
            Err(e) if e.kind() == ErrorKind::NotFound => {} // removed since it was written
            Err(e) => return Err(Error::read(&file, e)),
        }
    }
}

/// Compares the pipeline `theirs` of `file` in `folder` with `ours`: a run is identified by its training settings.
///
/// # Errors
/// The training settings differ; the message has the first lines that differ, if both texts have them.
fn compare_pipelines(folder: &Path, file: &Path, theirs: &str, ours: &Pipeline) -> Result<RunState> {
    let text = ours.to_ron()?;
    if theirs == text {
        return Ok(RunState::Begun);
    }
    // Parsed and written again, so that new fields with defaults, or comments, do not count as differences.
    let (their_text, our_text, is_scored_alike) = match input::parse_pipeline(theirs, file, &[]) {
        Ok(earlier) => {
            let rescored = scored_as(ours, &earlier);
            (earlier.essential().to_ron()?, rescored.essential().to_ron()?, rescored.to_ron()? == text)
        }
        // A pipeline of another version is compared as text.
        Err(_) => (theirs.to_owned(), ours.essential().to_ron()?, true),
    };
    if their_text == our_text {
        return Ok(if is_scored_alike { RunState::Begun } else { RunState::ScoredOtherwise });
    }
    let differ = their_text.lines().zip(our_text.lines()).find(|(a, b)| a != b);
    let difference = differ.map_or_else(String::new, |(their_line, our_line)| {
        let [theirs, ours] =
            [their_line, our_line].map(|line| strip_control(line).trim().trim_end_matches(',').to_owned());
        format!(": its {PIPELINE} has `{theirs}`, this one has `{ours}`")
    });
    let folder = folder.display();
    let problem =
        format!("{folder} holds a run of another pipeline{difference}; choose another --out or remove the folder");
    Err(Error::Config(problem))
}

/// Returns `pipeline` with the baselines and metrics of `other`, which do not affect training, and without residuals if
/// `other` has none: they are fitted to the trained model.
fn scored_as(pipeline: &Pipeline, other: &Pipeline) -> Pipeline {
    let residuals = pipeline.residuals.clone().filter(|_| other.residuals.is_some());
    Pipeline { baselines: other.baselines.clone(), metrics: other.metrics.clone(), residuals, ..pipeline.clone() }
}

/// Removes temporary files of killed starts, such as `.checkpoint.safetensors.123.tmp`. Failures are ignored.
fn remove_leftovers(folder: &Path) {
    files::remove_temporaries(folder, &UNSEALED.into_iter().chain(sealed_files()).collect::<Vec<_>>());
}
