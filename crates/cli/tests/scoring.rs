//! Baselines and metrics: checked before the first step, and changed without a new training.
use crate::common::{
    SMALL, copy_small_run, files, measured, pwrfgs, refuse, signal, stderr, stdout, succeed, wait_for_step, write,
};
use std::path::Path;
use std::process::Stdio;
use std::time::SystemTime;

const JOINED: &str = "Experiment(name: \"both\", join: true, base: \"p.ron\", seeds: [0, 1])";
const EXPERIMENT: &str = "Experiment(
    name: \"tiny\", base: \"p.ron\", seeds: [0],
    axes: [Axis(name: \"batch\", variants: [(label: \"1\", set: {\"training.batch\": 1}), (label: \"2\")])],
)";

/// `SMALL`, alone, with two seeds joined, and as an experiment.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("p.ron"), SMALL);
    write(&folder.path().join("both.ron"), JOINED);
    write(&folder.path().join("e.ron"), EXPERIMENT);
    folder
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap()
}

/// When training last wrote into a run folder.
fn trained(run: &Path) -> [SystemTime; 2] {
    let written = |name: &str| run.join(name).metadata().unwrap().modified().unwrap();
    ["model.safetensors", "curve.csv"].map(written)
}

#[test]
fn rejects_unsuitable_baselines_before_first_step() {
    let folder = folder();
    let here = folder.path();
    measured(here);
    let unsuitable: [(&str, &[&str]); 3] = [
        ("RayTracing()", &["baselines: RayTracing", "not simulated from a scene"]),
        ("Ridge()", &["baselines: `Ridge` needs link features", "use Kriging()"]),
        ("RayTracing(scene: \"missing.ron\")", &["baselines: cannot read", "missing.ron"]),
    ];
    for (baseline, words) in unsuitable {
        let set = format!("baselines=[{baseline}]");
        for command in ["check", "run"] {
            refuse(here, &[command, "p.ron", "--set", &set], 2, words);
        }
        for file in ["both.ron", "e.ron"] {
            refuse(here, &["sweep", file, "--set", &set], 2, words);
            refuse(here, &["sweep", file, "--dry-run", "--set", &set], 2, words);
        }
        assert!(!here.join("runs").exists(), "nothing is written for {baseline}");
    }
}

#[test]
fn evaluate_reports_same_training_set_only_for_data_of_run() {
    let folder = folder();
    let here = folder.path();
    for other in ["", "other"] {
        measured(&here.join(other));
    }
    let same = "2 test spectra; model and baselines are trained on the same 4";
    let each = "the model is trained on 4; the baselines are trained on 4 (training and validation)";
    let set = ["--set", "baselines=[MeanSpectrum()]"];
    assert!(stdout(&succeed(here, &[&["run", "p.ron", "--out", "r", "-q"][..], &set].concat())).contains(same));
    let head = |more: &[&str]| {
        let all = [&["evaluate", "r/model.safetensors", "-q"][..], more].concat();
        stdout(&succeed(here, &all)).lines().find(|line| line.contains("test spectra")).unwrap().to_owned()
    };
    assert_eq!(head(&[]), same);
    assert_eq!(head(&["--set", "metrics=[L1()]"]), same);
    assert!(head(&["--set", "data.root=other/data"]).contains(each));
    assert!(head(&["--set", "split=Random(test: 0.4, validation: 0.0)"]).contains(each));
    assert!(head(&["--pipeline", "other/p.ron", set[0], set[1]]).contains(each));
}

#[test]
fn finished_run_is_rescored_without_training() {
    let folder = folder();
    let here = folder.path();
    let run = here.join("r");
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--set", "baselines=[MeanSpectrum()]"]);
    let before = trained(&run);
    let other =
        ["run", "p.ron", "--out", "r", "--set", "baselines=[NearestNeighbours(k: 2)]", "--set", "metrics=[L1()]"];
    let table = stdout(&succeed(here, &other));
    assert!(table.contains("2-NN") && table.contains("l1"), "{table}");
    assert!(!table.contains("mean spectrum") && !table.contains("ssim"), "{table}");
    let pipeline = text(&run.join("pipeline.ron"));
    assert!(pipeline.contains("NearestNeighbours") && !pipeline.contains("MeanSpectrum"), "{pipeline}");
    let scores = text(&run.join("scores.csv"));
    assert!(scores.contains("2-NN,l1,") && !scores.contains("ssim"), "{scores}");
    assert!(stderr(&succeed(here, &other)).contains("nothing to do"), "it is finished again");
    succeed(here, &["report", "r", "-q"]); // every file is the one that run.json names

    // Another model is another run, whatever it is scored by.
    let words = ["another pipeline: its pipeline.ron has `batch: ", "`, this one has `batch: 1`; choose another"];
    refuse(here, &["run", "p.ron", "--out", "r", "--set", "training.batch=1"], 2, &words);
    refuse(here, &["run", "r", "--set", "metrics=[Ssim()]", "--set", "seed=1"], 2, &["another pipeline", "seed"]);
    assert_eq!(text(&run.join("pipeline.ron")), pipeline);
    succeed(here, &["run", "r", "-q", "--set", "metrics=[Ssim()]"]);
    assert!(text(&run.join("scores.csv")).contains("2-NN,ssim,"), "a folder is scored anew by its name too");
    assert_eq!(trained(&run), before);
}

#[test]
fn stopped_run_resumes_with_other_metrics() {
    let folder = folder();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL.replace("steps: 60", "steps: 400"));
    succeed(here, &["run", "p.ron", "--out", "whole", "-q"]);
    let mut child = pwrfgs(here).args(["run", "p.ron", "--out", "killed", "-q"]).stdout(Stdio::null()).spawn().unwrap();
    wait_for_step(&mut child, &here.join("killed"), 150);
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success());
    let message = succeed(here, &["run", "p.ron", "--out", "killed", "--set", "metrics=[L1()]"]);
    assert!(stderr(&message).contains("resuming after step"), "{}", stderr(&message));
    let model = |run: &str| std::fs::read(here.join(run).join("model.safetensors")).unwrap();
    assert!(model("whole") == model("killed"));
    assert!(!text(&here.join("killed/pipeline.ron")).contains("Ssim"));
    assert!(!text(&here.join("killed/scores.csv")).contains("ssim"));
}

#[test]
fn sweeps_and_joined_models_are_rescored() {
    let folder = folder();
    let here = folder.path();
    succeed(here, &["sweep", "both.ron", "-q"]);
    let before = trained(&here.join("runs/both/seed=0"));
    let set = ["-q", "--set", "baselines=[NearestNeighbours(k: 2)]", "--set", "metrics=[L1()]"];
    succeed(here, &[&["sweep", "both.ron"][..], &set].concat());
    for scored in ["joined", "seed=0"] {
        let scores = text(&here.join("runs/both").join(scored).join("scores.csv"));
        assert!(scores.contains("model,l1,") && !scores.contains("ssim"), "{scores}");
        assert_eq!(
            scores.contains("2-NN,l1,"),
            scored == "joined",
            "baselines stand beside the joined model: {scores}"
        );
    }
    assert_eq!(trained(&here.join("runs/both/seed=0")), before, "nothing was trained again");
    let status = stdout(&succeed(here, &["sweep", "both.ron", "--status"]));
    assert!(status.contains("0 of 2 runs finished"), "with the metrics of the file they are not scored: {status}");
}

#[test]
fn run_killed_during_rescoring_is_not_finished() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "r");
    let ended = |json: &str| json.contains("\"finished\": \"");
    assert!(ended(&text(&here.join("r/run.json"))));
    std::fs::remove_file(here.join("r/model.safetensors")).unwrap(); // the checkpoint makes it again
    let slow = ["run", "p.ron", "--out", "r", "-q", "--set", "metrics=[Latency(repeats: 10_000, warm_up: 10_000)]"];
    let mut child = pwrfgs(here).args(slow).stdout(Stdio::null()).spawn().unwrap();
    while !here.join("r/model.safetensors").is_file() {
        assert!(child.try_wait().unwrap().is_none(), "the run has ended");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!ended(&text(&here.join("r/run.json"))), "its table is that of other metrics");
}

#[test]
fn rescoring_locks_folder_and_survives_kill() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "r");
    let before = trained(&here.join("r"));
    // Each baseline is timed for two seconds.
    let slow = ["run", "p.ron", "--out", "r", "-q", "--set", "metrics=[Latency(repeats: 10_000, warm_up: 10_000)]"];
    let mut child = pwrfgs(here).args(slow).stdout(Stdio::null()).spawn().unwrap();
    while !text(&here.join("r/pipeline.ron")).contains("warm_up: 10000") {
        assert!(child.try_wait().unwrap().is_none(), "the run has ended");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    signal(&child, "-STOP");
    refuse(here, &["run", "p.ron", "--out", "r"], 2, &["r is in use by another pwrfgs process"]);
    refuse(here, &["run", "r", "--set", "metrics=[L1()]"], 2, &["r is in use by another pwrfgs process"]);
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success());
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--set", "metrics=[L1()]"]);
    assert!(text(&here.join("r/scores.csv")).contains("model,l1,"));
    assert_eq!(trained(&here.join("r")), before);
}

/// Kills a scoring after some predictors, several times: measured latencies of earlier starts stay, the rest is equal.
#[test]
fn killed_scoring_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    let set = [
        "baselines=[MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: 3), Kriging()]",
        "metrics=[Ssim(), Latency(repeats: 3_000, warm_up: 3_000)]",
    ];
    let run = |out| ["run", "p.ron", "--out", out, "-q", "--set", set[0], "--set", set[1]];
    succeed(here, &run("whole"));
    let partial = here.join("r/scoring.partial");
    let (mut held, mut damaged) = (String::new(), String::from("none"));
    for count in [1, 3, 5] {
        let mut child = pwrfgs(here).args(run("r")).stdout(Stdio::null()).spawn().unwrap();
        // The damaged line of the last round counts until the program cuts it off.
        let is_cut = |text: &String| text.strip_prefix(&held).is_some_and(|rest| !rest.starts_with(&damaged));
        let lines =
            || std::fs::read_to_string(&partial).ok().filter(is_cut).map_or(0, |text| text.matches('\n').count());
        while lines() < count {
            assert!(child.try_wait().unwrap().is_none(), "the run ended before line {count}");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        let now = text(&partial);
        assert!(now.starts_with(&held), "a predictor was scored again");
        held = now[..=now.rfind('\n').unwrap()].to_owned();
        // An incomplete line, and one that was changed: both are scored again.
        let changed = held.lines().last().unwrap().replacen("ssim", "ssin", 1);
        damaged = if count == 3 { held[..9].to_owned() } else { changed };
        write(&partial, format!("{held}{damaged}\n"));
    }
    succeed(here, &run("r"));
    let rows = |run: &str, is_timed: bool| {
        let scores = text(&here.join(run).join("scores.csv"));
        scores.lines().filter(|row| row.contains("latency") == is_timed).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(rows("r", false), rows("whole", false));
    let timed = rows("r", true);
    let total = timed.iter().find_map(|row| row.strip_prefix("model,latency_total_ms,,")).unwrap();
    assert!(held.lines().next().unwrap().contains(total), "{total}: the latency of the first start");
    for name in ["model.safetensors", "samples.csv"] {
        assert!(
            std::fs::read(here.join("r").join(name)).unwrap() == std::fs::read(here.join("whole").join(name)).unwrap()
        );
    }
    assert!(!partial.exists());
    // Results of other metrics do not count.
    write(&partial, &held);
    succeed(here, &["run", "r", "-q", "--set", "metrics=[Ssim(), L1()]"]);
    assert!(!partial.exists() && text(&here.join("r/scores.csv")).contains("model,l1,"));
}

/// Kills `evaluate` after its first predictors; the same command goes on to the same files.
#[test]
fn killed_evaluation_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "r");
    // Several predictors after the third, so that the signal comes before the end on a busy machine too.
    let further = [3, 2, 4, 5, 6].map(|k| format!("NearestNeighbours(k: {k})")).join(", ");
    let set = &format!("baselines=[MeanSpectrum(), NearestNeighbours(k: 1), {further}, Kriging()]");
    let slow = "metrics=[Ssim(), Latency(repeats: 3_000, warm_up: 3_000)]";
    let evaluate = |out| ["evaluate", "r", "--out", out, "--set", set, "--set", slow];
    succeed(here, &evaluate("whole"));
    let partial = here.join("killed.partial/scoring.partial");
    let lines = || std::fs::read_to_string(&partial).map_or(0, |text| text.matches('\n').count());
    for count in [1, 3] {
        let mut child =
            pwrfgs(here).args(evaluate("killed")).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        while lines() < count {
            assert!(child.try_wait().unwrap().is_none(), "the evaluation ended before line {count}");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        signal(&child, if count == 1 { "-KILL" } else { "-INT" });
        let output = child.wait_with_output().unwrap();
        if count == 3 {
            assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
            assert!(stderr(&output).contains("repeat the command to resume"), "{}", stderr(&output));
        }
    }
    let other = ["evaluate", "r", "--out", "killed", "--set", "metrics=[L1()]"];
    refuse(here, &other, 2, &["killed.partial holds unfinished output of other settings; repeat the command"]);
    assert!(stderr(&succeed(here, &evaluate("killed"))).contains("resuming the scoring in "));
    assert!(!here.join("killed.partial").exists());
    let names =
        |out: &str| files(&here.join(out)).into_keys().map(|path| path.file_name().unwrap().to_owned()).collect();
    let [whole, killed]: [Vec<_>; 2] = ["whole", "killed"].map(names);
    assert_eq!(whole, killed);
    let equal = |out: &str| {
        let scores = text(&here.join(out).join("scores.csv"));
        scores.lines().filter(|row| !row.contains("latency")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(equal("whole"), equal("killed"));
    assert_eq!(text(&here.join("whole/samples.csv")), text(&here.join("killed/samples.csv")));

    // Wrong input leaves no folder.
    refuse(
        here,
        &["evaluate", "r", "--out", "none", "--set", "data=Simulated(scene: \"nowhere.ron\", samples: 10)"],
        2,
        &[],
    );
    assert!(!here.join("none").exists() && !here.join("none.partial").exists());
}
