//! Runs of several models: folders, resumed runs, and equality with a sweep of folds.

use crate::common::{SMALL, pwrfgs, refuse, stderr, stdout, succeed, wait_for_step, write};
use pwrfgs::model::file;
use pwrfgs::pipeline::Pipeline;
use std::path::Path;
use std::process::Stdio;

const MODEL: &str = "model.safetensors";
const CHECKPOINT: &str = "checkpoint.safetensors";

fn members() -> String {
    SMALL.replace("name: \"small\",", "name: \"small\", members: 3, residuals: Kriged(), baselines: [Kriging()],")
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

#[test]
fn members_equal_a_joined_sweep_of_folds() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), members());
    assert!(stdout(&succeed(here, &["check", "p.ron"])).contains("3, one after another"));
    let table = stdout(&succeed(here, &["run", "p.ron", "--out", "r"]));
    for predictor in ["model", "member 1", "member 3", "Kriging", "90 % intervals of model"] {
        assert!(table.contains(predictor), "{predictor}: {table}");
    }
    let folds = members().replace("members: 3, ", "").replace("Kriged()", "Kriged(folds: true)");
    write(&here.join("folds.ron"), folds);
    write(&here.join("e.ron"), "Experiment(name: \"folds\", join: true, base: \"folds.ron\", seeds: [0, 1, 2])");
    succeed(here, &["sweep", "e.ron", "--out", "s", "-q"]);
    for index in 0..3 {
        let [own, swept] = [format!("r/members/{}", index + 1), format!("s/seed={index}")];
        let model = |run: &str| file::to_bytes(&file::read(&here.join(run).join(MODEL)).unwrap());
        assert!(model(&own) == model(&swept), "{own}");
        let validation = |run: &str| bytes(&here.join(run).join("validation.csv"));
        assert!(validation(&own) == validation(&swept), "{own}");
    }
    let [own, swept] = ["r", "s/joined"].map(|run| bytes(&here.join(run).join("samples.csv")));
    assert!(own == swept, "the ensembles predict the same");
    // Together, the members train on all known samples, so no known position is far from a training position.
    let samples = String::from_utf8(own).unwrap();
    let rows: Vec<Vec<&str>> = samples.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let position = |row: &Vec<&str>| [1, 2, 3].map(|k| row[k].parse::<f64>().unwrap());
    let known: Vec<_> = rows.iter().filter(|row| ["train", "validation"].contains(&row[4])).map(position).collect();
    let ensemble = file::read_ensemble(&here.join("r").join(MODEL)).unwrap();
    assert!(ensemble.training_distances(&known).unwrap().metres.iter().all(|metres| *metres < 0.2));
    for test in rows.iter().filter(|row| row[4] == "test") {
        let distance = |at: &[f64; 3]| (0..3).map(|k| (at[k] - position(test)[k]).powi(2)).sum::<f64>().sqrt();
        let nearest = known.iter().map(distance).fold(f64::INFINITY, f64::min);
        assert!((test[5].parse::<f64>().unwrap() - nearest).abs() < 1e-3, "{test:?}: {nearest}");
    }
    let page = std::fs::read_to_string(here.join("r/report.html")).unwrap();
    for text in ["Training loss, mean of 3 models", "members/3"] {
        assert!(page.contains(text), "{text}");
    }
    let checkpoints =
        || ["r/members/1", "r/members/3", "s/seed=0"].map(|run| here.join(run).join(CHECKPOINT).is_file());
    assert_eq!(checkpoints(), [false; 3]);
    succeed(here, &["run", "p.ron", "--out", "kept", "-q", "--keep-checkpoint"]);
    succeed(here, &["sweep", "e.ron", "--out", "swept", "-q", "--keep-checkpoint"]);
    for kept in ["kept/members/1", "kept/members/3", "swept/seed=0"] {
        assert!(here.join(kept).join(CHECKPOINT).is_file(), "{kept}");
    }
    succeed(here, &["compress", "r", "--out", "small.safetensors"]);
    let small = file::read_ensemble(&here.join("small.safetensors")).unwrap();
    assert_eq!((small.members().len(), small.residuals().is_some()), (3, true));
    write(&here.join("m.ron"), "Experiment(name: \"m\", join: true, base: \"p.ron\", seeds: [0, 1])");
    refuse(here, &["sweep", "m.ron", "--out", "no"], 2, &["join: `seed=0` has 3 members"]);
}

#[test]
fn more_than_four_members_share_four_parts() {
    let pipeline = Pipeline::parse(&members().replace("members: 3", "members: 6"), Path::new("p.ron")).unwrap();
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let left_out = |index: usize| pipeline.member(index).partition(&data).unwrap().validation;
    assert_eq!((left_out(4), left_out(5)), (left_out(0), left_out(1)));
    let mut all: Vec<usize> = (0..4).flat_map(left_out).collect();
    all.sort_unstable();
    assert_eq!(all, pipeline.partition(&data).unwrap().known().all());
    assert_ne!(pipeline.member(0).seed, pipeline.member(4).seed);
}

#[test]
fn killed_run_of_members_resumes_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), members());
    succeed(here, &["run", "p.ron", "--out", "whole", "-q"]);
    let mut child = pwrfgs(here).args(["run", "p.ron", "--out", "r", "-q"]).stdout(Stdio::null()).spawn().unwrap();
    while !here.join("r/members/2").is_dir() {
        assert!(child.try_wait().unwrap().is_none(), "the run has ended before its second model");
    }
    wait_for_step(&mut child, &here.join("r/members/2"), 20);
    child.kill().unwrap();
    child.wait().unwrap();
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--threads", "1"]);
    for name in [MODEL, "samples.csv", "members/1/model.safetensors", "members/2/validation.csv"] {
        assert!(bytes(&here.join("r").join(name)) == bytes(&here.join("whole").join(name)), "{name}");
    }
    assert!(stderr(&succeed(here, &["run", "p.ron", "--out", "r"])).contains("nothing to do"));
}

#[test]
fn members_need_enough_known_samples() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let few = SMALL.replace("samples: 40", "samples: 4").replace("Official(validation: 0.2)", "Random(test: 0.3)");
    write(&here.join("p.ron"), few);
    let run = |set: &'static str| ["run", "p.ron", "--out", "r", "-q", "--set", set];
    refuse(here, &run("members=0"), 2, &["members: 0 models; give 1 to 100"]);
    refuse(here, &run("members=99"), 2, &["parts, fewer than 4 folds"]);
    assert!(!here.join("r").exists(), "refused before files are written");
}

/// The kept model is the one that scored best on the validation set after pruning, also after a kill.
#[test]
fn best_validated_model_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let best = SMALL.replace("validate_every: 20,", "validate_every: 5, keep: Best,").replace("steps: 60", "steps: 80");
    write(&here.join("p.ron"), &best);
    write(&here.join("last.ron"), best.replace("keep: Best,", ""));
    succeed(here, &["run", "p.ron", "--out", "whole", "-q"]);
    succeed(here, &["run", "last.ron", "--out", "last", "-q"]);
    assert!(!here.join("whole/best.safetensors").exists());
    let rows = std::fs::read_to_string(here.join("whole/validation.csv")).unwrap();
    assert_eq!(rows, std::fs::read_to_string(here.join("last/validation.csv")).unwrap());
    let row = |line: &str| line.split(',').map(|field| field.parse::<f64>().unwrap()).take(2).collect::<Vec<_>>();
    let rows: Vec<Vec<f64>> = rows.lines().skip(1).map(row).filter(|row| row[0] > 40.0).collect();
    let best = rows.iter().max_by(|a, b| a[1].total_cmp(&b[1])).unwrap();
    let kept = bytes(&here.join("whole").join(MODEL));
    let is_last = kept == bytes(&here.join("last").join(MODEL));
    assert_eq!(is_last, best[0] == 80.0, "{best:?}");
    std::fs::remove_file(here.join("whole").join(MODEL)).unwrap();
    succeed(here, &["run", "p.ron", "--out", "whole", "-q"]);
    assert!(kept == bytes(&here.join("whole").join(MODEL)), "trained again without a checkpoint");

    let mut child = pwrfgs(here).args(["run", "p.ron", "--out", "r", "-q"]).stdout(Stdio::null()).spawn().unwrap();
    wait_for_step(&mut child, &here.join("r"), 55);
    child.kill().unwrap();
    child.wait().unwrap();
    succeed(here, &["run", "p.ron", "--out", "r", "-q"]);
    assert!(kept == bytes(&here.join("r").join(MODEL)), "another model after a kill");
    let run = |set: &'static str| ["run", "p.ron", "--out", "no", "-q", "--set", set];
    refuse(here, &run("training.validate_every=0"), 2, &["`keep: Best` chooses by validation"]);
    refuse(here, &run("split=Official(validation: 0.0)"), 2, &["training.keep: `Best` needs a validation set"]);
}
