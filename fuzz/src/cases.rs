//! One case after another, in this process.

use crate::mutate::mutate;
use crate::targets::{Reader, TARGETS, Target};
use pwrfgs_core::{Error, Result, rng};
use std::fs::{self, File};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest processor time of a case, seconds: a machine that has other things to do makes no case fail.
const PATIENCE: f64 = 10.0;
/// Longest time of a case that waits for something.
const LONGEST: Duration = Duration::from_mins(1);
/// The variable that makes the fuzzer be `pwrfgs`.
pub const AS_PROGRAM: &str = "PWRFGS_FUZZ_AS_PROGRAM";
/// What calls of the program write; a call is refused beside what an earlier one left.
const WRITTEN: [&str; 6] = ["ran", "simulated", "compared", "heard", "out.npz", "out.ply"];
/// Longest message, bytes.
const LONGEST_MESSAGE: usize = 2_000;

/// What the last panic said, and where.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// When a case began, and the processor time that its process had taken by then.
#[derive(Clone, Copy, Debug)]
pub struct Begun(Instant, f64);

impl Begun {
    /// Now, in the process `id`.
    pub fn now(id: u32) -> Self {
        Self(Instant::now(), processor_seconds(id))
    }

    /// Whether it takes too long by now.
    pub fn is_hanging(self, id: u32) -> bool {
        self.0.elapsed() > LONGEST || processor_seconds(id) - self.1 > PATIENCE
    }
}

/// Processor time of a process, seconds; 0 where the system does not tell.
fn processor_seconds(id: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    // User and system time in hundredths.
    fields.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// A bench, and what every file on it was.
#[derive(Debug)]
pub struct Bench {
    folder: PathBuf,
    /// For each target the bytes it is made from, its own first.
    seeds: Vec<Vec<Vec<u8>>>,
}

impl Bench {
    /// Of the folder that [`crate::bench::make`] has made; from now on panics are kept to ourselves.
    ///
    /// # Errors
    /// A seed that cannot be read.
    pub fn open(folder: &Path) -> Result<Self> {
        std::panic::set_hook(Box::new(|panic| {
            let frames = std::backtrace::Backtrace::force_capture().to_string();
            let text = panic.to_string().replace('\n', " ") + &own_frame(&frames);
            *PANIC.lock().unwrap_or_else(PoisonError::into_inner) = text;
        }));
        let seeds = TARGETS.iter().map(|target| seeds(folder, target)).collect::<Result<_>>()?;
        Ok(Self { folder: folder.into(), seeds })
    }

    /// Tries case `n` and leaves the bench as it was, or the broken file where `keep` says so; what is wrong, if anything.
    ///
    /// # Errors
    /// Where the bench cannot be written.
    pub fn try_case(&self, n: u64, keep: bool) -> Result<Option<String>> {
        let target = target_of(n);
        let seeds = &self.seeds[target];
        let mut random = rng::stream(0, "fuzz", n);
        let (seed, other) = (rng::below(&mut random, seeds.len()), rng::below(&mut random, seeds.len()));
        self.try_bytes(target, &mutate(&seeds[seed], &seeds[other], TARGETS[target].form, &mut random), keep)
    }

    /// What target number `target` is made from.
    pub fn seeds(&self, target: usize) -> &[Vec<u8>] {
        &self.seeds[target]
    }

    /// Tries `bytes` as the file of target number `target`, as [`Self::try_case`] does.
    ///
    /// # Errors
    /// Where the bench cannot be written.
    pub fn try_bytes(&self, target: usize, bytes: &[u8], keep: bool) -> Result<Option<String>> {
        let Target { file, reader, .. } = TARGETS[target];
        let path = self.folder.join(file);
        let put = |bytes: &[u8]| fs::write(&path, bytes).map_err(|e| Error::write(&path, e));
        put(bytes)?;
        let begun = Begun::now(std::process::id());
        let fault = match reader {
            Reader::Library(read) => match catch_unwind(AssertUnwindSafe(|| read(&self.folder))) {
                Ok(Ok(())) => None,
                Ok(Err(e)) if !e.is_input() => Some(format!("blames the machine: {e}")),
                Ok(Err(e)) => fault_of_message(&e.to_string()),
                Err(_) => Some(PANIC.lock().unwrap_or_else(PoisonError::into_inner).clone()),
            },
            Reader::Program(arguments) => match self.call(arguments)? {
                None => Some("takes too long".into()),
                Some((status, text)) => fault_of_end(status, &text),
            },
        };
        if !keep {
            put(&self.seeds[target][0])?;
        }
        Ok(fault.or_else(|| begun.is_hanging(std::process::id()).then(|| "takes too long".into())))
    }

    /// What the reader of target number `target` says against its own whole file, if anything. A reader that refuses it may
    /// never come to read the file, so that its cases test nothing.
    ///
    /// # Errors
    /// Where the program cannot be called.
    pub fn refusal(&self, target: usize) -> Result<Option<String>> {
        Ok(match TARGETS[target].reader {
            Reader::Library(read) => read(&self.folder).err().map(|e| e.to_string()),
            Reader::Program(arguments) => match self.call(arguments)? {
                Some((status, text)) => (!status.success()).then_some(text),
                None => Some("takes too long".into()),
            },
        })
    }

    /// Calls the program; how it ends and what it says, nothing if it takes too long.
    fn call(&self, arguments: &[&str]) -> Result<Option<(ExitStatus, String)>> {
        let said = self.folder.join("said.txt");
        let open = || File::create(&said).map_err(|e| Error::write(&said, e));
        let program = std::env::current_exe().map_err(|e| Error::Config(format!("where is this program? {e}")))?;
        let mut command = Command::new(program);
        command.args(arguments).current_dir(&self.folder).env(AS_PROGRAM, "1").env_remove("RUST_LOG");
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(open()?).spawn();
        let failed = |e| Error::Config(format!("the program cannot be called: {e}"));
        let mut child = child.map_err(failed)?;
        let begun = Begun::now(child.id());
        let status = loop {
            match child.try_wait().map_err(failed)? {
                Some(status) => break status,
                None if begun.is_hanging(child.id()) => {
                    _ = child.kill().and_then(|()| child.wait());
                    return Ok(None);
                }
                None => std::thread::sleep(Duration::from_millis(2)),
            }
        };
        let text = fs::read(&said).map_err(|e| Error::read(&said, e))?;
        for path in WRITTEN.map(|name| self.folder.join(name)) {
            let _ = fs::remove_dir_all(&path).or_else(|_| fs::remove_file(&path));
        }
        Ok(Some((status, String::from_utf8_lossy(&text).into_owned())))
    }
}

/// What is wrong with how the program ended.
fn fault_of_end(status: ExitStatus, text: &str) -> Option<String> {
    match status.code() {
        Some(0..=2) => text.lines().find_map(fault_of_message),
        code => {
            let last = text.lines().find(|line| line.contains("panicked")).or(text.lines().last());
            Some(format!("ends with {code:?} ({status}): {}", last.unwrap_or_default()))
        }
    }
}

/// Which target a case is of: targets take turns, as often in a round as their share.
fn target_of(n: u64) -> usize {
    let round: usize = TARGETS.iter().map(|target| target.share).sum();
    // Spread by a step that has no divisor in common with most rounds, so that any stretch of cases is of all.
    let mut place = (n.wrapping_mul(7_919) % round as u64) as usize;
    let found = TARGETS.iter().position(|target| {
        let here = place < target.share;
        place = place.wrapping_sub(if here { 0 } else { target.share });
        here
    });
    found.unwrap_or_default()
}

/// What a case breaks, for people.
pub fn name_of(n: u64) -> String {
    title(&TARGETS[target_of(n)])
}

/// The file of a target, and the command that reads it.
pub fn title(target: &Target) -> String {
    match target.reader {
        Reader::Library(_) => target.file.into(),
        Reader::Program(arguments) => format!("{} for pwrfgs {}", target.file, arguments[0]),
    }
}

/// Where a backtrace is in the library's own code for the first time, as ` in crates/..`.
pub fn own_frame(backtrace: &str) -> String {
    let place = backtrace.lines().find_map(|line| line.trim().strip_prefix("at ")?.split_once("/crates/"));
    place.map_or_else(String::new, |(_, place)| format!(" in crates/{place}"))
}

fn fault_of_message(message: &str) -> Option<String> {
    let start: String = message.chars().take(200).collect();
    if message.len() > LONGEST_MESSAGE {
        Some(format!("says {} bytes: {start:?}", message.len()))
    } else if message.contains(char::is_control) {
        Some(format!("says a control character: {start:?}"))
    } else {
        None
    }
}

/// The bytes of a target's own file, and of the files that its seeds name.
fn seeds(folder: &Path, target: &Target) -> Result<Vec<Vec<u8>>> {
    let read = |path: &Path| fs::read(path).map_err(|e| Error::read(path, e));
    let mut all = vec![read(&folder.join(target.file))?];
    for seed in target.seeds.iter().map(|seed| folder.join(seed)) {
        let mut files = vec![seed.clone()];
        if seed.is_dir() {
            let entries = fs::read_dir(&seed).map_err(|e| Error::read(&seed, e))?.flatten();
            files = entries.map(|entry| entry.path()).filter(|path| path.is_file()).collect();
            files.sort();
        }
        for file in files {
            all.push(read(&file)?);
        }
    }
    Ok(all)
}
