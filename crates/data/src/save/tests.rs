//! Valid data sets are saved and read back unchanged; invalid ones are rejected before writing.

use super::*;
use proptest::prelude::*;
use pwrfgs_core::{Channels as Gains, Geodetic, Pose, Receiver, Sample, Simulation};
use std::fs;

/// The data set read back from a folder.
fn read_back(data: &Dataset) -> Dataset {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("saved");
    let source = save(data, &out).unwrap();
    let recognised = pwrfgs_core::recognise(&out).unwrap();
    let alike = format!("{:?}", recognised.load(Path::new(""), &|_, _| {}).unwrap());
    assert_eq!(alike, format!("{:?}", source.load(Path::new(""), &|_, _| {}).unwrap()), "found as written");
    assert!(save(data, &out).is_err(), "what lies there stays");
    source.load(Path::new(""), &|_, _| {}).unwrap()
}

fn assert_same(data: &Dataset, read_back: &Dataset) {
    assert_eq!((data.len(), data.width, data.height), (read_back.len(), read_back.width, read_back.height));
    let links = |data: &Dataset| data.samples().map(|s| (s.id, s.position(), s.receiver)).collect::<Vec<_>>();
    assert_eq!(links(data), links(read_back));
    assert_eq!((&data.official, &data.scene.points), (&read_back.official, &read_back.scene.points));
    assert_eq!((data.marked_title(), data.scene.bounds), (read_back.title.clone(), read_back.scene.bounds));
    assert!((0..data.len()).all(|i| data.observations.raw(i) == read_back.observations.raw(i)));
    if let (Observations::Channels(first), Observations::Channels(second)) =
        (&data.observations, &read_back.observations)
    {
        assert_eq!(first, second);
    }
    assert_eq!(data.elevation, read_back.elevation);
    assert_eq!(data.is_simulated(), read_back.is_simulated());
    assert_eq!(data.scene.receivers.len(), read_back.scene.receivers.len());
    // Sums and rotations of positions round: to a hundredth of a micrometre on a map.
    let near = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-8);
    for (first, second) in data.scene.receivers.iter().zip(&read_back.scene.receivers) {
        assert_eq!((&first.name, first.pose.orientation), (&second.name, second.pose.orientation));
        assert!(near(&first.pose.position, &second.pose.position), "{first:?} {second:?}");
        assert!(first.antennas.iter().zip(&second.antennas).all(|(a, b)| near(a, b)), "{first:?} {second:?}");
    }
}

/// Checks that `data` and a part of them are read back with their IDs, bounds and title, which says that simulated data are simulated.
fn assert_round_trip(data: &Dataset) {
    assert_same(data, &read_back(data));
    let part = data.subset(&[0, data.len() - 1]).unwrap();
    assert_same(&part, &read_back(&part));
}

#[test]
fn reads_saved_data_back() {
    let pose = Pose { position: [0.25, 1.0, 2.0], ..Pose::IDENTITY };
    let samples: Vec<Sample> = (1..=3).map(|i| Sample::new(i, [f64::from(i) / 3.0, 0.5, 1.0])).collect();
    let spectra = Spectra::float((30, 8), &(0..720).map(|v| v as f32 / 720.0).collect::<Vec<_>>()).unwrap();
    let mut data = Dataset::new("room", pose, vec![[1.0, 2.0, 0.125]], samples.clone(), spectra).unwrap();
    data.official = Some((vec![0, 2], vec![1]));
    data.simulation = Some(Simulation::default());
    assert_round_trip(&data);
    data.elevation = Elevation { first: 80.0, last: -10.0 }; // pixels that are not square, from above to below
    assert_round_trip(&data);

    let spectra = Spectra::grey((30, 8), (0..960).map(|v| (v % 256) as u8).collect()).unwrap();
    let samples = (1..=4).map(|i| Sample::new(i, [f64::from(i % 2), 0.5, 1.0])).collect();
    let data = Dataset::new("carriers", pose, vec![], samples, spectra).unwrap();
    let data = Dataset { official: Some((vec![0, 2], vec![1, 3])), ..data };
    let data = data.with_carriers(&[2.4e9, 2.4e9, 2.4123e9, 2.4123e9]).unwrap();
    let back = read_back(&data);
    assert_eq!((&data.links, &data.scene.receivers), (&back.links, &back.scene.receivers));
    assert_eq!((&data.official, data.image(2)), (&back.official, back.image(2)));

    let folder = tempfile::tempdir().unwrap();
    let refused = |data: &Dataset| save(data, &folder.path().join("refused")).unwrap_err().to_string();
    let mut renamed = data.clone();
    renamed.scene.receivers[1].name = "high".into();
    assert!(refused(&renamed).contains("named such as 2400MHz"), "the reader would give another name");

    let receiver = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.5], ..Pose::IDENTITY });
    let samples = [(0, 0), (0, 1), (1, 1)]
        .map(|(id, receiver)| Sample { receiver, ..Sample::new(id, [f64::from(id), 2.0, 1.5]) });
    let powers = Observations::Powers(vec![-61.5, -70.25, -80.0]);
    let data =
        Dataset::of_links("hall", vec![receiver("=n()", 0.0), receiver("s", 9.0)], vec![], &samples, powers).unwrap();
    assert_round_trip(&data);
    let mut stated = data.clone();
    stated.scene.receivers.iter_mut().for_each(|receiver| receiver.carrier_hz = Some(2.4e9));
    assert!(refused(&stated).contains("powers at stated carriers"));

    let receiver = Receiver { antennas: vec![[0.0; 3], [0.0, 0.0625, 0.0]], ..receiver("array", 1.0) };
    let samples: Vec<Sample> = (0..2).map(|i| Sample::new(i, [f64::from(i), 2.0, 1.5])).collect();
    let gains = (0..12).map(|v| [v as Real, -1.0]).collect();
    let channels = Gains { antennas: 2, frequencies_hz: vec![2.3e9, 2.4e9, 2.5e9], gains };
    let data =
        Dataset::of_links("channels", vec![receiver], vec![], &samples, Observations::Channels(channels)).unwrap();
    let back = read_back(&data);
    assert_same(&data, &back);
    assert_eq!(data.scene.receivers, back.scene.receivers);
}

/// Small data of any kind, some invalid for every layout, drawn from `numbers`.
fn small_data(kind: usize, variant: usize, names: &[String], title: &str, numbers: &[f64]) -> Result<Dataset> {
    let number = |i: usize| numbers[i % numbers.len()];
    let far = if variant.is_multiple_of(2) { [0.0; 3] } else { [500_000.25, 5_400_000.5, 100.0] };
    let position = |i: usize| [0, 1, 2].map(|k| far[k] + number(3 * i + k));
    let turn: [f64; 4] = [0, 1, 2, 3].map(|k| number(k + 7) + 1.5);
    let length = turn.iter().map(|v| v * v).sum::<f64>().sqrt();
    let orientation = if variant.is_multiple_of(3) { Pose::IDENTITY.orientation } else { turn.map(|v| v / length) };
    let antennas = if kind == 2 { 1 + variant % 3 } else { 1 };
    let receiver = |(i, name): (usize, &String)| Receiver {
        antennas: (0..antennas).map(|a| [0.06 * a as f64, 0.0, 0.0]).collect(),
        ..Receiver::new(name.clone(), Pose { position: position(40 + i), orientation })
    };
    let receivers: Vec<Receiver> = names.iter().enumerate().map(receiver).take(if kind == 1 { 9 } else { 1 }).collect();
    let pairs = (0..4).flat_map(|t| (0..receivers.len()).map(move |r| (t, r)));
    let is_received = |(t, r): &(usize, usize)| kind != 1 || number(5 * t + r) > -0.7;
    let samples: Vec<Sample> = pairs
        .filter(is_received)
        .map(|(t, receiver)| Sample { receiver, ..Sample::new(t as u32 + 1, position(t)) })
        .collect();
    let count = samples.len();
    let size = [(12, 6), (6, 12), (16, 4), (5, 5)][variant % 4];
    let pixels = size.0 * size.1;
    let observations = match kind {
        0 if variant < 5 => {
            Spectra::grey(size, (0..4 * pixels).map(|i| (90.0 * (1.2 + number(i))) as u8).collect())?.into()
        }
        0 => Spectra::float(size, &(0..4 * pixels).map(|i| number(i).abs() as f32).collect::<Vec<_>>())?.into(),
        1 => Observations::Powers((0..count).map(|i| (number(i) * 100.0).round() as Real).collect()),
        _ => {
            let frequencies_hz =
                (0..3).map(|i| 1e9 + 1e6 * (number(i) + if variant < 6 { 3.0 * i as f64 } else { 0.0 }));
            let stated_antennas = if variant == 7 { 1 } else { antennas };
            let gains = (0..4 * stated_antennas * 3).map(|i| [number(i) as Real, number(i + 9) as Real]).collect();
            Observations::Channels(Gains { antennas: stated_antennas, frequencies_hz: frequencies_hz.collect(), gains })
        }
    };
    let points = (0..variant).map(|i| position(i + 20).map(|v| (v * 16.0).round() / 16.0)).collect();
    let data = Dataset::of_links(title, receivers, points, &samples, observations)?;
    let elevation = [(0.0, 90.0), (-90.0, 90.0), (90.0, 0.0), (0.0, 0.5)][if kind == 0 { variant / 2 } else { 0 }];
    Ok(Dataset { elevation: elevation.into(), simulation: (variant > 3).then(Simulation::default), ..data })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn valid_data_round_trip_unchanged(
        kind in 0..3usize, variant in 0..8usize, names in prop::collection::vec("[ab,\"\\[: é\u{2028}-]{1,4}", 1..4),
        title in "[a-z\\[{ :-]{0,9}", numbers in prop::collection::vec(-1.01..1.01f64, 3..90),
    ) {
        let Ok(data) = small_data(kind, variant, &names, &title, &numbers) else { return Ok(()) };
        match check_dataset(&data) {
            Ok(()) => assert_same(&data, &read_back(&data)),
            Err(refused) => {
                let folder = tempfile::tempdir().unwrap();
                let message = save(&data, &folder.path().join("saved")).unwrap_err();
                prop_assert!(message.is_input() && message.to_string() == refused.to_string(), "{message}\n{refused}");
                prop_assert_eq!(folder.path().read_dir().unwrap().count(), 0);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn power_folder_round_trips(
        names in prop::collection::vec("['=\"]?[=ab é]{1,2}", 1..4),
        cells in prop::collection::vec(prop::sample::select(vec!["-60", "-100", "-100.0000001", "-99.9", "2e-50"]), 3),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
        write("gateway_position.yml", gateway_positions_yaml(names.iter().map(|name| (&**name, Pose::IDENTITY))));
        let row = |cell: &&str| names.iter().map(|_| *cell).collect::<Vec<_>>().join(",") + "\n";
        let head = names.iter().map(|name| csv_cell(name)).collect::<Vec<_>>().join(",") + "\n";
        write("gateway_rssi.csv", head + &cells.iter().map(row).collect::<String>());
        write("tx_pos.csv", "x,y,z\n1,2,3\n4,5,6\n7,8,9\n".into());
        let source = Nerf2Rssi { root: folder.path().into(), points: None };
        if let Ok(data) = source.load(Path::new(""), &|_, _| {}) {
            let read: Vec<&str> = data.scene.receivers.iter().map(|receiver| &*receiver.name).collect();
            prop_assert_eq!(read, names.iter().map(String::as_str).collect::<Vec<_>>());
            assert_same(&data, &read_back(&data));
        }
    }
}

#[test]
fn rejects_receiver_name_that_cannot_be_saved() {
    let receiver = |name: &str| Receiver::new(name, Pose::IDENTITY);
    let samples: Vec<Sample> = (1..3).map(|i| Sample::new(i, [f64::from(i), 0.5, 1.0])).collect();
    let spectra = Spectra::grey((12, 3), vec![7; 72]).unwrap();
    let spectra = Dataset::new("room", Pose::IDENTITY, vec![], samples.clone(), spectra).unwrap();
    let gains = Gains { antennas: 1, frequencies_hz: vec![1e9], gains: vec![[1.0, 0.0]; 2] };
    let channels =
        Dataset::of_links("channels", vec![receiver("receiver")], vec![], &samples, Observations::Channels(gains))
            .unwrap();
    for (data, place) in [(spectra, "gateway_info.yml:6:11"), (channels, "receiver.yml:1:7")] {
        let folder = tempfile::tempdir().unwrap();
        let source = save(&data, &folder.path().join("saved")).unwrap();
        let path = folder.path().join("saved").join(place.split(':').next().unwrap());
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text.replacen("\"receiver\"", "'a\"b'", 1)).unwrap();
        let message = source.load(Path::new(""), &|_, _| {}).unwrap_err();
        assert!(
            message.is_input() && message.to_string().contains(&format!("{place}: receiver name `a\"b` is invalid")),
            "{message}"
        );
    }
}

#[test]
fn rejects_unsavable_data_with_advice() {
    let named = |names: &[&str], powers: &[Real]| {
        let receivers: Vec<Receiver> = names.iter().map(|name| Receiver::new(*name, Pose::IDENTITY)).collect();
        let samples: Vec<Sample> = (0..powers.len()).map(|i| Sample::new(i as u32, [i as f64, 0.0, 0.0])).collect();
        let data = Dataset::of_links("d", receivers, vec![], &samples, Observations::Powers(powers.to_vec())).unwrap();
        check_dataset(&data).unwrap_err().to_string()
    };
    let spectra = |size: (usize, usize), value: f32| {
        let spectra = Spectra::float(size, &vec![value; size.0 * size.1]).unwrap();
        check_dataset(&Dataset::new("d", Pose::IDENTITY, vec![], vec![Sample::new(1, [0.0; 3])], spectra).unwrap())
    };
    for (message, words) in [
        (named(&["a", "b"], &[-60.0]), "receiver `b` received no transmitter; leave it out"),
        (named(&["a"], &[-301.0]), "powers[0] is -301, no power in dBm"),
        (named(&["a\"b"], &[-60.0]), "is invalid; use 1 to 100 characters"),
        (spectra((12, 36), 0.5).unwrap_err().to_string(), "save s.transpose(0, 2, 1)"),
        (spectra((36, 12), 1.5).unwrap_err().to_string(), "spectra[0, 0, 0] is 1.5; spectra are linear, from 0 to 1"),
    ] {
        assert!(message.starts_with("data set `d`: ") && message.contains(words), "{message}");
    }
    assert!(spectra((36, 12), 0.5).is_ok());
}

/// Whether -100 dBm is a reading or a missing link, the folder declares it.
#[test]
fn power_of_minus_100_is_kept() {
    let at = |name: &str, x: f64| Receiver::new(name, Pose::from([x, 0.0, 2.0]));
    let sample = |id: u32, receiver: usize| Sample { receiver, ..Sample::new(id, [f64::from(id), 1.0, 1.0]) };
    let samples = [sample(0, 0), sample(0, 1), sample(1, 1), sample(2, 0)];
    for (first, cells) in
        [(-100.0, "-100.0,-70.5\n,-107.0\n-60.0,\n"), (-90.0, "-90.0,-70.5\n-100.0,-107.0\n-60.0,-100.0\n")]
    {
        let powers = vec![first, -70.5, -107.0, -60.0];
        let receivers = vec![at("a", 0.0), Receiver { is_estimated: true, ..at("b", 5.0) }];
        let mut data = Dataset::of_links("d", receivers, vec![], &samples, powers.clone().into()).unwrap();
        data.scene.geodetic = Some(Geodetic { latitude: 48.14, longitude: 11.58 });
        data.accepted = vec!["lone-value".into()];
        let folder = tempfile::tempdir().unwrap();
        let read = save(&data, &folder.path().join("d")).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
        let text = fs::read_to_string(folder.path().join("d/gateway_rssi.csv")).unwrap();
        assert_eq!(text, format!("a,b\n{cells}"));
        assert_eq!(read.observations.powers().unwrap(), &powers[..]);
        assert_eq!(
            (read.scene.geodetic, &read.scene.receivers, read.accepted),
            (data.scene.geodetic, &data.scene.receivers, data.accepted)
        );
    }
}
