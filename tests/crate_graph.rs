//! Plugin crates see `core` and what they take by default; training sees no plugin; `pipeline` joins the two sides.
use serde_json::Value;
use std::process::Command;

#[test]
fn crates_depend_on_each_other_as_drawn() {
    let allowed: &[(&str, &[&str])] = &[
        ("core", &[]),
        ("raster", &["core"]),
        ("init", &["core"]),
        ("foreign", &["core"]),
        ("coherent", &["core"]),
        ("nerf2", &["core", "layers"]),
        ("prune", &["core"]),
        ("metrics", &["core"]),
        ("data", &["core"]),
        ("waves", &[]),
        ("sim", &["core", "data", "waves"]),
        ("layers", &["core"]),
        ("model", &["core", "layers", "raster"]),
        ("train", &["core", "model"]),
        ("pipeline", &["core", "data", "init", "metrics", "model", "raster", "train"]),
        ("experiment", &["core", "model", "pipeline", "train"]),
        ("canvas", &[]),
        ("live", &["core", "experiment", "model"]),
        ("report", &["canvas", "core", "experiment", "live", "model", "pipeline", "train"]),
        ("view", &["canvas", "core", "experiment", "live", "model", "pipeline", "report", "train"]),
    ];
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut seen = 0;
    for package in metadata["packages"].as_array().unwrap() {
        let Some(name) = package["name"].as_str().unwrap().strip_prefix("pwrfgs-") else { continue };
        let Some((_, allowed)) = allowed.iter().find(|(n, _)| *n == name) else { continue };
        seen += 1;
        for dependency in package["dependencies"].as_array().unwrap() {
            // Tests may link what they like.
            if dependency["kind"] == "dev" {
                continue;
            }
            if let Some(other) = dependency["name"].as_str().unwrap().strip_prefix("pwrfgs-") {
                assert!(allowed.contains(&other), "pwrfgs-{name} depends on pwrfgs-{other}");
            }
        }
    }
    assert_eq!(seen, allowed.len());
}
