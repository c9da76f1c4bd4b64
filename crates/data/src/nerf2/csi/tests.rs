//! A small base station, and errors of invalid content.

use super::*;
use crate::folder::base_station_yaml;
use crate::splits::Voxel;
use crate::{npy_header, npy_header_as};
use pwrfgs_core::{Number, Split, rng};
use std::fs;

/// Three snapshots, two antennas, two subcarriers of the uplink and two of the downlink.
struct Folder(tempfile::TempDir);

fn complex(shape: &[usize], values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    npy_header_as("<c8", shape).into_iter().chain(values.into_iter().flat_map(f32::to_le_bytes)).collect()
}

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        folder.write("base-station.yml", base_station_yaml(&[[0.0; 3], [0.0625, 0.0, 1.0]]));
        folder.write("csidata.npy", complex(&[3, 2, 4], (0..48).map(|v| v as f32)));
        folder.write("train_index.txt", "0\n2\n");
        folder.write("test_index.txt", "1\n");
        folder
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.0.path().join(name), bytes).unwrap();
    }

    fn load(&self) -> Result<Dataset> {
        let source = Nerf2Csi { root: ".".into(), carrier_hz: 1e9, spacing_hz: 2e6, ..Nerf2Csi::default() };
        source.load(self.0.path(), &|_, _| {})
    }

    fn fault(&self) -> String {
        let error = self.load().unwrap_err();
        assert!(error.is_input());
        error.to_string().replace(&self.0.path().join(".").display().to_string(), "DIR")
    }
}

#[test]
fn uplink_is_feature_and_downlink_is_observation() {
    let folder = Folder::new();
    let data = folder.load().unwrap();
    assert_eq!((data.len(), data.width, data.height, data.placed), (6, 2, 2, false));
    assert_eq!((data.sample(3).id, data.sample(3).receiver), (1, 1));
    assert_eq!(data.scene.receivers[1].name, "antenna 2");
    assert_eq!(data.scene.receivers[1].pose.position, [0.0625, 0.0, 1.0]);
    // Snapshot 1 at antenna 2 begins at the number 24 of 48.
    // All are divided by the largest modulus of the training set: snapshots 0 and 2.
    let largest = 46f64.hypot(47.0);
    let close = |actual: &[Real], numbers: [f64; 4]| {
        assert!(actual.iter().zip(numbers).all(|(v, n)| (*v as f64 - n / largest).abs() < 1e-6), "{actual:?}");
    };
    close(data.query(3).features.unwrap(), [24.0, 26.0, 25.0, 27.0]);
    close(&data.image(3).pixels, [28.0, 30.0, 29.0, 31.0]);
    assert_eq!(data.official, Some((vec![0, 1, 4, 5], vec![2, 3])));
    let pwrfgs_core::Observations::Channels(channels) = &data.observations else { unreachable!() };
    assert_eq!(channels.frequencies_hz, [1e9 + 1e6, 1e9 + 3e6]);
    // That is also the overall maximum, until the last snapshot is the test set.
    folder.write("train_index.txt", "0\n1\n");
    folder.write("test_index.txt", "2\n");
    let scaled = folder.load().unwrap().image(5).pixels[3] as f64;
    assert!((scaled - 47.0 / 30f64.hypot(31.0)).abs() < 1e-6);
    folder.write("train_index.txt", "0\n2\n");
    folder.write("test_index.txt", "1\n");
    let error = Voxel::default().split(&data, &mut rng::stream(0, "split", 0)).unwrap_err();
    assert!(error.to_string().contains("needs transmitter positions"), "{error}");
    folder.write("tx_pos.csv", "x,y,z\n1,2,3\n4,5,6\n7,8,9\n");
    let placed = folder.load().unwrap();
    assert!(placed.placed && placed.sample(3).position() == [4.0, 5.0, 6.0]);
    // In double precision it is the same.
    let mut double =
        String::from_utf8_lossy(&npy_header_as("<c8", &[3, 2, 4])[6..]).replace("<c8'", "<c16'").into_bytes();
    let space = double.iter().rposition(|b| *b == b' ').unwrap();
    double.remove(space);
    let numbers: Vec<u8> = (0..48).flat_map(|v| f64::from(v).to_le_bytes()).collect();
    folder.write("csidata.npy", [b"\x93NUMPY", double.as_slice(), &numbers].concat());
    assert_eq!(folder.load().unwrap().image(5), placed.image(5));
}

#[test]
fn reports_position_of_invalid_input() {
    let folder = Folder::new();
    let arrays = [
        (complex(&[3, 2, 3], vec![1.0; 36]), "has 3 subcarriers, expected an even number: uplink, then downlink"),
        (complex(&[3, 1, 4], vec![1.0; 24]), "has 1 antennas per snapshot, but base-station.yml 2"),
        (complex(&[6, 4], vec![1.0; 48]), "has shape [6, 4]; channels are [N, A, 2F]"),
        (complex(&[3, 2, 4], vec![1.0; 47]), "numbers of shape [3, 2, 4] do not fit its length"),
        (complex(&[0, 2, 4], vec![]), "has shape [0, 2, 4] and is empty"),
        (complex(&[usize::MAX, 2, 4], vec![1.0; 48]), "numbers of shape"),
        (complex(&[3, 2, 4], vec![0.0; 48]), "is zero in its training part; give channels"),
        (
            complex(&[3, 2, 4], (0..48).map(|i| if i == 31 { f32::NAN } else { 1.0 })),
            "csidata[1, 1, 3] is (1.0, NaN); give finite numbers",
        ),
        (
            [npy_header(Number::F32, &[3, 2, 4]), vec![0; 96]].concat(),
            "holds real numbers; amplitudes and dB have no phase",
        ),
        (complex(&[1, 2, 2000], vec![1.0; 8000]), "has 2000 subcarriers, of which the lowest would be at"),
        (b"PK".to_vec(), "is not a NumPy array"),
    ];
    let good = fs::read(folder.0.path().join("csidata.npy")).unwrap();
    for (bytes, message) in arrays {
        folder.write("csidata.npy", bytes);
        let error = folder.fault();
        assert!(error.starts_with(&format!("DIR/csidata.npy: {message}")), "{error}");
    }
    folder.write("csidata.npy", good);
    let texts = [
        (
            "base-station.yml",
            "base_station: [[0, 0, 0], [0, .inf, 0]]",
            "DIR/base-station.yml:1:27: antenna 2 is not finite",
        ),
        ("base-station.yml", "station: 1\n", "DIR/base-station.yml:1:1: missing field `base_station`"),
        ("base-station.yml", "base_station: []", "DIR/base-station.yml: names no antenna"),
        ("tx_pos.csv", "x,y,z\n1,2,3\n", "DIR/tx_pos.csv: holds 1 transmitters, but csidata.npy 3 snapshots"),
        ("test_index.txt", "3\n", "DIR/test_index.txt:1:1: invalid row 3 of csidata.npy"),
    ];
    for (name, text, message) in texts {
        let folder = Folder::new();
        folder.write(name, text);
        let error = folder.fault();
        assert!(error.starts_with(message), "{error}");
    }
}
