//! Received powers and channels: page, predictions, maps and exports.

use crate::common::{npy, pwrfgs, refuse, stderr, succeed, wait_for_step, write};
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Stdio;

const MODEL: &str = "run/model.safetensors";
/// The same model in 16 bits, which makes an ensemble with it.
const HALF: &str = "half.safetensors";

/// Powers of 60 transmitters in a hall at two receivers by a law of distance, in NeRF2's layout, and a pipeline beside them.
pub(crate) fn hall(here: &Path) {
    let receivers = [("north", [1.0, 1.0, 2.5]), ("south", [9.0, 5.0, 2.5])];
    let place = |k: usize| [(k * 7 % 60) as f64 / 6.0, (k * 11 % 60) as f64 / 10.0, 1.0];
    let dbm = |k: usize, at: [f64; 3]| {
        let squares: f64 = place(k).iter().zip(at).map(|(a, b)| (a - b).powi(2)).sum();
        -40.0 - 10.0 * squares.log10() + (k % 5) as f64
    };
    let gateways = receivers.map(|(name, at)| format!("{name}: {at:?}\n")).concat();
    write(&here.join("data/gateway_position.yml"), gateways);
    let rows = |row: &dyn Fn(usize) -> String| (0..60).map(|k| row(k) + "\n").collect::<String>();
    let powers = rows(&|k| receivers.map(|(_, at)| format!("{:.2}", dbm(k, at))).join(","));
    write(&here.join("data/gateway_rssi.csv"), format!("north,south\n{powers}"));
    let places = rows(&|k| place(k).map(|v| v.to_string()).join(","));
    write(&here.join("data/tx_pos.csv"), format!("x,y,z\n{places}"));
    let text = "Pipeline(name: \"hall\", data: Nerf2Rssi(root: \"data\"), split: Random(test: 0.25), \
                initializer: Grid(count: 12), deformation: Factored(depth: 1, width: 8, tx_encoding: Octaves(1)), \
                readout: ReceivedPower(sky_deg: 30), training: (steps: 20, batch: 4, densify_until: 2, prune_until: 4, \
                prune_every: 2, validate_every: 0, densify: (every: 0)), baselines: [NearestNeighbours(k: 1)], \
                metrics: [PowerError()])";
    write(&here.join("p.ron"), text);
    succeed(here, &["run", "p.ron", "--out", "run"]);
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap()
}

/// The page of a run without its scripts.
fn page_of(run: &Path) -> String {
    read(&run.join("report.html")).split("<script").next().unwrap().to_owned()
}

fn names(folder: &Path) -> BTreeSet<String> {
    folder.read_dir().unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
fn powers_are_reported_predicted_mapped_and_exported() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    let page = page_of(&here.join("run"));
    for words in
        ["<h2>Errors</h2>", "Scores per receiver", "one map per receiver", "predicted, dBm", ">south<", "test links"]
    {
        assert!(page.contains(words), "`{words}` is not in the page");
    }
    assert!(!page.contains("test spectra") && !page.contains("NaN") && !page.contains("<h2>Spectra"));
    let message = succeed(here, &["evaluate", MODEL, "--out", "again"]);
    assert!(stderr(&message).contains("scoring 30 test links"), "{}", stderr(&message));
    let message = succeed(here, &["inspect", "p.ron"]);
    let message = String::from_utf8_lossy(&message.stdout);
    for words in
        ["120 received powers at 2 receivers, ids 0 to 59", "2: north, south", "dBm (median", "Random(", "1-NN"]
    {
        assert!(message.contains(words), "`{words}` is not in {message}");
    }
    assert!(!message.contains("picture") && !message.contains("spectra") && !message.contains("NaN"), "{message}");
    predicts_powers(here);
    maps_powers(here);
    succeed(here, &["export", MODEL, "--npz", "m.npz", "--ply", "m.ply"]);
    let mut archive = zip::ZipArchive::new(std::fs::File::open(here.join("m.npz")).unwrap()).unwrap();
    for name in ["kind", "receivers.names", "receivers.positions", "receivers.antennas"] {
        assert!(archive.by_name(&format!("{name}.npy")).is_ok(), "{name}");
    }
}

/// Free space at two subcarriers in `here/waves`, and a pipeline of virtual transmitters beside it.
pub(crate) fn free_space(here: &Path) {
    let place = |k: usize| [1.0 + (k * 7 % 40) as f64 / 20.0, (k * 11 % 40) as f64 / 20.0, 1.0 + (k % 5) as f64 / 10.0];
    let gain = |k: usize, hz: f64| {
        let d = place(k).iter().map(|x| x * x).sum::<f64>().sqrt();
        let (sin, cos) = (std::f64::consts::TAU * hz / 299_792_458.0 * d).sin_cos();
        [cos / d, -sin / d].map(|x| (x as f32).to_le_bytes()).concat()
    };
    let numbers = (0..40).flat_map(|k| [0.3e9 - 5e6, 0.3e9 + 5e6].map(|hz| gain(k, hz)).concat());
    let mut array = pwrfgs::data::npy_header_as("<c8", &[40, 1, 2]);
    array.extend(numbers);
    write(&here.join("waves/channel.npy"), array);
    let places = (0..40).map(|k| place(k).map(|v| v.to_string()).join(",") + "\n").collect::<String>();
    write(&here.join("waves/tx_pos.csv"), format!("x,y,z\n{places}"));
    let text = "Pipeline(name: \"waves\", data: Channels(root: \"waves\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ()), \
                split: Random(test: 0.25), initializer: MatchingPursuit(most: 3, reach: 1.0, hold_out: 0), \
                method: VirtualTransmitters(order: 1), pruners: [LearnableMask(learning_rate: 0.01)], \
                training: (steps: 700, batch: 8, densify_until: 0, prune_until: 350, prune_every: 50, validate_every: 100, \
                checkpoint_every: 35, densify: (every: 0)), baselines: [Zero()], metrics: [ChannelSnr()])";
    write(&here.join("waves.ron"), text);
}

#[test]
fn reports_position_of_too_large_channel_gain() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    free_space(here);
    let path = here.join("waves/channel.npy");
    let mut array = std::fs::read(&path).unwrap();
    let last = array.len() - 8;
    array[last..last + 4].copy_from_slice(&1e20_f32.to_le_bytes());
    write(&path, array);
    refuse(
        here,
        &["run", "waves.ron"],
        2,
        &["waves/channel.npy: channel[39, 0, 1] is (1.0000000200408773e20, ", "1e9"],
    );
    assert!(!here.join("runs").exists());
}

#[test]
fn receiver_names_are_not_formulas_in_tables() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    std::fs::remove_dir_all(here.join("run")).unwrap();
    for (file, name) in [("gateway_position.yml", "\"=north()\""), ("gateway_rssi.csv", "'=north()")] {
        let path = here.join("data").join(file);
        write(&path, read(&path).replacen("north", name, 1));
    }
    succeed(here, &["run", "p.ron", "--out", "run", "-q"]);
    succeed(here, &["predict", MODEL, "--tx", "1,2,1", "--out", "all"]);
    succeed(here, &["map", MODEL, "--plane", "z=1", "--step", "1", "--bounds", "0,1,0,1", "--out", "map"]);
    for (table, rows) in [("run/samples.csv", 60), ("all/predictions.csv", 1), ("map/map.csv", 1)] {
        let text = read(&here.join(table));
        assert_eq!(text.matches(",'=north(),").count(), rows, "{table}: {text}");
        assert!(!text.contains(",=") && !text.contains("'-"), "numbers are not names: {text}");
    }
    assert!(read(&here.join("all/predictions.csv")).contains("north(),-"), "a power below zero");
}

#[test]
fn killed_link_runs_resume_to_identical_result() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    free_space(here);
    let longer = "training=(steps: 700, prune_until: 350, prune_every: 50, validate_every: 100, checkpoint_every: 35)";
    for (pipeline, settings) in [("p.ron", &["--set", longer][..]), ("waves.ron", &[])] {
        let arguments = |out: &'static str| [&["run", pipeline, "--out", out, "-q"][..], settings].concat();
        succeed(here, &arguments("whole"));
        for step in [20, 310, 500] {
            let mut child = pwrfgs(here).args(arguments("killed")).stdout(Stdio::null()).spawn().unwrap();
            wait_for_step(&mut child, &here.join("killed"), step);
            child.kill().unwrap();
            assert!(!child.wait().unwrap().success(), "{pipeline}: killed after step {step}");
        }
        succeed(here, &arguments("killed"));
        let bytes = |run: &str, name: &str| std::fs::read(here.join(run).join(name)).unwrap();
        for name in ["model.safetensors", "validation.csv", "samples.csv", "start.safetensors"] {
            assert!(bytes("whole", name) == bytes("killed", name), "{pipeline}: {name} differs");
        }
        ["whole", "killed"].iter().for_each(|run| std::fs::remove_dir_all(here.join(run)).unwrap());
    }
}

#[test]
fn power_sweeps_are_compared_by_error() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    let experiment = "Experiment(name: \"count\", base: \"p.ron\", seeds: [0, 1], axes: [Axis(name: \"N\", variants: [\
                      (label: \"6\", set: {\"initializer\": Grid(count: 6)}), (label: \"12\")])])";
    write(&here.join("e.ron"), experiment);
    succeed(here, &["sweep", "e.ron"]);
    let report = here.join("runs/count/report");
    let page = read(&report.join("report.html"));
    let without_pictures =
        |(k, part): (usize, &str)| if k == 0 { part.to_owned() } else { part.split('"').skip(1).collect() };
    let table: String = page.split("base64,").enumerate().map(without_pictures).collect();
    for words in
        ["error", "mean [dB]", "90th percentile [dB]", "1-NN (baseline)", "Δ error", "test links", "Error distribution"]
    {
        assert!(table.contains(words), "`{words}` is not in {table}");
    }
    assert!(!table.contains("SSIM") && !table.contains("spectra") && !table.contains("NaN"), "{table}");
    let figures = names(&report.join("figures"));
    for name in ["1-error-n.svg", "1-distribution.svg", "1-distance.svg", "1-room.svg", "1-gaussians.svg"] {
        assert!(figures.contains(name), "{name} is not in {figures:?}");
    }
    // 15 transmitters are tested, at two receivers each, by two variants and a floor.
    let rows = read(&here.join("runs/count/N=6,seed=0/scores.csv"));
    assert_eq!(rows.matches("model,power_error_db,").count(), 30);
}

#[test]
fn suggests_pipeline_for_every_layout() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall(here);
    let message = succeed(here, &["init", "data", "--out", "powers.ron"]);
    assert!(String::from_utf8_lossy(&message.stdout).contains("120 received powers at 2 receivers"), "{message:?}");
    let text = read(&here.join("powers.ron"));
    assert!(
        text.contains("Nerf2Rssi(") && text.contains("ReceivedPower(") && text.contains("longest_m: 10.0"),
        "{text}"
    );
    // Waves along the axes make stripes in maps.
    let encoding = text.split("Wavelengths(").nth(1).and_then(|rest| rest.split("position_encoding").next());
    assert!(encoding.is_some_and(|own| own.contains("shortest_m: 1.25") && own.contains("seed: 0")), "{text}");
    succeed(here, &["run", "powers.ron", "--out", "powers", "--scale", "0.005"]);
    #[cfg(feature = "raytrace")]
    {
        let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/office-csi.ron");
        for (layout, words) in [("channels", ["Channels(", "MatchingPursuit("]), ("csi", ["Nerf2Csi(", "Features("])] {
            let ron = format!("{layout}.ron");
            succeed(here, &["simulate", scene, "--layout", layout, "--samples", "30", "--out", layout]);
            succeed(here, &["init", layout, "--out", &ron]);
            let text = read(&here.join(&ron));
            assert!(words.iter().all(|word| text.contains(word)) && text.contains("Official("), "{text}");
            let plan = succeed(here, &["check", &ron]);
            let has_search = String::from_utf8_lossy(&plan.stdout).contains(" of initial search, then ");
            assert_eq!(has_search, layout == "channels", "{plan:?}");
            assert_eq!(text.contains("reach: 3.0,") && !text.contains("finer"), has_search, "{text}");
            succeed(here, &["inspect", layout, "-q"]);
        }
    }
}

fn predicts_powers(here: &Path) {
    write(&here.join("tx.csv"), "x,y,z\n1,2,1\n3,4,1\n");
    succeed(here, &["predict", MODEL, "--tx-csv", "tx.csv", "--out", "all"]);
    let list = read(&here.join("all/predictions.csv"));
    let rows: Vec<&str> = list.lines().collect();
    assert_eq!((rows[0], rows.len()), ("row,x,y,z,receiver,dbm,training_distance_m", 5));
    assert!(rows[1].starts_with("1,1,2,1,north,-") && rows[4].starts_with("4,3,4,1,south,-"), "{list}");
    assert_eq!(names(&here.join("all")), ["predictions.csv".to_owned()].into());
    succeed(here, &["export", MODEL, "--half", HALF]);
    succeed(here, &["predict", MODEL, HALF, "--tx", "1,2,1", "--receiver", "south", "--out", "two"]);
    let two = read(&here.join("two/predictions.csv"));
    assert!(two.starts_with("row,x,y,z,receiver,dbm,spread_db,training_distance_m\n1,1,2,1,south,-"), "{two}");
    let distance = |list: &str| list.lines().nth(1).unwrap().rsplit(',').next().unwrap().to_owned();
    assert!(distance(&two) == distance(&list) && distance(&two).parse::<f64>().is_ok(), "{two}\n{list}");
    let spread: f64 = two.lines().nth(1).unwrap().split(',').nth(6).unwrap().parse().unwrap();
    assert!((0.0..0.1).contains(&spread), "{two}");
    succeed(here, &["predict", MODEL, "--tx", "1,2,1", "--interval", "0.5", "--out", "band"]);
    let band = read(&here.join("band/predictions.csv"));
    assert!(band.starts_with("row,x,y,z,receiver,dbm,lower_dbm,upper_dbm,training_distance_m\n"), "{band}");
    for row in band.lines().skip(1) {
        let numbers: Vec<f64> = row.split(',').skip(5).take(3).map(|v| v.parse().unwrap()).collect();
        let [dbm, lower, upper] = numbers[..] else { panic!("{band}") };
        assert!(lower < dbm && dbm < upper && ((upper - dbm) - (dbm - lower)).abs() < 1e-3, "{band}");
    }
    let out = ["--tx", "1,2,1", "--out", "no"];
    let two = [&["predict", MODEL, HALF, "--interval", "0.5"][..], &out].concat();
    refuse(here, &two, 2, &["--interval: the model has no calibration", "the model of a single run"]);
    refuse(here, &[&["predict", MODEL, "--stacked"][..], &out].concat(), 2, &["--stacked", "predictions.csv"]);
    let wrong = [&["predict", MODEL, "--receiver", "nort"][..], &out].concat();
    refuse(here, &wrong, 2, &["--receiver nort", "did you mean `north`?", "north, south"]);
    assert!(!here.join("no").exists());
}

fn maps_powers(here: &Path) {
    succeed(here, &["map", MODEL, "--plane", "z=1", "--step", "0.5", "--bounds", "0,2,1,2", "--out", "map"]);
    let maps = [
        "map.csv",
        "power-north.npy",
        "power-north.png",
        "power-south.npy",
        "power-south.png",
        "strongest.npy",
        "strongest.png",
        "training_distance.npy",
        "training_distance.png",
    ];
    assert_eq!(names(&here.join("map")), maps.map(str::to_owned).into());
    let (shape, north) = npy(&here.join("map/power-north.npy"));
    let (south, strongest) = (npy(&here.join("map/power-south.npy")).1, npy(&here.join("map/strongest.npy")).1);
    assert_eq!(shape, [3, 5]);
    assert!(strongest.iter().zip(north.iter().zip(&south)).all(|(s, (a, b))| *s == a.max(*b)));
    // The place x = 1, y = 2 is the third of the third row.
    let list = read(&here.join("all/predictions.csv"));
    let predicted: f32 = list.lines().nth(1).unwrap().split(',').nth(5).unwrap().parse().unwrap();
    assert!((north[12] - predicted).abs() < 1e-3, "{} {predicted}", north[12]);
    assert!(image::open(here.join("map/strongest.png")).is_ok());
    let list = read(&here.join("map/map.csv"));
    assert!(
        list.lines()
            .nth(1)
            .unwrap()
            .starts_with("power-north.npy,power-north.png,received power,dBm,north,x,0,5,y,1,3,0.5,z = 1 m,"),
        "{list}"
    );
    let (shape, distances) = npy(&here.join("map/training_distance.npy"));
    let predicted: f32 =
        read(&here.join("all/predictions.csv")).lines().nth(1).unwrap().rsplit(',').next().unwrap().parse().unwrap();
    assert!(shape == [3, 5] && (distances[12] - predicted).abs() < 1e-3, "{} {predicted}", distances[12]);
    let [limit, beyond]: [f32; 2] = {
        let cells: Vec<f32> =
            list.lines().nth(1).unwrap().rsplit(',').take(2).map(|cell| cell.parse().unwrap()).collect();
        [cells[1], cells[0]]
    };
    assert_eq!(beyond as usize, distances.iter().filter(|metres| **metres > limit).count(), "{list}");
    let message =
        succeed(here, &["map", MODEL, "--plane", "y=2", "--receiver", "south", "--step", "1", "--out", "side"]);
    let words = "(all training positions and mapped receivers); set --bounds to change this";
    assert!(stderr(&message).contains(words), "{}", stderr(&message));
    assert_eq!(names(&here.join("side")).len(), 5);
    for (arguments, words) in [
        (&["--plane", "w=1"][..], &["--plane w=1", "such as z=1.2"][..]),
        (&["--plane", "z=1", "--step", "0"], &["--step 0"]),
        (&["--plane", "z=1", "--step", "1e300"], &["--step 1e300: expected"]),
        (&["--plane", "z=1", "--bounds", "2,1,0,1"], &["--bounds 2,1,0,1", "the smaller first"]),
        (&["--plane", "z=1", "--bounds", "0,90000,0,90000", "--step", "0.1"], &["too large", "increase --step"]),
        (&["--plane", "z=1", "--of", "direction"], &["--of direction", "received powers"]),
        (&["--plane", "z=1", "--receiver", "x"], &["--receiver x", "north, south"]),
    ] {
        refuse(here, &[&["map", MODEL, "--out", "no"][..], arguments].concat(), 2, words);
    }
    refuse(here, &["map", MODEL, "--plane", "z=1", "--step", "1", "--out", "map"], 2, &["map", "not empty"]);
    assert!(!here.join("no").exists());
}

/// A model of channels of an office in `run`, trained in six steps.
#[cfg(feature = "raytrace")]
pub(crate) fn office(here: &Path) {
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/office-channel.ron");
    let text = format!(
        "Pipeline(name: \"office\", data: Simulated(scene: \"{scene}\", samples: 24, points: 200, observe: \
         Channel(snr_db: 30), cache: false), split: Random(test: 0.25), initializer: PointCloud(max_points: 10), \
         method: SplattedChannel(deformation: Factored(depth: 1, width: 8, tx_encoding: Octaves(1))), training: (steps: 6, batch: \
         2, densify_until: 2, prune_until: 4, prune_every: 2, validate_every: 0, densify: (every: 0)), baselines: \
         [NearestNeighbours(k: 1)], metrics: [ChannelSnr()])"
    );
    write(&here.join("p.ron"), text);
    succeed(here, &["run", "p.ron", "--out", "run"]);
}

#[test]
#[cfg(feature = "raytrace")]
fn channels_are_reported_predicted_and_mapped() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    office(here);
    let page = page_of(&here.join("run"));
    for words in ["Power delay profile", "16 antennas × 16 subcarriers", "degrees, unwrapped", "below an SNR"] {
        assert!(page.contains(words), "`{words}` is not in the page");
    }
    assert!(!page.contains("test spectra") && !page.contains("NaN"));
    let message = succeed(here, &["inspect", "p.ron"]);
    let message = String::from_utf8_lossy(&message.stdout);
    assert!(
        message.contains("24 channels of 16 antennas x 16 subcarriers")
            && message.contains("mean power of the channel"),
        "{message}"
    );
    write(&here.join("tx.csv"), "x,y,z\n3,2,1\n4,4,1\n");
    let interval = ["predict", MODEL, "--tx-csv", "tx.csv", "--interval", "0.9", "--out", "no"];
    refuse(here, &interval, 2, &["--interval: not supported for channels"]);
    succeed(here, &["predict", MODEL, "--tx-csv", "tx.csv", "--out", "each"]);
    succeed(here, &["predict", MODEL, "--tx-csv", "tx.csv", "--stacked", "--out", "stack"]);
    succeed(here, &["export", MODEL, "--half", HALF]);
    succeed(here, &["predict", MODEL, HALF, "--tx-csv", "tx.csv", "--stacked", "--out", "two"]);
    assert_eq!(names(&here.join("each")), ["00001.npy", "00002.npy", "predictions.csv"].map(str::to_owned).into());
    assert_eq!(names(&here.join("stack")), ["channels.npy", "predictions.csv"].map(str::to_owned).into());
    assert_eq!(names(&here.join("two")), ["channels.npy", "spread.npy", "predictions.csv"].map(str::to_owned).into());
    let bytes = |name: &str| std::fs::read(here.join(name)).unwrap();
    let (one, all) = (bytes("each/00002.npy"), bytes("stack/channels.npy"));
    let header = |bytes: &[u8]| String::from_utf8_lossy(&bytes[..128]).into_owned();
    assert!(header(&one).contains("'<c8'") && header(&one).contains("(16, 16)"), "{}", header(&one));
    assert!(header(&all).contains("'<c8'") && header(&all).contains("(2, 16, 16)"), "{}", header(&all));
    assert_eq!(one[one.len() - 2048..], all[all.len() - 2048..], "stacked or not, the same numbers");
    succeed(here, &["map", MODEL, "--plane", "z=1", "--step", "0.5", "--bounds", "3,4,2,3", "--out", "map"]);
    assert_eq!(npy(&here.join("map/power.npy")).0, [3, 3]);
    let db: f32 =
        read(&here.join("each/predictions.csv")).lines().nth(1).unwrap().split(',').nth(5).unwrap().parse().unwrap();
    assert!((npy(&here.join("map/power.npy")).1[0] - db).abs() < 1e-2);
}
