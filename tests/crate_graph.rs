//! The hourglass: plugin crates see `core` alone, and nothing but the facade joins the two sides.
use serde_json::Value;
use std::process::Command;

#[test]
fn crates_depend_on_each_other_as_drawn() {
    let allowed: &[(&str, &[&str])] = &[
        ("macros", &[]),
        ("core", &["macros"]),
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
        ("model", &["core", "layers"]),
        ("train", &["core", "model"]),
        ("experiment", &["core", "model", "train"]),
        ("canvas", &[]),
        ("live", &["core", "experiment", "model"]),
        ("report", &["canvas", "core", "experiment", "live", "model", "train"]),
        ("view", &["canvas", "core", "experiment", "live", "model", "report", "train"]),
        ("inspect", &["core", "experiment", "report", "train"]),
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
