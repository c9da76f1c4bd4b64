//! Every command with every task: it succeeds, or refuses with exit code 2 and the reason.

#![cfg(all(feature = "report", feature = "viewer"))]

use crate::common::{call, picture, refuse, stderr, stdout, succeed, write};
use crate::view::Served;
use pwrfgs::data::{base_station_yaml, npy_header_as, save};
use pwrfgs_core::{Channels, Dataset, Image, Observations, Pose, Real, Receiver, Sample, Spectra, gains_of, recognise};
use std::fmt::Write as _;
use std::path::Path;

const COUNT: usize = 40;

fn place(k: usize) -> [f64; 3] {
    [1.0 + (k * 7 % 40) as f64 / 20.0, (k * 11 % 40) as f64 / 20.0, 1.0 + (k % 5) as f64 / 10.0]
}

/// Numbers that depend on a transmitter, from 0 to 1.
fn value(k: usize, i: usize) -> f64 {
    0.5 + 0.5 * (place(k)[0] * (1.0 + i as f64 * 0.1) + place(k)[1]).sin()
}

/// A folder of each kind: spectra, powers, channels, uplinks without positions, and images of a camera.
fn folders(here: &Path) {
    let samples = |receivers: usize| -> Vec<Sample> {
        let pairs = (0..COUNT).flat_map(|k| (0..receivers).map(move |receiver| (k, receiver)));
        pairs.map(|(k, receiver)| Sample { receiver, ..Sample::new(k as u32, place(k)) }).collect()
    };
    let at = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.5], ..Pose::IDENTITY });
    let numbers = |of_each: usize| (0..COUNT * of_each).map(move |i| value(i / of_each, i % of_each));
    let pixels = numbers(24 * 6).map(|v| (255.0 * v) as u8).collect();
    let powers = numbers(2).map(|v| (-40.0 - 30.0 * v) as Real).collect();
    let gains = numbers(6).map(|v| [v as Real, 0.5]).collect();
    let array = Receiver { antennas: vec![[0.0; 3], [0.06, 0.0, 0.0]], ..at("array", 0.0) };
    let channels = Channels { antennas: 2, frequencies_hz: vec![0.29e9, 0.3e9, 0.31e9], gains };
    for (name, receivers, observations) in [
        ("spectra", vec![at("gate", 0.0)], Observations::from(Spectra::grey((24, 6), pixels).unwrap())),
        ("powers", vec![at("north", 0.0), at("south", 4.0)], Observations::Powers(powers)),
        ("channels", vec![array], Observations::Channels(channels)),
    ] {
        let samples = samples(receivers.len());
        let data = Dataset::of_links(name, receivers, vec![], &samples, observations).unwrap();
        save(&data, &here.join(name)).unwrap();
    }
    let bytes = numbers(2 * 8).flat_map(|v| [v as f32, 0.5]).flat_map(f32::to_le_bytes);
    let array: Vec<u8> = npy_header_as("<c8", &[COUNT, 2, 8]).into_iter().chain(bytes).collect();
    write(&here.join("uplinks/csidata.npy"), array);
    write(&here.join("uplinks/base-station.yml"), base_station_yaml(&[[0.0; 3], [0.06, 0.0, 0.0]]));
    let mut images = String::new();
    for k in 0..COUNT {
        let [x, y, z] = place(k).map(|v| -v);
        writeln!(images, "{k} 1 0 0 0 {x} {y} {z} 1 {k}.png\n").unwrap();
        picture(&here.join(format!("images/images/{k}.png")), 24, 18);
    }
    write(&here.join("images/sparse/0/cameras.txt"), "1 SIMPLE_PINHOLE 24 18 20 12 9\n");
    write(&here.join("images/sparse/0/images.txt"), images);
}

const NO_POSITION: (&str, &str) = ("uplinks", "instead of a transmitter");

/// Commands in the order of a user, KIND for the kind of data; who cannot do them, and the words that say so.
const COMMANDS: [(&str, &[(&str, &str)]); 18] = [
    ("inspect KIND", &[]),
    ("init KIND --out KIND.ron", &[]),
    ("check KIND.ron", &[]),
    ("run KIND.ron --out run/KIND", &[]),
    ("check run/KIND", &[]),
    ("evaluate run/KIND/model.safetensors --out scored/KIND", &[]),
    (
        "predict run/KIND/model.safetensors --tx-csv walk.csv --out heard/KIND",
        &[NO_POSITION, ("images", "give its poses with --rx-pose")],
    ),
    (
        "predict run/KIND/model.safetensors --tx 1.5,1,1.2 --stacked --out stacked/KIND",
        &[NO_POSITION, ("powers", "remove --stacked"), ("images", "give its poses with --rx-pose")],
    ),
    ("map run/KIND/model.safetensors --plane z=1.2 --step 0.5 --bounds 1,3,0,2 --out map/KIND", &[NO_POSITION]),
    ("locate run/KIND/model.safetensors --out located/KIND", &[NO_POSITION, ("images", "the receiver moves")]),
    ("plan KIND --simulate --count 12 --out next/KIND", &[("uplinks", "no transmitter positions")]),
    (
        "place KIND --count 1 --out place/KIND",
        &[
            ("spectra", "no received powers"),
            ("channels", "no received powers"),
            ("uplinks", "no received powers"),
            ("images", "no received powers"),
        ],
    ),
    ("export run/KIND/model.safetensors --npz KIND.npz --ply KIND.ply --half KIND.half", &[]),
    ("compress run/KIND/model.safetensors --out KIND.small", &[]),
    ("evaluate KIND.small --pipeline run/KIND/pipeline.ron", &[]),
    ("export run/KIND/model.safetensors --tx 1.5,1,1.2 --npz KIND-at.npz", &[NO_POSITION]),
    ("report run/KIND --out report/KIND", &[]),
    (
        "import --spectra KIND/KIND.npy --tx KIND/tx.npy --receiver 0,0,1 --orientation 0,0,0,1 --out new/KIND",
        &[
            ("powers", "cannot read"),
            ("channels", "a spectrum is real"),
            ("uplinks", "cannot read"),
            ("images", "cannot read"),
        ],
    ),
];

/// What makes the pipelines of `init` short.
fn shorter(kind: &str, command: &str) -> Vec<String> {
    let short = |search: &str| ["--scale", "0.005", "--set", search].map(str::to_owned).to_vec();
    match (command.split(' ').next(), kind) {
        (Some("check" | "run"), "channels") => short("initializer=MatchingPursuit(most: 2, reach: 1.0, hold_out: 0)"),
        (Some("check" | "run"), _) => short("training.batch=4"),
        _ => Vec::new(),
    }
}

#[test]
fn every_command_accepts_or_rejects_every_data_kind() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    folders(here);
    write(&here.join("walk.csv"), "x,y,z\n1.5,1,1.2\n1.6,1,1.2\n");
    for kind in ["spectra", "powers", "channels", "uplinks", "images"] {
        for (command, refusals) in COMMANDS {
            let line = command.replace("KIND/KIND.npy", "KIND/FILE.npy").replace("KIND", kind);
            let line = line.replace("FILE", if kind == "channels" { "channel" } else { kind });
            let tx = if kind == "spectra" { "tx.npy" } else { "tx_pos.csv" };
            let mut arguments: Vec<String> = line.replace("tx.npy", tx).split(' ').map(str::to_owned).collect();
            // A run folder is its pipeline as it was trained.
            arguments.extend(if line.starts_with("check run/") { Vec::new() } else { shorter(kind, command) });
            arguments.push("-q".into());
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            match refusals.iter().find(|(refused, _)| *refused == kind) {
                Some((_, words)) => refuse(here, &arguments, 2, &[words]),
                None => _ = succeed(here, &arguments),
            }
        }
    }
    for (kind, words) in [
        ("spectra", ""),
        ("powers", ""),
        ("channels", ""),
        ("uplinks", "localisation"),
        ("images", "the receiver moves"),
    ] {
        let served = Served::start(here, &[&format!("run/{kind}")]);
        let answer = served.body(&format!("/{}/locate?link=0", served.parts().1), "");
        let status = if words.is_empty() { "200" } else { "400" };
        assert!(answer.contains(&format!(" {status} ")) && answer.contains(words), "{kind}: {answer:.600}");
    }
    // Without positions the bootstrap draws single samples.
    let drawn = |kind: &str| std::fs::read_to_string(here.join("run").join(kind).join("run.json")).unwrap();
    assert!(drawn("uplinks").contains("\"edge_m\": null") && !drawn("channels").contains("\"edge_m\": null"));
    for (kind, data) in [
        ("powers", "data=Arrays(root: \"spectra\")"),
        ("spectra", "data=Nerf2Rssi(root: \"powers\")"),
        ("channels", "data=Nerf2Rssi(root: \"powers\")"),
    ] {
        let model = format!("run/{kind}/model.safetensors");
        refuse(here, &["evaluate", &model, "--set", data], 2, &["the data are"]);
        refuse(here, &["run", &format!("{kind}.ron"), "--set", data, "--out", "other"], 2, &["the data are"]);
    }
    refuse(here, &["check", "powers"], 2, &["name a pipeline file or a run folder"]);
}

/// Mean of the three nearest known links of the same receiver, weighted by inverse distance, as another program
/// computes it.
fn three_nearest(data: &Dataset, known: &[usize], i: usize) -> Image {
    let place = |i: usize| -> Vec<f64> {
        let of = |features: &pwrfgs_core::Features| features.row(i).iter().map(|v| *v as f64).collect();
        data.features.as_ref().map_or_else(|| data.sample(i).position().to_vec(), of)
    };
    let distance = |k: usize| place(k).iter().zip(place(i)).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let own = known.iter().filter(|&&k| data.links[k].receiver == data.links[i].receiver);
    let mut near: Vec<(f64, usize)> = own.map(|&k| (distance(k), k)).collect();
    near.sort_by(|a, b| a.partial_cmp(b).unwrap());
    let total: f64 = near[..3].iter().map(|(d, _)| 1.0 / d).sum();
    let mut mean = vec![0.0; data.width * data.height];
    for (d, k) in &near[..3] {
        mean.iter_mut().zip(data.image(*k).pixels).for_each(|(sum, v)| *sum += v as f64 / d / total);
    }
    Image { width: data.width, height: data.height, pixels: mean.into_iter().map(|v| v as Real).collect() }
}

/// Writes predictions of the test ids in `split`, the text of `--split-csv`, into `out`.
fn predict(data: &Dataset, split: &str, out: &Path) {
    let set =
        |line: &str| ["train", "validation", "test"].iter().position(|set| line.split(',').any(|word| word == *set));
    let sets: Vec<Option<usize>> = split.lines().skip(1).map(set).collect();
    let known: Vec<usize> = (0..data.len()).filter(|&i| sets[i] < Some(2)).collect();
    let mut table = format!("{},dbm\n", split.split(',').next().unwrap());
    for i in (0..data.len()).filter(|&i| sets[i] == Some(2)) {
        let image = three_nearest(data, &known, i);
        let bytes = |values: &[Real]| values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect::<Vec<u8>>();
        let (descr, shape, bytes) = if data.task().is_complex {
            let gains = gains_of(&image.pixels, image.width);
            ("<c8", [image.height / 2, image.width], bytes(gains.as_flattened()))
        } else {
            ("<f4", [image.height, image.width], bytes(&image.pixels))
        };
        _ = writeln!(table, "{},{}", data.label(i), image.pixels[0]);
        if !data.task().is_scalar {
            write(&out.join(format!("{:05}.npy", data.label(i))), [npy_header_as(descr, &shape), bytes].concat());
        }
    }
    if data.task().is_scalar {
        write(&out.join("predictions.csv"), table);
    }
}

/// Value of a row, metric and statistic of `report.csv`.
fn value_in(report: &Path, row: &str, metric: &str, statistic: &str) -> f64 {
    let mut reader = csv::Reader::from_path(report.join("report.csv")).unwrap();
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let found = rows.iter().find(|r| (&r[2], &r[4], &r[6]) == (row, metric, statistic));
    found.unwrap_or_else(|| panic!("{row}, {metric}, {statistic} in {rows:?}"))[7].parse().unwrap()
}

#[test]
fn compare_scores_predictions_of_other_program_like_baseline() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    folders(here);
    let search = ["--set", "initializer=MatchingPursuit(most: 2, reach: 1.0, hold_out: 0)"];
    for (kind, methods, more, metric) in [
        ("spectra", "P-WRFGS,waves", &[][..], "ssim"),
        ("powers", "P-WRFGS,NeRF2", &[], "power_error_db"),
        ("channels", "virtual transmitters", &search, "snr_db"),
        ("uplinks", "splatted channel", &[], "snr_db"),
    ] {
        let split = format!("{kind}.csv");
        let message = stdout(&succeed(here, &["compare", kind, "--split-csv", &split]));
        assert!(message.contains(" train, ") && message.contains(" test\n"), "{message}");
        assert!(!here.join("runs").join(format!("compare-{kind}")).exists(), "nothing has run");
        let data = recognise(&here.join(kind)).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
        let split = std::fs::read_to_string(here.join(split)).unwrap();
        predict(&data, &split, &here.join("mine").join(kind));
        let predictions = format!("mine=mine/{kind}");
        let short =
            ["compare", kind, "--methods", methods, "--seeds", "1", "--scale", "0.005", "--predictions", &predictions];
        let arguments = [&short[..], more].concat();
        let table = stdout(&succeed(here, &arguments));
        for words in ["mine (external)", "3-NN (baseline)", "Paired differences from mine", "report.html"] {
            assert!(table.contains(words), "{kind}: `{words}` is not in {table}");
        }
        assert!(methods.split(',').all(|name| table.contains(name)), "{table}");
        let report = here.join("runs").join(format!("compare-{kind}")).join("report");
        for statistic in ["mean", "median", "tail10"] {
            let [mine, ours] = ["mine", "3-NN"].map(|row| value_in(&report, row, metric, statistic));
            assert!((mine - ours).abs() <= 1e-4 * ours.abs().max(1.0), "{kind}, {statistic}: {mine} and {ours}");
        }
        assert!(value_in(&report, "3-NN", metric, "difference").abs() < 1e-4, "{kind}");
        assert_eq!(stderr(&succeed(here, &arguments)).matches("already finished").count(), methods.split(',').count());
    }
    // Other predictions are scored again, and no model is trained again.
    let (model, list) = ("runs/compare-powers/method=P-WRFGS,seed=0/model.safetensors", "mine/powers/predictions.csv");
    let written = || here.join(model).metadata().unwrap().modified().unwrap();
    let (before, text) = (written(), std::fs::read_to_string(here.join(list)).unwrap());
    let worse: Vec<String> = text.lines().map(|line| line.replace(",-", ",-1")).collect();
    write(&here.join(list), worse.join("\n"));
    let again = ["compare", "powers", "--methods", "P-WRFGS,NeRF2", "--seeds", "1", "--scale", "0.005"];
    let again = succeed(here, &[&again[..], &["--predictions", "mine=mine/powers"]].concat());
    assert_eq!((stderr(&again).matches("already finished").count(), written()), (1, before));
    assert!(value_in(&here.join("runs/compare-powers/report"), "mine", "power_error_db", "mean") > 50.0);
    let fewer = ["compare", "powers", "--methods", "NeRF2", "--seeds", "1", "--scale", "0.005"];
    refuse(here, &fewer, 2, &["holds the run `method=P-WRFGS,seed=0`; add its method"]);
    succeed(here, &[&fewer[..], &["--dry-run"]].concat());
    // Predictions that were not compared are not scored.
    write(&here.join(list), text);
    refuse(here, &["evaluate", model], 2, &["mine/powers: holds other predictions, or predictions for other data"]);
    let own = "Predictions(name: \"mine\", root: \"mine/powers\")";
    let twice = format!("baselines=[{own}, {own}]");
    refuse(
        here,
        &["evaluate", model, "--set", &twice],
        2,
        &["two baselines are called `mine`; rename the predictions"],
    );
}

#[test]
fn compare_leaves_out_methods_that_cannot_predict_the_data() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    folders(here);
    // Spectra of 144 pixels, fewer than the rays of NeRF2.
    let message = stderr(&succeed(here, &["compare", "spectra", "--split-csv", "spectra.csv"]));
    assert!(!message.contains("left out"), "{message}");
    let short = ["compare", "spectra", "--methods", "NeRF2", "--seeds", "1", "--scale", "0.002"];
    assert!(stdout(&succeed(here, &short)).contains("NeRF2"));
    let message = stderr(&succeed(here, &["compare", "images", "--split-csv", "images.csv"]));
    for method in ["waves", "NeRF2", "WRF-GS"] {
        assert!(
            message.contains(&format!("note: {method} is left out, since it cannot predict these data")),
            "{message}"
        );
    }
    assert!(!message.contains("P-WRFGS") && !message.contains(".ron"), "{message}");
    let named = ["compare", "images", "--methods", "P-WRFGS", "--split-csv", "named.csv"];
    assert!(!stderr(&succeed(here, &named)).contains("left out"));
    let split = |name: &str| std::fs::read_to_string(here.join(name)).unwrap();
    assert_eq!((split("named.csv"), split("named.csv").lines().count()), (split("images.csv"), COUNT + 1));
    for (methods, words) in [("waves", "rasterizer"), ("P-WRFGS,NeRF2", "Nerf2")] {
        let output = call(here, &["compare", "images", "--methods", methods, "--split-csv", "other.csv"]);
        let message = stderr(&output);
        assert!(output.status.code() == Some(2) && message.contains(words) && !message.contains(".ron"), "{message}");
    }
    assert!(!here.join("other.csv").exists());
}

/// Damages the prediction of test sample `id`.
fn damage(mine: &Path, id: &str, broken: &str) {
    let (file, table) = (mine.join(format!("{id:0>5}.npy")), mine.join("predictions.csv"));
    let text = std::fs::read_to_string(&table).unwrap_or_default();
    let mut lines: Vec<&str> = text.lines().collect();
    let array = |descr: &str, shape: [usize; 2], second: f32| {
        let values = (0..6 * shape[1]).map(|i| if i == 1 { second } else { 0.5 }).flat_map(f32::to_le_bytes);
        write(&file, npy_header_as(descr, &shape).into_iter().chain(values).collect::<Vec<u8>>());
    };
    let (odd, loud) = (format!("{id},NaN"), format!("{id},1e30"));
    match (broken, table.is_file()) {
        ("missing", true) => _ = lines.remove(1),
        ("twice", true) => lines.insert(1, lines[1]),
        ("nan", true) => lines[1] = &odd,
        ("loud", true) => lines[1] = &loud,
        ("header", true) => lines[0] = "link,power",
        ("missing", false) => std::fs::remove_file(&file).unwrap(),
        ("extra", false) => _ = std::fs::copy(&file, mine.join("00099.npy")).unwrap(),
        ("twice", false) => _ = std::fs::copy(&file, mine.join(format!("{id}.npy"))).unwrap(),
        ("shape", false) => array("<f4", [6, 12], 0.5),
        ("type", false) => array("<c8", [6, 24], 0.5),
        ("nan", false) => array("<f4", [6, 24], f32::NAN),
        ("decibels", false) => array("<f4", [6, 24], -60.0),
        ("short", false) => write(&file, npy_header_as("<f4", &[6, 24])),
        other => panic!("{other:?}"),
    }
    if table.is_file() {
        write(&table, lines.join("\n"));
    }
}

#[test]
fn compare_rejects_invalid_predictions() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    folders(here);
    let compare = |kind: &'static str, more: &[&'static str]| [&["compare", kind][..], more].concat();
    let of = |kind: &'static str| compare(kind, &["--predictions", "mine=mine"]);
    for (kind, broken, words) in [
        ("spectra", "missing", "mine: test ids without prediction: 1, such as ID; give one prediction per test id"),
        (
            "spectra",
            "extra",
            "mine: predictions that are not for test ids: 1, such as 99; give one prediction per test id",
        ),
        ("spectra", "twice", "is id ID as well; remove one of the two"),
        (
            "spectra",
            "shape",
            "has shape [6, 12], expected [6, 24] in C order; save numpy.ascontiguousarray(a), one array [elev",
        ),
        ("spectra", "type", "has numbers of type `<c8`, expected `<f4`; save a.astype('<f4')"),
        ("spectra", "nan", "the value at [0, 1] is NaN; give finite numbers, linear, 0 to 1"),
        ("spectra", "decibels", "the value at [0, 1] is -60; give finite numbers, linear"),
        ("spectra", "short", "does not have the length of its shape"),
        ("powers", "missing", "test links without prediction: 1, such as ID"),
        ("powers", "twice", "predictions.csv:3:1: link `ID` occurs twice"),
        ("powers", "nan", "no power; give one per link, or remove the row"),
        ("powers", "loud", "`1e30` is not a power in dBm; give the power in dBm"),
        ("powers", "header", "predictions.csv:1:1: no column `dbm`; the first line must name the columns link, dbm"),
    ] {
        let (split, mine) = (here.join("split.csv"), here.join("mine"));
        _ = std::fs::remove_dir_all(&mine);
        succeed(here, &compare(kind, &["--split-csv", "split.csv"]));
        let data = recognise(&here.join(kind)).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
        let text = std::fs::read_to_string(&split).unwrap();
        std::fs::remove_file(split).unwrap();
        predict(&data, &text, &mine);
        let test: Vec<&str> = text.lines().filter(|line| line.contains(",test,")).collect();
        let id = test[0].split(',').next().unwrap();
        damage(&mine, id, broken);
        refuse(here, &of(kind), 2, &[&words.replace("ID", id)]);
    }
    for (arguments, words) in [
        (compare("nowhere", &[]), "nowhere: no such folder"),
        (compare(".", &[]), "no known layout of data"),
        (of("channels"), "test ids without prediction"),
        (compare("spectra", &["--predictions", "mine"]), "--predictions mine: expected NAME=FOLDER"),
        (compare("spectra", &["--predictions", "3-NN=mine"]), "the table has another row `3-NN`; choose another name"),
        (compare("spectra", &["--predictions", "mine=none"]), "--predictions mine=none: no such folder"),
        (compare("spectra", &["--methods", "NeRF"]), "no such method for these data; did you mean `NeRF2`?"),
    ] {
        refuse(here, &arguments, 2, &[words]);
    }
    assert!(!here.join("runs").exists());
}
