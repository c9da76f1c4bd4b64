//! Processes in one folder at the same time: a process is held before a call while another runs. The folder ends as after
//! one process and then the other. `faults/shim.c` holds the process, so the tests do not depend on speed.
use crate::common::{call, measured, pwrfgs, stderr, stdout, succeed, write};
use crate::faults::{TINY, end_of, faulty, shim, temporaries};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Output, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// A folder with two pipelines, an experiment of two runs, and the shim.
struct Place {
    folder: tempfile::TempDir,
    shim: PathBuf,
}

impl Place {
    fn new() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let shim = shim(here)?;
        write(&here.join("a.ron"), TINY);
        write(&here.join("b.ron"), TINY.replace("target_count: 6", "target_count: 5"));
        write(&here.join("e.ron"), "Experiment(name: \"pair\", base: \"a.ron\", seeds: [0, 1], axes: [])");
        let place = Self { folder, shim };
        if !place.start(&["check", "a.ron"], ("a.ron", 1)).is_held() {
            pwrfgs_core::testing::skipped("LD_PRELOAD is not heeded here");
            return None;
        }
        Some(place)
    }

    fn here(&self) -> &Path {
        self.folder.path()
    }

    /// Starts the program, which is held before the call of this number on a path with this part; never if it is 0.
    fn start(&self, arguments: &[&str], (part, at): (&str, usize)) -> Process {
        static STARTED: AtomicUsize = AtomicUsize::new(0);
        let number = STARTED.fetch_add(1, Ordering::Relaxed);
        let [held, waits] = ["held", "waits"].map(|mark| self.here().join(format!("{mark}{number}")));
        let mut command = pwrfgs(self.here());
        command.args(arguments).env("LD_PRELOAD", &self.shim).env("FAULT_MODE", "hold").env("FAULT_PATH", part);
        command.env("FAULT_AT", at.to_string()).env("FAULT_HELD", &held).env("FAULT_WAITS", &waits);
        command.env("PATH", format!("{}:{}", self.here().join("bin").display(), std::env::var("PATH").unwrap()));
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        Process { child: Some(child), held, waits }
    }
}

/// A process that is held before one of its calls.
struct Process {
    child: Option<Child>,
    held: PathBuf,
    waits: PathBuf,
}

impl Process {
    /// Waits until it is held, or waits for a lock of another process, or has ended.
    fn settle(&mut self) {
        while !self.held.exists() && !self.waits.exists() && self.is_running() {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Whether it is held, once it is held or has ended.
    fn is_held(&mut self) -> bool {
        while !self.held.exists() && self.is_running() {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.held.exists()
    }

    fn is_running(&mut self) -> bool {
        self.child.as_mut().unwrap().try_wait().unwrap().is_none()
    }

    /// Lets it go on to its end.
    fn end(mut self) -> Output {
        while self.is_running() {
            _ = std::fs::remove_file(&self.held);
            std::thread::sleep(Duration::from_millis(1));
        }
        self.child.take().unwrap().wait_with_output().unwrap()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            _ = child.kill();
            _ = child.wait();
        }
    }
}

/// The calls before which a process is held: the first ones, which claim its folder, and a spread of the others.
fn calls(first: usize, spread: usize) -> impl Iterator<Item = usize> {
    (1..=first).chain((first..).step_by(spread).skip(1))
}

fn run<'a>(file: &'a str, out: &'a str) -> [&'a str; 7] {
    ["run", file, "--out", out, "-q", "--threads", "1"]
}

fn sweep(out: &str) -> [&str; 6] {
    ["sweep", "e.ron", "--out", out, "--threads", "1"]
}

/// What `end_of` says of some runs in a folder.
fn all_of(folder: &Path, runs: &[&str]) -> Vec<BTreeMap<String, Vec<u8>>> {
    runs.iter().map(|run| end_of(&folder.join(run))).collect()
}

#[test]
fn concurrent_runs_in_one_folder_complete_one_run() {
    let Some(place) = Place::new() else { return };
    let here = place.here();
    let whole = ["a.ron", "b.ron"].map(|file| {
        succeed(here, &run(file, &format!("whole-{file}")));
        end_of(&here.join(format!("whole-{file}")))
    });
    for (k, other) in ["a.ron", "b.ron"].into_iter().enumerate() {
        let mut tried = 0;
        for at in calls(18, 30) {
            let out = format!("r-{at}-{other}-");
            let mut first = place.start(&run("a.ron", &out), (&out, at));
            let is_held = first.is_held();
            let second = call(here, &run(other, &out));
            let first = first.end();
            let message = format!("call {at}, {other}: {} {}", stderr(&first), stderr(&second));
            let ends = [&first, &second].map(|output| output.status.code());
            let refused = ["a run of another pipeline", "is in use by another pwrfgs process"];
            match (k, ends) {
                (0, [Some(0), Some(0)]) => {}
                (_, [Some(0), Some(2)]) => {
                    assert!(refused.iter().any(|why| stderr(&second).contains(why)), "{message}");
                }
                (_, [Some(2), Some(0)]) => assert!(refused.iter().any(|why| stderr(&first).contains(why)), "{message}"),
                _ => panic!("{ends:?} {message}"),
            }
            let winner = if ends[0] == Some(0) { 0 } else { k };
            assert!(end_of(&here.join(&out)) == whole[winner], "{ends:?} {message}");
            if !is_held {
                break;
            }
            tried += 1;
        }
        assert!(tried >= 18, "only {tried} calls are on paths of the folder");
    }
}

#[test]
fn concurrent_sweeps_skip_locked_runs_and_succeed() {
    let Some(place) = Place::new() else { return };
    let (here, runs) = (place.here(), ["seed=0", "seed=1"]);
    succeed(here, &sweep("whole"));
    let whole = all_of(&here.join("whole"), &runs);
    // The first is held at a call on these paths; the second is then at work in the first run, or ends before it goes on.
    let cases = [
        ("seed=0", "start.", (8..=16).step_by(2)),
        ("sweep.json", "none", (1..=5).step_by(1)),
        ("seed=0", "none", (11..=11).step_by(1)),
        ("report", "none", (1..=3).step_by(2)),
    ];
    for (case, (path, part, calls)) in cases.into_iter().enumerate() {
        for at in calls {
            let out = format!("s{case}-{at}");
            let mut first = place.start(&sweep(&out), (&format!("{out}/{path}"), at));
            assert!(first.is_held(), "call {at} on {path}");
            let mut second = place.start(&sweep(&out), (part, 1));
            second.settle();
            for output in [first.end(), second.end()] {
                let message = stderr(&output);
                assert!(
                    output.status.success() && !message.contains("failed"),
                    "call {at} on {path}, {part}: {message}"
                );
            }
            let status = stdout(&succeed(here, &["sweep", "e.ron", "--out", &out, "--status"]));
            assert!(status.contains("2 of 2 runs finished"), "call {at} on {path}, {part}: {status}");
            assert!(all_of(&here.join(&out), &runs) == whole, "call {at} on {path}, {part}");
            assert!(here.join(&out).join("report/report.html").is_file(), "call {at} on {path}, {part}");
        }
    }
}

#[test]
fn shards_submitted_to_slurm_at_once_submit_each_run_once() {
    let Some(place) = Place::new() else { return };
    let here = place.here();
    // A Slurm whose queue holds whatever was submitted.
    for (name, text) in [("sbatch", "echo $$"), ("squeue", "seq 9")] {
        let path = here.join("bin").join(name);
        write(&path, format!("#!/bin/sh\n{text}\n"));
        let made = std::process::Command::new("chmod").arg("+x").arg(&path).status().unwrap();
        assert!(made.success());
    }
    for shards in [["1/2", "2/2"], ["1/1", "1/1"]] {
        for at in 1.. {
            let out = format!("q-{at}-{}-", shards[1].len() + usize::from(shards[0] == shards[1]));
            let submit = |shard| ["sweep", "e.ron", "--out", &out, "--launcher", "slurm", "--shard", shard];
            let mut first = place.start(&submit(shards[0]), (&out, at));
            let is_held = first.is_held();
            let mut second = place.start(&submit(shards[1]), ("nothing", 1));
            second.settle();
            for output in [first.end(), second.end()] {
                assert!(output.status.success(), "call {at}, {shards:?}: {}", stderr(&output));
            }
            let submissions = std::fs::read_dir(here.join(&out).join("slurm")).unwrap();
            let lists = submissions.map(|own| std::fs::read_to_string(own.unwrap().path().join("runs.txt")).unwrap());
            let text: String = lists.collect();
            let mut names: Vec<&str> = text.lines().collect();
            names.sort_unstable();
            assert_eq!(names, ["seed=0", "seed=1"], "call {at}, {shards:?}");
            if !is_held {
                break;
            }
        }
    }
}

#[test]
fn run_does_not_write_through_symlink_replacing_its_folder() {
    let Some(place) = Place::new() else { return };
    let here = place.here();
    succeed(here, &run("a.ron", "whole"));
    let whole = end_of(&here.join("whole"));
    let parts = [("checkpoint", 2), ("checkpoint", 3), ("curve.csv", 1), ("model", 2), ("scores", 2), ("run.json", 9)];
    for (k, call) in parts.into_iter().enumerate() {
        let [out, moved, elsewhere] = ["out", "moved", "elsewhere"].map(|name| here.join(format!("{name}{k}")));
        whole.keys().for_each(|name| write(&elsewhere.join(name), "mine"));
        let mut process = place.start(&run("a.ron", out.to_str().unwrap()), call);
        assert!(process.is_held(), "{call:?}");
        std::fs::rename(&out, &moved).unwrap();
        std::os::unix::fs::symlink(&elsewhere, &out).unwrap();
        let output = process.end();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(1), "{call:?}: {message}");
        assert!(
            message.contains(out.to_str().unwrap()) && message.contains(moved.to_str().unwrap()),
            "{call:?}: {message}"
        );
        let there = std::fs::read_dir(&elsewhere).unwrap().map(|entry| std::fs::read(entry.unwrap().path()).unwrap());
        let there: Vec<Vec<u8>> = there.collect();
        assert!(there.len() == whole.len() && there.iter().all(|bytes| bytes == b"mine"), "{call:?}");
        assert!(end_of(&moved) == whole, "{call:?}");
    }
}

#[test]
fn run_works_on_file_system_without_hard_links() {
    let Some(place) = Place::new() else { return };
    let here = place.here();
    succeed(here, &run("a.ron", "whole"));
    write(&here.join("p.ron"), TINY);
    let output = faulty(here, &place.shim, "out", ("unlinked", 0));
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(end_of(&here.join("out")) == end_of(&here.join("whole")));
}

#[test]
fn new_file_never_replaces_file_that_appears_meanwhile() {
    let Some(place) = Place::new() else { return };
    let here = place.here();
    measured(here);
    let validated = ["--set", "residuals=Kriged()", "--set", "split=Official(validation: 0.5)"];
    succeed(here, &[&run("p.ron", "kriged")[..], &validated].concat());
    succeed(here, &run("a.ron", "r"));
    let commands: [&[&str]; 5] = [
        &["compress", "r/model.safetensors", "--out"],
        &["export", "r/model.safetensors", "--npz"],
        &["view", "r", "--save"],
        &["update", "kriged/model.safetensors", "--data", "data", "--out"],
        &["compare", "data", "--split-csv"],
    ];
    for command in commands {
        let mut refused = 0;
        for at in 1.. {
            let name = format!("{}-{at}.new", command[0]);
            let mut process = place.start(&[command, &[&*name]].concat(), (&name, at));
            let (is_held, file) = (process.is_held(), here.join(&name));
            let appears = is_held && !file.exists();
            if appears {
                write(&file, "mine");
            }
            let output = process.end();
            let message = format!("{name}: {}", stderr(&output));
            assert_eq!(output.status.code(), Some(if appears { 2 } else { 0 }), "{message}");
            assert!(!appears || message.contains("exists; choose another name"), "{message}");
            assert_eq!(std::fs::read(&file).unwrap() == b"mine", appears, "{message}");
            refused += usize::from(appears);
            if !is_held {
                break;
            }
        }
        assert!(refused >= 2, "{command:?}: only {refused} calls before the file has its name");
        assert_eq!(temporaries(here), [] as [PathBuf; 0], "{command:?}");
    }
}

#[test]
fn folder_that_appears_meanwhile_is_invalid_input() {
    let Some(place) = Place::new() else { return };
    let here = place.here();
    measured(here);
    succeed(here, &run("a.ron", "r"));
    let import = ["import", "--spectra", "data/spectrum", "--tx", "data/tx_pos.csv", "--elevation", "-90,90"];
    let commands: [&[&str]; 4] = [
        &["predict", "r/model.safetensors", "--tx", "0.3,0.1,0.9", "--no-png"],
        &["evaluate", "r/model.safetensors"],
        &["plan", "data", "--count", "2"],
        &[&import[..], &["--receiver", "0,0,0", "--orientation", "0,0,0,1"]].concat(),
    ];
    for command in commands {
        let mut refused = 0;
        for at in 1.. {
            // The temporary name begins with a full stop, so only calls on the final path are counted.
            let name = format!("/{}-{at}", command[0]);
            let out = here.join(&name[1..]);
            let mut process = place.start(&[command, &["--out", out.to_str().unwrap()]].concat(), (&name, at));
            let is_held = process.is_held();
            let appears = is_held && !out.exists();
            if appears {
                write(&out.join("mine"), "mine");
            }
            let output = process.end();
            let message = format!("{name}: {}", stderr(&output));
            assert_eq!(output.status.code(), Some(if appears { 2 } else { 0 }), "{message}");
            assert!(!appears || message.contains("is not empty (it holds `mine`)"), "{message}");
            assert!(!appears || std::fs::read_dir(&out).unwrap().count() == 1, "{message}");
            refused += usize::from(appears);
            if !is_held {
                break;
            }
        }
        assert!(refused >= 3, "{command:?}: only {refused} calls before the folder has its name");
        assert_eq!(temporaries(here), [] as [PathBuf; 0], "{command:?}");
    }
}
