//! Each command with valid input, and that it overwrites no file of the user.
use crate::common::{SMALL, call, copy_small_run, measured, refuse, stderr, stdout, succeed, write};
use pwrfgs::model::{Model, file};
use pwrfgs_core::testing::npy;
use std::path::Path;

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap()
}

/// The commit in `run.json` and in `--version` is that of the checkout that these tests were built from.
fn names_its_commit(here: &Path, facts: &serde_json::Value) {
    let git = |arguments: &[&str]| {
        let output = std::process::Command::new("git").current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments).output();
        output.ok().filter(|o| o.status.success()).map(|o| String::from_utf8(o.stdout).unwrap().trim().to_owned())
    };
    let version = stdout(&succeed(here, &["--version"]));
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap();
    let is_own =
        git(&["rev-parse", "--show-toplevel"]).is_some_and(|top| Path::new(&top).canonicalize().unwrap() == root);
    match git(&["rev-parse", "HEAD"]).filter(|_| is_own) {
        Some(commit) => {
            assert_eq!(facts["commit"], commit);
            assert_eq!(version, format!("pwrfgs {} ({commit:.10})\n", env!("CARGO_PKG_VERSION")));
        }
        None => assert!(facts["commit"].is_null(), "{facts}"),
    }
}

/// The `table` of a run has the main metrics of its task; `--all` adds the others, which a note names.
fn main_metrics_are_printed_and_all_on_request(here: &Path, table: &str) {
    let metrics = |table: &str| -> Vec<String> {
        let rows = table.lines().filter(|line| line.contains(" ↑  ") || line.contains(" ↓  "));
        rows.filter(|line| !line.starts_with("model minus"))
            .map(|line| line.split(' ').next().unwrap().into())
            .collect()
    };
    assert_eq!(metrics(table), ["ssim", "eta_0db", "gaussians", "latency_total_ms"], "{table}");
    assert_eq!(table.matches("10th percentile").count(), 1, "{table}");
    assert!(table.contains("note: --all also prints l1, psnr, direction_error, chamfer, "), "{table}");
    for command in [&["run", "runs/small"][..], &["evaluate", "runs/small"]] {
        let all = stdout(&succeed(here, &[command, &["--all", "-q"]].concat()));
        assert_eq!(metrics(&all)[..4], ["ssim", "l1", "psnr", "eta_0db"], "{all}");
        assert!(metrics(&all).len() > 10 && all.matches("10th percentile").count() > 1, "{all}");
        assert!(all.starts_with("The model is ") && !all.contains("--all"), "{all}");
    }
}

#[test]
fn run_folder_predicts_and_evaluates() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("pipelines/small.ron"), SMALL);
    let output = succeed(here, &["run", "pipelines/small.ron", "--threads", "1"]);
    let table = stdout(&output);
    assert!(
        table.contains("ssim") && table.contains("mean spectrum") && table.contains("report: runs/small"),
        "{table}"
    );
    let (first, last) = (table.lines().next().unwrap(), table.lines().last().unwrap());
    let row = |line: &&str| line.starts_with("model minus");
    let differences: Vec<&str> =
        table.lines().skip_while(|line| !row(line)).skip(1).take_while(|l| !l.is_empty()).collect();
    assert_eq!(last, "next: `pwrfgs report runs/small`, `pwrfgs view runs/small`");
    let (verdict, baseline) = ["level with ", "ahead of ", "behind "]
        .iter()
        .find_map(|words| Some((*words, first.strip_prefix("The model is ")?.strip_prefix(words)?.split(": ").next()?)))
        .unwrap();
    let numbers = first.split(": ").nth(1).unwrap().split(" (").next().unwrap();
    let line = differences.iter().find(|line| line.starts_with(baseline)).unwrap();
    let same = ["level", "better", "worse"].into_iter().zip(["level with ", "ahead of ", "behind "]);
    assert!(
        line.contains(numbers) && same.into_iter().any(|(word, of)| of == verdict && line.contains(word)),
        "{line}"
    );
    main_metrics_are_printed_and_all_on_request(here, &table);
    let page = read(&here.join("runs/small/report.html"));
    assert!(page.contains(&format!("<b>The model is {verdict}{baseline}: {numbers}")), "the page gives the verdict");
    assert!(page.contains("<code>pwrfgs report RUN</code>") && page.contains("<code>pwrfgs view RUN</code>"));
    assert!(!page.contains("class=\"lead\"><td>"), "a row of scores has no type of a subtitle");
    assert!(stderr(&output).contains("step 60/60"), "plain lines where there is no terminal: {}", stderr(&output));

    let run = here.join("runs/small");
    for name in ["pipeline.ron", "model.safetensors", "start.safetensors", "validation.csv"] {
        assert!(run.join(name).is_file(), "{name}");
    }
    assert!(!run.join("checkpoint.safetensors").exists());
    let curve = read(&run.join("curve.csv"));
    assert_eq!(curve.lines().next(), Some("step,phase,loss,penalty,gaussians,seconds"));
    assert_eq!(curve.lines().count(), 61);
    assert!(read(&run.join("samples.csv")).starts_with("id,x,y,z,split,nearest_train_m\n1,"));
    let scores = read(&run.join("scores.csv"));
    assert!(scores.starts_with("predictor,metric,sample,value\nmodel,ssim,5,"), "{scores}");
    assert!(scores.lines().any(|l| l.starts_with("model,gaussians,,")) && scores.contains("\n3-NN,"), "{scores}");
    let facts: serde_json::Value = serde_json::from_str(&read(&run.join("run.json"))).unwrap();
    assert!(facts["finished"].is_string() && facts["wall_seconds"].as_f64().unwrap() > 0.0);
    assert_eq!(facts["machine"]["threads"], 1);
    names_its_commit(here, &facts);
    let report = read(&run.join("report.html"));
    for outside in ["src=\"http", "href=\"http", "<link", "<script src"] {
        assert!(!report.contains(outside), "the report needs {outside}");
    }
    assert!(report.contains("simulated") && report.matches("<svg").count() > 10);

    // Again: nothing to do. From its own pipeline.ron: the same run.
    let before = std::fs::metadata(run.join("report.html")).unwrap().modified().unwrap();
    let again = succeed(here, &["run", "runs/small/pipeline.ron"]);
    assert!(stderr(&again).contains("nothing to do"), "{}", stderr(&again));
    assert_eq!(stdout(&again), table);
    assert_eq!(std::fs::metadata(run.join("report.html")).unwrap().modified().unwrap(), before);
    // A missing report is written again, from the same model.
    std::fs::remove_file(run.join("report.html")).unwrap();
    let model = std::fs::read(run.join("model.safetensors")).unwrap();
    succeed(here, &["run", "pipelines/small.ron", "-q"]);
    assert!(run.join("report.html").is_file());
    assert_eq!(std::fs::read(run.join("model.safetensors")).unwrap(), model);

    predicts(here);
    evaluates(here, &scores);

    // Another pipeline may not have the folder.
    refuse(
        here,
        &["run", "pipelines/small.ron", "--set", "seed=1"],
        2,
        &["runs/small", "`seed: 0`", "`seed: 1`", "--out"],
    );
    assert_eq!(read(&run.join("scores.csv")).lines().count(), scores.lines().count());
}

/// `predict` needs nothing but the model file.
fn predicts(here: &Path) {
    let lonely = here.join("lonely");
    std::fs::create_dir(&lonely).unwrap();
    std::fs::copy(here.join("runs/small/model.safetensors"), lonely.join("m.safetensors")).unwrap();
    write(&lonely.join("tx.csv"), "name,Z,y,x\r\na,0.9,0.1,0.2\r\nb,1.0,-0.2,0.3\r\n");
    succeed(&lonely, &["predict", "m.safetensors", "--tx-csv", "tx.csv", "--out", "many"]);
    succeed(&lonely, &["predict", "m.safetensors", "--tx", "-0.2,0.1,0.9", "--out", "one"]);
    let list = read(&lonely.join("many/predictions.csv"));
    let header = "row,x,y,z,azimuth_deg,elevation_deg,peak,training_distance_m\n";
    assert!(list.starts_with(&format!("{header}1,0.2,0.1,0.9,")), "{list}");
    assert_eq!(list.lines().count(), 3);
    let bytes = std::fs::read(lonely.join("many/00002.npy")).unwrap();
    let (shape, values) = npy(&bytes);
    assert_eq!(shape, [12, 48]);
    let png = image::open(lonely.join("many/00002.png")).unwrap();
    assert_eq!(png.color(), image::ColorType::L8);
    let grey = png.into_luma8();
    for (pixel, value) in grey.as_raw().iter().zip(&values) {
        assert!((f64::from(*pixel) - 255.0 * value.clamp(0.0, 1.0)).abs() <= 0.51);
    }
    refuse(&lonely, &["predict", "m.safetensors", "--tx", "0,0,1", "--out", "many"], 2, &["many is not empty"]);
    stacked(&lonely, &values);
    extrapolates(&lonely);
    // A folder of somebody else's pictures is left alone.
    crate::common::picture(&lonely.join("spectra/00001.png"), 4, 4);
    let theirs = std::fs::read(lonely.join("spectra/00001.png")).unwrap();
    refuse(&lonely, &["predict", "m.safetensors", "--tx", "0,0,1", "--out", "spectra"], 2, &["spectra", "00001.png"]);
    assert_eq!(std::fs::read(lonely.join("spectra/00001.png")).unwrap(), theirs);
}

/// A position far from the training positions gives a warning with its distance; a model of an earlier version, a note.
fn extrapolates(here: &Path) {
    let model = file::read(&here.join("m.safetensors")).unwrap();
    let training = model.training_positions.clone().unwrap();
    let near = training.positions()[0];
    write(&here.join("far.csv"), format!("x,y,z\n{},{},{}\n22,0,1\n23,0,1\n", near[0], near[1], near[2]));
    let output = succeed(here, &["predict", "m.safetensors", "--tx-csv", "far.csv", "--out", "far", "-q"]);
    let list = read(&here.join("far/predictions.csv"));
    let distances: Vec<f64> =
        list.lines().skip(1).map(|row| row.rsplit(',').next().unwrap().parse().unwrap()).collect();
    let expected = training.positions().iter().map(|p| {
        let sides = [23.0 - p[0], p[1], 1.0 - p[2]].map(f64::from);
        sides.iter().map(|side| side * side).sum::<f64>().sqrt()
    });
    let expected = expected.fold(f64::INFINITY, f64::min);
    assert!(distances[0] == 0.0 && (distances[2] - expected).abs() < 1e-3, "{distances:?}, expected {expected}");
    let words = format!(
        "warning: 2 of 3 predictions are extrapolations: farther than {:.2} m from all training positions (up to {expected:.2} m)",
        training.limit()
    );
    assert_eq!(stderr(&output).matches(&words).count(), 1, "{}", stderr(&output));
    let output = succeed(here, &["predict", "m.safetensors", "--tx", "0.2,0.1,0.9", "--out", "near"]);
    assert!(!stderr(&output).contains("training positions"), "{}", stderr(&output));

    file::write(&here.join("old.safetensors"), &Model { training_positions: None, ..model }).unwrap();
    let output = succeed(here, &["predict", "old.safetensors", "--tx", "22,0,1", "--out", "old"]);
    assert!(stderr(&output).contains("note: the model has no training positions"), "{}", stderr(&output));
    assert!(read(&here.join("old/predictions.csv")).ends_with(",\n"));
}

/// One array in place of many, the same numbers, and no picture.
fn stacked(here: &Path, second: &[f64]) {
    let all = ["predict", "m.safetensors", "--tx-csv", "tx.csv", "--stacked", "--no-png", "--out", "stack"];
    succeed(here, &all);
    let names: std::collections::BTreeSet<String> =
        here.join("stack").read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert_eq!(names, ["predictions.csv", "spectra.npy"].map(str::to_owned).into());
    let bytes = std::fs::read(here.join("stack/spectra.npy")).unwrap();
    let (shape, values) = npy(&bytes);
    assert_eq!(shape, [2, 12, 48]);
    assert_eq!(&values[12 * 48..], second);
}

/// `evaluate` finds the pipeline beside the model and gives the scores of the run.
fn evaluates(here: &Path, scores: &str) {
    let model = "runs/small/model.safetensors";
    succeed(here, &["evaluate", model, "--out", "again"]);
    let own = |text: &str| text.lines().filter(|l| !l.contains("latency")).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(own(&read(&here.join("again/scores.csv"))), own(scores));
    let other =
        succeed(here, &["evaluate", model, "--set", "data=Teacher(seed: 3, width: 48, height: 12, samples: 20)"]);
    assert!(stdout(&other).contains("ssim"), "{}", stdout(&other));
    refuse(here, &["evaluate", model, "--set", "data=Teacher(samples: 20)"], 2, &["48 x 12 pixels", "360 x 90 pixels"]);
    refuse(here, &["evaluate", model, "--out", "again"], 2, &["again is not empty (it holds `"]);
    refuse(here, &["evaluate", "lonely/m.safetensors"], 2, &["m.safetensors", "--pipeline"]);
}

#[test]
fn commands_accept_run_folder_as_model() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "run");
    copy_small_run(here, "sweep/seed=0");
    copy_small_run(here, "sweep/joined");
    write(
        &here.join("sweep/sweep.json"),
        "{\"name\":\"x\",\"runs\":[{\"folder\":\"seed=0\",\"labels\":[],\"seed\":0}]}",
    );
    write(&here.join("begun/pipeline.ron"), SMALL);
    std::fs::create_dir(here.join("empty")).unwrap();
    measured(&here.join("lab"));
    let set = ["--set", "residuals=Kriged()", "--set", "split=Official(validation: 0.5)"];
    succeed(here, &[&["run", "lab/p.ron", "--out", "kriged", "-q"][..], &set].concat());
    let commands: [(&str, &str, &[&str]); 8] = [
        ("predict", "run", &["--tx", "0.3,0.1,0.9", "--no-png", "--out"]),
        ("map", "run", &["--plane", "z=0.5", "--step", "1", "--out"]),
        ("locate", "run", &["--out"]),
        ("export", "run", &["--npz"]),
        ("compress", "run", &["--out"]),
        ("evaluate", "run", &["--out"]),
        ("update", "kriged", &["--data", "lab/data", "--out"]),
        ("view", "run", &["--save"]),
    ];
    for (command, run, options) in commands {
        let [first, second, file] =
            [format!("{command}-1"), format!("{command}-2"), format!("{run}/model.safetensors")];
        let printed = stdout(&succeed(here, &[&[command, run], options, &[&*first]].concat()));
        if ["locate", "export", "compress", "update"].contains(&command) {
            let of_file = stdout(&succeed(here, &[&[command, &*file], options, &[&*second]].concat()));
            assert_eq!(printed, of_file.replace(&second, &first), "{command}");
        }
        let refuse = |model: &str, expected: &[&str]| {
            refuse(here, &[&[command, model], options, &["no"]].concat(), 2, expected);
        };
        refuse("sweep", &["sweep: folder of a sweep", "name one of its runs: joined, seed=0"]);
        refuse("begun", &["begun: this run has no model.safetensors yet", "`pwrfgs run`"]);
        refuse("empty", &["empty: not a run folder", "name a run folder or a model file"]);
    }
    let bytes = |name: &str| std::fs::read(here.join(name)).unwrap();
    for command in ["export", "compress", "update"] {
        assert!(bytes(&format!("{command}-1")) == bytes(&format!("{command}-2")), "{command}");
    }
    let pair = ["predict", "run", "sweep/seed=0", "--tx", "0.3,0.1,0.9", "--out", "no"];
    refuse(here, &pair, 2, &["models 1 and 2 of the ensemble are the same model"]);
    refuse(here, &["view", "sweep"], 2, &["name one of its runs: joined, seed=0"]);
    refuse(here, &["plan", "sweep", "--count", "1"], 2, &["name one of its runs: joined, seed=0"]);
    refuse(here, &["run", "sweep"], 2, &["name one of its runs: seed=0"]);
    refuse(here, &["inspect", "sweep"], 2, &["name one of its runs: seed=0"]);
}

#[test]
fn refuses_folder_with_foreign_files() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("small.ron"), SMALL);
    write(&here.join("thesis/chapter.txt"), "years of work");
    refuse(here, &["run", "small.ron", "--out", "thesis"], 2, &["thesis", "chapter.txt", "--out"]);
    assert_eq!(std::fs::read_dir(here.join("thesis")).unwrap().count(), 1);
    refuse(here, &["run", "small.ron", "--out", "small.ron"], 2, &["small.ron is not a folder"]);
    assert_eq!(read(&here.join("small.ron")), SMALL);
}

#[test]
fn resolves_paths_from_pipeline_and_set_paths_from_current_directory() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    crate::common::measured(&here.join("deep"));
    succeed(here, &["run", "deep/p.ron", "--out", "a", "-q"]);
    std::fs::rename(here.join("deep/data"), here.join("moved")).unwrap();
    refuse(here, &["run", "deep/p.ron", "--out", "b"], 2, &["deep/data"]);
    assert!(!here.join("b").exists(), "wrong input leaves nothing behind");
    succeed(here, &["run", "deep/p.ron", "--out", "b", "-q", "--set", "data=Nerf2Spectrum(root: \"moved\")"]);
    // The resolved pipeline holds everywhere.
    succeed(&here.join("deep"), &["run", "../b/pipeline.ron", "--out", "c", "-q"]);
    assert_eq!(std::fs::read(here.join("b/model.safetensors")).unwrap(), {
        std::fs::read(here.join("deep/c/model.safetensors")).unwrap()
    });
}

#[test]
fn plugins_command_lists_kinds_and_names_and_describes_one() {
    let here = Path::new(".");
    let all = stdout(&succeed(here, &["plugins"]));
    for word in ["Pruner (pruners)", "LearnableMask,", "Mercator", "NearestNeighbours", "Teacher", "--markdown"] {
        assert!(all.contains(word), "{word} is not in {all}");
    }
    assert!(all.lines().count() <= 40 && all.lines().all(|line| line.chars().count() <= 100), "one screen: {all}");
    let kind = stdout(&succeed(here, &["plugins", "pruners"]));
    assert!(kind.contains("Pruner (field `pruners`)") && kind.contains("  TopK: Keeps"), "{kind}");
    assert!(!kind.contains("Mercator") && !kind.contains("lambda: 0.01"), "first sentences only: {kind}");
    let one = stdout(&succeed(here, &["plugins", "TopK"]));
    assert!(one.contains("keep") && !one.contains("LearnableMask"), "{one}");
    refuse(here, &["plugins", "TopQ"], 2, &["did you mean `TopK`"]);
    assert!(stdout(&call(here, &["--help"])).contains("EXAMPLES"));
}
