//! Data in wrong units or wrong order: every command that loads them warns once, with the next step.

use crate::common::{SMALL, refuse, stderr, stdout, succeed, write};
use pwrfgs::data::{npy_header, save};
use pwrfgs_core::{Dataset, Number, Observations, Pose, Real, Receiver, Sample};
use std::path::Path;

const COUNT: usize = 60;

/// A hall of 10 m by 6 m, metres and dBm.
fn hall() -> (Vec<[f64; 3]>, Vec<f64>) {
    let positions: Vec<[f64; 3]> =
        (0..COUNT).map(|k| [(k * 7 % 60) as f64 / 6.0, (k * 11 % 60) as f64 / 10.0, 1.0]).collect();
    let power = |p: &[f64; 3]| -40.0 - 10.0 * (1.0 + p[0] * p[0] + p[1] * p[1]).log10();
    let powers = positions.iter().map(power).collect();
    (positions, powers)
}

/// A folder of powers, a third of them the test set, and a pipeline beside it.
fn powers(here: &Path, name: &str, (positions, powers): (Vec<[f64; 3]>, Vec<f64>), is_swapped: bool) {
    let samples: Vec<Sample> = (0..).zip(positions).map(|(id, tx)| Sample::new(id, tx)).collect();
    let receivers = vec![Receiver::new("hall", Pose { position: [0.0, 0.0, 2.5], ..Pose::IDENTITY })];
    let observations = Observations::Powers(powers.into_iter().map(|dbm| dbm as Real).collect());
    let data = Dataset::of_links(name, receivers, vec![], &samples, observations).unwrap();
    let (test, train) = (0..COUNT).partition(|k| k % 3 == 0);
    let official = Some(if is_swapped { (test, train) } else { (train, test) });
    save(&Dataset { official, ..data }, &here.join(name)).unwrap();
    let text = format!(
        "Pipeline(name: \"p\", data: Nerf2Rssi(root: \"{name}\"), initializer: Grid(count: 12), readout: \
         ReceivedPower(sky_deg: 30), deformation: Factored(depth: 1, width: 8, tx_encoding: Octaves(1)), training: (steps: 4, \
         batch: 4, densify_until: 2, prune_until: 3, prune_every: 1, validate_every: 0, densify: (every: 0)), baselines: \
         [NearestNeighbours(k: 1)], metrics: [PowerError()])"
    );
    write(&here.join(format!("{name}.ron")), text);
}

/// All warnings of a command that succeeds.
fn warned(here: &Path, arguments: &[&str]) -> Vec<String> {
    let message = stderr(&succeed(here, arguments));
    message.lines().filter(|line| line.starts_with("warning: ")).map(str::to_owned).collect()
}

#[test]
fn reports_wrong_units_and_orders_once() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let with_positions = |change: &dyn Fn([f64; 3]) -> [f64; 3]| (hall().0.into_iter().map(change).collect(), hall().1);
    let with_powers = |change: &dyn Fn(f64) -> f64| (hall().0, hall().1.into_iter().map(change).collect());
    for (name, data, is_swapped, words, error) in [
        ("right", hall(), false, "", ""),
        ("centimetres", with_positions(&|p| p.map(|v| 100.0 * v)), false, "convert them to metres", ""),
        ("alike", with_positions(&|_| [1.0, 2.0, 1.0]), false, "all 60 transmitters are at [1.0, 2.0, 1.0]", ""),
        ("milliwatts", with_powers(&|dbm| 10_f64.powf(dbm / 10.0)), false, "give 10 * log10(mW)", "power-unit"),
        ("strong", with_powers(&|dbm| dbm + 91.0), false, "decibels over a floor, add the floor", "power-unit"),
        ("codes", with_powers(&|dbm| if dbm < -58.0 { 100.0 } else { dbm }), false, "`--missing 100`", "lone-value"),
        ("kilometres", with_positions(&|p| p.map(|v| v / 1000.0)), false, "the site is only", "position-unit"),
        ("equal", with_powers(&|_| -60.0), false, "all 60 received powers are equal", ""),
        ("swapped", hall(), true, "exchange train_index.txt and test_index.txt", ""),
    ] {
        powers(here, name, data, is_swapped);
        let (pipeline, written) = (format!("{name}.ron"), format!("{name}-new.ron"));
        let run = format!("run-{name}");
        for arguments in [
            &["init", name, "--out", &written][..],
            &["inspect", name],
            &["check", &pipeline],
            &["run", &pipeline, "--out", &run],
        ] {
            let mut arguments = arguments.to_vec();
            if !error.is_empty() && arguments[0] != "inspect" {
                refuse(here, &arguments, 2, &[error, words, &format!("`--accept {error}`")]);
                arguments.extend(["--accept", error]);
            }
            let found = warned(here, &arguments);
            let expected = usize::from(!words.is_empty());
            assert!(found.len() == expected && found.iter().all(|one| one.contains(words)), "{arguments:?}: {found:?}");
        }
    }
    // A small training set may be what is asked for; warnings are also printed with -q.
    assert!(warned(here, &["check", "right.ron", "--set", "split=Sparse(train: 20)"]).is_empty());
    assert_eq!(warned(here, &["check", "right.ron", "--set", "split=Random(test: 0.8)"]).len(), 1);
    assert_eq!(warned(here, &["check", "swapped.ron", "-q"]).len(), 1);
    // The runs of a sweep load the same data.
    write(&here.join("e.ron"), "Experiment(name: \"e\", join: true, base: \"swapped.ron\", seeds: [0, 1])");
    assert_eq!(warned(here, &["sweep", "e.ron", "--dry-run"]).len(), 1);
    assert_eq!(warned(here, &["sweep", "e.ron"]).len(), 1);
}

/// Codes in the powers stop every command, until they are accepted; a pipeline keeps what `init` has accepted.
#[test]
fn errors_stop_every_command_until_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let coded = || (hall().0, hall().1.into_iter().map(|dbm| if dbm < -58.0 { 100.0 } else { dbm }).collect());
    powers(here, "right", hall(), false);
    powers(here, "codes", coded(), false);
    succeed(here, &["run", "right.ron", "--out", "model", "-q"]);
    write(&here.join("e.ron"), "Experiment(name: \"e\", base: \"codes.ron\", seeds: [0])");
    let table =
        std::iter::zip(coded().0, coded().1).map(|(p, dbm)| format!("{},{},{},hall,0,0,2.5,{dbm}\n", p[0], p[1], p[2]));
    write(&here.join("codes.csv"), "x,y,z,receiver,rx_x,rx_y,rx_z,dbm\n".to_owned() + &table.collect::<String>());
    write(&here.join("watts.csv"), "hall\n1e-9\n");
    write(&here.join("zero.csv"), "hall\n0\n");
    for arguments in [
        &["import", "--links", "codes.csv", "--out", "imported"][..],
        &["init", "codes", "--out", "new.ron"],
        &["check", "codes.ron"],
        &["run", "codes.ron", "--out", "run"],
        &["sweep", "e.ron", "--dry-run"],
        &["compare", "codes", "--dry-run", "--seeds", "1", "--set", "training.scale=0.001"],
        &["locate", "model", "--set", "data.root=codes"],
        &["locate", "model", "zero.csv"],
    ] {
        refuse(here, arguments, 2, &["lone-value: ", "`--accept lone-value`"]);
        let accepting = [arguments, &["--accept", "lone-value"]].concat();
        succeed(here, &accepting);
    }
    refuse(here, &["locate", "model", "watts.csv"], 2, &["watts.csv", "power-unit: ", "give 10 * log10(W) + 30"]);
    refuse(here, &["check", "codes.ron", "--accept", "lone-valu"], 2, &["did you mean `lone-value`"]);
    // The run and its pipeline keep the name: nothing else needs it.
    succeed(here, &["check", "new.ron"]);
    succeed(here, &["run", "run"]);
    succeed(here, &["run", "run", "--set", "metrics=[PowerError()]"]);
    succeed(here, &["evaluate", "run"]);
    succeed(here, &["report", "run", "--out", "page.html"]);
}

#[test]
fn import_warns_of_wrong_units() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let array = |number, shape: &[usize], bytes: Vec<u8>| -> Vec<u8> { [npy_header(number, shape), bytes].concat() };
    let positions = hall().0.into_iter().flat_map(|p| p.map(|v| 100.0 * v)).flat_map(f64::to_le_bytes).collect();
    write(&here.join("tx.npy"), array(Number::F64, &[COUNT, 3], positions));
    write(&here.join("s.npy"), array(Number::U8, &[COUNT, 6, 24], vec![200; COUNT * 24 * 6]));
    let pose = ["--receiver", "0,0,1", "--orientation", "0,0,0,1", "--out", "mine", "-q"];
    let found = warned(here, &[&["import", "--spectra", "s.npy", "--tx", "tx.npy"][..], &pose].concat());
    let words = ["convert them to metres", "all 60 spectra are equal"];
    assert!(found.len() == 2 && found.iter().zip(words).all(|(one, words)| one.contains(words)), "{found:?}");
}

/// The text in brackets after `name: `.
fn list<'a>(text: &'a str, name: &str) -> &'a str {
    text.split_once(&format!("{name}: [")).unwrap().1.split_once(']').unwrap().0
}

/// `SMALL` on the data in `root`.
fn small(root: &str) -> String {
    SMALL
        .replace("Teacher(gaussians: 4, samples: 40, width: 48, height: 12)", &format!("Arrays(root: \"{root}\")"))
        .replace("Official", "Random")
        .replace("LearnableMask(lambda: 0.02, learning_rate: 0.1), OpacityThreshold()", "")
        .replace("steps: 60", "steps: 60, scale: 0.05, stride: 3")
}

/// The orientation that the warning prints mends the data.
#[test]
fn wrong_orientation_warns_in_every_command_with_the_quaternion() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    succeed(here, &["simulate", "office", "--npy", "--no-paths", "--samples", "60", "--out", "office", "-q"]);
    let pose = std::fs::read_to_string(here.join("office/gateway_info.yml")).unwrap();
    let (receiver, orientation) = (list(&pose, "position").replace(' ', ""), list(&pose, "orientation"));
    let import = |orientation: &str, out: &str| {
        let files = ["import", "--spectra", "office/spectra.npy", "--tx", "office/tx_pos.csv", "--receiver", &receiver];
        warned(here, &[&files[..], &["--orientation", orientation, "--out", out]].concat())
    };
    write(&here.join("small.ron"), small("mine"));
    let of_import = import("0,0,0,1", "mine");
    assert_eq!(of_import.len(), 1, "{of_import:?}");
    for arguments in
        [&["init", "mine"][..], &["inspect", "mine"], &["check", "mine.ron"], &["run", "small.ron", "--out", "run"]]
    {
        assert_eq!(warned(here, arguments), of_import, "{arguments:?}");
    }
    let page = std::fs::read_to_string(here.join("run/report.html")).unwrap();
    let quaternion = of_import[0].split_once("with [").unwrap().1.split_once(']').unwrap().0;
    assert!(of_import[0].starts_with("warning: orientation: ") && page.contains(quaternion), "{of_import:?}");
    let numbers = |text: &str| text.split(',').map(|v| v.trim().parse().unwrap()).collect::<Vec<f64>>();
    let dot: f64 = numbers(quaternion).iter().zip(numbers(orientation)).map(|(a, b)| a * b).sum();
    assert!(2.0 * dot.abs().min(1.0).acos().to_degrees() < 3.0, "{quaternion} is not {orientation}");
    assert!(import(&quaternion.replace(' ', ""), "mended").is_empty());
}

#[test]
fn other_order_of_the_orientations_of_a_moving_receiver_warns() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    succeed(here, &["simulate", "office-moving", "--npy", "--no-paths", "--samples", "60", "--out", "walk", "-q"]);
    assert!(warned(here, &["init", "walk", "--out", "right.ron"]).is_empty());
    let poses = std::fs::read_to_string(here.join("walk/rx_pose.csv")).unwrap();
    let row = |line: &str| match &line.split(',').collect::<Vec<_>>()[..] {
        ["x", ..] => line.to_owned(),
        [x, y, z, qx, qy, qz, qw] => [x, y, z, qw, qx, qy, qz].map(|v| (*v).to_owned()).join(","),
        other => panic!("{other:?}"),
    };
    write(&here.join("walk/rx_pose.csv"), poses.lines().map(|line| row(line) + "\n").collect::<String>());
    let found = warned(here, &["init", "walk", "--out", "wrong.ron"]);
    assert!(found.len() == 1 && found[0].contains("if the recorded numbers are w, x, y, z, it is "), "{found:?}");
}

type Change = fn([f64; 3]) -> [f64; 3];

/// A room of 5 m by 5 m by 3 m, its points in another unit or frame.
#[test]
fn point_cloud_in_another_unit_or_frame_warns_with_both_extents() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let array = |number, shape: &[usize], bytes: Vec<u8>| -> Vec<u8> { [npy_header(number, shape), bytes].concat() };
    let count = 15;
    let positions = (0..count).flat_map(|k| [(k * 7 % 15) as f64 / 3.0, (k * 4 % 15) as f64 / 3.0, 1.2]);
    let pixels = (0..count * 24 * 6).map(|i| (i * 7919 % 251) as u8).collect();
    write(&here.join("s.npy"), array(Number::U8, &[count, 6, 24], pixels));
    write(&here.join("tx.npy"), array(Number::F64, &[count, 3], positions.flat_map(f64::to_le_bytes).collect()));
    let pose = ["--receiver", "2,2,2.5", "--orientation", "0,0,0,1", "--out", "room", "-q"];
    succeed(here, &[&["import", "--spectra", "s.npy", "--tx", "tx.npy"][..], &pose].concat());
    let room = |k: usize| [(k * 13 % 41) as f64 / 8.0, (k * 29 % 41) as f64 / 8.0, (k * 17 % 41) as f64 * 0.075];
    let clouds: [(&str, Change, &str); 5] = [
        ("metres", |p| p, ""),
        ("millimetres", |p| p.map(|v| 1000.0 * v), "divide its coordinates by 1000"),
        ("utm", |[x, y, z]| [x + 455_000.0, y + 5_410_000.0, z + 120.0], "give both in metres, in one frame"),
        ("y-up", |[x, y, z]| [x, z, -y], "save its columns as x, -z, y"),
        ("a-corner", |p| p.map(|v| 0.5 * v), ""),
    ];
    for (name, change, words) in clouds {
        let line = |p: [f64; 3]| format!("{} {} {}\n", p[0], p[1], p[2]);
        write(&here.join("room/points.xyz"), (0..41).map(|k| line(change(room(k)))).collect::<String>());
        let text = small("room").replace("root: \"room\"", "root: \"room\", points: \"room/points.xyz\"");
        write(&here.join(format!("{name}.ron")), text);
        let (pipeline, written, run) = (format!("{name}.ron"), format!("{name}-new.ron"), format!("run-{name}"));
        for arguments in [
            &["init", "room", "--out", &written][..],
            &["inspect", &pipeline],
            &["check", &pipeline],
            &["run", &pipeline, "--out", &run],
        ] {
            let found = warned(here, arguments);
            let expected = usize::from(!words.is_empty());
            let is_right = |one: &String| one.contains(words) && one.contains("; transmitters x 0.00 to 4.67, y 0.00");
            assert!(found.len() == expected && found.iter().all(is_right), "{name}, {arguments:?}: {found:?}");
        }
    }
    let shown = stdout(&succeed(here, &["inspect", "a-corner.ron", "-q"]));
    assert!(shown.contains("41 points, x 0.00 to 2.50, y 0.00 to 2.50, z 0.00 to 1.50 m"), "{shown}");
}
