//! `--set` and `set` of sweeps: valid changes in any order, and errors.
use pwrfgs::prelude::*;
use std::path::Path;

const BASE: &str = r#"Pipeline(
    name: "small",
    data: Nerf2Spectrum(root: "data"),
    initializer: Grid(count: 8),
    pruners: [LearnableMask(lambda: 0.02), OpacityThreshold()],
    training: (steps: 60, densify_until: 20, prune_until: 40),
)"#;

fn base() -> Pipeline {
    Pipeline::parse(BASE, Path::new("base.ron")).unwrap()
}

/// The lines of the pipeline that these arguments change, without spaces.
fn changed(arguments: &[&str]) -> Vec<String> {
    let mut pipeline = base();
    pipeline.set_all(arguments).unwrap_or_else(|e| panic!("{arguments:?}: {e}"));
    let before = base().to_ron().unwrap();
    let before: Vec<&str> = before.lines().collect();
    pipeline.to_ron().unwrap().lines().filter(|l| !before.contains(l)).map(|l| l.trim().to_owned()).collect()
}

fn refused(arguments: &[&str]) -> String {
    let mut pipeline = base();
    let message = pipeline.set_all(arguments).unwrap_err().to_string();
    assert_eq!(pipeline.to_ron().unwrap(), base().to_ron().unwrap(), "a refused change changes nothing");
    for internal in ["Misfit", "Checked"] {
        assert!(!message.contains(internal), "{message}");
    }
    message
}

#[test]
fn changes_are_validated_together_after_last_change() {
    let both = ["training.densify_until=500", "training.prune_until=2000"];
    let lines = ["densify_until: 500,", "prune_until: 2000,"];
    assert_eq!(changed(&both), lines);
    assert_eq!(changed(&[both[1], both[0]]), lines);
    let message = refused(&["training.batch=3", "training.densify_until=500"]);
    assert!(
        message.starts_with("--set training.batch=3 and --set training.densify_until=500: `prune_until` is below"),
        "{message}"
    );
    let message = refused(&["training.prune_until=30", "training.densify_until=35"]);
    assert!(message.starts_with("--set training.prune_until=30 and --set training.densify_until=35: "), "{message}");
}

#[test]
fn every_setting_has_path() {
    assert_eq!(changed(&["pruners.LearnableMask.lambda=0.05"]), ["lambda: 0.05,"]);
    assert_eq!(changed(&["pruners.0.lambda=0.05"]), ["lambda: 0.05,"]);
    assert_eq!(changed(&["initializer.count=500"]), ["count: 500,"]);
    assert_eq!(changed(&["initializer.Grid.count=500"]), ["count: 500,"]);
    assert_eq!(changed(&["training.optimizer.means.first=0.01"]), ["first: 0.01,"]);
    assert_eq!(changed(&["training=(batch: 2, densify: (every: 6))"]), ["batch: 2,", "every: 6,"]);
    assert_eq!(changed(&["deformation=(width: 32)"]), ["width: 32,"]);
    assert_eq!(changed(&["seed=18446744073709551615"]), ["seed: 18446744073709551615,"], "no digit is lost");
    assert_eq!(changed(&["readout=MinMax", " tensorboard = true "]), ["readout: MinMax,", "tensorboard: true,"]);
    assert!(changed(&[]).is_empty());
}

#[test]
fn quotes_around_set_values_are_optional() {
    assert_eq!(changed(&["data.root=own/a"]), ["root: \"own/a\","]);
    assert_eq!(changed(&["data.root=\"own/a\""]), ["root: \"own/a\","]);
    assert_eq!(changed(&[r"data.root=C:\own"]), [r#"root: "C:\\own","#]);
    assert_eq!(changed(&["data.points=room.ply"]), ["points: \"room.ply\","]);
    assert!(changed(&["data.points=None"]).is_empty());
    assert_eq!(changed(&["name=b-1"]), ["name: \"b-1\","]);
    assert_eq!(changed(&["split=Random", "split.test=0.3"]), ["split: Random(", "test: 0.3,"]);
    assert_eq!(changed(&["split=Random()"]), ["split: Random(", "test: 0.2,"]);
    assert_eq!(changed(&["pruners=[TopK()]", "training.target_count=5", "pruners.TopK.score=Opacity"]).len(), 3);
}

#[test]
fn invalid_changes_list_valid_alternatives() {
    let cases: [(&str, &[&str]); 21] = [
        ("training.steps", &["path.to.field=value"]),
        ("training.step=5", &["`training` has no field `step`", "did you mean `steps`?"]),
        ("steps=5", &["a pipeline has no field `steps`", "did you mean `training.steps`?"]),
        ("lambda=0.1", &["a pipeline has no field `lambda`", "did you mean `pruners.LearnableMask.lambda`?"]),
        ("trainin.steps=5", &["a pipeline has no field `trainin`", "did you mean `training`?"]),
        ("pruners.LearnableMask.lamda=1", &["LearnableMask", "did you mean `lambda`?"]),
        ("pruners.LearnedMask.lambda=1", &["did you mean `LearnableMask`?", "give the complete list"]),
        ("pruners.2.lambda=1", &["2 entries"]),
        ("baselines.NearestNeighbours.k=2", &["3 entries", "`baselines.2`"]),
        ("initializer.max_points=5", &["`initializer` is Grid", "'initializer=PointCloud(max_points: ..)'"]),
        ("training.steps.x=1", &["`training.steps` has no fields"]),
        ("split=Randm", &["did you mean `Random`?"]),
        ("readout=MinMx", &["did you mean `MinMax`?"]),
        ("training=(stepz: 5)", &["did you mean `steps`?"]),
        ("training=Training(stepz: 5)", &["did you mean `steps`?"]),
        ("training.steps=((", &["is not a value"]),
        ("training.steps=many", &["integer", "it takes a whole number"]),
        ("initializer.count=-5", &["it takes a whole number"]),
        ("training.optimizer.network=0.001", &["`0.001` found, expected a name; it takes a Schedule"]),
        ("pruners=TopK()", &["it takes a list of Pruner"]),
        ("pruners.0.lambda=-1", &["`lambda` is -1"]),
    ];
    for (argument, words) in cases {
        let message = refused(&[argument]);
        assert!(message.starts_with(&format!("--set {argument}: ")), "{message}");
        assert!(
            words.iter().all(|word| message.to_lowercase().contains(&word.to_lowercase())),
            "{argument}: {message}"
        );
    }
    let long = refused(&[&format!("name=({}", "x".repeat(1_000_000))]);
    assert!(long.len() < 1000, "an argument is not repeated at any length");
    refused(&[&format!("pruners={}", "[".repeat(100_000))]);
}

#[test]
fn change_arguments_never_panic() {
    let paths =
        ["training", "pruners", "pruners.0.lambda", "data.root", "split", "data", "name", "baselines.1", "readout"];
    let pieces = [
        "(",
        ")",
        "[",
        "]",
        "{",
        "}",
        ",",
        ":",
        "\"",
        "'",
        "\\",
        "r#\"",
        "\"#",
        "b\"",
        "//",
        "/*",
        "*/",
        "Some(",
        "None",
        "5",
        "-inf",
        "1e999",
        "steps",
        "lambda: 1",
        "TopK",
        "Random",
        "é",
        " ",
        "\n",
        ".",
        "=",
        "\u{0}",
        "#![enable(x)]",
        "r#type",
    ];
    let random = &mut rng::stream(0, "arguments", 0);
    let mut pick = |n: usize| rng::below(random, n);
    for _ in 0..2000 {
        let mut argument = format!("{}=", paths[pick(paths.len())]);
        (0..pick(8)).for_each(|_| argument += pieces[pick(pieces.len())]);
        let mut pipeline = base();
        if pipeline.set(&argument).is_ok() {
            let text = pipeline.to_ron().unwrap();
            let again = Pipeline::parse(&text, Path::new("again.ron")).unwrap_or_else(|e| panic!("{argument:?}: {e}"));
            assert_eq!(again.to_ron().unwrap(), text, "{argument:?}");
        }
    }
}

#[test]
#[cfg(unix)]
fn refuses_to_write_path_that_is_not_text() {
    let root = <std::ffi::OsStr as std::os::unix::ffi::OsStrExt>::from_bytes(b"\xff").into();
    let data: Box<dyn DataSource> = Box::new(pwrfgs_data::Nerf2Spectrum { root, ..Default::default() });
    let mut pipeline = Pipeline { data: data.into(), ..base() };
    for refused in [pipeline.to_ron().unwrap_err(), pipeline.set("seed=2").unwrap_err()] {
        assert!(refused.to_string().contains("this pipeline cannot be written as text: "), "{refused}");
    }
}
