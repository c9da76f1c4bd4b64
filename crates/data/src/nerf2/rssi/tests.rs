//! A small folder of powers, and errors of invalid content.

use super::*;
use crate::folder::gateway_positions_yaml;
use pwrfgs_core::{Link, Pose};
use std::fs;

const ROWS: &str = "b,a\n-60.5,-100\n-100.0,-71\n-62,-73\n";

/// Two gateways and three transmitters; 0 and 2 are training samples.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        let pose = |position| Pose { position, ..Pose::IDENTITY };
        let gateways = [("a", pose([1.0, 2.0, 3.0])), ("b", pose([4.0, 5.0, 6.5]))];
        folder.write("gateway_position.yml", &gateway_positions_yaml(gateways));
        folder.write("gateway_rssi.csv", ROWS);
        folder.write("tx_pos.csv", "x,y,z\n1,2,3\n4,5,6\n7,8,9\n");
        folder.write("train_index.txt", "2\n0\n");
        folder.write("test_index.txt", "1\n");
        folder
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.0.path().join(name), text).unwrap();
    }

    fn try_load(&self) -> Result<Dataset> {
        Nerf2Rssi { root: ".".into(), points: None }.load(self.0.path(), &|_, _| {})
    }

    /// The error message with `text` in the file `name`, which is restored afterwards.
    fn fault(&self, name: &str, text: &str) -> String {
        let path = self.0.path().join(name);
        let before = fs::read(&path).unwrap();
        fs::write(&path, text).unwrap();
        let error = self.try_load().unwrap_err();
        assert!(error.is_input());
        fs::write(&path, before).unwrap();
        error.to_string().replace(&self.0.path().join(".").display().to_string(), "DIR")
    }
}

#[test]
fn reads_valid_rssi_folder() {
    let data = Folder::new().try_load().unwrap();
    assert_eq!(data.scene.receivers[1], Receiver::new("b", Pose { position: [4.0, 5.0, 6.5], ..Pose::IDENTITY }));
    let link = |location, receiver| Link { location, receiver };
    assert_eq!(data.links, [link(0, 1), link(1, 0), link(2, 0), link(2, 1)]);
    let powers: Vec<Real> = (0..4).map(|i| data.image(i).pixels[0]).collect();
    assert_eq!(powers, [-60.5, -71.0, -73.0, -62.0]);
    assert_eq!((data.sample(3).id, data.sample(3).position()), (2, [7.0, 8.0, 9.0]));
    assert_eq!(data.official, Some((vec![0, 2, 3], vec![1])));
    assert!(data.placed && !data.is_simulated());
}

#[test]
fn reads_empty_cells_and_leaves_out_deaf_gateways() {
    let folder = Folder::new();
    folder.write("gateway_rssi.csv", "b,a\n,-61\nNaN,-63\n-100,-62\n");
    let data = folder.try_load().unwrap();
    assert_eq!(data.observations.powers().unwrap(), [-61.0, -63.0, -62.0]);
    assert_eq!(data.scene.receivers.iter().map(|receiver| &*receiver.name).collect::<Vec<_>>(), ["a"]);
    folder.write("manifest.json", r#"{"missing": []}"#);
    assert_eq!(folder.try_load().unwrap().observations.powers().unwrap(), [-61.0, -63.0, -62.0, -100.0]);
}

#[test]
fn error_names_the_table_of_moving_receivers() {
    let folder = Folder::new();
    folder.write("rx_pose.csv", "x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n");
    let error = folder.try_load().unwrap_err().to_string();
    assert!(error.contains("holds 3 rows of powers, but rx_pose.csv 1 positions"), "{error}");
}

#[test]
fn reports_position_of_invalid_input() {
    let folder = Folder::new();
    let cases = [
        (
            "gateway_position.yml",
            "a: [1, 2, 3]\n",
            "DIR/gateway_rssi.csv:1:1: `b` has no position in gateway_position.yml",
        ),
        ("gateway_position.yml", "a: [1, 2]\n", "DIR/gateway_position.yml:1:4: neither a position nor a pose"),
        ("gateway_position.yml", "a: [1, 2, 3]\na: [1, 2, 3]\n", "DIR/gateway_position.yml:"),
        (
            "gateway_position.yml",
            "a: [1, 2, 3]\nb: [1, .nan, 3]\n",
            "DIR/gateway_position.yml:2:8: value `.nan` is not a finite number",
        ),
        (
            "gateway_position.yml",
            "a: [1, 2, 3]\n'b\"': [1, 2, 3]\n",
            "DIR/gateway_position.yml:2:7: receiver name `b\"` is invalid; use 1 to 100 characters",
        ),
        ("gateway_position.yml", "{}", "DIR/gateway_position.yml: names no gateway"),
        (
            "gateway_rssi.csv",
            "a\n-60\n-61\n-62\n",
            "DIR/gateway_rssi.csv:1:1: no column `b`, a gateway that has a position",
        ),
        ("gateway_rssi.csv", "a,b,a\n", "DIR/gateway_rssi.csv:1:5: a second column `a`"),
        ("gateway_rssi.csv", "", "DIR/gateway_rssi.csv: is empty"),
        (
            "gateway_rssi.csv",
            "a,b\n-60,-61\n-62,inf\n",
            "DIR/gateway_rssi.csv:3:5: `inf` is not finite; give the power in dBm",
        ),
        ("gateway_rssi.csv", "a,b\n-60,x\n", "DIR/gateway_rssi.csv:2:5: `x` is not a number"),
        ("gateway_rssi.csv", "a,b\n-60\n", "DIR/gateway_rssi.csv:2:4: the row ends after 1"),
        ("gateway_rssi.csv", "a,b\n-60,-61,5\n", "DIR/gateway_rssi.csv:2:9: the row has 3 fields"),
        ("gateway_rssi.csv", "a,b\n-60,1000\n", "DIR/gateway_rssi.csv:2:5: `1000` is not a power in dBm"),
        ("gateway_rssi.csv", "a,b\n-60,300.0000001\n", "DIR/gateway_rssi.csv:2:5: `300.0000001` is not a power in dBm"),
        (
            "gateway_rssi.csv",
            "a,b\n-60,-61\n-100,-100.0\n-1,-1\n",
            "DIR/gateway_rssi.csv:3:1: no power was received at this position; remove the row",
        ),
        ("gateway_rssi.csv", "a,b\n-100,\nNaN,-100\n,\n", "DIR/gateway_rssi.csv:2:1: no power was received at this"),
        ("gateway_rssi.csv", "a,b\n-60,-61\n", "DIR/gateway_rssi.csv: holds 1 rows of powers, but tx_pos.csv 3"),
        ("tx_pos.csv", "x,y,z\n1,2,3\n1,2,inf\n", "DIR/tx_pos.csv:3:5: `inf` is not finite"),
        (
            "test_index.txt",
            "3\n",
            "DIR/test_index.txt:1:1: invalid row 3 of tx_pos.csv, which has 3 rows counted from 0",
        ),
        ("test_index.txt", "1\n0\n", "DIR/test_index.txt:2:1: id 0 was already named in train_index.txt, line 2"),
        ("test_index.txt", "-1\n", "DIR/test_index.txt:1:1: `-1` is not a row of tx_pos.csv"),
    ];
    for (name, text, message) in cases {
        let error = folder.fault(name, text);
        assert!(error.starts_with(message), "{error}");
    }
    fs::remove_file(folder.0.path().join("gateway_rssi.csv")).unwrap();
    assert!(folder.try_load().unwrap_err().to_string().contains("no such file; a NeRF2 folder of powers holds"));
}
