//! Paths that are not UTF-8, pipes in place of files, and names with control characters.
#![cfg(unix)]

use crate::common::{call, measured, pwrfgs, refuse, stderr, stdout, succeed, write};
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

#[test]
fn rejects_paths_that_are_not_utf8() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let odd = OsStr::from_bytes(b"caf\xe9");
    std::fs::rename(here.join("data"), here.join(odd)).unwrap();
    for verb in ["run", "init", "inspect", "report"] {
        let output = pwrfgs(here).arg(verb).arg(odd).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{verb}: {}", stderr(&output));
        assert_eq!(stderr(&output), "error: caf\u{fffd}: not UTF-8; rename the file or folder\n");
    }
    refuse(&here.join(odd), &["check", "p.ron"], 2, &["not UTF-8; rename the file or folder"]);
    write(
        &here.join("nul.ron"),
        std::fs::read_to_string(here.join("p.ron")).unwrap().replace("\"data\"", "\"da\\u{0}ta\""),
    );
    refuse(here, &["run", "nul.ron", "--out", "n"], 2, &["da"]);
}

#[test]
fn rejects_pipe_as_input_file_without_blocking() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    succeed(here, &["run", "p.ron", "--out", "r", "-q"]);
    let files = [
        "p.ron",
        "data/gateway_info.yml",
        "data/tx_pos.csv",
        "data/train_index.txt",
        "data/spectrum/00003.png",
        "r/model.safetensors",
        "r/pipeline.ron",
    ];
    for name in files {
        let (path, kept) = (here.join(name), here.join("kept"));
        std::fs::rename(&path, &kept).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let arguments: &[&str] = match name {
            "r/model.safetensors" => &["predict", name, "--tx", "0,0,1", "--out", "h"],
            "r/pipeline.ron" => &["run", "p.ron", "--out", "r"],
            _ => &["run", "p.ron", "--out", "other"],
        };
        let mut child = pwrfgs(here).args(arguments).stderr(Stdio::piped()).spawn().unwrap();
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if begun.elapsed() > Duration::from_secs(20) {
                child.kill().unwrap();
                panic!("{name}: waits for the pipe");
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{name}: {}", stderr(&output));
        assert!(stderr(&output).contains("this is a named pipe; give a regular file"), "{name}: {}", stderr(&output));
        std::fs::remove_file(&path).unwrap();
        std::fs::rename(&kept, &path).unwrap();
    }
    refuse(here, &["predict", "r/model.safetensors", "--tx-csv", "/dev/zero", "--out", "h"], 2, &["this is a device"]);
}

#[test]
fn rejects_output_paths_that_cannot_be_created() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    succeed(here, &["run", "p.ron", "--out", "r", "-q"]);
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/lab-s23.ron"), here.join("lab.ron"))
        .unwrap();
    write(&here.join("walk.csv"), "x,y,z\n1,0,1\n");
    let axes = "axes: [(name: \"steps\", variants: [(label: \"a\"), (label: \"b\", set: {\"training.stride\": 2})])]";
    write(&here.join("e.ron"), format!("Experiment(name: \"e\", base: \"p.ron\", {axes})"));
    std::os::unix::fs::symlink("nowhere", here.join("link")).unwrap();
    let model = "r/model.safetensors";
    let commands: &[&[&str]] = &[
        &["run", "p.ron", "--out"],
        &["sweep", "e.ron", "--out"],
        &["predict", model, "--tx", "0,0,1", "--out"],
        &["map", model, "--plane", "z=1", "--step", "1", "--bounds", "0,1,0,1", "--out"],
        &["locate", model, "--out"],
        &["plan", "data", "--count", "2", "--out"],
        &["evaluate", model, "--out"],
        &["report", "r", "--out"],
        &["simulate", "lab.ron", "--samples", "5", "--points", "50", "--out"],
        &[
            "import",
            "--spectra",
            "data/spectrum",
            "--tx",
            "data/tx_pos.csv",
            "--receiver",
            "0,0,0",
            "--orientation",
            "0,0,0,1",
            "--out",
        ],
        &["init", "data", "--out"],
        &["man", "--out"],
        &["export", model, "--ply"],
        &["export", model, "--npz"],
        &["export", model, "--half"],
    ];
    let long = "n".repeat(300);
    let below = format!("missing/{long}");
    for command in commands {
        for (out, word) in
            [("link", "link"), ("/dev/null/x", "/dev/null"), (&long, "nnn"), (&below, "nnn"), ("p.ron/x", "p.ron")]
        {
            refuse(here, &[command, &[out][..]].concat(), 2, &[word]);
        }
        if ["export", "view"].contains(&command[0]) {
            refuse(
                here,
                &[command, &["missing/file"][..]].concat(),
                2,
                &["the folder `missing` does not exist; create it"],
            );
        }
    }
    assert!(!here.join("missing").exists() && !here.join("nowhere").exists(), "nothing was written");
    // The longest name that a file system takes is fine.
    let longest = "n".repeat(251) + ".npz";
    succeed(here, &["export", model, "--npz", &longest]);
    assert!(here.join(longest).is_file());
}

#[test]
fn escapes_and_shortens_text_from_files() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let gateway = std::fs::read_to_string(here.join("data/gateway_info.yml")).unwrap();
    let name = "dataset_name: \"a\\e]0;owned\\x07\\e[31mb\"\n";
    write(&here.join("data/gateway_info.yml"), format!("{gateway}{name}"));
    let output = succeed(here, &["run", "p.ron", "--out", "r"]);
    let all = stdout(&output) + &stderr(&output);
    assert!(!all.contains(['\x1b', '\x07']), "{all:?}");
    assert!(!std::fs::read_to_string(here.join("r/report.html")).unwrap().contains(['\x1b', '\x07']));
    let table = std::fs::read_to_string(here.join("data/tx_pos.csv")).unwrap();
    write(&here.join("data/tx_pos.csv"), table.replace("0.3,", &format!("\x1b[2J{},", "9x".repeat(100_000))));
    let output = call(here, &["run", "p.ron", "--out", "other"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).len() < 600 && !stderr(&output).contains('\x1b'), "{:?}", stderr(&output));
    write(&here.join("q.ron"), format!("Pipeline(name: \"x\", {}: 1)", "long".repeat(1_000_000)));
    let output = call(here, &["run", "q.ron", "--out", "other"]);
    assert!(output.status.code() == Some(2) && output.stderr.len() < 5_000, "{} bytes", output.stderr.len());
}
