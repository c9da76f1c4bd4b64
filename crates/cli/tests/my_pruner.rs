//! The plugins of `examples`, outside this workspace: built, tested, and used by name.
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").canonicalize().unwrap()
}

/// Where cargo builds the workspace under test: `CARGO_TARGET_TMPDIR` is the folder `tmp` in it.
fn target() -> &'static Path {
    Path::new(env!("CARGO_TARGET_TMPDIR")).parent().unwrap()
}

/// Cargo at work in the example, as the one that runs this test: the same versions of all crates, hence without
/// network; the same target folder and settings, so that no crate of others is compiled again. Those of pwrfgs are,
/// since to another workspace they are other packages: unoptimised, for the runs here are small.
fn cargo(example: &Path, command: &str) -> Output {
    let mut cargo = Command::new(std::env::var("CARGO").unwrap_or_else(|_| env!("CARGO").into()));
    cargo.args([command, "--offline"]).current_dir(example).env("CARGO_TARGET_DIR", target());
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    for name in std::fs::read_dir(root().join("crates")).unwrap().map(|entry| entry.unwrap().file_name()) {
        cargo.args(["--config", &format!("profile.dev.package.pwrfgs-{}.opt-level=0", name.display())]);
    }
    cargo.args(["--config", "profile.dev.package.pwrfgs.opt-level=0"]);
    let output = cargo.output().unwrap();
    assert!(
        output.status.success(),
        "cargo {command}: {}{}",
        crate::common::stdout(&output),
        crate::common::stderr(&output)
    );
    output
}

#[test]
fn plugins_page_matches_example_crate() {
    let read = |name: &str| std::fs::read_to_string(root().join(name)).unwrap();
    let page = read("docs/plugins.md");
    let main = read("examples/my-pruner/src/main.rs");
    assert!(page.contains(&format!("```rust,ignore\n{main}```")), "docs/plugins.md has another main.rs");
}

#[test]
fn example_plugin_is_swept_by_name() {
    let example = root().join("examples/my-pruner");
    let (tested, program) = built("my-pruner");
    assert!(tested.contains("gate_derivative_has_closed_form ... ok"), "{tested}");
    assert!(tested.contains("gumbel_mask::GumbelMask (line"), "its manual page is tested: {tested}");

    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let output = Command::new(&program).args(arguments).current_dir(folder.path()).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", crate::common::stderr(&output));
        crate::common::stdout(&output)
    };
    let listed = run(&["plugins", "GumbelMask"]);
    assert!(listed.contains("Pruner (field `pruners`)") && listed.contains("temperature: 0.5"), "{listed}");
    assert!(listed.contains("// Temperature of the relaxation"), "its comments are printed: {listed}");

    // The shipped sweep, as it stands and then as small as it can be.
    let file = |name: &str| example.join(name).to_str().unwrap().to_owned();
    assert!(run(&["sweep", &file("sweep.ron"), "--dry-run"]).contains("mask=gumbel"));
    let set: Vec<&str> = SMALL.iter().flat_map(|s| ["--set", s]).collect();
    run(&[&["sweep", &file("sweep.ron"), "--out", "s"][..], &set].concat());
    for name in ["mask=gumbel,seed=0", "mask=gumbel,seed=1", "mask=learnable,seed=0", "mask=learnable,seed=1"] {
        let done = folder.path().join("s").join(name);
        let pipeline = std::fs::read_to_string(done.join("pipeline.ron")).unwrap();
        assert_eq!(pipeline.contains("GumbelMask("), name.contains("gumbel"), "{name}");
        let scores = std::fs::read_to_string(done.join("scores.csv")).unwrap();
        assert!(scores.lines().any(|l| l.starts_with("model,ssim,")), "{name}");
        assert!(curve(&done).iter().take(40).all(|(penalty, _)| *penalty > 0.0), "{name}");
    }
    // Under pressure gates fall shut for good; what is left then is the model, without a trace of the column.
    let hard = ["--set", "pruners=[GumbelMask(lambda: 0.3, learning_rate: 0.13)]", "--out", "r"];
    run(&[&["run", &file("gumbel.ron")][..], &set, &hard].concat());
    let counts: Vec<usize> = curve(&folder.path().join("r")).iter().map(|(_, n)| *n).collect();
    assert!(counts[0] == 30 && (1..30).contains(&counts[39]), "{counts:?}");
    assert!(counts[39..].iter().all(|n| *n == counts[39]), "{counts:?}");
    let model = pwrfgs::model::file::read(&folder.path().join("r/model.safetensors")).unwrap();
    assert_eq!((model.cloud.len(), model.cloud.extra.len()), (counts[39], 0));
}

#[test]
fn published_pruners_work_outside_the_workspace() {
    let (tested, program) = built("more-pruners");
    assert!(tested.contains("training_reaches_exact_target_and_resumes_bit_identically ... ok"), "{tested}");
    for name in ["FastGs", "Reduced3dgs"] {
        assert!(tested.contains(&format!("- {name} (line")), "its manual page is tested: {tested}");
        let output = Command::new(&program).args(["plugins", name]).output().unwrap();
        assert!(crate::common::stdout(&output).contains("Pruner (field `pruners`)"), "{name}");
    }
}

/// Builds and tests an example. Returns what its tests print, and its program.
fn built(name: &str) -> (String, PathBuf) {
    let example = root().join("examples").join(name);
    // Cargo takes the versions from here and writes back what the example needs of them; git ignores the file.
    std::fs::copy(root().join("Cargo.lock"), example.join("Cargo.lock")).unwrap();
    cargo(&example, "build");
    let tested = crate::common::stdout(&cargo(&example, "test"));
    let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
    (tested, target().join(profile).join(name))
}

/// Sixty steps, pruned up to step 40.
const SMALL: [&str; 6] = [
    "data=Teacher(gaussians: 4, samples: 40, width: 48, height: 12)",
    "split=Official(validation: 0.2)",
    "initializer=Grid(count: 30)",
    "deformation=Mlp(depth: 2, width: 16, skip: None)",
    "training=(steps: 60, batch: 2, densify_until: 10, prune_until: 40, prune_every: 10, validate_every: 0)",
    "metrics=[Ssim(), GaussianCount()]",
];

/// Penalty and number of Gaussians at each step of a run.
fn curve(run: &Path) -> Vec<(f64, usize)> {
    let text = std::fs::read_to_string(run.join("curve.csv")).unwrap();
    let row = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        (fields[3].parse().unwrap(), fields[4].parse().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}
