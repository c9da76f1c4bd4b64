//! Corrupt or exchanged files and files of other programs: every reader names the file and refuses it.
use crate::common::{SMALL, copy_small_run, pwrfgs, refuse, stderr, succeed, wait_for_step, write};
use pwrfgs::model::tensors::Tensors;
use pwrfgs_core::testing::skipped;
use std::path::Path;
use std::process::Stdio;

#[test]
fn reports_damaged_file_and_recreates_it_after_removal() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "r");
    for (name, length) in [("scores.csv", 200), ("model.safetensors", 0), ("curve.csv", 0), ("report.html", 5_000)] {
        let path = here.join("r").join(name);
        let whole = std::fs::read(&path).unwrap();
        write(&path, &whole[..length]);
        let (file, problem) = (format!("r/{name}"), format!("it has {length} bytes, expected"));
        let words = [file.as_str(), problem.as_str(), "copy it again"];
        refuse(here, &["run", "r"], 2, &words);
        if name == "report.html" {
            // The page comes from the other files, and is made again from them.
            succeed(here, &["report", "r", "-q"]);
            assert!(std::fs::read(&path).unwrap() == whole, "another page than the run made");
            succeed(here, &["run", "r", "-q"]);
        } else {
            refuse(here, &["report", "r"], 2, &words);
        }
        let mut changed = whole.clone();
        changed[whole.len() / 2] ^= 1;
        write(&path, &changed);
        refuse(here, &["run", "r"], 2, &[&format!("r/{name}"), "its content differs"]);
        write(&path, &whole);
        succeed(here, &["run", "r", "-q"]);
    }
    write(&here.join("r/run.json"), "{\"version\": ");
    refuse(here, &["run", "r"], 2, &["r/run.json", "is damaged", "remove it"]);
    std::fs::remove_file(here.join("r/run.json")).unwrap();
    std::fs::remove_file(here.join("r/scores.csv")).unwrap();
    succeed(here, &["run", "r", "-q"]);
    assert!(here.join("r/scores.csv").is_file() && stderr(&succeed(here, &["run", "r"])).contains("nothing to do"));
}

#[test]
fn run_command_resumes_and_repeats_run_folder() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--scale", "0.1", "--out", "r", "-q"]);
    let text = std::fs::read_to_string(here.join("r/pipeline.ron")).unwrap();
    assert!(text.contains("steps: 6,") && text.contains("prune_until: 4,") && text.contains("scale: 1.0"), "{text}");
    // What changes nothing of the result is no other run.
    let same = ["run", "r", "--set", "tensorboard=true", "--set", "training.checkpoint_every=3", "--threads", "1"];
    assert!(stderr(&succeed(here, &same)).contains("nothing to do"));
    refuse(here, &["run", "r", "--set", "seed=1"], 2, &["r holds a run of another pipeline", "--out"]);
    succeed(here, &["run", "r", "--out", "again", "-q"]);
    let model = |run: &str| std::fs::read(here.join(run).join("model.safetensors")).unwrap();
    assert!(model("r") == model("again"));
    refuse(here, &["run", "."], 2, &["not a run folder: no pipeline.ron"]);
    let plan = String::from_utf8(succeed(here, &["check", "p.ron", "--scale", "0.5"]).stdout).unwrap();
    for words in ["30 of 2 transmitters", "prune from step 11 to 20", "LearnableMask, OpacityThreshold", "8 initially"]
    {
        assert!(plan.contains(words), "{words}: {plan}");
    }
}

#[test]
fn rejects_checkpoint_of_other_run_or_with_flipped_bit() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    let run = |out: &'static str, seed: &'static str| {
        ["run", "p.ron", "--out", out, "-q", "--keep-checkpoint", "--set", seed]
    };
    copy_small_run(here, "a");
    succeed(here, &run("b", "seed=1"));
    let checkpoint = here.join("a/checkpoint.safetensors");
    let whole = std::fs::read(&checkpoint).unwrap();
    std::fs::remove_file(here.join("a/model.safetensors")).unwrap();
    std::fs::copy(here.join("b/checkpoint.safetensors"), &checkpoint).unwrap();
    refuse(here, &run("a", "seed=0"), 2, &["a/checkpoint.safetensors", "other settings", "remove it"]);
    for at in (0..13).map(|k| k * (whole.len() - 1) / 12) {
        let mut flipped = whole.clone();
        flipped[at] ^= 4;
        write(&checkpoint, &flipped);
        refuse(here, &run("a", "seed=0"), 2, &["a/checkpoint.safetensors", "remove it"]);
    }
    write(&checkpoint, &whole);
    succeed(here, &run("a", "seed=0"));
}

#[test]
fn checks_settings_read_from_model_file() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--scale", "0.05", "--out", "r", "-q"]);
    let whole = std::fs::read(here.join("r/model.safetensors")).unwrap();
    let message = |from: &str, to: &str, words: &[&str]| {
        let mut file = Tensors::from_bytes(&whole).unwrap();
        assert!(file.note.contains(from), "{}", file.note);
        file.note = file.note.replacen(from, to, 1);
        write(&here.join("m.safetensors"), file.to_bytes());
        let all = [&["m.safetensors"], words].concat();
        refuse(here, &["predict", "m.safetensors", "--tx", "0,0,1", "--out", "o"], 2, &all);
    };
    message("\"orientation\":[0.0,0.0,0.0,1.0]", "\"orientation\":[0.0,0.0,0.0,0.0]", &["quaternion", "is zero"]);
    message("\"width\":48", "\"width\":0", &["0 x 12 pixels"]);
    message("\"width\":48,\"height\":12", "\"width\":100000,\"height\":100000", &["100000 x 100000 pixels"]);
    message("\"first\":0.0", "\"first\":7.5", &["plane: the projector does not support its angles"]);
    message(
        "\"gaussians\":8",
        "\"gaussians\":9223372036854775808",
        &["gaussians.means", "expected [9223372036854775808, 3]"],
    );
    message("width: 16", "width: 0", &["width is 0"]);
    let note = Tensors::from_bytes(&whole).unwrap().note;
    let receiver = note.split_once("\"receivers\":[").unwrap().1.split_once("]},\"plane\"").unwrap().0;
    message(receiver, &format!("{receiver},{receiver}"), &["two receivers have the name"]);
    let drawn = |rasterizer: &str, readout: &str| {
        format!("rasterizer: {rasterizer}, calibration: Physical, readout: {readout}")
    };
    let waves = drawn("ArrayResponse()", "Real");
    message(&drawn("AlphaBlending(support: Exact)", "Magnitude"), &waves, &["Real takes one channel"]);
    assert!(!here.join("o").exists());
    // Numbers that are finite, and a picture that is not.
    let mut file = Tensors::from_bytes(&whole).unwrap();
    let signals = file.take("gaussians.signals", &[8, 2]).unwrap();
    file.put("gaussians.signals", vec![8, 2], vec![3e38 as pwrfgs::core::Real; signals.len()]);
    write(&here.join("m.safetensors"), file.to_bytes());
    if size_of::<pwrfgs::core::Real>() == 4 {
        refuse(here, &["predict", "m.safetensors", "--tx", "0,0,1", "--out", "o"], 2, &["row 1", "is not finite"]);
    }
}

#[test]
fn fails_if_result_cannot_be_written() {
    let to = |path: &str| {
        let full = std::fs::OpenOptions::new().write(true).open(path).unwrap();
        pwrfgs(Path::new(".")).arg("plugins").stdout(full).stderr(Stdio::piped()).output().unwrap()
    };
    let output = to("/dev/full");
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stderr(&output).contains("error: cannot write the result"), "{}", stderr(&output));
    assert!(to("/dev/null").status.success());
}

#[test]
fn run_under_nohup_outlives_its_terminal() {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    if ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1) {
        skipped("the tests themselves run under nohup, so that no run can be told to stop by SIGHUP");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL.replace("steps: 60", "steps: 1_500"));
    let program = env!("CARGO_BIN_EXE_pwrfgs");
    let ends = |script: &str, out: &str| {
        let line = format!("{script} exec {program} run p.ron --out {out} -q");
        let mut command = std::process::Command::new("sh");
        let mut child = command.args(["-c", &line]).current_dir(here).stdout(Stdio::null()).spawn().unwrap();
        wait_for_step(&mut child, &here.join(out), 20);
        assert!(std::process::Command::new("kill").args(["-HUP", &child.id().to_string()]).status().unwrap().success());
        child.wait().unwrap().code()
    };
    assert_eq!(ends("trap '' HUP;", "outlives"), Some(0));
    assert_eq!(ends("", "stops"), Some(130));
}
