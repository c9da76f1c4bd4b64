//! `pwrfgs plan` and `pwrfgs place`: files, table, and messages about invalid input.

#![cfg(all(feature = "report", feature = "raytrace"))]

use crate::common::{copy_small_run, measured, refuse, stdout, succeed, write};
use pwrfgs::data::save;
use pwrfgs_core::{Dataset, Observations, Pose, Real, Receiver, Sample};
use std::path::Path;

/// Empty room with smooth walls.
const BOX: &str = r#"(
    name: "box",
    carrier_hz: 2.4e9,
    room: (
        outline: Box(low: (0, 0, 0), high: (8, 6, 3)),
        walls: (material: "plasterboard", thickness_m: 0.1),
        floor: (material: "concrete", thickness_m: 0.25),
        ceiling: (material: "ceiling_board", thickness_m: 0.02),
    ),
    receiver: (position: (1, 1, 2.9), orientation: Facing(direction: (0, 0, -1)), array: (rows: 4, columns: 4)),
    transmitter: (positions: Uniform(low: (2, 2, 1), high: (5, 4, 1.4)), polarization: (0, 1, 0)),
    propagation: (order: 1, room_order: 1),
)"#;
/// Scene without surfaces.
const OPEN: &str = r#"(
    name: "open",
    carrier_hz: 2.4e9,
    receiver: (position: (1, 1, 2.9), orientation: Facing(direction: (0, 0, -1))),
    transmitter: (positions: Uniform(low: (2, 2, 1), high: (5, 4, 1.4))),
)"#;

const NEW: &str = "x,y,z\n0.1,1.1,0.5\n0.3,1.2,0.5\n0.5,1.1,0.5\n";

#[test]
fn many_candidates_are_thinned_to_the_farthest() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let row = |k: usize| format!("{},{},0.5\n", (k % 150) as f64 * 0.01, (k / 150) as f64 * 0.01);
    write(&here.join("many.csv"), format!("x,y,z\n{}", (0..20_100).map(row).collect::<String>()));
    let line = ["plan", "data", "--candidates", "many.csv", "--length-scale", "0.5", "--count"];
    let output = stdout(&succeed(here, &[&line[..], &["2"]].concat()));
    assert!(output.contains("20,100 candidates, 6 known measurements"), "{output}");
    assert!(output.contains("selected among 20,000 candidates, the farthest from each other"), "{output}");
    let list = std::fs::read_to_string(here.join("plan/plan.csv")).unwrap();
    for line in list.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(row(cells[1].parse::<usize>().unwrap() - 1).trim(), cells[2..5].join(","), "{list}");
    }
    refuse(
        here,
        &[&line[..], &["20001", "--out", "b"]].concat(),
        2,
        &["--count 20001: a plan has at most 20,000 positions"],
    );
}

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
    assert!(
        output.contains("0 known measurements") && output.contains("length scale 1.720 m (assumed: a fifth"),
        "{output}"
    );
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
        (
            &["data", "--candidates", "far.csv", "--count", "1"],
            &["far.csv", "m from the nearest known measurement, and", "in one frame"],
        ),
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

/// Received powers of 30 transmitters on a line at three receivers, each strong near one of them.
fn powers(here: &Path) {
    let at = |k: usize| [0.2 * k as f64, 1.0, 1.0];
    let receiver = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.0], ..Pose::IDENTITY });
    let receivers = [("west", 0.0), ("middle", 3.0), ("east", 6.0)];
    let pairs: Vec<(usize, usize)> =
        (0..30).flat_map(|k| (0..3).map(move |r| (k, r))).filter(|p| *p != (0, 2)).collect();
    let samples: Vec<Sample> =
        pairs.iter().map(|&(k, receiver)| Sample { receiver, ..Sample::new(k as u32, at(k)) }).collect();
    let power = |&(k, r): &(usize, usize)| (-40.0 - 5.0 * (at(k)[0] - receivers[r].1).abs()) as Real;
    let observations = Observations::Powers(pairs.iter().map(power).collect());
    let receivers = receivers.map(|(name, x)| receiver(name, x)).to_vec();
    let data = Dataset::of_links("line", receivers, vec![], &samples, observations).unwrap();
    save(&data, &here.join("powers")).unwrap();
}

#[test]
fn place_selects_receivers_of_measured_powers() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    powers(here);
    let mut lists = Vec::new();
    for (threads, out) in [("1", "a"), ("2", "b")] {
        let line = ["place", "powers", "--count", "1", "--threads", threads, "--out", out];
        let output = stdout(&succeed(here, &line));
        for words in [
            "exhaustive",
            "greedy",
            "random, mean of 100 (seed 0)",
            "all 3 receivers",
            "24 training and 6 held-out transmitters (random split, seed 0)",
            "1 of 90 links are missing and count as −69.0",
            "exhaustive choice: middle",
        ] {
            assert!(output.contains(words), "{words} is not in: {output}");
        }
        lists.push(std::fs::read_to_string(here.join(out).join("place.csv")).unwrap());
        assert!(image::open(here.join(out).join("place.png")).unwrap().width() > 500);
    }
    assert_eq!(lists[0], lists[1]);
    assert!(
        lists[0].starts_with("choice,order,receiver,x,y,z,coverage_dbm\nexhaustive,1,middle,3,0,2,-"),
        "{}",
        lists[0]
    );
}

#[test]
fn place_searches_positions_in_simulated_scene() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("box.ron"), BOX);
    let mut lists = Vec::new();
    for (threads, out) in [("1", "a"), ("2", "b")] {
        let line = ["place", "box.ron", "--count", "1", "--step", "0.8", "--threads", threads, "--out", out];
        let output = stdout(&succeed(here, &line));
        for words in [
            "ascent",
            "grid, exhaustive",
            "random, mean of 100",
            "links traced",
            "simulated power",
            "the ascent minus the grid: ",
        ] {
            assert!(output.contains(words), "{words} is not in: {output}");
        }
        lists.push(std::fs::read_to_string(here.join(out).join("place.csv")).unwrap());
    }
    assert_eq!(lists[0], lists[1]);
    let ascent = lists[0].lines().nth(1).unwrap();
    let cells: Vec<&str> = ascent.split(',').collect();
    let [x, y] = [3, 4].map(|k| cells[k].parse::<f64>().unwrap());
    assert!((x - 4.0).abs() < 1.5 && (y - 3.0).abs() < 1.5, "{ascent}");
    let quick = ["place", "box.ron", "--count", "2", "--step", "1.5", "--no-grid", "--mount", "2", "--out", "quick"];
    let output = stdout(&succeed(here, &quick));
    assert!(!output.contains("grid"), "{output}");
}

#[test]
fn place_rejects_invalid_input_with_advice() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    powers(here);
    write(&here.join("box.ron"), BOX);
    write(&here.join("open.ron"), OPEN);
    std::fs::create_dir(here.join("nothing")).unwrap();
    let cases: &[(&[&str], &[&str])] = &[
        (&["powers", "--count", "0"], &["--count 0", "at least 1"]),
        (&["powers", "--count", "4"], &["--count 4", "3 receivers"]),
        (&["box.ron", "--count", "4"], &["--count 4", "at most 3"]),
        (&["box.ron", "--count", "1", "--step", "0"], &["grid step", "0.25"]),
        (&["box.ron", "--count", "1", "--height", "9"], &["height of 9 m", "give one inside"]),
        (&["box.ron", "--count", "1", "--mount", "-1"], &["height of -1 m", "give one inside"]),
        (&["box.ron", "--count", "3", "--step", "9"], &["1 receiver position", "smaller --step"]),
        (&["open.ron", "--count", "1"], &["scene is empty", "give it a `room`"]),
        (&["data", "--count", "1"], &["data: the data have no received powers", "name data"]),
        (&["nothing", "--count", "1"], &["no data found", "docs/data.md"]),
        (&["missing", "--count", "1"], &["missing"]),
    ];
    for (arguments, words) in cases {
        refuse(here, &[&["place"], *arguments].concat(), 2, words);
        assert!(!here.join("place").exists(), "{arguments:?} leaves no folder");
    }
}
