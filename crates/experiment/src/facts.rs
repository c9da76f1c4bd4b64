//! `run.json`: with what, on what machine, when and how long a run was made.

use crate::folder::{FACTS, MODEL_FILE, REMADE, REPORT, SAMPLES, SCORES, sealed};
use crate::scores::ScoreTable;
use pwrfgs_core::files::{self, digest, if_found, write_atomically};
use pwrfgs_core::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

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
    /// Folders of the runs whose models were joined, below the sweep folder: steps, seconds of training and Gaussians are then
    /// those of all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub members: Vec<String>,
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
    /// Mean of the first validation metric that each baseline, fitted on the training set alone, reaches on the samples
    /// of `validation.csv`; finite ones.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub validation_baselines: Vec<(String, f64)>,
    /// Summaries of `scores.csv`.
    pub scores: Option<ScoreTable>,
    /// The finished files of the folder by name: whoever reads them can tell whether they are whole.
    #[serde(default)]
    pub files: BTreeMap<String, Mark>,
}

/// What a file is known by.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Mark {
    /// Its length.
    pub bytes: u64,
    /// What `sha256sum` says of it.
    pub sha256: String,
}

impl Mark {
    pub(crate) fn of(bytes: &[u8]) -> Self {
        Self { bytes: bytes.len() as u64, sha256: digest(bytes) }
    }
}

/// The longest `run.json` that is read: its own has some kilobytes.
const MAX_BYTES: u64 = 1 << 19;

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
    /// The facts of a run that goes on in `folder`.
    pub(crate) fn open(folder: &Path, seed: u64) -> Result<Self> {
        let old = Self::read(folder)?.unwrap_or_else(|| Self { started: now(), ..Self::default() });
        Ok(Self {
            version: env!("CARGO_PKG_VERSION").into(),
            commit: commit(),
            real_bytes: size_of::<pwrfgs_core::Real>(),
            machine: Machine::here(),
            seed,
            starts: old.starts.saturating_add(1),
            finished: None,
            scores: None,
            files: BTreeMap::new(),
            ..old
        })
    }

    /// The facts in `folder`, if there are any.
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

    /// Scores and facts of a run to which nothing is left to do.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn finished(folder: &Path) -> Result<Option<(ScoreTable, Self)>> {
        let Some(facts) = Self::read(folder)? else { return Ok(None) };
        let stands = |name: &str| folder.join(name).is_file();
        let marked = |name: &&str| facts.files.contains_key(*name);
        let complete = [MODEL_FILE, SCORES, SAMPLES].into_iter().all(stands)
            && (!facts.report || stands(REPORT))
            && REMADE.into_iter().filter(marked).all(stands);
        let scores = facts.scores.clone().filter(|_| complete && facts.finished.is_some());
        Ok(scores.map(|scores| (scores, facts)))
    }

    /// Marks the files of a run that has just finished.
    pub(crate) fn seal(&mut self, folder: &Path) -> Result<()> {
        self.files.clear();
        for name in sealed().filter(|name| folder.join(name).is_file()) {
            let path = folder.join(name);
            let bytes = files::read(&path).map_err(|e| Error::read(&path, e))?;
            self.files.insert(name.into(), Mark::of(&bytes));
        }
        Ok(())
    }

    /// Holds the files of a finished run against their marks.
    ///
    /// # Errors
    /// The first that is damaged or missing.
    pub fn verify(&self, folder: &Path) -> Result<()> {
        self.files.keys().try_for_each(|name| self.verify_file(folder, name))
    }

    /// Holds one file against its mark, where it has one.
    ///
    /// # Errors
    /// Where it is damaged or missing.
    pub fn verify_file(&self, folder: &Path, name: &str) -> Result<()> {
        let Some(mark) = self.files.get(name) else { return Ok(()) };
        let path = folder.join(name);
        let found = match if_found(&path, files::read(&path))? {
            Some(bytes) if Mark::of(&bytes) == *mark => return Ok(()),
            Some(bytes) if bytes.len() as u64 == mark.bytes => "its bytes are others".to_owned(),
            Some(bytes) => format!("it has {} bytes and not {}", bytes.len(), mark.bytes),
            None => "it is missing".into(),
        };
        let advice = if REMADE.contains(&name) {
            "copy it anew, or remove it, and `pwrfgs run` makes it again"
        } else {
            "copy it anew, or remove the folder and run again"
        };
        Err(Error::input(&path, format!("is not what {FACTS} says was written: {found}; {advice}")))
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

/// Now, such as `2026-11-21T09:49:19Z`.
pub(crate) fn now() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    rfc3339(seconds)
}

/// Seconds since 1970 as a date of the Gregorian calendar.
fn rfc3339(seconds: u64) -> String {
    let (mut days, rest) = (seconds / 86_400, seconds % 86_400);
    let leap = |year: u64| year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400);
    let mut year = 1970;
    while days >= 365 + u64::from(leap(year)) {
        days -= 365 + u64::from(leap(year));
        year += 1;
    }
    let february = 28 + u64::from(leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    let (hours, minutes, seconds) = (rest / 3600, rest / 60 % 60, rest % 60);
    format!("{year:04}-{month:02}-{:02}T{hours:02}:{minutes:02}:{seconds:02}Z", days + 1)
}

/// Largest resident memory of this process, bytes; 0 where the system does not tell.
pub(crate) fn peak_memory() -> u64 {
    let status = files::read_string("/proc/self/status").unwrap_or_default();
    kib(&status, "VmHWM:").unwrap_or(0)
}

/// Bytes that this process can still take: what the machine has free, the control group allows (a job of Slurm, a
/// container) and `ulimit -v` leaves, whichever is least; `None` where the system does not tell.
pub(crate) fn free_memory() -> Option<u64> {
    let machine = kib(&files::read_string("/proc/meminfo").unwrap_or_default(), "MemAvailable:");
    [machine, control_group(), address_space()].into_iter().flatten().min()
}

/// The number behind `name` in a file of lines such as `VmHWM:  1234 kB`.
fn kib(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// What is left of the limit of the control group (version 2), where there is one.
fn control_group() -> Option<u64> {
    let own = files::read_string("/proc/self/cgroup").ok()?;
    let path = own.lines().find_map(|line| line.strip_prefix("0::"))?.trim();
    let number =
        |file: &str| files::read_string(format!("/sys/fs/cgroup{path}/{file}")).ok()?.trim().parse::<u64>().ok();
    Some(number("memory.max")?.saturating_sub(number("memory.current")?))
}

/// What is left of `ulimit -v`, where it is set.
fn address_space() -> Option<u64> {
    let limits = files::read_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    let limit = line.split_whitespace().next()?.parse::<u64>().ok()?;
    let used = kib(&files::read_string("/proc/self/status").ok()?, "VmSize:")?;
    Some(limit.saturating_sub(used))
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
    fn numbers_come_back_as_the_bits_that_were_written() {
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
        assert_eq!(rfc3339(0), "1970-01-01T00:00:00Z");
        assert_eq!(rfc3339(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(rfc3339(1_795_254_559), "2026-11-21T09:49:19Z");
    }

    #[test]
    fn linux_tells() {
        if cfg!(target_os = "linux") {
            assert!(peak_memory() > 1_000_000 && free_memory().is_some_and(|bytes| bytes > 1_000_000));
        }
        assert_eq!(kib("VmRSS:\t  12 kB\nVmHWM:\t    7 kB\n", "VmHWM:"), Some(7 * 1024));
        assert_eq!(kib("VmHWM: unlimited\n", "VmHWM:"), None);
    }
}
