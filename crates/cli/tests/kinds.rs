//! Every command over every kind of data: it does its work, or says with exit code 2 why it cannot.

#![cfg(all(feature = "report", feature = "viewer"))]

use crate::common::{refuse, succeed, write};
use pwrfgs::data::{base_station_yaml, npy_header_as, save};
use pwrfgs_core::{Channels, Dataset, Observations, Pose, Real, Receiver, Sample, Spectra};
use std::path::Path;

const COUNT: usize = 40;

fn place(k: usize) -> [f64; 3] {
    [1.0 + (k * 7 % 40) as f64 / 20.0, (k * 11 % 40) as f64 / 20.0, 1.0 + (k % 5) as f64 / 10.0]
}

/// Numbers that depend on a transmitter, from 0 to 1.
fn value(k: usize, i: usize) -> f64 {
    0.5 + 0.5 * (place(k)[0] * (1.0 + i as f64 * 0.1) + place(k)[1]).sin()
}

/// A folder of each kind: spectra, powers, channels, and uplinks without positions.
fn folders(here: &Path) {
    let samples = |receivers: usize| -> Vec<Sample> {
        let pairs = (0..COUNT).flat_map(|k| (0..receivers).map(move |receiver| (k, receiver)));
        pairs.map(|(k, receiver)| Sample { id: k as u32, tx: place(k), receiver }).collect()
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
}

const NO_POSITION: (&str, &str) = ("uplinks", "instead of a transmitter");

/// Commands in the order of a user, KIND for the kind of data; who cannot do them, and the words that say so.
const COMMANDS: [(&str, &[(&str, &str)]); 15] = [
    ("inspect KIND", &[]),
    ("init KIND --out KIND.ron", &[]),
    ("check KIND.ron", &[]),
    ("run KIND.ron --out run/KIND", &[]),
    ("check run/KIND", &[]),
    ("evaluate run/KIND/model.safetensors --out scored/KIND", &[]),
    ("predict run/KIND/model.safetensors --tx-csv walk.csv --out heard/KIND", &[NO_POSITION]),
    (
        "predict run/KIND/model.safetensors --tx 1.5,1,1.2 --stacked --out stacked/KIND",
        &[NO_POSITION, ("powers", "remove --stacked")],
    ),
    ("map run/KIND/model.safetensors --plane z=1.2 --step 0.5 --bounds 1,3,0,2 --out map/KIND", &[NO_POSITION]),
    ("export run/KIND/model.safetensors --npz KIND.npz --ply KIND.ply --half KIND.half", &[]),
    ("compress run/KIND/model.safetensors --out KIND.small", &[]),
    ("evaluate KIND.small --pipeline run/KIND/pipeline.ron", &[]),
    ("export run/KIND/model.safetensors --tx 1.5,1,1.2 --npz KIND-at.npz", &[NO_POSITION]),
    ("report run/KIND --out report/KIND", &[]),
    (
        "import --spectra KIND/KIND.npy --tx KIND/tx.npy --receiver 0,0,1 --orientation 0,0,0,1 --out new/KIND",
        &[("powers", "cannot read"), ("channels", "a spectrum is real"), ("uplinks", "cannot read")],
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
    for kind in ["spectra", "powers", "channels", "uplinks"] {
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
