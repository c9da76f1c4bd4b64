//! `pwrfgs plan`: files, table, and messages about invalid input.

#![cfg(all(feature = "report", feature = "raytrace"))]

use crate::common::{copy_small_run, measured, refuse, stdout, succeed, write};

const NEW: &str = "x,y,z\n0.1,1.1,0.5\n0.3,1.2,0.5\n0.5,1.1,0.5\n";

#[test]
fn plan_writes_order_and_picture_and_prints_other_choices() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let output = stdout(&succeed(here, &["plan", "data", "--simulate", "--count", "2", "--seed", "3"]));
    for words in [
        "mean variance",
        "SSIM",
        "least integrated",
        "every k-th",
        "random (seed 3)",
        "largest variance",
        "6 candidates",
    ] {
        assert!(output.contains(words), "{words} is not in: {output}");
    }
    let text = |name: &str| std::fs::read_to_string(here.join(name)).unwrap();
    let list = text("plan/plan.csv");
    assert!(list.starts_with("order,candidate,x,y,z,mean_variance\n1,3,0.3,1,0.5,0."), "{list}");
    assert_eq!(list.lines().count(), 3);
    let picture = image::open(here.join("plan/plan.png")).unwrap();
    assert!(picture.width() > 500);

    write(&here.join("new.csv"), NEW);
    for (threads, out) in [("1", "a"), ("2", "b")] {
        let line = ["plan", "data", "--candidates", "new.csv", "--count", "3", "--threads", threads, "--out", out];
        let output = stdout(&succeed(here, &line));
        assert!(output.contains("3 candidates, 6 known measurements") && !output.contains("SSIM"), "{output}");
    }
    assert_eq!(text("a/plan.csv"), text("b/plan.csv"));
}

#[test]
fn plan_takes_models_and_floors() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    copy_small_run(here, "run");
    write(&here.join("new.csv"), NEW);
    succeed(here, &["plan", "run", "--candidates", "new.csv", "--count", "1", "--out", "next"]);
    refuse(here, &["plan", "run", "--count", "1", "--out", "no"], 2, &["a model has no candidates", "--candidates"]);
    let floor = ["plan", "--floor", "office", "--step", "1", "--count", "4", "--out", "floor"];
    let output = stdout(&succeed(here, &floor));
    assert!(output.contains("0 known measurements") && output.contains("length scale 1.720 m"), "{output}");
    refuse(here, &["plan", "--floor", "office", "--step", "0", "--count", "4"], 2, &["scene `office`", "step"]);
}

#[test]
fn plan_rejects_invalid_input_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    write(&here.join("far.csv"), "x,y,z\n9000,0,0\n");
    write(&here.join("nan.csv"), "x,y,z\nNaN,0,0\n");
    write(&here.join("empty.csv"), "x,y,z\n");
    std::fs::create_dir(here.join("nothing")).unwrap();
    let cases: &[(&[&str], &[&str])] = &[
        (&["data", "--count", "0"], &["--count 0", "at least 1"]),
        (&["data", "--count", "7"], &["--count 7", "6 candidates"]),
        (&["data", "--count", "2", "--region", "5,6,5,6"], &["no candidate inside", "x from 0.1000 to 0.6000"]),
        (&["data", "--count", "2", "--region", "5,6"], &["--region 5,6", "x0,x1,y0,y1"]),
        (&["data", "--count", "2", "--length-scale", "0"], &["--length-scale 0"]),
        (&["data", "--candidates", "far.csv", "--count", "1"], &["far.csv", "in one frame"]),
        (&["data", "--candidates", "nan.csv", "--count", "1"], &["nan.csv", "NaN"]),
        (&["data", "--candidates", "empty.csv", "--count", "1"], &["empty.csv", "no row"]),
        (&["nothing", "--count", "1"], &["name a data folder"]),
        (&["data", "--simulate", "--candidates", "far.csv", "--count", "1"], &["--simulate"]),
        (&["--count", "1"], &["SOURCE"]),
    ];
    for (arguments, words) in cases {
        refuse(here, &[&["plan"], *arguments].concat(), 2, words);
        assert!(!here.join("plan").exists(), "{arguments:?} leaves no folder");
    }
}
