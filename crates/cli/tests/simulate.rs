//! `pwrfgs simulate`: folders that the other commands read, and failed simulations, which write no files.
use crate::common::{call, pwrfgs, signal, stderr, stdout, succeed};
use std::fs;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const SCENE: &str = r#"(
    name: "closet",
    carrier_hz: 2.4e9,
    room: (
        outline: Box(low: (0, 0, 0), high: (3, 2, 2.5)),
        walls: (material: "brick", thickness_m: 0.1), floor: (material: "concrete"), ceiling: (material: "wood"),
    ),
    receiver: (position: (0.2, 1, 1.5), orientation: Facing(direction: (1, 0, 0))),
    transmitter: (positions: Uniform(low: (1, 0.5, 0.5), high: (2.5, 1.5, 2))),
)"#;

#[test]
fn simulated_data_set_is_trainable() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("closet.ron"), SCENE).unwrap();
    let arguments = ["simulate", "closet.ron", "--samples", "12", "--points", "300", "--out", "closet"];
    let made = call(folder, &arguments);
    assert!(made.status.success(), "{}", stderr(&made));
    assert!(stderr(&made).contains("12 simulated spectra of closet"), "{}", stderr(&made));
    for name in ["gateway_info.yml", "tx_pos.csv", "power.csv", "paths.csv", "points.ply", "manifest.json"] {
        assert!(folder.join("closet").join(name).is_file(), "{name}");
    }
    let paths = fs::read_to_string(folder.join("closet/paths.csv")).unwrap();
    assert!(paths.lines().next().unwrap().starts_with("id,path,interactions,gain_re"));
    assert!(paths.contains(",LOS,") && paths.contains(",R,"));
    let pipeline = crate::common::SMALL
        .replace(
            "Teacher(gaussians: 4, samples: 40, width: 48, height: 12)",
            "Nerf2Spectrum(root: \"closet\", points: \"closet/points.ply\")",
        )
        .replace("steps: 60,", "steps: 41,");
    fs::write(folder.join("small.ron"), pipeline).unwrap();
    let run = call(folder, &["run", "small.ron"]);
    assert!(run.status.success(), "{}", stderr(&run));
    assert!(stdout(&run).contains("chamfer"));
    let again = call(folder, &arguments);
    assert_eq!(again.status.code(), Some(2));
    assert!(stderr(&again).contains("closet is not empty (it holds `"), "{}", stderr(&again));
}

#[test]
fn warns_once_of_what_meshes_lose() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let plate = "v -5 -4 0\nv 5 -4 0\nv 5 4 0\nv -5 4 0\n";
    fs::write(here.join("flat.obj"), format!("{plate}f 1 2 3 4\nf 1 1 2\nf 1 2 2 3\n")).unwrap();
    fs::write(here.join("two.obj"), format!("{plate}usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n")).unwrap();
    fs::write(here.join("one.obj"), format!("{plate}usemtl a\nf 1 2 3\nusemtl a\nf 1 3 4\n")).unwrap();
    let room = "v -5 0 -4\nv 5 0 -4\nv 5 0 4\nv -5 0 4\nv -5 3 -4\nv 5 3 -4\nf 1 2 3 4\nf 1 2 6 5\n";
    fs::write(here.join("up.obj"), room).unwrap();
    let turned = "<transform name=\"to_world\"><rotate x=\"1\" angle=\"90\"/></transform>";
    for (name, more, expected) in [
        ("flat", "", "flat.obj: 2 of 5 triangles have no area and are left out"),
        ("two", "", "two.obj: 2 materials (`usemtl`) are ignored"),
        ("one", "", ""),
        ("up", "", "up.obj: y seems to point up (y from 0.00 to 3.00, z from -4.00 to 4.00)"),
        ("up", turned, ""),
    ] {
        let mesh = format!("<string name=\"filename\" value=\"{name}.obj\"/>{more}<ref id=\"itu_wood\"/>");
        let bsdf = "<bsdf type=\"diffuse\" id=\"itu_wood\"/>";
        fs::write(here.join("s.xml"), format!("<scene>{bsdf}<shape type=\"obj\">{mesh}</shape></scene>")).unwrap();
        let out = format!("{name}{}", more.len());
        let made = succeed(
            here,
            &["simulate", "s.xml", "--samples", "5", "--points", "9", "--npy", "--no-paths", "--out", &out],
        );
        let warnings: Vec<_> = stderr(&made).lines().filter(|line| line.contains("WARN")).map(str::to_owned).collect();
        assert_eq!(warnings.len(), usize::from(!expected.is_empty()), "{warnings:?}");
        assert!(warnings.iter().all(|line| line.contains(expected)), "{warnings:?}");
    }
}

#[test]
fn positions_of_a_file_are_simulated_in_every_layout() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("walk.csv"), "id,x,y,z\n7,3,2,1.1\n8,4.1234567,3,1.2\n9,2,2.5,1\n").unwrap();
    fs::write(here.join("poses.csv"), "x,y,z,qx,qy,qz,qw\n3,2,1.1,0,0,0,1\n4.5,3,1.2,0,0,0.6,0.8\n").unwrap();
    let make = |scene: &str, out: &str, more: &str| {
        let arguments: Vec<&str> = more.split_whitespace().collect();
        succeed(here, &[&["simulate", scene, "--out", out, "--points", "10", "-q"][..], &arguments].concat());
        if out != "deepmimo" {
            succeed(here, &["inspect", out, "-q"]);
        }
        ["tx_pos.csv", "rx_pose.csv"].map(|name| fs::read_to_string(here.join(out).join(name)).unwrap_or_default())
    };
    for (scene, layout, more) in [
        ("office", "spectra", ""),
        ("office", "spectra", "--npy"),
        ("office", "rssi", ""),
        ("office", "channels", ""),
        ("office-csi", "csi", ""),
        ("office-channel", "deepmimo", ""),
    ] {
        let out = format!("{layout}{more}");
        let [txs, _] = make(scene, &out, &format!("--tx-csv walk.csv --layout {layout} {more}"));
        assert!(layout == "deepmimo" || txs == "x,y,z\n3,2,1.1\n4.1234567,3,1.2\n2,2.5,1\n", "{out}: {txs}");
    }
    let [one, _] = make("office", "one", "--tx 3,2,1.1 --no-paths --npy");
    assert_eq!(one, "x,y,z\n3,2,1.1\n");
    let pixels = |name: &str| fs::read(here.join(name).join("spectra.npy")).unwrap();
    let (first, all) = (pixels("one"), pixels("spectra--npy"));
    assert_eq!(first[first.len() - 90 * 360..], all[all.len() - 3 * 90 * 360..][..90 * 360]);
    let users = fs::read_to_string(here.join("deepmimo/params.json")).unwrap();
    assert!(users.matches("\"num_points\":3").count() == 1, "{users}");
    for more in ["--npy", "--layout rssi", "--layout channels"] {
        let [_, poses] =
            make("office", &format!("m{more}"), &format!("--rx-pose-csv poses.csv --tx 1,1,2 --no-paths {more}"));
        assert_eq!(poses.lines().nth(2), Some("4.5,3.0,1.2,0.0,0.0,0.6,0.8"));
    }
    let [_, pose] = make("office-moving", "pose", "--rx-pose 3,2,1.1,0,0,0,1 --no-paths --layout rssi");
    assert_eq!(pose.lines().count(), 2);
    for (arguments, expected) in [
        (
            ["office", "--tx-csv", "poses.csv", "--samples", "9"],
            "'--tx-csv <FILE>' cannot be used with '--samples <N>'",
        ),
        (
            ["office", "--rx-pose-csv", "poses.csv", "--layout", "rssi"],
            "its transmitter moves; add the position of a fixed one with --tx",
        ),
        (["office-moving", "--tx", "3,2,1", "--layout", "rssi"], "its receiver moves; give poses with --rx-pose or"),
        (["office", "--rx-pose", "3,2,1", "--tx", "1,1,1"], "--rx-pose 3,2,1: expected x,y,z,qx,qy,qz,qw"),
    ] {
        let refused = call(here, &[&["simulate", "--out", "refused"][..], &arguments].concat());
        assert!(refused.status.code() == Some(2) && stderr(&refused).contains(expected), "{}", stderr(&refused));
    }
    fs::write(
        here.join("mine.ron"),
        SCENE.replace("Uniform(low: (1, 0.5, 0.5), high: (2.5, 1.5, 2))", "Csv(\"walk.csv\")"),
    )
    .unwrap();
    fs::write(here.join("walk.csv"), "x,y,z\n2,1,1\n1.5,1,1\n").unwrap();
    let [txs, _] = make("mine.ron", "mine", "--no-paths");
    assert_eq!(txs, "x,y,z\n2,1,1\n1.5,1,1\n");
    let refused = call(here, &["simulate", "mine.ron", "--samples", "9", "--out", "refused"]);
    assert!(
        stderr(&refused).contains("--samples: the scene states 2 positions; remove --samples"),
        "{}",
        stderr(&refused)
    );
}

#[test]
fn exported_scene_is_simulated_with_given_carrier_and_receiver() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("closet.ron"), SCENE).unwrap();
    let made = call(folder, &["export-scene", "closet.ron", "--out", "closet"]);
    assert!(
        stderr(&made).contains("3 meshes in closet; read scene.xml with `simulate --carrier-hz 2.4e9` or sionna.rt"),
        "{}",
        stderr(&made)
    );
    let more = ["--carrier-hz", "2.4e9", "--receiver", "0.2,1,1.5"];
    let simulate = ["simulate", "closet/scene.xml", "--samples", "5", "--points", "9", "--out", "again"];
    let made = call(folder, &[&simulate[..], &more].concat());
    let expected = "3 meshes; carrier 2.4e9 Hz, receiver at [0.2, 1.0, 1.5], transmitters from [0.3, 0.2, 1.25] to [2.7, \
                    1.8, 1.25]";
    assert!(made.status.success() && stderr(&made).contains(expected), "{}", stderr(&made));
    fs::remove_file(folder.join("closet/meshes/walls.ply")).unwrap();
    let refused = call(folder, &["simulate", "closet/scene.xml", "--out", "third"]);
    assert_eq!(refused.status.code(), Some(2));
    let expected = "scene.xml:4:9: mesh `meshes/walls.ply` is missing";
    assert!(stderr(&refused).contains(expected), "{}", stderr(&refused));
    assert!(!folder.join("third").exists());
}

#[test]
fn model_of_moving_receiver_predicts_at_poses() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let moving = SCENE.replace("transmitter:", "moving_receiver: (turn_deg: 60),\n    transmitter:");
    fs::write(folder.join("moving.ron"), moving).unwrap();
    fs::write(folder.join("closet.ron"), SCENE).unwrap();
    let refuse = |arguments: &[&str], expected: &str| {
        let refused = call(folder, arguments);
        assert_eq!(refused.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&refused).contains(expected), "{}", stderr(&refused));
    };
    let run = |arguments: &[&str]| {
        let made = call(folder, arguments);
        assert!(made.status.success(), "{arguments:?}: {}", stderr(&made));
    };
    let simulate = |scene: &'static str, out: &'static str| {
        vec!["simulate", scene, "--samples", "20", "--points", "50", "--npy", "--no-paths", "--out", out]
    };
    refuse(&["simulate", "moving.ron", "--out", "walk"], "add --no-paths, and --npy for spectra");
    run(&simulate("moving.ron", "walk"));
    run(&simulate("closet.ron", "fixed"));
    let pipeline = r#"Pipeline(name: "walk", data: Arrays(root: "walk"), split: Random(test: 0.2, validation: 0.0),
        initializer: Random(count: 20, std: 2.0), deformation: Fixed(), pruners: [],
        training: (steps: 4, batch: 2, densify_until: 0, prune_until: 0), baselines: [NearestNeighbours(k: 1)],
        metrics: [Ssim()])"#;
    fs::write(folder.join("walk.ron"), pipeline).unwrap();
    fs::write(folder.join("fixed.ron"), pipeline.replace("\"walk\"", "\"fixed\"")).unwrap();
    run(&["run", "walk.ron", "-q"]);
    let model = "runs/walk/model.safetensors";
    let predict = |more: &[&'static str], out: &'static str| [&["predict", model], more, &["--out", out]].concat();
    run(&predict(&["--rx-pose", "1,1,1,0,0,0.6,0.8"], "one"));
    run(&predict(&["--rx-pose-csv", "walk/rx_pose.csv", "--stacked"], "all"));
    let rows = fs::read_to_string(folder.join("one/predictions.csv")).unwrap();
    assert!(rows.starts_with("row,x,y,z,qx,qy,qz,qw,azimuth_deg") && rows.contains("\n1,1,1,1,0,0,0.6,0.8,"), "{rows}");
    refuse(&predict(&["--rx-pose", "1,1,1,0,0,0.6,0.9"], "two"), "the quaternion has length");
    refuse(&predict(&["--rx-pose", "1,1,1"], "two"), "expected x,y,z,qx,qy,qz,qw, such as 3.5,2.2,1.2,0,0,0,1");
    refuse(&predict(&["--tx", "1,1,1"], "two"), "the receiver of this model moves; give its poses with --rx-pose");
    refuse(&predict(&["--rx-pose-csv", "fixed/tx_pos.csv"], "two"), "tx_pos.csv:1:1: no column `qx`");
    refuse(&["evaluate", model, "--set", "data.root=fixed"], "moves, and that of the other is fixed");
    let left_out = stderr(&succeed(folder, &["compare", "walk", "--split-csv", "walk.csv"]));
    assert!(
        ["NeRF2", "WRF-GS"].iter().all(|method| left_out.contains(&format!("note: {method} is left out"))),
        "{left_out}"
    );
    refuse(&["compare", "walk", "--methods", "NeRF2", "--split-csv", "other.csv"], "Nerf2");
    refuse(&["run", "walk.ron", "--set", "method=Nerf2()", "--out", "nerf"], "Nerf2");
}

#[test]
fn powers_and_channels_at_a_moving_receiver_are_read_back_and_predicted() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let moving = SCENE.replace("transmitter:", "moving_receiver: (turn_deg: 60),\n    transmitter:");
    fs::write(here.join("moving.ron"), moving).unwrap();
    for (layout, noise, header) in
        [("rssi", ["--noise-db", "3"], "receiver,dbm"), ("channels", ["--snr-db", "20"], "receiver,db")]
    {
        let data = ["simulate", "moving.ron", "--samples", "20", "--points", "50", "--no-paths", "--layout", layout];
        succeed(here, &[&data[..], &noise, &["--out", layout]].concat());
        let facts = if layout == "rssi" { "gateway_position.yml" } else { "receiver.yml" };
        assert!(here.join(layout).join("rx_pose.csv").exists() && here.join(layout).join(facts).exists());
        let poses = fs::read_to_string(here.join(layout).join("rx_pose.csv")).unwrap();
        let told = succeed(here, &["inspect", layout]);
        let text = String::from_utf8_lossy(&told.stdout).into_owned();
        assert!(text.contains("receiver") && text.contains("transmitter"), "{text}");
        succeed(here, &["init", layout, "--out", &format!("{layout}.ron")]);
        succeed(here, &["run", &format!("{layout}.ron"), "--scale", "0.02", "--out", &format!("run-{layout}"), "-q"]);
        let model = format!("run-{layout}/model.safetensors");
        let table = format!("{layout}/rx_pose.csv");
        succeed(here, &["predict", &model, "--rx-pose-csv", &table, "--out", &format!("at-{layout}")]);
        let rows = fs::read_to_string(here.join(format!("at-{layout}/predictions.csv"))).unwrap();
        assert!(rows.starts_with(&format!("row,x,y,z,qx,qy,qz,qw,{header}")), "{rows}");
        assert_eq!(rows.lines().count(), poses.lines().count());
    }
}

#[test]
fn carriers_of_a_scene_are_rows_of_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scene = SCENE.replace("receiver:", "carriers_hz: [2e9, 2.4e9, 3e9],\n    receiver:");
    fs::write(folder.join("closet.ron"), scene).unwrap();
    let run = |arguments: &[&str]| {
        let made = call(folder, arguments);
        assert!(made.status.success(), "{arguments:?}: {}", stderr(&made));
    };
    let refuse = |arguments: &[&str], expected: &str| {
        let refused = call(folder, arguments);
        assert_eq!(refused.status.code(), Some(2), "{arguments:?}");
        assert!(stderr(&refused).contains(expected), "{}", stderr(&refused));
    };
    let simulate = ["simulate", "closet.ron", "--samples", "10", "--points", "50"];
    run(&[&simulate[..], &["--out", "images"]].concat());
    run(&[&simulate[..], &["--npy", "--no-paths", "--out", "arrays"]].concat());
    run(&[&simulate[..], &["--carrier-hz", "2.4e9", "--out", "alone"]].concat());
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    assert_eq!(read("images/freq.txt"), "2000000000.0\n2400000000.0\n3000000000.0\n".repeat(10));
    assert!(folder.join("images/paths-3000MHz.csv").exists() && folder.join("images/spectrum/00030.png").exists());
    assert_eq!(read("images/test_index.txt"), "00013\n00014\n00015\n00028\n00029\n00030\n");
    assert_eq!(read("alone/tx_pos.csv").lines().nth(2), read("images/tx_pos.csv").lines().nth(4));
    refuse(
        &[&simulate[..], &["--layout", "rssi", "--out", "x"]].concat(),
        "several carriers, which only spectra support",
    );
    let pipeline = r#"Pipeline(name: "carriers", data: Arrays(root: "arrays"), split: LeaveReceiverOut(receivers: ["2400MHz"]),
        initializer: Random(count: 20, std: 2.0), deformation: Factored(depth: 1, width: 8, carrier: 2.0), pruners: [],
        training: (steps: 4, batch: 2, densify_until: 0, prune_until: 0), baselines: [MeanSpectrum(), NearestCarrier()],
        metrics: [Ssim()])"#;
    fs::write(folder.join("carriers.ron"), pipeline).unwrap();
    run(&["run", "carriers.ron", "-q"]);
    run(&["inspect", "images"]);
    run(&["init", "images"]);
    run(&["check", "images.ron"]);
    let predict = ["predict", "runs/carriers/model.safetensors", "--tx", "1,1,1"];
    run(&[&predict[..], &["--receiver", "2400MHz", "--out", "one"]].concat());
    refuse(&[&predict[..], &["--receiver", "2500MHz", "--out", "two"]].concat(), "2500MHz");
    fs::write(folder.join("arrays/freq.txt"), "2.4\nx\n").unwrap();
    refuse(&["inspect", "arrays"], "freq.txt:2:1: `x` is not a number; write the carrier of one sample per line");
    refuse(&["simulate", "closet.ron", "--layout", "channels", "--out", "x"], "several carriers");
}

#[test]
fn scenario_of_deepmimo_has_base_stations_and_users() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let more =
        "more_receivers: [(name: \"b\", position: (2.8, 1, 2), orientation: Facing(direction: (-1, 0, 0)))],\n    ";
    fs::write(folder.join("closet.ron"), SCENE.replace("transmitter:", &format!("{more}transmitter:"))).unwrap();
    let simulate = ["simulate", "closet.ron", "--samples", "7", "--layout", "deepmimo", "--out", "closet"];
    let made = call(folder, &simulate);
    let expected = "7 simulated users of closet at 2 receivers in closet";
    assert!(made.status.success() && stderr(&made).contains(expected), "{}", stderr(&made));
    assert!(stderr(&made).contains("from_deepmimo(\"closet\", pair=(0, 0, 1))"), "{}", stderr(&made));
    let text = fs::read_to_string(folder.join("closet/params.json")).unwrap();
    let params: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(params["txrx_sets"]["txrx_set_0"]["num_points"], 2);
    assert_eq!(params["txrx_sets"]["txrx_set_1"]["num_active_points"], 7);
    for name in ["power", "inter_pos", "rx_pos", "tx_pos"] {
        for station in ["tx000", "tx001"] {
            assert!(folder.join(format!("closet/{name}_t000_{station}_r001.npz")).is_file());
        }
    }
    let refused = call(folder, &[&simulate[..], &["--no-paths"]].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("--no-paths: the layout deepmimo consists of paths"), "{}", stderr(&refused));
}

#[test]
fn invalid_scenes_leave_no_files() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("brik.ron"), SCENE.replace("brick", "brik")).unwrap();
    fs::write(
        folder.join("far.ron"),
        SCENE.replace("high: (2.5, 1.5, 2)", "high: (2.5, 9.5, 2)").replace("low: (1, 0.5, 0.5)", "low: (1, 8.5, 0.5)"),
    )
    .unwrap();
    let at = "low: (0.2, 1, 1.5), high: (0.2, 1, 1.5)";
    let with = |places: &str| SCENE.replace("Uniform(low: (1, 0.5, 0.5), high: (2.5, 1.5, 2))", places);
    fs::write(folder.join("in.ron"), with(&format!("Uniform({at})"))).unwrap();
    let grid = "Grid(low: (0.15, 1, 1.5), high: (0.65, 1, 1.5), step_m: 0.1)";
    fs::write(folder.join("on.ron"), with(grid)).unwrap();
    for (scene, more, expected) in [
        ("gone.ron", vec![], "cannot read gone.ron"),
        ("brik.ron", vec![], "brik.ron:6:27: unknown material `brik`; did you mean `brick`?"),
        ("far.ron", vec![], "outside the room"),
        ("in.ron", vec![], "transmitter 1 at (0.2, 1, 1.5) is in the receiver; move the"),
        ("on.ron", vec!["--samples", "5"], "transmitter 1 at (0.2, 1, 1.5) is in the receiver; move the"),
        ("brik.ron", vec!["--samples", "0"], "`samples` is 0"),
        ("brik.ron", vec!["--samples", "many"], "invalid value"),
    ] {
        let called = call(folder, &[&["simulate", scene, "--out", "out"][..], &more].concat());
        assert_eq!(called.status.code(), Some(2), "{scene}: {}", stderr(&called));
        assert!(stderr(&called).contains(expected), "{scene}: {}", stderr(&called));
    }
    let mut left: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["brik.ron", "far.ron", "in.ron", "on.ron"]);
}

/// What stands in a folder, sorted.
fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// A simulation that would take long, once its first spectrum is written. A killed simulation may have left its folder.
fn begun(folder: &Path) -> Child {
    let earlier = entries(folder);
    let arguments = ["simulate", "closet.ron", "--samples", "99999", "--out", "out", "-q"];
    let mut child = pwrfgs(folder).args(arguments).stderr(Stdio::null()).spawn().unwrap();
    let end = Instant::now() + Duration::from_mins(1);
    let is_begun = || {
        let folders = entries(folder).into_iter().filter(|name| name.starts_with(".out.") && !earlier.contains(name));
        folders.into_iter().any(|name| folder.join(name).join("spectrum/00001.png").exists())
    };
    while !is_begun() {
        assert!(child.try_wait().unwrap().is_none() && Instant::now() < end, "no picture in a minute");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

#[test]
#[cfg(unix)]
fn stopped_simulation_leaves_no_files_and_next_one_cleans_up_after_kill() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("closet.ron"), SCENE).unwrap();
    let mut child = begun(folder);
    signal(&child, "-INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert_eq!(entries(folder), ["closet.ron"]);

    let mut child = begun(folder);
    child.kill().unwrap(); // SIGKILL
    child.wait().unwrap();
    assert_eq!(entries(folder).len(), 2, "{:?}", entries(folder));
    // One that still works is left alone, by name and by lock.
    let mut child = begun(folder);
    assert_eq!(entries(folder).len(), 2, "{:?}", entries(folder));
    let made = call(folder, &["simulate", "closet.ron", "--samples", "5", "--points", "10", "--out", "out"]);
    assert!(made.status.success(), "{}", stderr(&made));
    assert!(child.try_wait().unwrap().is_none());
    assert_eq!(entries(folder).len(), 3, "{:?}", entries(folder));
    child.kill().unwrap();
    child.wait().unwrap();
    fs::remove_dir_all(folder.join("out")).unwrap();
    let made = call(folder, &["simulate", "closet.ron", "--samples", "5", "--points", "10", "--out", "out"]);
    assert!(made.status.success(), "{}", stderr(&made));
    assert_eq!(entries(folder), ["closet.ron", "out"]);
}

/// Sends Ctrl-C and waits for the end; what is said.
#[cfg(unix)]
fn interrupted(mut child: Child) -> String {
    signal(&child, "-INT");
    let end = Instant::now() + Duration::from_mins(1); // a second is meant, and the machine may be busy
    while child.try_wait().unwrap().is_none() {
        if Instant::now() > end {
            child.kill().unwrap();
            panic!("Ctrl-C was not heard within a minute");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    stderr(&output)
}

#[test]
#[cfg(unix)]
fn ctrl_c_stops_commands_during_simulation() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("closet.ron"), SCENE).unwrap();
    let data = "Teacher(gaussians: 4, samples: 40, width: 48, height: 12)";
    let source = "Simulated(scene: \"closet.ron\", samples: 1_000_000)";
    fs::write(folder.join("small.ron"), crate::common::SMALL.replace(data, source)).unwrap();
    fs::create_dir(folder.join("cache")).unwrap();
    for (command, words) in [("run", ["stopped", "repeat the command to resume"]), ("check", ["stopped"; 2])] {
        let mut program = pwrfgs(folder);
        program.args([command, "small.ron"]).env("PWRFGS_CACHE", folder.join("cache"));
        let child = program.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let end = Instant::now() + Duration::from_mins(1);
        while entries(&folder.join("cache")).is_empty() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(20));
        }
        let message = interrupted(child);
        assert!(words.iter().all(|words| message.contains(words)), "{message}");
        assert!(entries(&folder.join("cache")).is_empty() && !folder.join("runs").exists(), "{:?}", entries(folder));
    }
}

#[test]
fn simulates_polygons_and_fans_of_thousands_of_corners() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let count = 4_000;
    let corner = |k: usize, radius: f64, z: f64| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / count as f64).sin_cos();
        format!("v {:.6} {:.6} {z}\n", 1.5 + radius * cos, 1.0 + radius * sin)
    };
    // A circle with a dent as one polygon; and a zigzag of triangles about one vertex.
    let circle = (0..count).map(|k| corner(k, if k == count / 3 { 0.2 } else { 0.4 }, 1.0)).collect::<String>();
    let face = (1..=count).map(|k| format!(" {k}")).collect::<Vec<_>>().concat();
    fs::write(folder.join("circle.obj"), format!("{circle}f{face}\n")).unwrap();
    let rim = (0..count).map(|k| corner(k, 0.4, if k.is_multiple_of(2) { 2.0 } else { 2.1 })).collect::<String>();
    let sides = (2..=count).map(|k| format!("f 1 {k} {}\n", k + 1)).collect::<Vec<_>>().concat();
    fs::write(folder.join("fan.obj"), format!("v 1.5 1.0 2.0\n{rim}{sides}")).unwrap();
    let mesh = |name: &str| {
        format!("Mesh(name: \"{name}\", file: \"{name}.obj\", finish: (material: \"wood\", thickness_m: 0.01))")
    };
    let objects =
        format!("objects: [{}, {}], propagation: (order: 1, diffraction: false),", mesh("circle"), mesh("fan"));
    fs::write(folder.join("closet.ron"), SCENE.replace("receiver:", &format!("{objects}\n    receiver:"))).unwrap();
    let made =
        call(folder, &["simulate", "closet.ron", "--samples", "5", "--points", "10", "--no-paths", "--out", "out"]);
    assert!(made.status.success(), "{}", stderr(&made));
}

#[test]
#[cfg(unix)]
fn removes_partial_cache_entries_of_killed_processes() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("closet.ron"), SCENE).unwrap();
    let mut child = begun(folder);
    child.kill().unwrap();
    child.wait().unwrap();
    let left = entries(folder).into_iter().find(|name| name.starts_with(".out.")).unwrap();
    fs::create_dir(folder.join("cache")).unwrap();
    fs::rename(folder.join(&left), folder.join("cache").join(&left)).unwrap();
    let data = "Teacher(gaussians: 4, samples: 40, width: 48, height: 12)";
    let source = "Simulated(scene: \"closet.ron\", samples: 10, points: 50)";
    fs::write(folder.join("small.ron"), crate::common::SMALL.replace(data, source).replace("steps: 60,", "steps: 41,"))
        .unwrap();
    let run = pwrfgs(folder).args(["run", "small.ron"]).env("PWRFGS_CACHE", folder.join("cache")).output().unwrap();
    assert!(run.status.success(), "{}", stderr(&run));
    let kept = entries(&folder.join("cache"));
    assert!(kept.len() == 1 && kept[0].starts_with("closet-"), "{kept:?}");
}

#[test]
fn simulate_writes_every_layout() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let more = "more_receivers: [(name: \"high\", position: (2.8, 1, 2), orientation: Facing(direction: (-1, 0, 0)))],
        subcarriers: (count: 4, bandwidth_hz: 20e6),\n    transmitter:";
    fs::write(folder.join("closet.ron"), SCENE.replace("transmitter:", more)).unwrap();
    let simulate = |more: &[&str], out: &str| {
        let arguments = ["simulate", "closet.ron", "--samples", "5", "--points", "10", "--out", out];
        call(folder, &[&arguments[..], more].concat())
    };
    for (layout, noise, files) in [
        ("spectra", None, ["gateway1/gateway_info.yml", "high/spectrum/00005.png"]),
        ("rssi", Some(["--noise-db", "3"]), ["gateway_rssi.csv", "gateway_position.yml"]),
        ("channels", Some(["--snr-db", "-3"]), ["gateway1/channel.npy", "high/receiver.yml"]),
        ("csi", None, ["gateway1/csidata.npy", "high/base-station.yml"]),
    ] {
        let more = [&["--layout", layout][..], noise.as_ref().map_or(&[], |noise| &noise[..])].concat();
        let made = simulate(&more, layout);
        assert!(made.status.success(), "{}", stderr(&made));
        assert!(
            stderr(&made).contains("10 simulated ") && stderr(&made).contains(" at 2 receivers"),
            "{}",
            stderr(&made)
        );
        assert!(files.iter().all(|file| folder.join(layout).join(file).is_file()), "{layout}");
        assert!(folder.join(layout).join("manifest.json").is_file(), "{layout}");
    }
    for (more, expected) in [
        (&["--layout", "rssi", "--npy"][..], "--npy: supported only for spectra"),
        (&["--snr-db", "30"], "--snr-db: supported only for channels; add --layout channels"),
        (&["--layout", "csi", "--noise-db", "3"], "--noise-db: supported only for received powers"),
        (&["--layout", "rssi", "--noise-db", "NaN"], "`noise_db` is NaN"),
        (&["--layout", "wifi"], "invalid value 'wifi'"),
    ] {
        let refused = simulate(more, "out");
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
        assert!(stderr(&refused).contains(expected) && !folder.join("out").exists(), "{}", stderr(&refused));
    }
}
