//! Kills a run at each system call that changes a file, or fills the disk from there on; the resumed run has the same bytes.
//! `faults/shim.c` is loaded before the C library; it needs `cc`, which Rust links with.
//!
//! This runs a selection of the calls; `PWRFGS_FAULTS=all` runs all.
use crate::common::{call, files, measured, pwrfgs, stderr, succeed, write};
use crate::resume::{curve, events};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Less than a second: densified, pruned twice, four checkpoints, three looks at the validation part, a report.
pub(crate) const TINY: &str = "Pipeline(
    name: \"tiny\", tensorboard: true,
    data: Teacher(gaussians: 4, samples: 12, width: 90, height: 24),
    split: Official(validation: 0.2),
    initializer: Grid(count: 8),
    deformation: Mlp(depth: 2, width: 8, skip: None),
    pruners: [TopK(), LearnableMask(lambda: 0.02, learning_rate: 0.1)],
    baselines: [MeanSpectrum()],
    metrics: [Ssim(), GaussianCount()],
    training: (
        steps: 12, batch: 2, target_count: 6, densify_until: 4, prune_until: 9, prune_every: 2, validate_every: 4, checkpoint_every: 3,
        densify: (every: 2, from: 2),
    ),
)
";

/// The shim, made in `folder`; nothing where there is no compiler, or where the program does not take it.
pub(crate) fn shim(folder: &Path) -> Option<PathBuf> {
    let (source, shim) = (Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults/shim.c"), folder.join("shim.so"));
    let made = Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).arg(&shim).arg(source).arg("-ldl").output();
    let why = match made {
        Ok(made) if made.status.success() => return Some(shim),
        Ok(made) => stderr(&made),
        Err(e) => e.to_string(),
    };
    pwrfgs_core::testing::skipped(&format!("cc cannot make a shared library: {}", why.lines().next().unwrap_or("")));
    None
}

/// The tiny run in the folder `out`, whose call number `at` goes wrong.
pub(crate) fn faulty(here: &Path, shim: &Path, out: &str, (mode, at): (&str, u64)) -> Output {
    let mut command = pwrfgs(here);
    command.args(["run", "p.ron", "--out", out, "-q", "--threads", "1"]).env("LD_PRELOAD", shim);
    command.env("FAULT_MODE", mode).env("FAULT_AT", at.to_string()).env("FAULT_COUNT", here.join("count"));
    command.output().unwrap()
}

/// Every file of a run, without what tells the time: seconds in `curve.csv`, times in the events, times, memory and the
/// number of starts in `run.json`, three lines of the report.
pub(crate) fn end_of(run: &Path) -> BTreeMap<String, Vec<u8>> {
    let names = std::fs::read_dir(run).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let content = |name: &str| {
        let bytes = std::fs::read(run.join(name)).unwrap();
        match name {
            "curve.csv" => curve(run).join("\n").into(),
            "events.out.tfevents.pwrfgs" => events(run).concat(),
            "run.json" => {
                let mut facts: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
                let facts = facts.as_object_mut().unwrap();
                assert!(facts["finished"].is_string());
                for timed in ["wall_seconds", "training_seconds", "peak_memory_bytes", "starts", "started", "finished"]
                {
                    facts.remove(timed).unwrap();
                }
                // Their digests and lengths follow the times.
                for timed in ["curve.csv", "events.out.tfevents.pwrfgs", "report.html"] {
                    facts.get_mut("files").and_then(|files| files.as_object_mut()?.remove(timed));
                }
                serde_json::to_vec(facts).unwrap()
            }
            "report.html" => {
                let text = String::from_utf8(bytes).unwrap();
                let timed = |line: &&str| {
                    ["<td>Training</td>", "<td>Total</td>", "<footer>"].iter().any(|mark| line.contains(mark))
                };
                assert_eq!(text.lines().filter(timed).count(), 3);
                text.lines().filter(|line| !timed(line)).collect::<Vec<_>>().join("\n").into()
            }
            _ => bytes,
        }
    };
    names.map(|name| (name.clone(), content(&name))).collect()
}

/// Temporary files, and the marks of folders in progress, in a folder and below it.
pub(crate) fn temporaries(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), entry.file_name().into_string().unwrap());
        let is_temporary = path.extension().is_some_and(|extension| extension == "tmp");
        if name.starts_with('.') && (is_temporary || name.contains("pwrfgs-lock")) {
            found.push(path);
        } else if path.is_dir() {
            found.extend(temporaries(&path));
        }
    }
    found
}

/// A folder with the pipeline and the shim, and calls of a whole run that are to go wrong.
struct Faults {
    folder: tempfile::TempDir,
    shim: PathBuf,
    mode: &'static str,
    calls: Vec<u64>,
}

impl Faults {
    /// Every `spread`-th call, or all.
    fn prepare(mode: &'static str, spread: usize) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        write(&here.join("p.ron"), TINY);
        let shim = shim(here)?;
        assert!(faulty(here, &shim, "counted", (mode, 0)).status.success());
        let Ok(count) = std::fs::read_to_string(here.join("count")) else {
            pwrfgs_core::testing::skipped("LD_PRELOAD is not heeded here");
            return None;
        };
        let count: u64 = count.trim().parse().unwrap();
        assert!(count > 100, "{count} calls are too few to be all");
        let all = std::env::var_os("PWRFGS_FAULTS").is_some_and(|which| which == "all");
        let calls: Vec<u64> = (1..=count).step_by(if all { 1 } else { spread }).collect();
        println!("{mode}: {} of {count} calls", calls.len());
        Some(Self { folder, shim, mode, calls })
    }

    /// Lets each happen to a run of its own and resumes it; `judge` looks at how it ended.
    fn each(&self, judge: impl Fn(&str, &Output) + Sync) {
        let (here, next) = (self.folder.path(), AtomicUsize::new(0));
        succeed(here, &["run", "p.ron", "--out", "whole", "-q", "--threads", "1"]);
        let whole = end_of(&here.join("whole"));
        let work = || {
            while let Some(at) = self.calls.get(next.fetch_add(1, Ordering::Relaxed)) {
                let out = format!("{}-{at}", self.mode);
                judge(&out, &faulty(here, &self.shim, &out, (self.mode, *at)));
                succeed(here, &["run", "p.ron", "--out", &out, "-q", "--threads", "1"]);
                let end = end_of(&here.join(&out));
                assert!(end.keys().eq(whole.keys()), "{out}: {:?}", end.keys());
                end.iter().for_each(|(name, bytes)| assert!(*bytes == whole[name], "{out}: {name} differs"));
                std::fs::remove_dir_all(here.join(&out)).unwrap();
            }
        };
        let workers = std::thread::available_parallelism().map_or(1, usize::from);
        std::thread::scope(|scope| (0..workers).for_each(|_| _ = scope.spawn(work)));
    }
}

#[test]
fn run_killed_at_any_write_resumes_to_identical_result() {
    for (mode, spread) in [("kill", 13), ("half", 25)] {
        let Some(faults) = Faults::prepare(mode, spread) else { return };
        faults.each(|out, ended| {
            assert!(!ended.status.success() && ended.status.code().is_none(), "{out}: {}", ended.status);
        });
    }
}

#[test]
fn reports_full_disk_at_any_write_and_run_resumes() {
    let Some(faults) = Faults::prepare("full", 17) else { return };
    faults.each(|out, ended| {
        let message = stderr(ended);
        // The last call brings the folder to the disk, and a file system that cannot do that is no failure.
        if !ended.status.success() {
            assert_eq!(ended.status.code(), Some(1), "{out}: {message}");
            let is_reported =
                message.matches("error: cannot write ").count() == 1 && message.contains("No space left on device");
            assert!(is_reported && !message.contains("panicked"), "{out}: {message}");
        }
    });
}

/// Each command is killed before calls that change a file, and started again.
#[test]
fn next_start_removes_what_killed_command_left() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let Some(shim) = shim(here) else { return };
    measured(here);
    let validated = ["--set", "residuals=Kriged()", "--set", "split=Official(validation: 0.5)"];
    succeed(here, &[&["run", "p.ron", "--out", "kriged", "-q"][..], &validated].concat());
    write(&here.join("tiny.ron"), TINY);
    succeed(here, &["run", "tiny.ron", "--out", "r", "-q"]);
    let all = std::env::var_os("PWRFGS_FAULTS").is_some_and(|which| which == "all");
    write(&here.join("tx.csv"), "x,y,z\n0.3,0.1,0.9\n0.1,0.2,0.8\n");
    let commands: [(&[&str], usize); 8] = [
        (&["compress", "r/model.safetensors", "--out", "new"], 1),
        (&["export", "r/model.safetensors", "--npz", "new"], 1),
        (&["view", "r", "--save", "new"], 2),
        (&["update", "kriged/model.safetensors", "--data", "data", "--out", "new"], 2),
        (&["predict", "r/model.safetensors", "--tx", "0.3,0.1,0.9", "--out", "new"], 2),
        (&["predict", "r/model.safetensors", "--tx-csv", "tx.csv", "--stacked", "--no-png", "--out", "new"], 2),
        (&["evaluate", "r/model.safetensors", "--out", "new"], 4),
        (&["report", "r", "--out", "new"], 23),
    ];
    let out = here.join("new");
    // Files in a folder have times.
    let content = || {
        if out.is_dir() {
            files(&out).into_keys().map(|path| (path, Vec::new())).collect()
        } else {
            BTreeMap::from([(out.clone(), std::fs::read(&out).unwrap())])
        }
    };
    let remove = || std::fs::remove_dir_all(&out).or_else(|_| std::fs::remove_file(&out)).unwrap();
    for (arguments, spread) in commands {
        let kill = |at: usize| {
            let mut command = pwrfgs(here);
            command.args(arguments).args(["-q", "--threads", "1"]).env("LD_PRELOAD", &shim).env("FAULT_MODE", "kill");
            command.env("FAULT_AT", at.to_string()).env("FAULT_COUNT", here.join("count")).output().unwrap()
        };
        assert!(kill(0).status.success(), "{arguments:?}");
        let Ok(count) = std::fs::read_to_string(here.join("count")) else { return }; // LD_PRELOAD is not heeded here
        let (count, whole) = (count.trim().parse::<usize>().unwrap(), content());
        remove();
        println!("{arguments:?}: {count} calls");
        for at in (1..=count).step_by(if all { 1 } else { spread }) {
            assert!(kill(at).status.code().is_none(), "{arguments:?}, call {at}");
            if arguments[0] == "report" && out.join("report.html").exists() {
                assert!(whole.keys().all(|path| path.exists()), "call {at}: the page is last");
            }
            let again = call(here, arguments);
            let is_complete = ["exists; choose", "is not empty"].iter().any(|why| stderr(&again).contains(why));
            assert!(again.status.success() || is_complete, "{arguments:?}, call {at}: {}", stderr(&again));
            assert!(content() == whole, "{arguments:?}, call {at}");
            assert_eq!(temporaries(here), [] as [PathBuf; 0], "{arguments:?}, call {at}");
            assert!(!here.join("new.partial").exists(), "{arguments:?}, call {at}");
            remove();
        }
    }
}
