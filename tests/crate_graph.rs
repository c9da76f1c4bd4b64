//! Plugin crates see `core` and what they take by default; training sees no plugin; `pipeline` joins the two sides.
use serde_json::Value;
use std::process::Command;

#[test]
fn crates_depend_on_each_other_as_drawn() {
    let allowed: &[(&str, &[&str])] = &[
        ("core", &[]),
        ("raster", &["core"]),
        ("networks", &["core"]),
        ("init", &["core"]),
        ("prune", &["core"]),
        ("metrics", &["core"]),
        ("data", &["core"]),
        ("model", &["core"]),
        ("methods", &["core", "networks", "raster"]),
        ("raytrace", &["core", "data"]),
        ("train", &["core", "model"]),
        ("pipeline", &["core", "data", "init", "methods", "metrics", "model", "networks", "raster", "train"]),
        ("experiment", &["core", "model", "pipeline", "train"]),
        ("report", &["core", "experiment", "model", "pipeline", "train"]),
        ("viewer", &["core", "experiment", "model", "pipeline", "report", "train"]),
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
