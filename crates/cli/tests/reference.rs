//! Reference, `init`, completions, manual, `--set` and `set` of sweeps.
use crate::common::{SMALL, call, measured, picture, refuse, stdout, succeed, write};
use std::path::Path;

#[test]
fn reference_page_lists_fields_settings_and_every_plugin() {
    let page = stdout(&succeed(Path::new("."), &["plugins", "--markdown"]));
    for family in pwrfgs_core::plugin::inventory::iter::<pwrfgs_core::plugin::PluginFamily>() {
        assert!((family.members)().iter().all(|plugin| page.contains(&format!("\n### {}\n", plugin.name))));
    }
    for line in ["| `lambda` | number | `0.01` | Weight λ", "### Densify (field `densify`)", "| `Magnitude` | "] {
        assert!(page.contains(line), "{line} is not in the reference");
    }
}

#[test]
fn schema_lists_every_plugin_with_fields_and_defaults() {
    let text = stdout(&succeed(Path::new("."), &["plugins", "--schema"]));
    let schema: serde_json::Value = serde_json::from_str(&text).unwrap();
    let types = &schema["$defs"];
    for family in pwrfgs_core::plugin::inventory::iter::<pwrfgs_core::plugin::PluginFamily>() {
        let all = types[family.kind]["oneOf"].as_array().unwrap();
        for plugin in (family.members)() {
            let name = |one: &serde_json::Value| one["properties"][plugin.name]["$ref"].as_str().map(str::to_owned);
            let found = all.iter().find_map(name).unwrap_or_else(|| panic!("{} {}", family.kind, plugin.name));
            assert!(types[&found["#/$defs/".len()..]]["description"].is_string(), "{found}");
        }
    }
    let lambda = &types["LearnableMask"]["properties"]["lambda"];
    assert_eq!(lambda["default"].to_string(), "0.01", "the digits of single precision");
    assert!(lambda["description"].as_str().unwrap().starts_with("Weight λ of the penalty"), "{lambda}");
    assert_eq!(types["Pipeline"]["required"], serde_json::json!(["name", "data"]));
    assert_eq!(types["Experiment"]["properties"]["base"]["format"], "path");
}

#[test]
fn plugins_command_describes_every_pipeline_setting() {
    let here = Path::new(".");
    let message = |name: &str| stdout(&succeed(here, &["plugins", name]));
    let asked: [(&str, &[&str]); 10] = [
        ("training", &["Training(", "// Number of training steps M. [whole number]", "steps: 200000"]),
        ("optimizer", &["log_scales: Constant(0.005)", "Schedule: Constant, LogLinear, Cosine"]),
        ("densify", &["gradient_threshold"]),
        ("loss", &["ssim_weight: 0.2"]),
        ("readout", &["MinMax: "]),
        ("Schedule", &["LogLinear(first: number"]),
        ("pruner", &["LearnableMask: ", "TopK: "]),
        ("LearnableMask", &["LearnableMask(", "// Weight λ of the penalty", "lambda: 0.01"]),
        ("Pipeline", &["// Random seed of the run"]),
        ("slurm", &["cpus: 2"]),
    ];
    for (name, words) in asked {
        let text = message(name);
        assert!(words.iter().all(|word| text.contains(word)), "{name}: {text}");
    }
    let mask = message("LearnableMask").split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(mask.contains("A mask that has closed cannot reopen"), "the whole comment");
    refuse(here, &["plugins", "optimiser"], 2, &["did you mean `Optimizer`"]);
    refuse(here, &["plugins", "trainin"], 2, &["did you mean `Training`"]);
}

#[test]
fn init_writes_runnable_pipeline_and_never_overwrites() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    std::fs::rename(here.join("data"), here.join("my \"data\"")).unwrap();
    let message = stdout(&succeed(here, &["init", "my \"data\""]));
    assert!(message.contains("6 spectra of 12 x 6 pixels: 3 training, 1 validation, 2 test"), "{message}");
    let text = std::fs::read_to_string(here.join("my--data-.ron")).unwrap();
    for words in [
        "split: Official(",
        "// Batch size: transmitters per step, at most those of the training set. [whole number]",
        "batch: 3,",
        "points: None",
        "Grid(",
    ] {
        assert!(text.contains(words), "{words} is not in {text}");
    }
    // The settings that matter most are above a line, in this order; all others are below.
    let (top, rest) = text.split_once("// Other settings. ").unwrap();
    let names =
        ["    data: ", "\n    split: ", "\n    pruners: ", "\n    members: ", "\n    training: ", "\n        steps: "];
    let at: Vec<usize> = names.iter().map(|name| top.find(name).unwrap_or_else(|| panic!("{name}: {top}"))).collect();
    assert!(at.is_sorted() && !top.contains("\n    seed: ") && !top.contains("\n        batch: "), "{top}");
    assert!(rest.contains("\n        batch: ") && rest.contains("\n    seed: "), "{rest}");
    let few = ["training.steps=6", "training.densify_until=2", "training.prune_until=5", "deformation.width=8"];
    let few: Vec<&str> = few.iter().flat_map(|set| ["--set", set]).collect();
    // A batch is limited to the training set.
    succeed(here, &[&["run", "my--data-.ron", "-q", "--set", "training.batch=1000"][..], &few].concat());
    refuse(here, &["init", "my \"data\""], 2, &["my--data-.ron", "not overwritten", "--out"]);
    assert_eq!(std::fs::read_to_string(here.join("my--data-.ron")).unwrap(), text);
    refuse(here, &["init", "nowhere"], 2, &["nowhere: no such folder"]);
    write(&here.join("rssi.npy"), "");
    refuse(here, &["init", "rssi.npy"], 2, &["rssi.npy: is a file; give a folder", "docs/data.md"]);
    std::fs::create_dir(here.join("empty")).unwrap();
    refuse(here, &["init", "empty"], 2, &["empty: no known layout", "spectra.npy", "gateway_rssi.csv", "docs/data.md"]);
    assert!(!here.join("nowhere.ron").exists());
}

#[test]
fn init_selects_voxel_split_without_lists_and_finds_points() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let data = here.join("data");
    let rows: Vec<String> =
        (0..120).map(|i| format!("{},{},0.5\n", f64::from(i % 12) * 0.25, f64::from(i / 12) * 0.25)).collect();
    write(&data.join("tx_pos.csv"), format!("x,y,z\n{}", rows.concat()));
    (1..=120).for_each(|id| picture(&data.join(format!("spectrum/{id:05}.png")), 12, 6));
    for list in ["train_index.txt", "test_index.txt"] {
        std::fs::remove_file(data.join(list)).unwrap();
    }
    write(&data.join("room.xyz"), "0 0 1\n0 1 1\n1 1 1\n1 0 1\n");
    succeed(here, &["init", "data", "--out", "deep/p.ron"]);
    let text = std::fs::read_to_string(here.join("deep/p.ron")).unwrap();
    assert!(
        text.contains("split: Voxel(") && text.contains("room.xyz (4 points)") && text.contains("PointCloud("),
        "{text}"
    );
    let edge = |text: &str| text.split("size_m: ").nth(1).unwrap().split([',', ')']).next().unwrap().to_owned();
    let starred = |set: &[&str]| {
        let table = stdout(&succeed(here, &[&["inspect", "data", "-q"], set].concat()));
        table.lines().find(|line| line.contains(") *  ")).unwrap_or_else(|| panic!("no star in {table}")).to_owned()
    };
    let line = starred(&[]);
    assert!(line.starts_with("Voxel(") && edge(&line) == edge(&text), "{line}");
    assert!(starred(&["--set", "split=TimeBlock()"]).starts_with("TimeBlock("), "--set is stronger");
    let few = ["training.steps=6", "training.densify_until=2", "training.prune_until=5", "deformation.width=8"];
    let few: Vec<&str> = few.iter().flat_map(|set| ["--set", set]).collect();
    succeed(here, &[&["run", "deep/p.ron", "-q"][..], &few].concat());
}

#[test]
fn completions_and_manual_pages_cover_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for shell in ["bash", "zsh", "fish"] {
        let script = stdout(&succeed(here, &["completions", shell]));
        assert!(["sweep", "init", "markdown"].iter().all(|word| script.contains(word)), "{shell}: {script}");
    }
    assert_eq!(call(here, &["completions", "dos"]).status.code(), Some(2));
    assert!(stdout(&succeed(here, &["man"])).contains(".TH pwrfgs 1"));
    succeed(here, &["man", "--out", "man1"]);
    let page = std::fs::read_to_string(here.join("man1/pwrfgs-run.1")).unwrap();
    assert!(page.contains("tensorboard") && here.join("man1/pwrfgs.1").is_file(), "{page}");
    // Pages of an earlier version give way, and nothing else does.
    write(&here.join("man1/pwrfgs-run.1"), page.replace("tensorboard", "?"));
    succeed(here, &["man", "--out", "man1"]);
    assert_eq!(std::fs::read_to_string(here.join("man1/pwrfgs-run.1")).unwrap(), page);
    write(&here.join("man1/pwrfgs-run.1"), "notes of mine\n");
    std::fs::remove_file(here.join("man1/pwrfgs.1")).unwrap();
    refuse(here, &["man", "--out", "man1"], 2, &["man1/pwrfgs-run.1", "not replaced", "--out"]);
    assert_eq!(std::fs::read_to_string(here.join("man1/pwrfgs-run.1")).unwrap(), "notes of mine\n");
    assert!(!here.join("man1/pwrfgs.1").exists(), "all or none");
}

#[test]
fn variant_sets_field_by_its_path() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    let sweep = |set: &str, variant: &str| {
        let text = format!(
            "Experiment(name: \"e\", base: \"p.ron\", set: {set}, axes: [
                Axis(name: \"start\", variants: [(label: \"a\", set: {{\"training.densify_until\": 45}}), {variant}]),
                Axis(name: \"later\", variants: [(label: \"b\", set: {{\"training.prune_until\": 50}})]),
            ])"
        );
        write(&here.join("e.ron"), text);
    };
    sweep(
        "{\"pruners.OpacityThreshold.epsilon\": 0.01}",
        "(label: \"0.05\", set: {\"pruners.LearnableMask.lambda\": 0.05, \"split\": Official(validation: 0.25)})",
    );
    let set = ["--scale", "0.04", "--set", "training.batch=1", "--set", "pruners.0.threshold=0.02"];
    // Axes are checked together, like `--set`: the first alone would densify for longer than the base prunes.
    succeed(here, &[&["sweep", "e.ron", "-q"][..], &set].concat());
    let pipeline = std::fs::read_to_string(here.join("runs/e/start=0.05,later=b,seed=0/pipeline.ron")).unwrap();
    for words in ["lambda: 0.05", "epsilon: 0.01", "threshold: 0.02", "validation: 0.25", "prune_until: 2,"] {
        assert!(pipeline.contains(words), "{words} is not in {pipeline}");
    }
    let refused = |variant: &str, words: &[&str]| {
        sweep("{}", variant);
        refuse(here, &["sweep", "e.ron", "--out", "x"], 2, words);
    };
    refused(
        "(label: \"c\", set: {\"pruners.TopK.score\": Opacity})",
        &["axis `start`, variant `c`", "no entry `TopK`"],
    );
    refused("(label: \"c\", set: {\"pruners.0.lambda\": -3})", &["axis `start`, variant `c`", "`lambda` is -3"]);
    refused("(label: \"c\", set: {\"seed\": 3})", &["e.ron:", "`seeds`"]);
    refused("(label: \"c\", set: {\"training.stepz\": 3})", &["e.ron:2:", "did you mean `steps`"]);
    refused("(label: \"c\", training: (steps: 3))", &["e.ron:2:", "`training`", "`set`"]);
    refused("(label: \"c\", set: {\"seed\": 3, \"seed\": 4})", &["e.ron:2:", "`seed` is given twice"]);
    // In a pipeline itself there is nothing to change.
    write(&here.join("q.ron"), SMALL.replacen("name:", "set: {}, name:", 1));
    refuse(here, &["run", "q.ron"], 2, &["q.ron:2:", "field named `set`"]);
}
