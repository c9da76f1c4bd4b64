//! `run.json`: with what, on what and how long.

use crate::clock;
use crate::folder::{FACTS, MODEL_FILE, REPORT, SAMPLES, SCORES};
use crate::scores::ScoreTable;
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The facts of a run. `finished` is empty until model, scores and report are written.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// Version of pwrfgs.
    pub version: String,
    /// Git commit of the checkout that the program lies in, where it lies in one.
    pub commit: Option<String>,
    /// Bytes of one number: 4, or 8 in the double-precision build.
    pub real_bytes: usize,
    /// What it ran on.
    pub machine: Machine,
    /// The pipeline's seed.
    pub seed: u64,
    /// What the data call themselves.
    pub data: String,
    /// Whether they are simulated.
    pub simulated: bool,
    /// Samples for training, validation, test.
    pub samples: [usize; 3],
    /// Steps done.
    pub steps: u64,
    /// Gaussians.
    pub gaussians: usize,
    /// Seconds of training and evaluation, all starts together.
    pub wall_seconds: f64,
    /// Of these, seconds inside training steps.
    pub training_seconds: f64,
    /// Largest resident memory, bytes.
    pub peak_memory_bytes: u64,
    /// How often the run was started.
    pub starts: u32,
    /// First start, RFC 3339.
    pub started: String,
    /// End, RFC 3339.
    pub finished: Option<String>,
    /// Whether there is a report.
    pub report: bool,
    /// Summaries of `scores.csv`.
    pub scores: Option<ScoreTable>,
}

/// A computer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Processor.
    pub cpu: String,
    /// Processors that this program may use.
    pub cores: usize,
    /// Threads it used.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
}

impl Machine {
    /// This one.
    pub fn here() -> Self {
        let info = files::read_string("/proc/cpuinfo").unwrap_or_default();
        let model = info.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(':').nth(1));
        Self {
            cpu: model.map_or_else(|| "unknown".into(), |m| m.trim().to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads: rayon::current_num_threads(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        }
    }
}

impl Facts {
    /// The facts that earlier starts left in `folder`, or fresh ones.
    pub(crate) fn open(folder: &Path, seed: u64) -> Self {
        let old = Self::read(folder).unwrap_or_else(|| Self { started: clock::now(), ..Self::default() });
        Self {
            version: env!("CARGO_PKG_VERSION").into(),
            commit: commit(),
            real_bytes: size_of::<pwrfgs_core::Real>(),
            machine: Machine::here(),
            seed,
            starts: old.starts + 1,
            ..old
        }
    }

    /// The facts in `folder`, if there are any.
    pub fn read(folder: &Path) -> Option<Self> {
        serde_json::from_str(&files::read_string(folder.join(FACTS)).ok()?).ok()
    }

    /// Scores and facts of a run to which nothing is left to do.
    pub fn finished(folder: &Path) -> Option<(ScoreTable, Self)> {
        let facts = Self::read(folder)?;
        let stands = |name: &str| folder.join(name).is_file();
        let complete = [MODEL_FILE, SCORES, SAMPLES].into_iter().all(stands) && (!facts.report || stands(REPORT));
        let scores = facts.scores.clone().filter(|_| complete && facts.finished.is_some())?;
        Some((scores, facts))
    }

    /// Looks at the largest resident memory so far.
    pub(crate) fn note_memory(&mut self) {
        self.peak_memory_bytes = self.peak_memory_bytes.max(peak_memory());
    }

    /// Writes `run.json`.
    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(|e| Error::Config(format!("run.json: {e}")))?;
        write_atomically(&folder.join(FACTS), (text + "\n").as_bytes())
    }
}

/// Largest resident memory of this process, bytes; 0 where the system does not tell.
fn peak_memory() -> u64 {
    let status = files::read_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    line.and_then(|l| l.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()).map_or(0, |kib| kib * 1024)
}

/// The commit of the checkout of this project that the program lies in, read from git's files.
fn commit() -> Option<String> {
    let program = std::env::current_exe().ok()?;
    let root = program.ancestors().find(|folder| folder.join("crates/experiment").is_dir())?;
    let git = root.join(".git");
    let head = files::read_string(git.join("HEAD")).ok()?;
    let Some(name) = head.trim().strip_prefix("ref: ") else { return Some(head.trim().to_owned()) };
    if let Ok(id) = files::read_string(git.join(name)) {
        return Some(id.trim().to_owned());
    }
    let packed = files::read_string(git.join("packed-refs")).ok()?;
    packed.lines().find_map(|l| l.strip_suffix(name).map(|id| id.trim().to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_accumulate_over_starts() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = Facts::open(folder.path(), 7);
        first.wall_seconds = 12.5;
        first.write(folder.path()).unwrap();
        let second = Facts::open(folder.path(), 7);
        assert_eq!((second.starts, second.wall_seconds, &second.started), (2, 12.5, &first.started));
        assert!(second.machine.threads >= 1);
    }

    #[test]
    fn numbers_come_back_as_the_bits_that_were_written() {
        // serde_json rounds to the nearest only with its feature `float_roundtrip`; a table printed again would differ.
        let mut random = pwrfgs_core::rng::stream(0, "facts", 0);
        for _ in 0..20_000 {
            let value = f64::from(pwrfgs_core::rng::normal(&mut random)) * 0.123_456_789;
            let text = serde_json::to_string(&value).unwrap();
            assert_eq!(serde_json::from_str::<f64>(&text).unwrap().to_bits(), value.to_bits(), "{text}");
        }
    }
}
