//! `run.json`: settings, machine, time and results of a run.

use crate::findings::Finding;
use crate::folder::{FACTS, MODEL_FILE, REMADE, REPORT, SAMPLES, SCORES, sealed_files};
use crate::scores::ScoreTable;
use pwrfgs_core::files::{self, digest, if_found, write_atomically};
use pwrfgs_core::{Error, Result, peak_memory};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Facts of a run. `finished` is empty until model, scores and report are written.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// Version of pwrfgs.
    pub version: String,
    /// Git commit that the program was built from, if known.
    pub commit: Option<String>,
    /// Bytes per number: 4, or 8 in the double-precision build.
    pub real_bytes: usize,
    /// Machine of the run.
    pub machine: Machine,
    /// Random seed of the pipeline.
    pub seed: u64,
    /// Title of the data set.
    pub data: String,
    /// Whether the data are simulated.
    pub simulated: bool,
    /// Numbers of training, validation and test samples.
    pub samples: [usize; 3],
    /// What is implausible about the data.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub findings: Vec<Finding>,
    /// Number of completed steps.
    pub steps: u64,
    /// Number of Gaussians.
    pub gaussians: usize,
    /// Run folders of the models of an ensemble, relative to the sweep folder or, with `members` in the pipeline, to the run
    /// folder; steps, training seconds and Gaussians are then sums over these.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub members: Vec<String>,
    /// Seconds of training and evaluation, summed over all starts.
    pub wall_seconds: f64,
    /// Seconds inside training steps.
    pub training_seconds: f64,
    /// Largest resident memory, bytes.
    pub peak_memory_bytes: u64,
    /// Number of starts.
    pub starts: u32,
    /// Time of the first start, RFC 3339.
    pub started: String,
    /// Time of the end, RFC 3339.
    pub finished: Option<String>,
    /// Whether the run has a report.
    pub report: bool,
    /// Mean of the first validation metric for each baseline, fitted on the training set alone, on the samples of
    /// `validation.csv`; finite values only.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub validation_baselines: Vec<(String, f64)>,
    /// Summary of `scores.csv`.
    pub scores: Option<ScoreTable>,
    /// Sizes and checksums of the finished files by name, for verification.
    #[serde(default)]
    pub files: BTreeMap<String, FileDigest>,
}

/// Size and checksum of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileDigest {
    /// Length, bytes.
    pub bytes: u64,
    /// Checksum in the format of `sha256sum`.
    pub sha256: String,
}

impl FileDigest {
    /// Computes size and checksum of the content of a file.
    pub(crate) fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: digest(bytes) }
    }
}

/// Largest `run.json` that is read, bytes; usual files have some kilobytes.
const MAX_BYTES: u64 = 1 << 19;

/// Description of a computer.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Processor name.
    pub cpu: String,
    /// Number of processors available to this program.
    pub cores: usize,
    /// Number of threads used.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
    /// Name of the GPU that ran the networks; `None` for the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
}

impl Machine {
    /// Describes the machine of this process; without `/proc/cpuinfo` the processor is `unknown`.
    pub fn current() -> Self {
        let info = files::read_string("/proc/cpuinfo").unwrap_or_default();
        let model = info.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(':').nth(1));
        Self {
            cpu: model.map_or_else(|| "unknown".into(), |m| m.trim().to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            threads: rayon::current_num_threads(),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            device: pwrfgs_core::device::name().map(str::to_owned),
        }
    }
}

impl Facts {
    /// Creates the facts of one more start of the run in `folder`, from those of earlier starts: with this version and
    /// machine, without results. Writes nothing.
    ///
    /// # Errors
    /// Same as [`Self::read`].
    pub(crate) fn open(folder: &Path, seed: u64) -> Result<Self> {
        let old = Self::read(folder)?.unwrap_or_else(|| Self { started: utc_now(), ..Self::default() });
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").into(),
            commit: option_env!("PWRFGS_COMMIT").map(str::to_owned),
            real_bytes: size_of::<pwrfgs_core::Real>(),
            machine: Machine::current(),
            seed,
            starts: old.starts.saturating_add(1),
            finished: None,
            scores: None,
            files: BTreeMap::new(),
            ..old
        })
    }

    /// Sets steps and training seconds to the sums over the runs in `folders`, and raises the peak memory to the largest of
    /// them. A run that has not begun adds nothing.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(crate) fn sum_members(&mut self, folders: impl Iterator<Item = PathBuf>) -> Result<()> {
        (self.steps, self.training_seconds) = (0, 0.0);
        for folder in folders {
            let member = Self::read(&folder)?.unwrap_or_default();
            self.steps += member.steps;
            self.training_seconds += member.training_seconds;
            self.peak_memory_bytes = self.peak_memory_bytes.max(member.peak_memory_bytes);
        }
        Ok(())
    }

    /// Reads the facts in `folder`; `None` without `run.json`.
    ///
    /// # Errors
    /// A file that is damaged, or cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = folder.join(FACTS);
        let Some(bytes) = if_found(&path, files::read_at_most(&path, MAX_BYTES))? else { return Ok(None) };
        serde_json::from_slice(&bytes).map(Some).map_err(|e| {
            let why =
                format!("is damaged, or of another version ({e}); remove it, and `pwrfgs run` scores the run again");
            Error::input(&path, why)
        })
    }

    /// Reads scores and facts of a finished run; `None` if it has not finished, or one of its files is missing.
    ///
    /// # Errors
    /// Same as [`Self::read`].
    pub fn read_finished(folder: &Path) -> Result<Option<(ScoreTable, Self)>> {
        let Some(facts) = Self::read(folder)? else { return Ok(None) };
        let exists = |name: &str| folder.join(name).is_file();
        let is_sealed = |name: &&str| facts.files.contains_key(*name);
        let complete = [MODEL_FILE, SCORES, SAMPLES].into_iter().all(exists)
            && (!facts.report || exists(REPORT))
            && REMADE.into_iter().filter(is_sealed).all(exists);
        let scores = facts.scores.clone().filter(|_| complete && facts.finished.is_some());
        Ok(scores.map(|scores| (scores, facts)))
    }

    /// Replaces `files` by the sizes and checksums of the sealed files that exist in `folder`.
    pub(crate) fn seal(&mut self, folder: &Path) -> Result<()> {
        self.files.clear();
        for name in sealed_files().filter(|name| folder.join(name).is_file()) {
            let path = folder.join(name);
            let bytes = files::read(&path).map_err(|e| Error::read(&path, e))?;
            self.files.insert(name.into(), FileDigest::of(&bytes));
        }
        Ok(())
    }

    /// Verifies the files of a finished run.
    ///
    /// # Errors
    /// A file is damaged or missing, or cannot be read; the message names the first.
    pub fn verify(&self, folder: &Path) -> Result<()> {
        self.files.keys().try_for_each(|name| self.verify_file(folder, name))
    }

    /// Verifies the file `name` in `folder`; a name without a checksum passes.
    ///
    /// # Errors
    /// The file is damaged or missing, or cannot be read.
    pub fn verify_file(&self, folder: &Path, name: &str) -> Result<()> {
        let Some(expected) = self.files.get(name) else { return Ok(()) };
        let path = folder.join(name);
        let problem = match if_found(&path, files::read(&path))? {
            Some(bytes) if FileDigest::of(&bytes) == *expected => return Ok(()),
            Some(bytes) if bytes.len() as u64 == expected.bytes => "its content differs".to_owned(),
            Some(bytes) => format!("it has {} bytes, expected {}", bytes.len(), expected.bytes),
            None => "it is missing".into(),
        };
        let advice = match name {
            MODEL_FILE => "copy it again, or remove it and let `pwrfgs run` train it again",
            _ if REMADE.contains(&name) => "copy it again, or remove it and let `pwrfgs run` recreate it",
            _ => "copy it again, or remove the folder and run again",
        };
        Err(Error::input(&path, format!("does not match {FACTS}: {problem}; {advice}")))
    }

    /// Raises `peak_memory_bytes` to the largest resident memory of this process.
    pub(crate) fn update_peak_memory(&mut self) {
        self.peak_memory_bytes = self.peak_memory_bytes.max(peak_memory());
    }

    /// Writes `run.json` into `folder`.
    pub(crate) fn write(&self, folder: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(|e| Error::Config(format!("run.json: {e}")))?;
        write_atomically(&folder.join(FACTS), (text + "\n").as_bytes())
    }
}

/// Version of the program, such as `0.1.0 (1f0a2b3c4d)` with the start of the git commit that it was built from.
pub const VERSION: &str = env!("PWRFGS_VERSION");

/// Returns the current time as RFC 3339, such as `2026-11-21T09:49:19Z`.
pub(crate) fn utc_now() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    format_time(seconds)
}

/// Formats seconds since 1970 as UTC date and time of RFC 3339.
fn format_time(seconds: u64) -> String {
    let (mut days, second_of_day) = (seconds / 86_400, seconds % 86_400);
    let is_leap = |year: u64| year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400);
    let month_days = |year: u64, month: u64| match month {
        2 => 28 + u64::from(is_leap(year)),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    let (mut year, mut month) = (1970, 1);
    while days >= month_days(year, month) {
        days -= month_days(year, month);
        (year, month) = (year + month / 12, month % 12 + 1);
    }
    let (hours, minutes, seconds) = (second_of_day / 3600, second_of_day / 60 % 60, second_of_day % 60);
    format!("{year:04}-{month:02}-{:02}T{hours:02}:{minutes:02}:{seconds:02}Z", days + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facts_accumulate_over_starts() {
        let folder = tempfile::tempdir().unwrap();
        let mut first = Facts::open(folder.path(), 7).unwrap();
        first.wall_seconds = 12.5;
        first.write(folder.path()).unwrap();
        let second = Facts::open(folder.path(), 7).unwrap();
        assert_eq!((second.starts, second.wall_seconds, &second.started), (2, 12.5, &first.started));
        assert!(second.machine.threads >= 1);
    }

    #[test]
    fn numbers_round_trip_bit_identically() {
        // serde_json rounds to the nearest only with its feature `float_roundtrip`; a table printed again would differ.
        let mut random = pwrfgs_core::rng::stream(0, "facts", 0);
        for _ in 0..20_000 {
            let value = f64::from(pwrfgs_core::rng::normal(&mut random)) * 0.123_456_789;
            let text = serde_json::to_string(&value).unwrap();
            assert_eq!(serde_json::from_str::<f64>(&text).unwrap().to_bits(), value.to_bits(), "{text}");
        }
    }

    #[test]
    fn dates_follow_the_calendar() {
        assert_eq!(format_time(0), "1970-01-01T00:00:00Z");
        assert_eq!(format_time(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(format_time(1_795_254_559), "2026-11-21T09:49:19Z");
    }
}
