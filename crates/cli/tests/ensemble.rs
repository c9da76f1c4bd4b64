//! Ensembles, and model files with 16 bits per number.
use crate::common::{SMALL, npy, refuse, stdout, succeed, write};
use pwrfgs::model::file;
use pwrfgs_core::Real;
use std::path::Path;

#[test]
fn ensemble_predicts_mean_and_deviation() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    for seed in ["0", "1"] {
        succeed(here, &["run", "p.ron", "--out", seed, "-q", "--scale", "0.05", "--set", &format!("seed={seed}")]);
    }
    let models = ["0/model.safetensors", "1/model.safetensors"];
    let predict = |which: &[&str], out: &str| {
        succeed(here, &[&["predict", "--tx", "0.3,0.1,0.9", "--out", out][..], which].concat());
        npy(&here.join(out).join("00001.npy")).1
    };
    let (a, b) = (predict(&models[..1], "a"), predict(&models[1..], "b"));
    let both = predict(&models, "both");
    let spread = npy(&here.join("both/00001-spread.npy")).1;
    for (((a, b), both), spread) in a.iter().zip(&b).zip(&both).zip(&spread) {
        let (a, b) = (a.clamp(0.0, 1.0), b.clamp(0.0, 1.0));
        assert!((both - 0.5 * (a + b)).abs() < 1e-6 && (spread - 0.5 * (a - b).abs()).abs() < 1e-6);
    }
    assert!(spread.iter().any(|s| *s > 0.0));
    let png = image::open(here.join("both/00001-spread.png")).unwrap().into_luma8();
    assert!(png.as_raw().iter().zip(&spread).all(|(grey, s)| (f32::from(*grey) - 510.0 * s.min(0.5)).abs() <= 0.51));
    succeed(here, &[&["predict", "--tx", "0.3,0.1,0.9", "--stacked", "--out", "stack"][..], &models].concat());
    assert_eq!((npy(&here.join("stack/spectra.npy")).1, npy(&here.join("stack/spread.npy")).1), (both, spread));

    let table = stdout(&succeed(here, &["evaluate", models[0], models[1]]));
    assert!(table.contains("ssim") && table.contains("mean of 2 models"), "{table}");
    assert!(table.contains("member 1") && table.contains("member 2") && table.contains("rank correlation"), "{table}");
    succeed(here, &["evaluate", models[0], models[1], "--out", "x"]);
    let page = std::fs::read_to_string(here.join("x/report.html")).unwrap();
    assert!(page.contains("Error against ensemble spread"));
    assert!(here.join("x/confidence.csv").is_file());
    succeed(
        here,
        &[
            "run",
            "p.ron",
            "--out",
            "2",
            "-q",
            "--scale",
            "0.02",
            "--set",
            "data=Teacher(samples: 30, width: 24, height: 6, gaussians: 3)",
        ],
    );
    refuse(
        here,
        &["predict", models[0], "2/model.safetensors", "--tx", "0,0,1", "--out", "no"],
        2,
        &["model 2", "image plane"],
    );
    for command in [&["evaluate"][..], &["predict", "--tx", "0,0,1", "--out", "no"]] {
        let twice = [command, &models, &["0/model.safetensors"]].concat();
        refuse(here, &twice, 2, &["models 1 and 3 of the ensemble are the same model", "give each model once"]);
    }
    assert!(!here.join("no").exists());
}

#[test]
fn half_precision_model_halves_file_and_keeps_predictions() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--scale", "0.05"]);
    succeed(here, &["export", "r/model.safetensors", "--half", "half.safetensors"]);
    let [whole, half] = ["r/model.safetensors", "half.safetensors"].map(|name| file::read(&here.join(name)).unwrap());
    assert_eq!(whole.cloud, half.cloud, "the Gaussians keep their digits");
    let network = |model: &pwrfgs::model::Model| model.weights.clone();
    assert!(network(&whole).iter().zip(network(&half)).all(|(w, h)| (w - h).abs() <= 5e-4 * w.abs() + 1e-7));
    let saved = |name: &str| std::fs::metadata(here.join(name)).unwrap().len() as usize;
    assert!(saved("half.safetensors") + 2 * whole.weights.len() <= saved("r/model.safetensors") + 64);
    let tx = [0.2, 0.1, 0.8];
    let (a, b) = (whole.predict(tx), half.predict(tx));
    assert!(a.pixels.iter().zip(&b.pixels).all(|(a, b)| (a - b).abs() < 0.01));
    refuse(here, &["export", "r/model.safetensors", "--half", "half.safetensors"], 2, &["half.safetensors exists"]);
}

#[test]
fn compressed_model_is_a_quarter_as_large_and_predicts_alike() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--out", "r", "-q", "--scale", "0.05"]);
    let whole = file::read(&here.join("r/model.safetensors")).unwrap();
    let size = |name: &str| std::fs::metadata(here.join(name)).unwrap().len() as usize;
    for (bits, bytes_per_weight, close) in [("8", 1, 0.01), ("16", 2, 0.005)] {
        let name = format!("{bits}.safetensors");
        let output = succeed(here, &["compress", "r/model.safetensors", "--out", &name, "--bits", bits]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(text.contains("whole file") && text.contains("mean difference of predictions at"), "{text}");
        let small = file::read(&here.join(&name)).unwrap();
        assert_eq!(small.stages.layout().weights, whole.stages.layout().weights);
        // Scales, biases, Gaussians and the header take the rest.
        assert!(size(&name) < bytes_per_weight * whole.weights.len() + 12_000, "{bits}: {}", size(&name));
        assert!(size(&name) < size("r/model.safetensors") * (bytes_per_weight + 1) / 4);
        let (a, b) = (whole.predict([0.2, 0.1, 0.8]), small.predict([0.2, 0.1, 0.8]));
        let mean = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (a - b).abs()).sum::<Real>() / a.pixels.len() as Real;
        assert!(mean > 0.0 && mean < close, "{bits}: {mean}");
        // The same numbers again: nothing is lost by a second compression.
        succeed(here, &["compress", &name, "--out", "again.safetensors", "--bits", bits]);
        let again = file::read(&here.join("again.safetensors")).unwrap();
        assert!(again.weights.iter().zip(&small.weights).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs()));
        std::fs::remove_file(here.join("again.safetensors")).unwrap();
    }
    refuse(here, &["compress", "r/model.safetensors", "--out", "8.safetensors"], 2, &["8.safetensors exists"]);
    refuse(here, &["compress", "p.ron", "--out", "no"], 2, &["p.ron", "give the model.safetensors of a finished run"]);
    refuse(here, &["compress", "r/model.safetensors", "--out", "no", "--bits", "4"], 2, &["8, 16"]);
    assert!(!here.join("no").exists());
}

/// Two kinds of model with two seeds, on a split that follows the seed.
fn write_joined(here: &Path) {
    let base = SMALL.replace("Official(validation: 0.2)", "Random(test: 0.3, validation: 0.2)");
    write(&here.join("wide.ron"), base.replace("width: 16", "width: 24"));
    write(&here.join("p.ron"), base);
    write(&here.join("e.ron"), experiment("base: \"wide.ron\"", "seeds: [0],"));
}

/// A joined sweep of `p.ron` as it is and with a change.
fn experiment(change: &str, more: &str) -> String {
    format!(
        "Experiment(name: \"both\", join: true, base: \"p.ron\", {more} set: {{\"training.scale\": 0.5}},
        axes: [Axis(name: \"net\", variants: [(label: \"small\"), (label: \"wide\", {change})])])"
    )
}

/// `scores.csv` without what a clock measured.
fn scores(folder: &Path) -> String {
    let text = std::fs::read_to_string(folder.join("scores.csv")).unwrap();
    text.lines().filter(|line| !line.contains("latency")).collect::<Vec<_>>().join("\n")
}

#[test]
fn joined_sweep_is_scored_and_saved_as_one_model() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write_joined(here);
    let table = stdout(&succeed(here, &["sweep", "e.ron", "-q"]));
    assert!(["small-0", "wide-0"].iter().all(|name| table.contains(&format!("member {name}"))), "{table}");
    assert!(table.contains("5-NN"), "baselines stand beside the joined model: {table}");

    let own = here.join("runs/both/joined");
    let runs = ["net=small,seed=0", "net=wide,seed=0"];
    let models = runs.map(|run| format!("runs/both/{run}/model.safetensors"));
    let predict = |which: &[&str], out: &str| {
        succeed(here, &[&["predict", "--tx", "0.3,0.1,0.9", "--out", out][..], which].concat());
        (npy(&here.join(out).join("00001.npy")), npy(&here.join(out).join("00001-spread.npy")))
    };
    let together = predict(&["runs/both/joined/model.safetensors"], "one");
    assert_eq!(together, predict(&models.each_ref().map(String::as_str), "two"), "one file, the same bits");

    // All runs are tested on the same transmitters.
    let tested = |path: &str| {
        let text = std::fs::read_to_string(here.join(path)).unwrap();
        text.lines().filter(|line| line.contains(",test,")).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(tested("runs/both/joined/samples.csv"), tested("runs/both/net=wide,seed=0/samples.csv"));

    let confidence = std::fs::read_to_string(own.join("confidence.csv")).unwrap();
    assert_eq!(confidence.lines().count(), 1 + tested("runs/both/joined/samples.csv").len());
    let page = std::fs::read_to_string(own.join("report.html")).unwrap();
    let link = "../net=wide,seed=0/report.html";
    assert!(page.contains(link) && own.join(link).is_file() && page.contains("Error against ensemble spread"));

    // Members are no baselines: their curves are solid, and that of the baseline is dashed.
    let figure = page.split("<svg").find(|svg| svg.contains("aria-label=\"Share of test")).unwrap();
    assert!([">model<", ">members<", ">5-NN<"].iter().all(|name| figure.contains(name)), "{figure}");
    let strokes = |colour: &str| {
        let groups =
            figure.split("<g ").filter(|group| group.contains(&format!("stroke=\"{colour}\""))).collect::<Vec<_>>();
        assert!(!groups.is_empty(), "{colour}: {figure}");
        groups.iter().all(|group| group.contains("stroke-dasharray"))
    };
    assert_eq!(["#6ea0dc", "#787c84"].map(strokes), [false, true], "{figure}");

    // What is lost is made again, to the same bytes.
    let (model, before) = (std::fs::read(own.join("model.safetensors")).unwrap(), scores(&own));
    std::fs::remove_file(own.join("model.safetensors")).unwrap();
    std::fs::remove_dir_all(here.join("runs/both").join(runs[1])).unwrap();
    succeed(here, &["sweep", "e.ron", "-q"]);
    std::fs::remove_file(own.join("confidence.csv")).unwrap();
    succeed(here, &["sweep", "e.ron", "-q"]);
    assert_eq!((std::fs::read(own.join("model.safetensors")).unwrap(), scores(&own)), (model, before));
    let written = || own.join("scores.csv").metadata().unwrap().modified().unwrap();
    let before = written();
    assert!(stdout(&succeed(here, &["sweep", "e.ron"])).contains("member wide-0"));
    let other = ["run", "runs/both/joined", "--set", "metrics=[L1()]"];
    refuse(here, &other, 2, &["joined: holds the joined model of a sweep", "`pwrfgs sweep`"]);
    refuse(here, &["run", "runs/both"], 2, &["runs/both: folder of a sweep", "`pwrfgs sweep`"]);
    assert_eq!(written(), before, "nothing is left to do");

    assert!(stdout(&succeed(here, &["evaluate", "runs/both/joined/model.safetensors"])).contains("member wide-0"));
    let study = stdout(&succeed(here, &["report", "runs/both", "--out", "compared"]));
    assert!(
        study.contains("5-NN (baseline)") && !study.contains("small-0 (baseline)"),
        "members are no baselines: {study}"
    );
    assert!(study.contains("joined") && study.contains("net wide"), "{study}");

    is_exported_whole(here, "runs/both/joined/model.safetensors");
    // One more seed changes the joined model, and has the same test transmitters.
    write(&here.join("e.ron"), experiment("base: \"wide.ron\"", "seeds: [0, 1],"));
    assert!(stdout(&succeed(here, &["sweep", "e.ron", "-q"])).contains("member wide-1"));
    assert_eq!(tested("runs/both/joined/samples.csv"), tested("runs/both/net=wide,seed=1/samples.csv"));
    assert_eq!(file::read_ensemble(&own.join("model.safetensors")).unwrap().members().len(), 4);
}

/// PLY, NPZ and 16-bit numbers hold both members.
fn is_exported_whole(here: &Path, model: &str) {
    succeed(here, &["export", model, "--ply", "a.ply", "--npz", "a.npz", "--half", "half.safetensors"]);
    succeed(here, &["compress", model, "--out", "small.safetensors"]);
    assert_eq!(file::read_ensemble(&here.join("small.safetensors")).unwrap().names(), ["small-0", "wide-0"]);
    let ensemble = file::read_ensemble(&here.join(model)).unwrap();
    assert_eq!(ensemble.names(), ["small-0", "wide-0"]);
    let ply = std::fs::read(here.join("a.ply")).unwrap();
    let header = String::from_utf8_lossy(&ply[..600]).into_owned();
    assert!(header.contains(&format!("element vertex {}\n", ensemble.gaussians())), "{header}");
    let last = f32::from_le_bytes(ply[ply.len() - 4..].try_into().unwrap());
    assert!(header.contains("property float member\nend_header") && last == 1.0);
    let mut archive = zip::ZipArchive::new(std::fs::File::open(here.join("a.npz")).unwrap()).unwrap();
    assert!(archive.by_name("members.1.means.npy").is_ok());
    let half = file::read_ensemble(&here.join("half.safetensors")).unwrap();
    let (whole, half) =
        (ensemble.prepare().predict_many(&[[0.2; 3].into()]), half.prepare().predict_many(&[[0.2; 3].into()]));
    assert!(whole[0].pixels.iter().zip(&half[0].pixels).all(|(a, b)| (a - b).abs() < 0.01));
    assert!(file::read(&here.join(model)).unwrap_err().to_string().contains("an ensemble of 2 models"));
}

#[test]
fn refuses_to_join_incompatible_runs() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write_joined(here);
    let refused = |change: &str, more: &str, why: &[&str]| {
        write(&here.join("x.ron"), experiment(change, more));
        refuse(here, &["sweep", "x.ron"], 2, why);
    };
    refused("set: {\"split\": Sparse(train: 10)}", "", &["x.ron: join: ", "`net=wide,seed=0` differ in `split`"]);
    refused("set: {\"data\": Teacher(samples: 50)}", "", &["differ in `data`", "`set`"]);
    refused("set: {\"tensorboard\": true}", "", &["train the same model", "net=small,seed=0"]);
    refused("set: {\"split_seed\": 3}", "", &["train the same model"]);
    refused("set: {\"training.steps\": 10}", "", &["variant `wide`", "pruners"]);
    refused("base: \"none.ron\"", "", &["variant `wide`", "none.ron"]);
    write(&here.join("x.ron"), "Experiment(name: \"x\", join: true, base: \"p.ron\")");
    refuse(here, &["sweep", "x.ron"], 2, &["x.ron: join: there are 1 runs", "2 to 100"]);
    let second = "axes: [Axis(name: \"a\", variants: [(label: \"1\")]), Axis(name: \"b\", variants: [(label: \"2\", base: \"p.ron\")])]";
    write(&here.join("x.ron"), format!("Experiment(name: \"x\", base: \"p.ron\", {second})"));
    refuse(here, &["sweep", "x.ron"], 2, &["axis `b`", "first axis", "`base`"]);
    assert!(!here.join("runs").exists(), "nothing was written");
}

#[test]
fn rejects_file_of_other_command_and_suggests_command() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write_joined(here);
    write(
        &here.join("p.ron"),
        format!("/* Experiment( */ // Ensemble(\n{}", std::fs::read_to_string(here.join("p.ron")).unwrap()),
    );
    for command in ["run", "check"] {
        refuse(here, &[command, "e.ron"], 2, &["e.ron:1:", "`Experiment`", "use this file with `pwrfgs sweep`"]);
    }
    refuse(here, &["sweep", "p.ron"], 2, &["p.ron:2:", "`Pipeline`", "use this file with `pwrfgs run`"]);
    succeed(here, &["run", "p.ron", "-q", "--scale", "0.05"]);
}
