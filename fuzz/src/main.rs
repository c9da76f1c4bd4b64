//! The driver: cases are tried in processes of their own with little memory, so that one that aborts or hangs is known by
//! its number and the others go on.
//!
//! ```text
//! pwrfgs-fuzz [--cases N] [--first N]   tries cases and lists what is wrong; exit code 1 where something is
//! pwrfgs-fuzz --case N                  tries one in this process and keeps the broken file
//! pwrfgs-fuzz --whole                   tries files that are not broken and lists those that are refused
//! ```

#![allow(clippy::print_stdout, clippy::print_stderr, clippy::disallowed_methods)] // a program that reads its own files

use pwrfgs_core::Result;
use pwrfgs_fuzz::bench;
use pwrfgs_fuzz::cases::{AS_PROGRAM, Begun, Bench, name_of, own_frame, title};
use pwrfgs_fuzz::targets::TARGETS;
use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, ExitCode, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Address space of a process that tries cases, KiB.
const MEMORY_KIB: u64 = 4_000_000;
/// Exit code where the fuzzer itself cannot work.
const BROKEN: u8 = 3;

fn main() -> ExitCode {
    if std::env::var_os(AS_PROGRAM).is_some() {
        return pwrfgs_cli::main();
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |name: &str| {
        let place = arguments.iter().position(|a| a == name)?;
        arguments.get(place + 1)?.parse::<u64>().ok()
    };
    let done = match (arguments.first().map(String::as_str), number("--case")) {
        (Some("work"), _) => work(&arguments[1..]),
        (Some("--whole"), _) => whole(),
        (_, Some(case)) => repeat(case),
        _ => drive(number("--first").unwrap_or(0), number("--cases").unwrap_or(10_000)),
    };
    done.unwrap_or_else(|error| {
        eprintln!("error: {error}");
        ExitCode::from(BROKEN)
    })
}

/// One case, here.
fn repeat(case: u64) -> Result<ExitCode> {
    let folder = std::env::temp_dir().join(format!("pwrfgs-fuzz-{case}"));
    bench::make(&folder)?;
    println!("case {case} breaks {} in {}", name_of(case), folder.display());
    let fault = Bench::open(&folder)?.try_case(case, true)?;
    println!("{}", fault.as_deref().unwrap_or("fine"));
    Ok(ExitCode::from(u8::from(fault.is_some())))
}

/// The whole file of every target, twice: an earlier call must not be what refuses the next.
fn whole() -> Result<ExitCode> {
    let folder = tempfile::tempdir().map_err(|e| pwrfgs_core::Error::write(&std::env::temp_dir(), e))?;
    bench::make(folder.path())?;
    let bench = Bench::open(folder.path())?;
    let mut refused = 0;
    for (place, target) in TARGETS.iter().enumerate().chain(TARGETS.iter().enumerate()) {
        if let Some(why) = bench.refusal(place)? {
            println!("{}: {}", title(target), why.trim());
            refused += 1;
        }
    }
    Ok(ExitCode::from(u8::from(refused > 0)))
}

/// Every `step`-th case from `first` to below `end`: tells which it tries, and what is wrong with it.
fn work(arguments: &[String]) -> Result<ExitCode> {
    let [folder, first, step, end] = arguments else { return Ok(ExitCode::from(BROKEN)) };
    let [first, step, end] = [first, step, end].map(|text| text.parse::<u64>().unwrap_or(1));
    let bench = Bench::open(Path::new(folder))?;
    for case in (first..end).step_by(step as usize) {
        println!("case {case}");
        if let Some(fault) = bench.try_case(case, false)? {
            println!("fault {}", fault.replace('\n', " "));
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// What was found wrong: how often, by target and kind.
#[derive(Default)]
struct Faults(Mutex<BTreeMap<(String, String), u64>>);

impl Faults {
    /// Counts one, and tells the first of its kind.
    fn note(&self, case: u64, fault: &str) {
        // The same but for numbers, paths and quotations is the same; of what is said too long or badly, the first words.
        let words = fault.split(['`', '"']).step_by(2).flat_map(|part| part.split(' '));
        let words = words.filter(|word| !word.contains('/') || word.contains(".rs:"));
        let kind: String = words.take(if fault.starts_with("says") { 2 } else { 30 }).collect();
        let kind = kind.chars().filter(char::is_ascii_alphabetic).collect();
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let count = all.entry((name_of(case), kind)).or_insert(0);
        *count += 1;
        if *count == 1 {
            println!("case {case}, {}: {}", name_of(case), fault.chars().take(400).collect::<String>());
        }
    }
}

/// All cases, in as many processes at a time as there are processors.
fn drive(first: u64, cases: u64) -> Result<ExitCode> {
    let (begun, end, faults) = (Instant::now(), first + cases, Faults::default());
    let workers = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    let ended: Vec<Result<()>> = std::thread::scope(|scope| {
        let faults = &faults;
        let all: Vec<_> =
            (0..workers).map(|w| scope.spawn(move || all_of([first + w, workers, end], faults))).collect();
        all.into_iter().map(|worker| worker.join().expect("a worker that fails says so")).collect()
    });
    ended.into_iter().collect::<Result<()>>()?;
    let faults = faults.0.into_inner().unwrap_or_else(PoisonError::into_inner);
    let wrong: u64 = faults.values().sum();
    let seconds = begun.elapsed().as_secs_f64();
    println!("{wrong} of {cases} cases are wrong in {} ways, {seconds:.0} s", faults.len());
    Ok(ExitCode::from(u8::from(wrong > 0)))
}

/// Every `step`-th case, in as many processes as it takes.
fn all_of([mut next, step, end]: [u64; 3], faults: &Faults) -> Result<()> {
    let folder = tempfile::tempdir().map_err(|e| pwrfgs_core::Error::write(&std::env::temp_dir(), e))?;
    while next < end {
        // A new one: what a process that was stopped leaves behind must not fail the next.
        let bench = folder.path().join(next.to_string());
        bench::make(&bench)?;
        let Some((case, why)) = one_process(&bench, [next, step, end], faults) else { break };
        faults.note(case, &why);
        next = case + step;
    }
    Ok(())
}

/// Runs one process to its end; the case that it died of, if it did.
fn one_process(bench: &Path, range: [u64; 3], faults: &Faults) -> Option<(u64, String)> {
    let mut child = spawn(bench, range).expect("a shell can be started");
    let (send, receive) = channel();
    let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
    std::thread::spawn(move || lines.map_while(std::result::Result::ok).try_for_each(|line| send.send(line)));
    let (mut case, mut begun) = (range[0], Begun::now(child.id()));
    loop {
        match receive.recv_timeout(Duration::from_secs(1)) {
            Ok(line) => match line.split_once(' ') {
                Some(("case", number)) => {
                    (case, begun) = (number.parse().unwrap_or(case), Begun::now(child.id()));
                }
                Some(("fault", why)) => faults.note(case, why),
                _ => {}
            },
            Err(RecvTimeoutError::Timeout) if !begun.is_hanging(child.id()) => {}
            Err(RecvTimeoutError::Timeout) => {
                _ = child.kill().and_then(|()| child.wait());
                return Some((case, "hangs".into()));
            }
            Err(RecvTimeoutError::Disconnected) => {
                let status = child.wait().expect("a child can be waited for");
                let said = std::fs::read(bench.join("stderr.txt")).unwrap_or_default();
                let said = String::from_utf8_lossy(&said);
                let first = said.lines().next().unwrap_or_default();
                let why = format!("ends the process ({status}): {first}{}", own_frame(&said));
                assert_ne!(status.code(), Some(i32::from(BROKEN)), "{why}");
                return (!status.success()).then_some((case, why));
            }
        }
    }
}

/// This program as one that works, on one thread and with little memory.
fn spawn(bench: &Path, range: [u64; 3]) -> std::io::Result<Child> {
    let stderr = std::fs::File::create(bench.join("stderr.txt"))?;
    let limited = format!("ulimit -v {MEMORY_KIB}; exec \"$@\"");
    let mut command = Command::new("sh");
    command.args(["-c", &limited, "sh"]).arg(std::env::current_exe()?).arg("work").arg(bench);
    command.args(range.map(|number| number.to_string())).env("RAYON_NUM_THREADS", "1").env("RUST_BACKTRACE", "1");
    command.env("PWRFGS_CACHE", bench.join("cache")).stdout(Stdio::piped()).stderr(stderr).stdin(Stdio::null());
    std::io::stdout().flush()?;
    command.spawn()
}
