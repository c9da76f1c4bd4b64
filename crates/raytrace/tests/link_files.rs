//! Folders of powers and channels: reproducible bytes, content, and clear errors.

use crate::common::{CSI, small_room};
use pwrfgs_raytrace::output::{DatasetWriter, OutputLayout};
use pwrfgs_raytrace::{
    ObservationKind, ReceiverObservation, SILENT_DBM, SceneFile, SimulatedObservation, SimulationRecipe,
    SimulationRequest, Simulator, simulate_links,
};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Parses a scene.
fn parse(text: &str) -> SceneFile {
    SceneFile::parse(text, Path::new("links.ron")).unwrap()
}

/// Returns the recipe of 10 samples of a scene.
fn recipe(folder: &Path, text: &str, observe: ObservationKind) -> SimulationRecipe {
    let path = folder.join("scene.ron");
    fs::write(&path, text).unwrap();
    SimulationRecipe::read(&path, 10, 7, 50).unwrap().observing(observe).unwrap()
}

/// Returns every file of a folder with its bytes.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                all.push((path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap()));
            }
        }
    }
    all.sort();
    all
}

/// Writes a data set.
fn try_write(recipe: &SimulationRecipe, layout: OutputLayout, has_paths: bool, out: &Path) -> pwrfgs_core::Result<()> {
    DatasetWriter { layout, has_paths, progress: &|_, _| {}, stop: &AtomicBool::new(false) }.write(recipe, out)
}

/// Writes a data set with paths, and returns its files.
fn written(recipe: &SimulationRecipe, layout: OutputLayout, out: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    try_write(recipe, layout, true, out).unwrap();
    contents(out)
}

const KINDS: [(OutputLayout, ObservationKind); 5] = [
    (OutputLayout::Images, ObservationKind::Spectrum),
    (OutputLayout::Array, ObservationKind::Spectrum),
    (OutputLayout::Rssi, ObservationKind::Power { noise_db: 3.0 }),
    (OutputLayout::Channels, ObservationKind::Channel { snr_db: Some(10.0) }),
    (OutputLayout::Csi, ObservationKind::Channel { snr_db: None }),
];

#[test]
fn every_layout_is_bit_identical_at_any_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    for (layout, observe) in KINDS {
        let recipe = recipe(folder.path(), &small_room(CSI), observe);
        let written_files = [1, 3].map(|threads| {
            let out = folder.path().join(format!("{layout:?}{threads}"));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&recipe, layout, &out))
        });
        assert!(written_files[0] == written_files[1], "{layout:?}");
    }
}

#[test]
fn receiver_observes_same_with_and_without_others() {
    let folder = tempfile::tempdir().unwrap();
    let text = small_room(CSI);
    let (from, to) = (text.find("receiver: (pos").unwrap(), text.find("transmitter: (").unwrap());
    let b = "receiver: (name: \"b\", position: (3.7, 1, 2), orientation: Facing(direction: (-1, 0, 0)),
             array: (rows: 4, columns: 2)),";
    let alone = format!("{}{b}{}", &text[..from], &text[to..]);
    for (layout, observe) in KINDS {
        let both = recipe(folder.path(), &text, observe);
        let all = written(&both, layout, &folder.path().join(format!("{layout:?}")));
        let recipe = recipe(folder.path(), &alone, observe);
        let files_alone = written(&recipe, layout, &folder.path().join(format!("{layout:?} alone")));
        if layout == OutputLayout::Rssi {
            let column = |files: &[(PathBuf, Vec<u8>)], k: usize| -> Vec<String> {
                let table = files.iter().find(|(name, _)| name == Path::new("gateway_rssi.csv")).unwrap();
                let text = String::from_utf8(table.1.clone()).unwrap();
                text.lines().map(|line| line.split(',').nth(k).unwrap().into()).collect()
            };
            assert_eq!(column(&all, 1), column(&files_alone, 0));
            continue;
        }
        let of_b =
            all.iter().filter_map(|(name, bytes)| Some((name.strip_prefix("b").ok()?.to_owned(), bytes.clone())));
        assert!(of_b.eq(files_alone.into_iter()), "{layout:?}");
        assert!(all.iter().any(|(name, _)| name == Path::new("gateway1/manifest.json")));
    }
}

#[test]
fn files_hold_simulated_observations() {
    let folder = tempfile::tempdir().unwrap();
    let text = small_room(CSI).replace("transmitter: (", "transmitter: (power_dbm: -50, ");
    let received = |observe| {
        let mut all = Vec::new();
        let request = SimulationRequest { kind: observe, samples: 10, seed: 7 };
        let each = |_, _, received: Vec<ReceiverObservation>| {
            all.extend(received.into_iter().map(|received| received.observed));
            Ok(())
        };
        simulate_links(&Simulator::new(&parse(&text)).unwrap(), &request, &AtomicBool::new(false), each).unwrap();
        all
    };
    let text_of = |out: &str, name: &str| fs::read_to_string(folder.path().join(out).join(name)).unwrap();

    let observe = ObservationKind::Power { noise_db: 3.0 };
    written(&recipe(folder.path(), &text, observe), OutputLayout::Rssi, &folder.path().join("rssi"));
    let table = text_of("rssi", "gateway_rssi.csv");
    let mut rows = table.lines();
    assert_eq!(rows.next(), Some("gateway1,b"));
    let read: Vec<SimulatedObservation> =
        rows.flat_map(|row| row.split(',').map(|v| SimulatedObservation::Power(v.parse().unwrap()))).collect();
    assert_eq!(read, received(observe));
    let silent = table.matches("-100.0").count();
    assert!(silent > 0 && silent < 20 && read.contains(&SimulatedObservation::Power(SILENT_DBM)), "{table}");
    assert_eq!(text_of("rssi", "gateway_position.yml"), "gateway1: [0.2, 1.5, 1.5]\nb: [3.7, 1.0, 2.0]\n");
    assert_eq!(text_of("rssi", "test_index.txt"), "4\n9\n");
    assert_eq!(text_of("rssi", "tx_pos.csv").lines().count(), 11);
    assert!(text_of("rssi", "manifest.json").contains("\"simulated\": true"));
    assert!(folder.path().join("rssi/paths-b.csv").exists());

    let observe = ObservationKind::Channel { snr_db: Some(30.0) };
    let recipe = recipe(folder.path(), &text, observe);
    let links = received(observe);
    for (layout, array, facts) in [
        (OutputLayout::Channels, "channel.npy", "receiver.yml"),
        (OutputLayout::Csi, "csidata.npy", "base-station.yml"),
    ] {
        let out = format!("{layout:?}");
        written(&recipe, layout, &folder.path().join(&out));
        for (r, name) in ["gateway1", "b"].into_iter().enumerate() {
            let bytes = fs::read(folder.path().join(&out).join(name).join(array)).unwrap();
            let header = String::from_utf8_lossy(&bytes[10..128]).into_owned();
            assert!(header.contains("'<c8'") && header.contains("(10, 8, 6)"), "{header}");
            let gains = links.chunks(2).map(|both| &both[r]).flat_map(|observed| match observed {
                SimulatedObservation::Channel(channel) => channel.clone(),
                other => panic!("{other:?}"),
            });
            let expected: Vec<u8> = gains.flat_map(|h| [h.re as f32, h.im as f32]).flat_map(f32::to_le_bytes).collect();
            assert!(bytes[128..] == expected);
            let facts = text_of(&format!("{out}/{name}"), facts);
            let rows = facts.matches('[').count();
            assert_eq!(rows, if layout == OutputLayout::Csi { 1 + 8 } else { 3 + 1 + 8 }, "{facts}");
        }
    }
    let facts = text_of("Channels/b", "receiver.yml");
    assert!(facts.starts_with("name: b\nposition: [3.7, 1.0, 2.0]\n"), "{facts}");
    assert!(facts.contains("carrier_hz: 2400000000.0\nspacing_hz: 3333333.3333333335\n"), "{facts}");
}

#[test]
fn single_receiver_scenes_keep_cache_key() {
    let scene = parse(&small_room("")).with_receiver(&parse(&small_room("")).receiver);
    let text = scene.to_ron();
    for word in ["more_receivers", "subcarriers", "power_dbm", "gateway1"] {
        assert!(!text.contains(word), "{word}");
    }
    assert_eq!(parse(&text), scene);
    let full = parse(&small_room(CSI).replace("transmitter: (", "transmitter: (power_dbm: 3, "));
    assert_eq!(parse(&full.to_ron()), full);
    let folder = tempfile::tempdir().unwrap();
    let names = KINDS.map(|(_, observe)| recipe(folder.path(), &small_room(CSI), observe).folder_name());
    assert!(!recipe(folder.path(), &small_room(CSI), ObservationKind::Spectrum).to_json().contains("\"observe\""));
    assert!(names[0] == names[1] && names[1] != names[2] && names[3] != names[4]);
}

#[test]
fn reports_position_of_invalid_input() {
    let error_of = |from: &str, to: &str| {
        let text = small_room(CSI);
        assert!(text.contains(from), "{from}");
        let scene = SceneFile::parse(&text.replacen(from, to, 1), Path::new("s.ron"));
        let error = scene.and_then(|scene| Simulator::new(&scene).map(|_| ())).expect_err(to);
        assert!(error.is_input());
        error.to_string()
    };
    for (from, to, expected) in [
        ("name: \"b\"", "name: \"gateway1\"", "s.ron:6:11: two receivers are called `gateway1`"),
        ("name: \"b\", ", "", "two receivers are called `gateway1`; give each a unique `name`"),
        ("name: \"b\"", "name: \"GateWay1\"", "two receivers are called `GateWay1`"),
        ("name: \"b\"", "name: \"a/b\"", "s.ron:6:35: `a/b` is not a valid receiver name; use a letter"),
        ("name: \"b\"", "name: \"\"", "`` is not a valid receiver name"),
        ("name: \"b\"", "name: \"No\"", "`No` is not a valid receiver name"),
        ("name: \"b\"", "name: \"null\"", "`null` is not a valid receiver name"),
        ("(3.7, 1, 2)", "(NaN, 1, 2)", "s.ron:6:35: receiver `b`: `position` is [NaN"),
        ("(3.7, 1, 2)", "(1.5, 1.5, 0.3)", "the receiver `b` at [1.5, 1.5, 0.3] is inside `desk`"),
        ("(3.7, 1, 2)", "(9, 1, 2)", "the receiver `b` at [9.0, 1.0, 2.0] is outside the room"),
        ("direction: (-1, 0, 0)", "direction: (0, 0, 0)", "receiver `b`: `direction` is [0.0, 0.0, 0.0]"),
        ("rows: 4", "rows: 0", "array: `rows` is 0"),
        ("count: 6", "count: 0", "s.ron:10:"),
        ("count: 6", "count: 5000", "subcarriers: `count` is 5000; give 1 to 4096"),
        ("20e6", "-1", "subcarriers: `bandwidth_hz` is -1"),
        ("20e6", "3e9", "s.ron:10:11: subcarriers: `bandwidth_hz` is 3000000000, more than the carrier"),
        ("bandwidth_hz", "bandwith_hz", "did you mean `bandwidth_hz`?"),
        ("more_receivers", "more_recievers", "did you mean `more_receivers`?"),
        ("transmitter: (", "transmitter: (power_dbm: inf, ", "s.ron:8:11: `power_dbm` of the transmitter is inf"),
    ] {
        let message = error_of(from, to);
        assert!(message.contains(expected), "{to}: {message}");
    }
    let one = "(name: \"b\", position: (3.7, 1, 2), orientation: Facing(direction: (-1, 0, 0))),";
    let many: String = (0..300).map(|i| one.replace("\"b\"", &format!("\"b{i}\""))).collect();
    assert!(error_of("more_receivers: [", &format!("more_receivers: [{many}")).contains("302 receivers are too many"));
}

#[test]
fn rejects_observation_that_does_not_fit_layout() {
    let folder = tempfile::tempdir().unwrap();
    let shown = |text: &str, observe: ObservationKind, layout: OutputLayout| {
        let path = folder.path().join("scene.ron");
        fs::write(&path, text).unwrap();
        let recipe = SimulationRecipe::read(&path, 10, 7, 50).and_then(|recipe| recipe.observing(observe));
        let out = folder.path().join("out");
        let made = recipe.and_then(|r| try_write(&r, layout, false, &out));
        let error = made.unwrap_err();
        assert!(error.is_input() && !out.exists());
        error.to_string()
    };
    let (text, channel) = (small_room(CSI), ObservationKind::Channel { snr_db: None });
    assert!(shown(&text, channel, OutputLayout::Rssi).contains("does not match the observation type"));
    assert!(
        shown(&text.replace("rows: 4", "rows: 3"), channel, OutputLayout::Channels)
            .contains("has 8 antennas and `b` has 6")
    );
    assert!(shown(&text.replace("count: 6", "count: 5"), channel, OutputLayout::Csi).contains("give an even number"));
    let path = folder.path().join("scene.ron");
    fs::write(&path, text.replace("count: 6", "count: 4096")).unwrap();
    let links = SimulationRecipe::read(&path, 600_000, 7, 50).unwrap_err().to_string();
    assert!(links.contains("600000 samples at 2 receivers are more than 1000000 links"), "{links}");
    let many = SimulationRecipe::read(&path, 100_000, 7, 50).unwrap().observing(channel);
    let many = many.unwrap_err().to_string();
    assert!(
        many.contains("training with channels of 100000 transmitters needs 52.4 GB of memory, more than the "),
        "{many}"
    );
    assert!(many.ends_with(" available; give fewer samples, antennas or subcarriers"), "{many}");
    assert!(
        shown(&text, ObservationKind::Power { noise_db: f64::NAN }, OutputLayout::Rssi).contains("`noise_db` is NaN")
    );
    assert!(
        shown(&text, ObservationKind::Channel { snr_db: Some(1e9) }, OutputLayout::Csi)
            .contains("`snr_db` is 1000000000")
    );
}

#[test]
fn rejects_table_without_received_power_and_removes_files() {
    let folder = tempfile::tempdir().unwrap();
    let text = small_room("").replace("transmitter: (", "transmitter: (power_dbm: -190, ");
    let recipe = recipe(folder.path(), &text, ObservationKind::Power { noise_db: 0.0 });
    let out = folder.path().join("silent");
    let shown = try_write(&recipe, OutputLayout::Rssi, true, &out).unwrap_err();
    assert!(shown.is_input() && shown.to_string().contains("receives no transmitter above -100 dBm"), "{shown}");
    assert!(!out.exists());
}
