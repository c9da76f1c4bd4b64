//! Valid and invalid channel files, and the `NeWRF` channels if they are available.

use super::*;
use crate::npy_header_as;
use crate::{NearestNeighbours, Zero};
use pwrfgs_core::testing::shared;
use pwrfgs_core::{Baseline, FittingSet};
use std::fs;

fn source(root: PathBuf) -> Channels {
    Channels {
        root,
        file: "h.npy".into(),
        positions: "p.csv".into(),
        points: None,
        carrier_hz: Some(1e9),
        spacing_hz: Some(1e6),
        more_carriers: vec![],
        receiver: Some(ReceiverPlace::default()),
        simulated: false,
    }
}

fn folder(shape: [usize; 3]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let numbers = (0..2 * shape.iter().product::<usize>()).flat_map(|v| (v as f32).to_le_bytes());
    fs::write(
        folder.path().join("h.npy"),
        npy_header_as("<c8", &shape).into_iter().chain(numbers).collect::<Vec<u8>>(),
    )
    .unwrap();
    fs::write(folder.path().join("p.csv"), "x,y,z\n1,2,3\n4,5,6\n").unwrap();
    folder
}

#[test]
fn reads_channels_with_antennas_and_frequencies() {
    let folder = folder([2, 2, 3]);
    let mut source = source(folder.path().into());
    let message = source.load(".".as_ref(), &|_, _| {}).unwrap_err();
    assert!(
        message.is_input() && message.to_string().contains("has 2 antennas, but `receiver.antennas` lists 0"),
        "{message}"
    );
    source.receiver.as_mut().unwrap().antennas = vec![[0.0; 3], [0.1, 0.0, 0.0]];
    let data = source.load(".".as_ref(), &|_, _| {}).unwrap();
    assert_eq!((data.len(), data.width, data.height), (2, 3, 4));
    assert_eq!(data.image(1).pixels[..6], [12.0, 14.0, 16.0, 13.0, 15.0, 17.0]);
    assert_eq!((data.sample(1).id, data.sample(1).position()), (1, [4.0, 5.0, 6.0]));
    let pwrfgs_core::Observations::Channels(channels) = &data.observations else { unreachable!() };
    assert_eq!(channels.frequencies_hz, [1e9 - 1e6, 1e9, 1e9 + 1e6]);
    assert_eq!(data.scene.receivers[0].antennas.len(), 2);
    assert!(!data.is_simulated() && data.title.contains("measured"), "{}", data.title);
    source.simulated = true;
    let data = source.load(".".as_ref(), &|_, _| {}).unwrap();
    assert!(data.is_simulated() && !data.title.contains("measured"), "{}", data.title);
    source.carrier_hz = Some(1e5);
    assert!(source.load(".".as_ref(), &|_, _| {}).unwrap_err().to_string().contains("correct `carrier_hz`"));
}

#[test]
fn reads_several_carriers_at_the_same_positions() {
    let folder = folder([2, 1, 3]);
    fs::copy(folder.path().join("h.npy"), folder.path().join("low.npy")).unwrap();
    fs::write(folder.path().join("train_index.txt"), "0\n").unwrap();
    fs::write(folder.path().join("test_index.txt"), "1\n").unwrap();
    let low = CarrierFile { file: "low.npy".into(), carrier_hz: 9e8 };
    let mut source = Channels { more_carriers: vec![low], ..source(folder.path().into()) };
    let data = source.load(".".as_ref(), &|_, _| {}).unwrap();
    let names: Vec<&str> = data.scene.receivers.iter().map(|receiver| receiver.name.as_str()).collect();
    assert_eq!((names, data.locations.len(), data.len()), (vec!["900MHz", "1000MHz"], 2, 4));
    assert_eq!(data.image(2).pixels, data.image(3).pixels);
    assert_eq!(data.official, Some((vec![0, 1], vec![2, 3])));
    let setup = pwrfgs_core::MeasurementSetup::of(&data, data.plane());
    assert_eq!(setup.frequencies_of(0), [9e8 - 1e6, 9e8, 9e8 + 1e6]);
    assert_eq!(setup.frequencies_of(1), [1e9 - 1e6, 1e9, 1e9 + 1e6]);
    assert_eq!(setup.carriers(), [-1.0, 1.0]);
    for (hz, words) in [(1e9, "occurs twice"), (1e6, "the lowest subcarrier would be at 0 Hz")] {
        source.more_carriers[0].carrier_hz = hz;
        let message = source.load(".".as_ref(), &|_, _| {}).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
    fs::write(
        folder.path().join("low.npy"),
        npy_header_as("<c8", &[1, 1, 1]).into_iter().chain([0; 8]).collect::<Vec<u8>>(),
    )
    .unwrap();
    let message = source.load(".".as_ref(), &|_, _| {}).unwrap_err().to_string();
    assert!(message.contains("low.npy: has the shape [1, 1, 1], but h.npy has [2, 1, 3]; give arrays of"), "{message}");
    source.more_carriers[0].carrier_hz = 0.0;
    assert!(source.check().unwrap_err().starts_with("`more_carriers`: the carrier is 0.0 Hz"));
}

#[test]
fn reads_missing_settings_from_companion_file() {
    let folder = folder([2, 2, 3]);
    let bare = Channels { carrier_hz: None, spacing_hz: None, receiver: None, ..source(folder.path().into()) };
    let load = |source: &Channels| source.load(".".as_ref(), &|_, _| {});
    let message = load(&bare).unwrap_err();
    assert!(message.is_input() && message.to_string().contains("say all three, or give the file"), "{message}");
    // Half a turn about z.
    let good = "name: tower\nposition: [1, 2, 3]\norientation: [0, 0, 1, 0]\ncarrier_hz: 2.0e9\nspacing_hz: 1.0e6\n\
                antennas: [[1, 2, 3], [1.1, 2, 3]]\n";
    fs::write(folder.path().join("receiver.yml"), good).unwrap();
    fs::write(folder.path().join("train_index.txt"), "1\n").unwrap();
    fs::write(folder.path().join("test_index.txt"), "0\n").unwrap();
    let data = load(&bare).unwrap();
    let tower = &data.scene.receivers[0];
    assert_eq!((&*tower.name, tower.pose.position), ("tower", [1.0, 2.0, 3.0]));
    assert!((tower.antennas[1][0] + 0.1).abs() < 1e-12 && tower.antennas[0] == [0.0; 3], "{:?}", tower.antennas);
    let pwrfgs_core::Observations::Channels(channels) = &data.observations else { unreachable!() };
    assert_eq!(channels.frequencies_hz, [2e9 - 1e6, 2e9, 2e9 + 1e6]);
    assert_eq!(data.official, Some((vec![1], vec![0])));
    let mine = load(&Channels { spacing_hz: Some(5e5), ..bare.clone() }).unwrap();
    let pwrfgs_core::Observations::Channels(channels) = &mine.observations else { unreachable!() };
    assert_eq!(channels.frequencies_hz[2], 2e9 + 5e5);
    for (from, to, word) in [
        ("0, 0, 1, 0", "0, 0, 0, 0", ":3:14: the quaternion is zero"),
        ("[1, 2, 3]\no", "[1, .nan, 3]\no", ":2:11: the position"),
        ("name: tower\n", "", "missing field `name`"),
        ("2.0e9", "fast", ":4:13:"),
        ("spacing_hz: 1.0e6", "spacing_hz: 1e6\nfrequencies_hz: [1e9, 2e9]", "lists 2 `frequencies_hz`"),
        ("[1.1, 2, 3]", "[1.1, .inf, 3]", "not finite"),
        (
            ", [1.1, 2, 3]",
            "",
            "has 2 antennas, but `antennas` in receiver.yml lists 1; give the position of each there",
        ),
    ] {
        fs::write(folder.path().join("receiver.yml"), good.replace(from, to)).unwrap();
        let message = load(&bare).unwrap_err();
        assert!(message.is_input() && message.to_string().contains(word), "{word}: {message}");
    }
}

#[test]
fn antennas_of_moving_receiver_are_in_its_frame() {
    let folder = folder([2, 2, 3]);
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("rx_pose.csv", "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n4,5,6,0,0,1,0\n");
    write(
        "receiver.yml",
        "name: robot\nposition: [1, 2, 3]\norientation: [0, 0, 1, 0]\ncarrier_hz: 2.0e9\nspacing_hz: 1.0e6\n\
         antennas: [[0, 0, 0], [0.1, 0, 0]]\n",
    );
    let bare = Channels { carrier_hz: None, spacing_hz: None, receiver: None, ..source(folder.path().into()) };
    let data = bare.load(".".as_ref(), &|_, _| {}).unwrap();
    assert_eq!(data.scene.receivers[0].antennas, [[0.0; 3], [0.1, 0.0, 0.0]]);
}

#[test]
fn rejects_mismatched_files() {
    let three = folder([3, 1, 1]);
    let message = source(three.path().into()).load(".".as_ref(), &|_, _| {}).unwrap_err().to_string();
    assert!(
        message.contains("holds channels of 3 positions") && message.contains("p.csv 2; give as many of each"),
        "{message}"
    );
    for wrong in [
        Channels { carrier_hz: Some(f64::NAN), ..Channels::default() },
        Channels { spacing_hz: Some(0.0), ..Channels::default() },
        Channels { file: PathBuf::new(), ..Channels::default() },
        Channels {
            receiver: Some(ReceiverPlace { orientation: [0.0; 4], ..ReceiverPlace::default() }),
            ..Channels::default()
        },
    ] {
        assert!(wrong.check().is_err());
    }
}

/// Neighbours are wavelengths apart, or a good part of one at 433 MHz: their mean is next to nothing, or worse.
#[test]
fn nearest_neighbours_hardly_predict_newrf_channels() {
    let Some(root) = shared("data/newrf") else { return };
    let receiver = ReceiverPlace { position: [-1.5, 0.0, 1.7], ..ReceiverPlace::default() };
    let files = [
        ("csi_433MHz.npy", "csi_433MHz_pos.csv", 395),
        ("csi_928MHz.npy", "tx_pos.csv", 433),
        ("csi_2400MHz.npy", "tx_pos.csv", 433),
    ];
    for (file, positions, count) in files {
        let source = Channels {
            root: root.clone(),
            file: file.into(),
            positions: positions.into(),
            carrier_hz: Some(2.412e9),
            receiver: Some(receiver.clone()),
            ..Channels::default()
        };
        let data = source.load(".".as_ref(), &|_, _| {}).unwrap();
        assert_eq!(data.len(), count);
        let first_test = count - count / 5;
        let train: Vec<usize> = (0..first_test).collect();
        let snr = |baseline: &dyn Baseline| {
            let fitted = baseline.fit(&data, FittingSet::train(&train)).unwrap();
            let (mut error, mut power) = (0.0, 0.0);
            for i in first_test..count {
                for (p, t) in fitted.predict(data.query(i)).pixels.iter().zip(data.image(i).pixels) {
                    error += (*p as f64 - t as f64).powi(2);
                    power += (t as f64).powi(2);
                }
            }
            -10.0 * f64::log10(error / power)
        };
        assert!(snr(&Zero {}).abs() < 1e-9);
        let ratios = [1, 2, 3, 5, 8, 15].map(|k| snr(&NearestNeighbours { k: k.into() }));
        println!("{file}: SNR of 1, 2, 3, 5, 8 and 15 neighbours {ratios:.2?} dB");
        assert!(ratios.iter().all(|snr| *snr < 2.0), "{file}: {ratios:?}");
    }
}

#[test]
fn leaves_out_zero_channels() {
    let folder = folder([2, 1, 3]);
    fs::write(folder.path().join("train_index.txt"), "0\n").unwrap();
    fs::write(folder.path().join("test_index.txt"), "1\n").unwrap();
    let path = folder.path().join("h.npy");
    let mut bytes = fs::read(&path).unwrap();
    bytes[128..152].fill(0);
    fs::write(&path, &bytes).unwrap();
    let load = || source(folder.path().into()).load(".".as_ref(), &|_, _| {});
    let data = load().unwrap();
    assert_eq!((data.len(), data.sample(0).id, data.unmatched.positions), (1, 1, 1));
    assert_eq!((data.sample(0).position(), data.official.as_ref()), ([4.0, 5.0, 6.0], None));
    assert_eq!(data.image(0).pixels, [6.0, 8.0, 10.0, 7.0, 9.0, 11.0]);
    bytes[128..].fill(0);
    fs::write(&path, &bytes).unwrap();
    assert!(load().unwrap_err().to_string().contains("is zero throughout"));
}

#[test]
fn real_arrays_are_refused_with_what_makes_them_complex() {
    let folder = folder([2, 1, 3]);
    for (shape, descr, words) in [
        (&[2, 1, 3, 2][..], "<f4", "save a[..., 0] + 1j * a[..., 1] as complex64"),
        (&[2, 2, 1, 3], "<f8", "save a[0] + 1j * a[1] as complex64"),
        (&[2, 1, 3], "<f4", "amplitudes and dB have no phase: use powers, `pwrfgs import --channels FILE --powers ..`"),
        (&[2, 1, 3], "<i2", "holds real numbers"),
        (&[2, 1, 3], ">c8", "holds numbers of type `>c8`; channels are complex64"),
    ] {
        fs::write(folder.path().join("h.npy"), npy_header_as(descr, shape)).unwrap();
        let message = source(folder.path().into()).load(".".as_ref(), &|_, _| {}).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn rejects_carrier_that_is_not_in_hz() {
    let folder = folder([2, 1, 3]);
    let bare = Channels { carrier_hz: None, spacing_hz: None, receiver: None, ..source(folder.path().into()) };
    let text = crate::receiver_yaml("ap", &Pose::IDENTITY, [2400.0, 1.0], &[2.4e9, 2.401e9, 2.402e9], &[[0.0; 3]]);
    fs::write(folder.path().join("receiver.yml"), text).unwrap();
    let message = bare.load(".".as_ref(), &|_, _| {}).unwrap_err().to_string();
    assert!(
        message.contains("receiver.yml: the carrier is 2400.0 Hz; give a frequency between 1e6 and 1e12 Hz"),
        "{message}"
    );
    let set = Channels { carrier_hz: Some(2.4), ..bare };
    assert!(set.check().unwrap_err().contains("`carrier_hz`: the carrier is 2.4 Hz"));
}
