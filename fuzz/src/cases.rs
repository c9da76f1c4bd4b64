//! One case after another, in this process.

use crate::mutate::mutate;
use crate::targets::{Reader, TARGETS, Target};
use pwrfgs_core::{Error, Result, rng};
use std::fs::{self, File};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest time of a case.
pub const PATIENCE: Duration = Duration::from_secs(10);
/// The variable that makes the fuzzer be `pwrfgs`.
pub const AS_PROGRAM: &str = "PWRFGS_FUZZ_AS_PROGRAM";
/// Longest message, bytes.
const LONGEST_MESSAGE: usize = 2_000;

/// What the last panic said, and where.
static PANIC: Mutex<String> = Mutex::new(String::new());

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
            let text = panic.to_string().replace('\n', " ");
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
        let (seeds, Target { file, form, reader, .. }) = (&self.seeds[target], TARGETS[target]);
        let mut random = rng::stream(0, "fuzz", n);
        let (seed, other) = (rng::below(&mut random, seeds.len()), rng::below(&mut random, seeds.len()));
        let broken = mutate(&seeds[seed], &seeds[other], form, &mut random);
        let path = self.folder.join(file);
        let put = |bytes: &[u8]| fs::write(&path, bytes).map_err(|e| Error::write(&path, e));
        put(&broken)?;
        let begun = Instant::now();
        let fault = match reader {
            Reader::Library(read) => match catch_unwind(AssertUnwindSafe(|| read(&self.folder))) {
                Ok(Ok(())) => None,
                Ok(Err(e)) if !e.is_input() => Some(format!("blames the machine: {e}")),
                Ok(Err(e)) => fault_of_message(&e.to_string()),
                Err(_) => Some(PANIC.lock().unwrap_or_else(PoisonError::into_inner).clone()),
            },
            Reader::Program(arguments) => self.call(arguments)?,
        };
        if !keep {
            put(&seeds[0])?;
        }
        Ok(fault.or_else(|| (begun.elapsed() > PATIENCE).then(|| "takes too long".into())))
    }

    /// Calls the program; what is wrong with how it ends.
    fn call(&self, arguments: &[&str]) -> Result<Option<String>> {
        let said = self.folder.join("said.txt");
        let open = || File::create(&said).map_err(|e| Error::write(&said, e));
        let program = std::env::current_exe().map_err(|e| Error::Config(format!("where is this program? {e}")))?;
        let mut command = Command::new(program);
        command.args(arguments).current_dir(&self.folder).env(AS_PROGRAM, "1").env_remove("RUST_LOG");
        let child = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(open()?).spawn();
        let failed = |e| Error::Config(format!("the program cannot be called: {e}"));
        let (mut child, begun) = (child.map_err(failed)?, Instant::now());
        let status = loop {
            match child.try_wait().map_err(failed)? {
                Some(status) => break status,
                None if begun.elapsed() > PATIENCE => {
                    _ = child.kill().and_then(|()| child.wait());
                    return Ok(Some("takes too long".into()));
                }
                None => std::thread::sleep(Duration::from_millis(2)),
            }
        };
        let text = fs::read(&said).map_err(|e| Error::read(&said, e))?;
        let text = String::from_utf8_lossy(&text);
        for folder in ["ran", "simulated", "compared", "heard"] {
            let _ = fs::remove_dir_all(self.folder.join(folder));
        }
        match status.code() {
            Some(0..=2) => Ok(text.lines().find_map(fault_of_message)),
            code => {
                let last = text.lines().find(|line| line.contains("panicked")).or(text.lines().last());
                Ok(Some(format!("ends with {code:?} ({status}): {}", last.unwrap_or_default())))
            }
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
    let target = &TARGETS[target_of(n)];
    match target.reader {
        Reader::Library(_) => target.file.into(),
        Reader::Program(arguments) => format!("{} for pwrfgs {}", target.file, arguments[0]),
    }
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
