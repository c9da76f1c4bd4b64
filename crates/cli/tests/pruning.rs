//! Warnings and errors about pruning that removes nothing or too much.
use crate::common::{SMALL, refuse, stderr, stdout, succeed, write};
use std::path::Path;

/// Three strategies to as many Gaussians as there are at the start, and one to fewer.
const IDLE: &str = "Experiment(
    name: \"idle\", base: \"p.ron\", seeds: [0],
    set: {\"training.target_count\": 8},
    axes: [Axis(name: \"by\", variants: [
        (label: \"chance\", set: {\"pruners\": [RandomReference()]}),
        (label: \"light\", set: {\"pruners\": [LightGaussian()]}),
        (label: \"signal\", set: {\"pruners\": [SignalContribution()]}),
        (label: \"less\", set: {\"pruners\": [RandomReference()], \"training.target_count\": 3}),
    ])],
)";

/// `SMALL` without densification: 8 Gaussians from the first step on.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("p.ron"), SMALL.replace("every: 5, from: 5", "every: 0"));
    folder
}

fn gaussians(run: &Path) -> u64 {
    let facts: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(run.join("run.json")).unwrap()).unwrap();
    facts["gaussians"].as_u64().unwrap()
}

#[test]
fn reports_target_reached_at_start_and_marks_equal_models() {
    let folder = folder();
    let here = folder.path();
    write(&here.join("e.ron"), IDLE);
    let idle = "training.target_count is 8, but training starts with 8 Gaussians";
    let one = ["p.ron", "--set", "pruners=[LightGaussian()]", "--set"];
    let message = |command: &str, target: &str| stderr(&succeed(here, &[&[command][..], &one, &[target]].concat()));
    assert!(message("check", "training.target_count=8").contains(&format!("warning: pruners: {idle}")));
    assert!(!message("check", "training.target_count=7").contains("warning"));
    write(&here.join("both.ron"), "Experiment(name: \"both\", join: true, base: \"p.ron\", seeds: [0, 1])");
    let set = ["--set", "pruners=[LightGaussian()]", "--set", "training.target_count=8"];
    let both = |more: &[&str]| stderr(&succeed(here, &[&["sweep", "both.ron", "--dry-run"][..], &set, more].concat()));
    assert_eq!((both(&[]).matches(idle).count(), both(&["-q"]).matches(idle).count()), (1, 1));
    let run = message("run", "training.target_count=8");
    assert!(run.contains(idle) && run.contains("nothing was pruned: 8 Gaussians remain"), "{run}");

    let message = stderr(&succeed(here, &["sweep", "e.ron", "--dry-run"]));
    let warning = |by: &str| format!("warning: by={by},seed=0: pruners: {idle}");
    assert!(["chance", "light", "signal"].iter().all(|by| message.contains(&warning(by))), "{message}");
    let quiet = stderr(&succeed(here, &["sweep", "e.ron", "--dry-run", "-q"]));
    assert!(quiet.lines().all(|line| line.starts_with("warning: ")), "{quiet}");
    let table = stdout(&succeed(here, &["sweep", "e.ron", "-q"]));
    for words in ["light ≡ chance", "signal ≡ chance", "chance ≡ light ≡ signal: these variants have bit-identical"]
    {
        assert!(table.contains(words), "`{words}` is not in {table}");
    }
    assert!(!table.contains("≡ less") && !table.contains("less ≡"), "variants that differ are not marked: {table}");
    // One more seed of combinations that have finished.
    write(&here.join("e.ron"), IDLE.replace("seeds: [0]", "seeds: [0, 1]"));
    let message = stderr(&succeed(here, &["sweep", "e.ron", "--dry-run"]));
    assert!(message.contains("warning: by=chance,seed=1") && message.matches(idle).count() == 3, "{message}");
    let latex = std::fs::read_to_string(here.join("runs/idle/report/tables/1-scores.tex")).unwrap();
    let row = latex.lines().find(|line| line.starts_with("light ")).unwrap();
    assert!(row.contains("\\equiv") && !row.contains("\\textbf"), "a twin competes with nobody: {row}");
}

#[test]
fn reports_mask_that_cannot_close_in_time() {
    let folder = folder();
    let here = folder.path();
    let slow = ["p.ron", "--set", "pruners=[LearnableMask(learning_rate: 0.1)]"];
    let words = "a mask of `LearnableMask` needs about 128 steps to close and pruning ends after step 40";
    let message = stderr(&succeed(here, &[&["check"][..], &slow].concat()));
    assert!(message.contains(words), "{message}");
    let message = stderr(&succeed(here, &[&["run"][..], &slow].concat()));
    assert!(message.contains(words) && message.contains("nothing was pruned: 8 Gaussians remain"), "{message}");
    assert!(message.contains("masks closed 0 of 8 Gaussians, less than a tenth; raise λ"), "{message}");
    for (fast, target) in [("LearnableMask(learning_rate: 1.0)", 0), ("LearnableMask()", 3), ("OpacityThreshold()", 0)]
    {
        let set = [format!("pruners=[{fast}]"), format!("training.target_count={target}")];
        let message = stderr(&succeed(here, &["check", "p.ron", "--set", &set[0], "--set", &set[1]]));
        assert!(!message.contains("warning"), "{fast}: {message}");
    }
}

#[test]
fn warns_of_more_gaussians_than_trained_pixels() {
    let folder = folder();
    let fixed = ["check", "p.ron", "--set", "training.stride=4", "--set", "training.moving_stride=false"];
    let many = [&fixed[..], &["--set", "initializer.count=40"]].concat();
    let message = stderr(&succeed(folder.path(), &many));
    assert!(message.contains("40 Gaussians train on 36 of 576 pixels"), "{message}");
    for other in [&fixed[..], &[&many[..], &["--set", "training.moving_stride=true"]].concat()] {
        let message = stderr(&succeed(folder.path(), other));
        assert!(!message.contains("moving_stride"), "{message}");
    }
}

#[test]
fn shorter_training_still_prunes() {
    let folder = folder();
    let here = folder.path();
    let text = SMALL
        .replace("Grid(count: 8)", "Grid(count: 40)")
        .replace("every: 5, from: 5", "every: 0")
        .replace("lambda: 0.02, learning_rate: 0.1", "lambda: 0.1, learning_rate: 0.02")
        .replace("steps: 60", "steps: 1_200")
        .replace("prune_until: 40, prune_every: 10", "prune_until: 1_000, prune_every: 50");
    write(&here.join("p.ron"), text);
    let message = stderr(&succeed(here, &["run", "p.ron", "--scale", "0.25", "--out", "short"]));
    let said = ["nothing was pruned", "to close", "masks closed"];
    assert!(said.iter().all(|words| !message.contains(words)), "{message}");
    assert!(gaussians(&here.join("short")) < 40);
    let pipeline = std::fs::read_to_string(here.join("short/pipeline.ron")).unwrap();
    assert!(pipeline.contains("prune_until: 250") && pipeline.contains("learning_rate: 0.08"), "{pipeline}");
    assert!(pipeline.contains("validate_every: 30"), "ten times in 300 steps: {pipeline}");
    let samples = |scale: &str, out: &str, count: &str| {
        let count = format!("training.validation_samples={count}");
        succeed(
            here,
            &["run", "p.ron", "--scale", scale, "--set", &count, "--set", "training.steps=1000", "--out", out],
        );
        let pipeline = std::fs::read_to_string(here.join(out).join("pipeline.ron")).unwrap();
        let line = pipeline.lines().find(|line| line.contains("validation_samples")).unwrap();
        line.split(": ").nth(1).unwrap().trim_end_matches(',').parse::<usize>().unwrap()
    };
    assert_eq!(samples("0.25", "fewer", "300"), 75);
    assert_eq!(samples("0.1", "least", "300"), 50);
    assert_eq!(samples("0.1", "few", "20"), 20, "as many as the pipeline has");
    let output = succeed(here, &["check", "p.ron", "--scale", "0.05", "--set", "pruners.LearnableMask.lambda=0.02"]);
    let (tiny, plan) = (stderr(&output), stdout(&output));
    assert!(
        plan.contains("at this lambda, 0.02, the paper keeps 0.08 % of 190,000 points, which is less than one of"),
        "{plan}"
    );
    assert!(tiny.contains("needs about 128 steps to close and pruning ends after step 50"), "{tiny}");
}

#[test]
fn reports_rule_that_removes_more_than_half() {
    let folder = folder();
    let here = folder.path();
    let message = stderr(&succeed(
        here,
        &["run", "p.ron", "-q", "--set", "pruners=[TopK()]", "--set", "training.target_count=3"],
    ));
    assert!(message.contains("step 30 removed 5 of 8 Gaussians (`TopK`: 5)"), "{message}");
}

#[test]
fn training_stops_if_one_gaussian_remains() {
    let folder = folder();
    let here = folder.path();
    let size = "training.densify=(every: 5, from: 5, large_above: 0.0001, large_after: 10)";
    let run =
        |out: &'static str, more: &[&'static str]| [&["run", "p.ron", "--set", size, "--out", out][..], more].concat();
    let message = stderr(&succeed(here, &["check", "p.ron", "--set", size]));
    assert!(
        message.contains("8 of 8 Gaussians start larger than `large_above`") && message.contains("at step 15"),
        "{message}"
    );
    refuse(
        here,
        &run("r", &[]),
        1,
        &["one Gaussian is left at step 15", "`large_above`, 0.00 m: ", "extent_m", "max_gaussians"],
    );
    assert!(!here.join("r/model.safetensors").exists());
    succeed(here, &run("asked", &["--set", "training.target_count=1"]));
    succeed(here, &run("alone", &["--set", "initializer=Grid(count: 1)"]));
    // Masks that close are a result; a rule that leaves one is none.
    let pruned = |out: &'static str, pruners: &'static str| ["run", "p.ron", "--out", out, "--set", pruners];
    succeed(here, &pruned("masked", "pruners=[LearnableMask(lambda: 1000, learning_rate: 1.0)]"));
    assert_eq!(gaussians(&here.join("masked")), 1);
    let rule = "pruners=[LearnableMask(), OpacityThreshold(epsilon: 0.99)]";
    refuse(here, &pruned("rule", rule), 1, &["one Gaussian is left at step", "removed by `OpacityThreshold`: 8"]);
}

#[test]
fn densification_that_removes_nearly_all_ends_the_run_and_keeps_its_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let text = SMALL.replace("Grid(count: 8)", "Random(count: 60, std: 2.0)").replace("every: 5, from: 5", "DENSIFY");
    let settings = "training.checkpoint_every=5";
    for (name, densify, said) in [
        // The largest of 60 scales is far from the others, so that more than one and less than 5 % stay.
        (
            "size",
            "every: 5, from: 5, large_after: 10, max_gaussians: 60, extent_m: EXTENT",
            ["`large_above`", "extent_m", "max_gaussians"],
        ),
        (
            "faint",
            "every: 5, from: 5, large_above: 0, max_gaussians: 60, opacity_floor: 0.5",
            ["`opacity_floor`", "0.5", "reset_opacity"],
        ),
    ] {
        let pipeline = format!("{name}.ron");
        write(&here.join(&pipeline), text.replace("DENSIFY", densify).replace("EXTENT", "0.5"));
        let run = ["run", &pipeline, "--set", settings, "--out", name];
        refuse(here, &run, 1, &[&said[..], &["left at step"]].concat());
        let checkpoint = std::fs::read(here.join(name).join("checkpoint.safetensors")).unwrap();
        refuse(here, &run, 1, &said);
        assert_eq!(std::fs::read(here.join(name).join("checkpoint.safetensors")).unwrap(), checkpoint);
    }
}

#[test]
fn validation_in_the_step_of_an_opacity_reset_precedes_it() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let rows = |reset: &str| {
        let densify = format!("every: 0, reset_every: {reset}");
        let name = format!("reset-{reset}");
        write(&here.join("p.ron"), SMALL.replace("every: 5, from: 5", &densify));
        let set = ["training.validate_every=10", "training.densify_until=30", "training.prune_until=40"];
        let run = ["run", "p.ron", "--out", &name, "--set", set[0], "--set", set[1], "--set", set[2]];
        succeed(here, &run);
        let rows = std::fs::read_to_string(here.join(name).join("validation.csv")).unwrap();
        rows.lines().skip(1).map(str::to_owned).collect::<Vec<_>>()
    };
    let (reset, never) = (rows("20"), rows("0"));
    assert_eq!(reset[..2], never[..2], "steps 10 and 20");
    assert_ne!(reset[2], never[2], "step 30 follows the reset");
}

#[test]
fn run_whose_masks_leave_one_gaussian_names_lambda_and_scale() {
    let folder = folder();
    let run = |pruner: &str| stderr(&succeed(folder.path(), &["run", "p.ron", "--set", pruner, "--out", &pruner[9..]]));
    let message = run("pruners=[LearnableMask(lambda: 1000, learning_rate: 0.3)]");
    let words = "masks closed all but one of 8 Gaussians: λ decides a share of the start";
    assert!(message.contains(words) && message.contains("larger --scale"), "{message}");
    assert!(!run("pruners=[OpacityThreshold()]").contains("all but one"));
}
