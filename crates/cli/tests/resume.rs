//! Killed and interrupted runs: a resumed run has the same bytes.
use crate::common::{SMALL, pwrfgs, refuse, signal, succeed, wait_for_step, write};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::OnceLock;

/// A few seconds of training in small steps, with densification, pruning and checkpoints on the way.
fn longer() -> String {
    SMALL
        .replace("name: \"small\"", "name: \"small\", tensorboard: true")
        .replace("steps: 60", "steps: 2_400")
        .replace("densify_until: 20", "densify_until: 900")
        .replace(
            "prune_until: 40, prune_every: 10, validate_every: 20",
            "prune_until: 1_800, prune_every: 150, validate_every: 300",
        )
        .replace("checkpoint_every: 10", "checkpoint_every: 70")
        .replace("every: 5, from: 5", "every: 100, from: 100, max_gaussians: 60")
}

/// `curve.csv` without its seconds.
pub(crate) fn curve(run: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(run.join("curve.csv")).unwrap();
    text.lines().map(|l| l.rsplit_once(',').unwrap().0.to_owned()).collect()
}

/// The records of the TensorBoard file without their times; the last one holds the scores, latencies among them.
pub(crate) fn events(run: &Path) -> Vec<Vec<u8>> {
    let bytes = std::fs::read(run.join("events.out.tfevents.pwrfgs")).unwrap();
    let mut rest = bytes.as_slice();
    let mut records = Vec::new();
    while let Some((length, tail)) = rest.split_first_chunk::<8>() {
        let length = u64::from_le_bytes(*length) as usize;
        assert_eq!(tail[4], 1 << 3 | 1, "a record begins with its wall time, eight bytes");
        records.push(tail[4 + 9..4 + length].to_vec());
        rest = &tail[4 + length + 4..];
    }
    assert!(records.pop().unwrap().windows(9).any(|text| text == b"test/ssim"));
    records
}

/// Such a run that was never stopped, made once for all tests.
fn whole() -> &'static Path {
    static RUN: OnceLock<PathBuf> = OnceLock::new();
    RUN.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("longer-run");
        _ = std::fs::remove_dir_all(&folder);
        write(&folder.join("p.ron"), longer());
        succeed(&folder, &["run", "p.ron", "--out", "whole", "-q", "--threads", "2"]);
        folder.join("whole")
    })
}

fn same_end(a: &Path, b: &Path) {
    assert!(curve(a) == curve(b), "curves differ");
    assert_eq!(events(a).len(), 1 + (curve(a).len() - 1) + 2_400 / 300, "the version, each row, each validation");
    assert!(events(a) == events(b), "events differ");
    for name in ["model.safetensors", "validation.csv", "samples.csv", "start.safetensors", "unpruned.safetensors"] {
        assert!(std::fs::read(a.join(name)).unwrap() == std::fs::read(b.join(name)).unwrap(), "{name} differs");
    }
}

#[test]
fn killed_run_resumes_to_identical_result() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), longer());
    // Between two checkpoints: densifying, pruning, fine-tuning; and right at a checkpoint, a prune and a validation.
    for step in [40, 330, 900, 1050, 1520, 2100] {
        let mut child =
            pwrfgs(here).args(["run", "p.ron", "--out", "killed", "-q"]).stdout(Stdio::null()).spawn().unwrap();
        wait_for_step(&mut child, &here.join("killed"), step);
        child.kill().unwrap(); // SIGKILL
        assert!(!child.wait().unwrap().success(), "killed after step {step}");
    }
    succeed(here, &["run", "p.ron", "--out", "killed", "-q"]);
    same_end(whole(), &here.join("killed"));
    let rows = curve(whole());
    assert_eq!(rows.len(), 1 + 1 + 240, "a header, step 1 and every tenth");
    assert!(rows.iter().any(|r| r.contains("prune")) && rows.iter().any(|r| r.contains("finetune")));
}

#[test]
fn interrupted_run_prints_resume_command() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), longer());
    let mut child =
        pwrfgs(here).args(["run", "p.ron", "--out", "r"]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for_step(&mut child, &here.join("r"), 70);
    signal(&child, "-STOP");
    // The folder of a running process is locked for others.
    refuse(here, &["run", "p.ron", "--out", "r"], 2, &["r is in use by another pwrfgs process"]);
    ["-INT", "-CONT"].iter().for_each(|name| signal(&child, name));
    let output = child.wait_with_output().unwrap();
    let message = crate::common::stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{message}");
    assert!(message.contains("stopped after step") && message.contains("repeat the command to resume"), "{message}");
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--threads", "1"]);
    same_end(&here.join("r"), whole());
}
