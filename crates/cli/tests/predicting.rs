//! Predictions at many positions: equal to single ones, and continued after a kill.

use crate::common::{copy_small_run, files, npy, pwrfgs, refuse, signal, stderr, succeed, write};
use crate::links::hall;
use pwrfgs::model::file;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

const MODEL: &str = "run/model.safetensors";

/// Writes `count` positions of a walk to `tx.csv`, and returns them.
fn walk(here: &Path, count: usize) -> Vec<[f64; 3]> {
    let position = |k: usize| [(k * 7 % 611) as f64 / 611.0, (k * 11 % 613) as f64 / 613.0, 0.9];
    let walk: Vec<[f64; 3]> = (0..count).map(position).collect();
    let mut text = "x,y,z\n".to_owned();
    walk.iter().for_each(|[x, y, z]| _ = writeln!(text, "{x},{y},{z}"));
    write(&here.join("tx.csv"), text);
    walk
}

/// Files of an output folder by name.
fn content(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let name = |path: &Path| path.strip_prefix(out).unwrap().to_str().unwrap().to_owned();
    files(out).into_iter().map(|(path, bytes)| (name(&path), bytes)).collect()
}

/// Starts a prediction into `killed`, and waits until a part of it is complete.
fn start(here: &Path, arguments: &[&str]) -> Child {
    let mut command = pwrfgs(here);
    command.args(arguments).args(["--out", "killed", "--threads", "1"]).stdout(Stdio::null()).stderr(Stdio::piped());
    let length = || here.join("killed.partial/predictions.csv").metadata().map_or(0, |metadata| metadata.len());
    let (before, mut child) = (length(), command.spawn().unwrap());
    while length() < before.max(1_000) + 1_000 {
        assert!(child.try_wait().unwrap().is_none(), "{arguments:?} has ended");
        std::thread::sleep(Duration::from_millis(1));
    }
    child
}

/// Kills the prediction twice, continues it, and compares it with one that was never stopped.
fn survives_kill(here: &Path, arguments: &[&str]) {
    succeed(here, &[arguments, &["--out", "whole"]].concat());
    for _ in 0..2 {
        let mut child = start(here, arguments);
        child.kill().unwrap(); // SIGKILL
        assert!(!child.wait().unwrap().success() && !here.join("killed").exists(), "{arguments:?}");
    }
    let again = succeed(here, &[arguments, &["--out", "killed"]].concat());
    assert!(stderr(&again).contains("resuming after row "), "{}", stderr(&again));
    assert!(stderr(&again).contains(" ms, median of 64 single predictions"), "{}", stderr(&again));
    let [whole, killed] = ["whole", "killed"].map(|out| content(&here.join(out)));
    assert!(whole == killed, "{arguments:?}: {:?} and {:?}", whole.keys().last(), killed.keys().last());
    assert!(!here.join("killed.partial").exists());
    ["whole", "killed"].iter().for_each(|out| std::fs::remove_dir_all(here.join(out)).unwrap());
}

#[test]
fn killed_predictions_of_spectra_resume_to_identical_result() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "run");
    walk(here, 9_000);
    succeed(here, &["export", MODEL, "--half", "half.safetensors"]);
    let predict = ["predict", MODEL, "--tx-csv", "tx.csv"];
    for more in [&[][..], &["--no-png"], &["--stacked", "--no-png"], &["half.safetensors", "--stacked"]] {
        survives_kill(here, &[&predict[..], more].concat());
    }
}

#[test]
fn killed_predictions_of_powers_resume_to_identical_result() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    walk(here, 20_000);
    let predict = ["predict", MODEL, "--tx-csv", "tx.csv"];
    survives_kill(here, &predict);

    // Another request does not touch the partial folder.
    walk(here, 60_000);
    let mut child = start(here, &predict);
    signal(&child, "-STOP");
    refuse(here, &[&predict[..], &["--out", "killed"]].concat(), 2, &["killed.partial is in use by another"]);
    ["-INT", "-CONT"].iter().for_each(|name| signal(&child, name));
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    assert!(stderr(&output).contains("are in killed.partial; repeat the command to resume"), "{}", stderr(&output));
    let before = content(&here.join("killed.partial"));
    write(&here.join("other.csv"), "x,y,z\n1,2,1\n");
    let other = ["predict", MODEL, "--tx-csv", "other.csv", "--out", "killed"];
    let words = ["killed.partial holds unfinished output of other positions; repeat the command", "remove this folder"];
    refuse(here, &other, 2, &words);
    succeed(here, &["export", MODEL, "--half", "half.safetensors"]);
    let other = [&predict[..], &["half.safetensors", "--receiver", "south", "--out", "killed"]].concat();
    refuse(here, &other, 2, &["holds unfinished output of other models and options; repeat the command"]);
    assert!(before == content(&here.join("killed.partial")) && !here.join("killed").exists());
    child = pwrfgs(here).args(predict).args(["--out", "killed", "-q"]).spawn().unwrap();
    assert!(child.wait().unwrap().success() && !here.join("killed.partial").exists());
}

#[test]
#[cfg(feature = "raytrace")]
fn killed_predictions_of_channels_resume_to_identical_result() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    crate::links::office(here);
    walk(here, 5_000);
    let predict = ["predict", MODEL, "--tx-csv", "tx.csv"];
    survives_kill(here, &predict);
    survives_kill(here, &[&predict[..], &["--stacked"]].concat());
}

#[test]
fn predictions_in_batches_equal_single_predictions() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "run");
    let walk = walk(here, 150);
    succeed(here, &["predict", MODEL, "--tx-csv", "tx.csv", "--stacked", "--no-png", "--out", "one"]);
    let model = file::read(&here.join(MODEL)).unwrap();
    let single = |tx: &[f64; 3]| model.predict(*tx).pixels.into_iter().map(|p| p as f32).collect::<Vec<f32>>();
    assert!(npy(&here.join("one/spectra.npy")).1 == walk.iter().flat_map(single).collect::<Vec<f32>>());
    succeed(here, &["export", MODEL, "--half", "half.safetensors"]);
    let pair = ["predict", MODEL, "half.safetensors", "--tx-csv", "tx.csv", "--stacked", "--no-png", "--out", "two"];
    succeed(here, &pair);
    let paths = [MODEL, "half.safetensors"].map(|name| here.join(name));
    let ensemble = pwrfgs::tasks::read_models(&paths).unwrap();
    let ready = ensemble.prepare();
    let both: Vec<_> = walk.iter().map(|tx| ready.predict_with_deviation(*tx)).collect();
    let numbers = |image: &pwrfgs_core::Image| image.pixels.iter().map(|p| *p as f32).collect::<Vec<f32>>();
    assert!(npy(&here.join("two/spectra.npy")).1 == both.iter().flat_map(|b| numbers(&b.0)).collect::<Vec<f32>>());
    assert!(npy(&here.join("two/spread.npy")).1 == both.iter().flat_map(|b| numbers(&b.1)).collect::<Vec<f32>>());
}
