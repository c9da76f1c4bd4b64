//! Driver of the mutation tests: cases run in separate processes with little memory, so that one that panics, aborts or
//! hangs is identified and the others continue.
//!
//! ```text
//! pwrfgs-fuzz [--cases N] [--first N]   tries cases and lists what is wrong; exit code 1 where something is
//! pwrfgs-fuzz --case N                  tries one in this process and keeps the broken file
//! pwrfgs-fuzz --whole                   tries files that are not broken and lists those that are refused
//! ```

#![allow(clippy::print_stdout, clippy::disallowed_methods)] // a program that reads its own files

use pwrfgs_fuzz::{AS_PROGRAM, Bench, target_of, targets::TARGETS};
use std::io::Result;
use std::path::Path;
use std::process::{Command, ExitCode, Output};

/// Limits of a worker process: address space, KiB, and processor time, seconds.
const LIMITS: &str = "ulimit -v 4000000; ulimit -t";

fn main() -> Result<ExitCode> {
    if std::env::var_os(AS_PROGRAM).is_some() {
        return Ok(pwrfgs_cli::main());
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |name: &str| arguments.iter().skip_while(|a| *a != name).nth(1)?.parse::<u64>().ok();
    let (first, cases) = (number("--first").unwrap_or(0), number("--cases").unwrap_or(10_000));
    let wrong = match arguments.first().map(String::as_str) {
        Some("work") => work(Path::new(&arguments[1]), first, number("--step").unwrap_or(1), first + cases),
        Some("--whole") => whole()?,
        Some("--case") => {
            let case = number("--case").unwrap_or(0);
            let folder = std::env::temp_dir().join(format!("pwrfgs-fuzz-{case}"));
            println!("case {case} breaks {} in {}", name_of(case), folder.display());
            let fault = bench(&folder).try_case(case, true).expect("the bench can be written");
            println!("{}", fault.as_deref().unwrap_or("fine"));
            usize::from(fault.is_some())
        }
        _ => drive(first, cases)?,
    };
    Ok(ExitCode::from(u8::from(wrong > 0)))
}

/// Description of a case.
fn name_of(case: u64) -> String {
    let target = TARGETS[target_of(case)];
    format!("{}{}", target.file, target.command())
}

fn bench(folder: &Path) -> Bench {
    Bench::new(folder).expect("the bench can be made")
}

/// Tests the valid file of every target twice: output of an earlier call must not cause an error.
fn whole() -> Result<usize> {
    let folder = tempfile::tempdir()?;
    let bench = bench(folder.path());
    let try_one = |k: usize| bench.refusal(k % TARGETS.len()).expect("the program can be called").map(|why| (k, why));
    let refused: Vec<_> = (0..2 * TARGETS.len()).filter_map(try_one).collect();
    refused.iter().for_each(|(k, why)| println!("{}: {}", TARGETS[k % TARGETS.len()].file, why.text));
    Ok(refused.len())
}

/// Runs every `step`-th case from `first` to below `end`; prints each case and its fault.
fn work(folder: &Path, first: u64, step: u64, end: u64) -> usize {
    let bench = bench(folder);
    for case in (first..end).step_by(step as usize) {
        println!("case {case}");
        if let Some(fault) = bench.try_case(case, false).expect("the bench can be written") {
            println!("fault {case}, {}: {fault}", name_of(case));
        }
    }
    0
}

/// Runs all cases in parallel, one process per processor; returns the number of faults.
fn drive(first: u64, cases: u64) -> Result<usize> {
    let workers = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    let faults: Vec<Result<Vec<String>>> = std::thread::scope(|scope| {
        let all: Vec<_> =
            (0..workers).map(|w| scope.spawn(move || all_of(first + w, workers, first + cases))).collect();
        all.into_iter().map(|worker| worker.join().expect("a failed worker reports its fault")).collect()
    });
    let faults = faults.into_iter().collect::<Result<Vec<_>>>()?.concat();
    faults.iter().take(50).for_each(|fault| println!("{fault}"));
    println!("{} of {cases} cases are wrong", faults.len());
    Ok(faults.len())
}

/// Runs every `step`-th case, restarting the process if needed; returns the faults.
fn all_of(mut next: u64, step: u64, end: u64) -> Result<Vec<String>> {
    let mut faults = Vec::new();
    while next < end {
        let Output { status, stdout, stderr } = one_process(next, step, end)?;
        let (message, errors) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
        faults.extend(message.lines().filter_map(|line| line.strip_prefix("fault ")).map(Into::into));
        if status.success() {
            break;
        }
        let last = message.lines().filter_map(|line| line.strip_prefix("case ")?.parse::<u64>().ok()).next_back();
        let case = last.unwrap_or_else(|| panic!("no case was tried ({status}): {errors}"));
        faults.push(format!("{case}, {}: ends the process ({status}): {errors}", name_of(case)));
        next = case + step;
    }
    Ok(faults)
}

/// Starts this program as a worker in a new folder, on one thread and with little memory.
fn one_process(first: u64, step: u64, end: u64) -> Result<Output> {
    let folder = tempfile::tempdir()?;
    let mut command = Command::new("sh");
    // A case takes some milliseconds, the bench a few seconds.
    command.args(["-c", &format!("{LIMITS} {}; exec \"$@\"", 60 + (end - first) / step / 20), "sh"]);
    command.arg(std::env::current_exe()?).arg("work").arg(folder.path());
    for (name, value) in [("--first", first), ("--step", step), ("--cases", end - first)] {
        command.args([name, &value.to_string()]);
    }
    command.env("RAYON_NUM_THREADS", "1").env("RUST_BACKTRACE", "1").env("PWRFGS_CACHE", folder.path().join("cache"));
    command.output()
}
