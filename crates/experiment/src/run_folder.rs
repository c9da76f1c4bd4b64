//! `RunFolder`: one folder a run, claimed by its pipeline and never taken from another.

use crate::facts::Facts;
use crate::folder::{CHECKPOINT, FACTS, PIPELINE, sealed};
use crate::input;
use crate::scores::ScoreTable;
use pwrfgs_core::files::{self, HeldFolder, refuse_foreign, write_new};
use pwrfgs_core::words::clean;
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_pipeline::Pipeline;
use std::fs::{File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Files without a seal: `pipeline.ron` is compared with the pipeline at hand, and the checkpoint has a digest of its own.
const UNSEALED: [&str; 3] = [PIPELINE, CHECKPOINT, FACTS];

/// What a folder holds of the run of a pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// Nothing: the run may begin there.
    New,
    /// The run, begun or finished.
    Begun,
    /// The run with other baselines or metrics, which score it again.
    ScoredOtherwise,
}

impl RunState {
    /// Scores and facts of the run in `path` if nothing is left to do, its page included if it shall be `reported`.
    ///
    /// # Errors
    /// As [`Facts::read`].
    pub(crate) fn finished(self, path: &Path, reported: bool) -> Result<Option<(ScoreTable, Facts)>> {
        let end = if self == Self::Begun { Facts::finished(path)? } else { None };
        Ok(end.filter(|(_, facts)| facts.report || !reported))
    }

    /// The same for a run whose files are as its seals say.
    ///
    /// # Errors
    /// A file that is damaged or missing.
    pub(crate) fn verified(self, path: &Path, reported: bool) -> Result<Option<ScoreTable>> {
        let Some((scores, facts)) = self.finished(path, reported)? else { return Ok(None) };
        facts.verify(path).map(|()| Some(scores))
    }
}

/// A run folder that this process holds.
#[derive(Debug)]
pub struct RunFolder {
    folder: HeldFolder,
    /// `pipeline.ron`, locked while the run is at work. Dropping it releases the lock, and the system does so however the
    /// process ends.
    lock: File,
    is_new: bool,
    state: RunState,
}

impl RunFolder {
    /// What `path` holds of the run of this pipeline; reads only.
    ///
    /// # Errors
    /// Where it is no folder, or holds something else, or a run of another pipeline.
    pub fn inspect(path: &Path, pipeline: &Pipeline) -> Result<RunState> {
        let own = path.join(PIPELINE);
        match files::if_found(&own, files::read_string(&own))? {
            Some(text) => compare(path, &own, &text, pipeline),
            None => match refuse_foreign(path, "a run folder") {
                // Another process has made the run since.
                Err(_) if own.is_file() => Self::inspect(path, pipeline),
                foreign => foreign.map(|()| RunState::New),
            },
        }
    }

    /// Makes the folder where it is missing, writes `pipeline.ron` into it and locks it. Of several processes that claim
    /// one folder at once, one succeeds.
    ///
    /// # Errors
    /// As [`Self::inspect`]; [`Error::Busy`] if another process is at work in it; [`Error::Write`].
    pub fn claim(path: &Path, pipeline: &Pipeline) -> Result<Self> {
        Self::inspect(path, pipeline)?;
        std::fs::create_dir_all(path).map_err(|e| Error::write(path, e))?;
        let folder = HeldFolder::open(path)?;
        let (lock, is_new, state) = locked(folder.path(), pipeline).map_err(|e| folder.named(e))?;
        remove_leftovers(folder.path());
        Ok(Self { folder, lock, is_new, state })
    }

    /// Opens `run.json` for another start on `data`, of a joined model with the folders of its `members`, and replaces
    /// `pipeline.ron` where its baselines or metrics are not those of `pipeline`. From here on the run is not finished: what
    /// an earlier end says of files, and of baselines, is about to be wrong.
    ///
    /// The new `pipeline.ron` is locked before it takes the name, so that at no instant another process can hold the folder.
    ///
    /// # Errors
    /// A damaged `run.json`; [`Error::Write`], the old file is then untouched.
    pub(crate) fn begin(
        &mut self,
        pipeline: &Pipeline,
        (data, partition): (&Dataset, &Partition),
        members: Vec<String>,
    ) -> Result<Facts> {
        let facts = Facts {
            data: data.title.clone(),
            simulated: data.is_simulated(),
            samples: partition.sizes(),
            members,
            ..Facts::open(self.path(), pipeline.seed)?
        };
        facts.write(self.path())?;
        if self.state == RunState::ScoredOtherwise {
            self.lock = files::replace(&self.file(PIPELINE), pipeline.to_ron().as_bytes(), |file| {
                // A file system without locks is no reason to refuse.
                _ = file.try_lock();
            })?;
        }
        Ok(facts)
    }

    /// Whether a process is at work in `path`.
    pub fn is_busy(path: &Path) -> bool {
        files::open(path.join(PIPELINE)).is_ok_and(|own| matches!(own.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// Whether this claim has made the run: nothing but `pipeline.ron` lies in the folder.
    pub fn is_new(&self) -> bool {
        self.is_new
    }

    /// What the folder held when it was claimed.
    pub(crate) fn state(&self) -> RunState {
        self.state
    }

    /// The path through which its files are reached, whatever takes the name of the folder meanwhile.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// The path that users gave, for messages.
    pub fn name(&self) -> &Path {
        self.folder.name()
    }

    /// A file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    /// Puts the name of the folder into the error of a `result`, and checks that it still leads to the folder.
    ///
    /// # Errors
    /// That of `result`, or where the folder was moved or replaced.
    pub fn settle<T>(&self, result: Result<T>) -> Result<T> {
        let value = result.map_err(|e| self.folder.named(e))?;
        self.folder.check_name().map(|()| value)
    }
}

/// Locks `pipeline.ron` of `pipeline`, which is written where there is none; also whether it was, and what there is.
fn locked(folder: &Path, pipeline: &Pipeline) -> Result<(File, bool, RunState)> {
    let own = folder.join(PIPELINE);
    loop {
        let is_new = write_new(&own, pipeline.to_ron().as_bytes())?;
        match files::try_lock(&own) {
            Ok(None) => return Err(Error::Busy(folder.into())),
            // What is locked may be what another process wrote meanwhile.
            Ok(Some(lock)) => return RunFolder::inspect(folder, pipeline).map(|state| (lock, is_new, state)),
            Err(e) if e.kind() == ErrorKind::NotFound => {} // removed since it was written
            Err(e) => return Err(Error::read(&own, e)),
        }
    }
}

/// Compares the pipeline `theirs` that `file` in `folder` holds with `ours`. A run is what is trained: of another one, the error
/// names the first difference.
fn compare(folder: &Path, file: &Path, theirs: &str, ours: &Pipeline) -> Result<RunState> {
    let text = ours.to_ron();
    if theirs == text {
        return Ok(RunState::Begun);
    }
    // Read and written again, so that fields added since with their defaults, or a comment, are no difference.
    let (theirs, ours, alike) = match input::parse(theirs, file, &[]) {
        Ok(theirs) => {
            let ours = scored_as(ours, &theirs);
            (theirs.essential().to_ron(), ours.essential().to_ron(), ours.to_ron() == text)
        }
        Err(_) => (theirs.to_owned(), ours.essential().to_ron(), true),
    };
    let differ = theirs.lines().zip(ours.lines()).enumerate().find(|(_, (a, b))| a != b);
    match differ {
        Some((line, (there, here))) => Err(Error::Config(format!(
            "{} holds a run of another pipeline: its {PIPELINE}:{} has `{}`, this one has `{}`; \
             choose another --out or remove the folder",
            folder.display(),
            line + 1,
            clean(there).trim_end_matches(','),
            clean(here).trim_end_matches(',')
        ))),
        None if theirs.lines().count() == ours.lines().count() => {
            Ok(if alike { RunState::Begun } else { RunState::ScoredOtherwise })
        }
        None => Err(Error::Config(format!(
            "{} holds a run of another pipeline; choose another --out or remove the folder",
            folder.display()
        ))),
    }
}

/// `pipeline` with the baselines and metrics of `other`: these are not part of what is trained.
fn scored_as(pipeline: &Pipeline, other: &Pipeline) -> Pipeline {
    Pipeline { baselines: other.baselines.clone(), metrics: other.metrics.clone(), ..pipeline.clone() }
}

/// Removes the temporary files of starts that were killed while writing, `.checkpoint.safetensors.123.tmp` say; the lock
/// tells that nobody is writing them any more. What cannot be removed does no harm.
fn remove_leftovers(folder: &Path) {
    files::remove_temporaries(folder, &UNSEALED.into_iter().chain(sealed()).collect::<Vec<_>>());
}
