//! Failures of the machine: exit code 1, and all files written before stay valid.
use crate::common::{SMALL, call, copy_small_run, refuse, stderr, write};

#[test]
fn fails_if_folder_is_read_only() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    refuse(here, &["run", "p.ron", "--out", "/proc/nowhere"], 1, &["cannot write /proc/nowhere"]);
}

/// A limit on the size of files stands for a full disk: both make a write fail half-way. Its signal, SIGXFSZ, is not ignored
/// by who starts the program.
#[test]
fn full_disk_keeps_written_files_and_run_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "whole");
    let checkpoint = std::fs::metadata(here.join("whole/checkpoint.safetensors")).unwrap().len();
    let blocks = checkpoint / 1024 / 2; // in KiB: settings and curve fit, the checkpoint does not
    let script = format!("ulimit -f {blocks}; exec {} run p.ron --out r -q", env!("CARGO_BIN_EXE_pwrfgs"));
    let output = std::process::Command::new("bash").args(["-c", &script]).current_dir(here).output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("error: cannot write r/") && message.contains("File too large"), "{message}");
    assert!(!message.contains("panicked"), "{message}");
    let names: Vec<String> =
        std::fs::read_dir(here.join("r")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert!(
        names.iter().any(|n| n == "pipeline.ron") && !names.iter().any(|n| n == "checkpoint.safetensors"),
        "{names:?}"
    );
    assert!(std::fs::read_to_string(here.join("r/curve.csv")).unwrap().ends_with('\n'));
    // With room again the same command goes on to the same end.
    assert!(call(here, &["run", "p.ron", "--out", "r", "-q"]).status.success());
    let model = |run: &str| std::fs::read(here.join(run).join("model.safetensors")).unwrap();
    assert!(model("r") == model("whole"));
}

#[test]
fn non_finite_values_stop_run_and_keep_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let wild =
        SMALL.replace("batch: 2,", "batch: 2, optimizer: (log_scales: LogLinear(first: 1e-3, last: 1e38, steps: 55)),");
    write(&here.join("p.ron"), wild.replace("checkpoint_every: 10", "checkpoint_every: 4"));
    refuse(here, &["run", "p.ron", "--out", "r"], 1, &["is not finite at step", "the last checkpoint is kept in r/"]);
    assert!(here.join("r/checkpoint.safetensors").is_file() && !here.join("r/model.safetensors").exists());
}
