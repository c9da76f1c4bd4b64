//! Pipelines, scenes and models in the program are used by name, without the repository.
use crate::common::{refuse, stderr, stdout, succeed, write};
use pwrfgs_core::ShippedModel;
use pwrfgs_core::testing::shared;

/// Settings that make `quickstart` a run of a second.
const SHORT: [&str; 8] = [
    "--scale",
    "0.004",
    "--set",
    "data.samples=60",
    "--set",
    "data.points=500",
    "--set",
    "baselines=[MeanSpectrum(), RayTracing()]",
];

#[test]
fn quickstart_runs_in_empty_folder() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let run = |pipeline: &str| succeed(here, &[&["run", pipeline][..], &SHORT].concat());
    let output = run("quickstart");
    assert!(stdout(&output).contains("report: runs/quickstart"), "{}", stdout(&output));
    assert!(stderr(&output).contains("office (simulated)"), "{}", stderr(&output));
    let text = std::fs::read_to_string(here.join("runs/quickstart/pipeline.ron")).unwrap();
    assert!(text.contains("scene: \"office\""), "{text}");

    // A copy is the same pipeline.
    let copied = succeed(here, &["pipelines", "--copy", "quickstart"]);
    assert!(stdout(&copied).ends_with("next: pwrfgs run quickstart.ron\n"), "{}", stdout(&copied));
    assert!(stderr(&run("quickstart.ron")).contains("nothing to do"));
    let again = succeed(here, &["run", "runs/quickstart"]);
    assert!(stderr(&again).contains("nothing to do"), "the run folder needs no scene file: {}", stderr(&again));
    refuse(here, &["pipelines", "--copy", "quickstart"], 2, &["quickstart.ron", "not overwritten"]);

    // A file of the user is used first.
    write(&here.join("quickstart"), "Pipeline(name: 1)");
    refuse(here, &["check", "quickstart"], 2, &["quickstart:1:16"]);
}

#[test]
fn pipelines_are_listed_with_their_purpose() {
    let folder = tempfile::tempdir().unwrap();
    let list = stdout(&succeed(folder.path(), &["pipelines"]));
    let line =
        |name: &str| list.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("{name}: {list}"));
    assert!(line("s23-laptop ").contains("Trains P-WRFGS on s23 (measured)"));
    assert!(line("quickstart ").contains("simulated") && line("scenes ").contains("office-csi"));
    assert!(
        line("paper-office ").contains("simulated office") && line("curve ").contains("equal numbers of Gaussians")
    );
    let at = |text: &str| list.find(text).unwrap_or_else(|| panic!("{text}: {list}"));
    assert!(at("\nwrfgs ") < at("experiments for `pwrfgs sweep`") && at("\narray ") < at("scenes for"));
    assert!(list.lines().all(|line| line.len() < 165), "{list}");
}

#[test]
fn unknown_names_suggest_shipped_ones() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |arguments: &[&str], words: &[&str]| refuse(folder.path(), arguments, 2, words);
    refused(&["run", "quikstart"], &["quikstart: no such file", "did you mean `quickstart`?"]);
    refused(
        &["pipelines", "--copy", "s23-labtop"],
        &["--copy s23-labtop: no such pipeline or experiment; did you mean `s23-laptop`?"],
    );
    refused(&["simulate", "ofice", "--out", "o"], &["ofice: no such file", "did you mean `office`?"]);
    refused(&["run", "quickstart", "--set", "data.scene=ofice"], &["did you mean `office`?"]);
    // The data of other pipelines begin in the current directory.
    refused(&["run", "s23-laptop"], &[&folder.path().join("data/s23").display().to_string()]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is written");
}

#[test]
fn experiments_and_simulate_accept_names() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let axis = "(name: \"N\", variants: [(label: \"8\", set: {\"initializer.max_points\": 8})])";
    write(&here.join("e.ron"), format!("Experiment(name: \"e\", base: \"quickstart\", axes: [{axis}])"));
    let plan = succeed(here, &["sweep", "e.ron", "--dry-run", "--set", "data.samples=60", "--set", "data.points=500"]);
    assert!(stdout(&plan).contains("runs/e"), "{}", stdout(&plan));
    let status = |name: &str| stdout(&succeed(here, &["sweep", name, "--status"]));
    let named = status("splits");
    assert!(named.contains("0 of 24 runs finished, in runs/splits"), "{named}");
    let copied = stdout(&succeed(here, &["pipelines", "--copy", "splits"]));
    assert!(copied.ends_with("next: pwrfgs sweep splits.ron\n"), "{copied}");
    assert_eq!(status("splits.ron"), named);
    refuse(here, &["sweep", "split"], 2, &["split: no such file", "did you mean `splits`?"]);
    succeed(here, &["simulate", "office", "--samples", "5", "--points", "10", "--no-paths", "--out", "data"]);
    assert!(here.join("data/spectrum/00005.png").is_file());
}

#[test]
fn models_are_listed_with_their_purpose() {
    let folder = tempfile::tempdir().unwrap();
    let print = |arguments: &[&str]| stdout(&succeed(folder.path(), arguments));
    let list = print(&["pipelines"]);
    let (_, list) = list.split_once("models for `pwrfgs view`").unwrap();
    for ShippedModel { name, purpose, .. } in ShippedModel::all() {
        let line = list.lines().find(|line| line.starts_with(&format!("{name} "))).unwrap();
        assert!(line.ends_with(purpose) && ["(measured)", "(simulated)"].iter().any(|word| purpose.contains(word)));
        for command in ["view", "predict"] {
            assert!(print(&[command, "--help"]).contains(name), "{command}: {name}");
        }
    }
}

#[test]
fn models_of_program_need_no_data() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let predict = |model, out| succeed(here, &["predict", model, "--tx", "0.1,-0.2,1.2", "--out", out]);
    assert!(stderr(&predict("s23", "spectrum")).contains("1 spectrum in spectrum"));
    for command in [
        &["predict", "ble", "--tx", "20,30,0", "--out", "powers"][..],
        &["predict", "office-channel", "--tx", "3,2,1.2", "--out", "channel"],
        &["map", "ble", "--plane", "z=0", "--step", "4", "--receiver", "g01", "--out", "map"],
        &["export", "s23", "--ply", "s23.ply"],
        &["compress", "office-channel", "--out", "half.safetensors", "--bits", "16"],
        &["plan", "s23", "--floor", "lab-s23", "--count", "2"],
    ] {
        succeed(here, command);
    }
    refuse(here, &["evaluate", "s23"], 2, &[&here.join("data/s23").display().to_string()]);
    refuse(here, &["view", "s23", "--save", "room.html"], 2, &["expected a run folder for --save"]);
    refuse(here, &["predict", "s32", "--tx", "0,0,1", "--out", "no"], 2, &["ships no model", "did you mean `s23`?"]);

    // What the user has is used first.
    write(&here.join("ble"), ShippedModel::find("s23".as_ref()).unwrap().bytes);
    assert!(stderr(&predict("ble", "again")).contains("1 spectrum in again"));
    std::fs::create_dir(here.join("s23")).unwrap();
    refuse(here, &["predict", "s23", "--tx", "0,0,1", "--out", "no"], 2, &["s23: not a run folder"]);
}

#[test]
fn models_of_program_locate_by_their_predictions() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let position = [0.1, -0.2, 1.2];
    succeed(here, &["predict", "s23", "--tx", "0.1,-0.2,1.2", "--out", "p"]);
    let located = succeed(here, &["locate", "s23", "p/00001.png"]);
    let row = stdout(&located).lines().last().unwrap().split_whitespace().map(str::to_owned).collect::<Vec<_>>();
    for (found, expected) in row[1..4].iter().zip(position) {
        assert!((found.replace('−', "-").parse::<f64>().unwrap() - expected).abs() < 0.1, "{row:?}");
    }
    assert_eq!(row.len(), 5, "no region: {row:?}");
    let message = stderr(&located);
    assert!(message.contains(" fingerprints, predicted at the training positions in the model file"), "{message}");
    assert!(message.contains("there are no regions"), "{message}");
    refuse(here, &["locate", "s23"], 2, &[&here.join("data/s23").display().to_string()]);
    succeed(here, &["predict", "office-channel", "--tx", "3,2,1.2", "--stacked", "--out", "c"]);
    assert!(stdout(&succeed(here, &["locate", "office-channel", "c/channels.npy"])).contains("00001"));
}

#[test]
fn scores_of_models_are_those_of_their_cards() {
    let Some(shared) = shared("data") else { return };
    let folder = tempfile::tempdir().unwrap();
    let card = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/README.md")).unwrap();
    for (name, metric) in [("s23", "Ssim()"), ("ble", "PowerError()")] {
        let root = format!("data.root={}", shared.join(name).display());
        let metrics = format!("metrics=[{metric}]");
        let arguments =
            ["evaluate", name, "--set", &root, "--set", &metrics, "--set", "baselines=[]", "--threads", "1"];
        let table = stdout(&succeed(folder.path(), &arguments));
        let mut words = table.split_whitespace().skip_while(|word| *word != "mean");
        let score = words.nth(1).unwrap_or_else(|| panic!("{table}")).trim_end_matches('*');
        let row = card.lines().find(|line| line.starts_with(&format!("| `{name}` |"))).unwrap();
        assert_eq!(row.split('|').nth(3).unwrap().trim().trim_matches('*'), score, "{name}: {table}");
    }
}

#[test]
fn public_data_are_listed_with_licence_and_address() {
    let folder = tempfile::tempdir().unwrap();
    let list = stdout(&succeed(folder.path(), &["data"]));
    for set in list.split("\n\n").filter(|set| set.contains("  licence")) {
        for field in ["size", "address", "download", "copy to", "pipelines"] {
            assert!(set.contains(&format!("\n  {field} ")), "{set}");
        }
    }
    for set in ["s23: measured", "BLE: measured", "NeWRF: *simulated*", "RF-3DGS: *simulated*", "DeepMIMO: *simulated*"]
    {
        assert!(list.contains(set), "{list}");
    }
    assert!(list.contains("curl -LO https://"), "{list}");
}

#[test]
fn data_check_reports_layout_and_digests() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    succeed(here, &["simulate", "office", "--samples", "5", "--points", "10", "--no-paths", "--out", "mine"]);
    let text = stdout(&succeed(here, &["data", "check", "mine"]));
    assert!(
        text.starts_with(
            "layout: Nerf2Spectrum, 5 spectra of 360 x 90 pixels, simulated\nindex files: 4 training, 1 test"
        ),
        "{text}"
    );
    assert!(text.ends_with("digests: no file of a known public data set; `pwrfgs data` lists them\n"), "{text}");
    std::fs::remove_file(here.join("mine/tx_pos.csv")).unwrap();
    refuse(here, &["data", "check", "mine"], 2, &["tx_pos.csv"]);
    refuse(here, &["data", "check", "nowhere"], 2, &["nowhere: no such folder"]);
    std::fs::create_dir(here.join("empty")).unwrap();
    refuse(here, &["data", "check", "empty"], 2, &["no known layout of data"]);

    let Some(shared) = shared("data") else { return };
    let check = |name: &str| stdout(&succeed(here, &["data", "check", shared.join(name).to_str().unwrap()]));
    for (name, files) in [("s23", 3), ("ble", 3), ("newrf", 2)] {
        let text = check(name);
        assert!(text.contains(&format!("digests: {files} of {files} files equal the ")), "{text}");
    }
    // A changed file.
    for name in ["gateway_position.yml", "gateway_rssi.csv", "tx_pos.csv"] {
        let bytes = std::fs::read(shared.join("ble").join(name)).unwrap();
        let cut = if name == "tx_pos.csv" { &[&bytes[..], b"\n"].concat()[..] } else { &bytes[..] };
        write(&here.join("ble").join(name), std::str::from_utf8(cut).unwrap());
    }
    let text = stdout(&succeed(here, &["data", "check", "ble"]));
    assert!(
        text.contains("digests: 2 of 3 files equal the BLE files") && text.contains("tx_pos.csv            differs: "),
        "{text}"
    );
}
