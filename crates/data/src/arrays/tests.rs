//! A small folder of arrays, and errors of invalid content.

use super::*;
use crate::npy_header;
use pwrfgs_core::{Number, Plugin};
use std::fs;

/// Four transmitters and pictures of 3 x 2.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        fs::create_dir(folder.path("s")).unwrap();
        folder.write("gateway_info.yml", "gateway1:\n  position: [5.0, 0.26, 0]\n  orientation: [0, 0, 0, 1]\n");
        let tx: Vec<u8> = (0..12).flat_map(|v| f64::from(v).to_le_bytes()).collect();
        folder.array("tx.npy", Number::F64, &[4, 3], &tx);
        folder.array("spectra.npy", Number::U8, &[4, 2, 3], &(0..24).collect::<Vec<u8>>());
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path("s").join(name), bytes).unwrap();
    }

    fn array(&self, name: &str, number: Number, shape: &[usize], bytes: &[u8]) {
        self.write(name, [&npy_header(number, shape), bytes].concat());
    }

    fn floats(&self, values: impl IntoIterator<Item = f32>) {
        let bytes: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
        self.array("spectra.npy", Number::F32, &[4, 2, 3], &bytes);
    }

    fn try_load(&self) -> Result<Dataset> {
        Arrays { root: "s".into(), elevation: Some((-90.0, 90.0).into()), ..Arrays::default() }
            .load(self.0.path(), &|_, _| {})
    }

    fn fault(&self) -> String {
        let error = self.try_load().unwrap_err();
        assert!(error.is_input());
        error.to_string().replace(&self.0.path().display().to_string(), "DIR")
    }
}

#[test]
fn reads_and_saves_poses_of_a_moving_receiver() {
    let folder = Folder::new();
    let rows = ["1,2,3,0,0,0,1", "4,5,6,0,0,1,0", "7,8,9,0,1,0,0", "1,1,1,0.6,0,0,0.8"];
    let table = |rows: &[&str]| {
        format!("qw_old,x,y,z,qx,qy,qz,qw\n{}", rows.iter().flat_map(|row| ["9,", row, "\n"]).collect::<String>())
    };
    folder.write("rx_pose.csv", table(&rows));
    let data = folder.try_load().unwrap();
    assert_eq!(data.query(2).pose, Pose { position: [7.0, 8.0, 9.0], orientation: [0.0, 1.0, 0.0, 0.0] });
    assert_eq!((data.scene.moving, data.scene.transmitter), (End::Receiver, Some([5.0, 0.26, 0.0])));
    let out = folder.path("saved");
    let read = crate::save(&data, &out).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
    assert_eq!((read.scene.transmitter, &read.locations), (data.scene.transmitter, &data.locations));
    assert!(!out.join("tx.npy").exists());
    let cases = [
        (&rows[..3], "holds 4 spectra, but rx_pose.csv 3 positions"),
        (&["1,2,3,0,0,0,1", "1,2,3,0,0,0,2"], "rx_pose.csv:3:9: the quaternion has length 2.000000, expected 1"),
        (&["1,2,3,0,0,0"], "rx_pose.csv:2"),
        (&["1,NaN,3,0,0,0,1"], "rx_pose.csv:2:5"),
        (&[], "has a header but no row; give every row x, y and z in metres, and the unit quaternion"),
    ];
    for (rows, what) in cases {
        folder.write("rx_pose.csv", table(rows));
        let message = folder.fault();
        assert!(message.contains(what), "{message}");
    }
}

#[test]
fn reads_valid_array_folder() {
    let folder = Folder::new();
    let data = folder.try_load().unwrap();
    assert_eq!((data.title.as_str(), data.width, data.height), ("s (measured, arrays)", 3, 2));
    assert_eq!((data.sample(3).id, data.sample(3).position()), (4, [9.0, 10.0, 11.0]));
    assert_eq!(data.observations.raw(3).as_ref(), [18, 19, 20, 21, 22, 23]);
    assert!(data.official.is_none() && data.observations.bytes_in_memory() == 24);
    folder.write("train_index.txt", "1\n2\n4\n");
    folder.write("test_index.txt", "0003\n");
    folder.write("manifest.json", r#"{"simulated": true}"#);
    let data = folder.try_load().unwrap();
    assert_eq!(data.official, Some((vec![0, 1, 3], vec![2])));
    assert!(data.is_simulated() && data.title == "s (arrays)");
    // A table does as well as an array.
    fs::remove_file(folder.path("s/tx.npy")).unwrap();
    folder.write("tx_pos.csv", "x,y,z\n0,1,2\n3,4,5\n6,7,8\n9,10,11\n");
    assert_eq!(folder.try_load().unwrap().sample(3).position(), data.sample(3).position());
}

#[test]
fn reads_every_number_format_unchanged() {
    let folder = Folder::new();
    folder.floats((0..24).map(|v| v as f32 / 23.0));
    assert_eq!(folder.try_load().unwrap().image(3).pixels[5], 1.0);
    assert_eq!(folder.try_load().unwrap().image(0).pixels[1] as f32, 1.0 / 23.0);
    let wide: Vec<u8> = (0..24u16).flat_map(|v| (v + 65_000).to_le_bytes()).collect();
    folder.array("spectra.npy", Number::U16, &[4, 2, 3], &wide);
    assert_eq!(folder.try_load().unwrap().image(0).pixels[1] as f32, 65_001.0 / 65_535.0);
    // Positions in single precision and in Fortran order, as numpy.save writes tx.T.
    let tx: Vec<u8> = (0..12).flat_map(|v| (v as f32).to_le_bytes()).collect();
    let header = npy_header(Number::F32, &[4, 3]);
    let text = String::from_utf8_lossy(&header[10..]).replace("False", "True ");
    folder.write("tx.npy", [&header[..10], text.as_bytes(), &tx].concat());
    assert_eq!(folder.try_load().unwrap().sample(1).position(), [1.0, 5.0, 9.0]);
}

#[test]
fn reports_invalid_input() {
    let with = |change: &dyn Fn(&Folder)| {
        let folder = Folder::new();
        change(&folder);
        folder.fault()
    };
    let pictures = |shape: &[usize], bytes: usize| {
        with(&|folder: &Folder| folder.array("spectra.npy", Number::U8, shape, &vec![0; bytes]))
    };
    let value = |v: f32| with(&|folder: &Folder| folder.floats((0..24).map(|i| if i == 10 { v } else { 0.5 })));
    let header = |from: &str, to: &str| {
        with(&|folder: &Folder| {
            let bytes = fs::read(folder.path("s/spectra.npy")).unwrap();
            let text: String = bytes.iter().map(|b| char::from(*b)).collect();
            folder.write("spectra.npy", text.replace(from, to).chars().map(|c| c as u8).collect::<Vec<u8>>());
        })
    };
    let tx = |number, shape: &[usize], bytes: usize| {
        with(&|folder: &Folder| folder.array("tx.npy", number, shape, &vec![0; bytes]))
    };
    let cases = [
        (pictures(&[4, 6], 24), "DIR/s/spectra.npy: has shape [4, 6]; spectra are [M, H, W]"),
        (pictures(&[3, 2, 3], 18), "DIR/s/spectra.npy: holds 3 spectra, but tx.npy 4 positions"),
        (
            pictures(&[4, 2, 3], 23),
            "DIR/s/spectra.npy: 4 spectra of 3 x 2 pixels do not fit its 151 bytes; the file is truncated",
        ),
        (pictures(&[4, 2, 3], 25), "do not fit its 153 bytes"),
        (pictures(&[1 << 40, 1 << 40, 1 << 40], 24), "do not fit its 152 bytes"),
        (value(f32::NAN), "DIR/s/spectra.npy: spectra[1, 1, 1] is NaN; spectra are linear, from 0 to 1"),
        (value(-43.5), "spectra[1, 1, 1] is -43.5"),
        (value(1.25), "spectra[1, 1, 1] is 1.25"),
        (header("False", "True "), "is in Fortran order; save numpy.ascontiguousarray(spectra)"),
        (header("|u1", ">f4"), "holds numbers of type `>f4`; spectra are uint8"),
        (header("|u1", "<c8"), "a spectrum is real"),
        (tx(Number::F64, &[3, 4], 96), "DIR/s/tx.npy: has shape [3, 4]; positions are [M, 3]: x, y and z"),
        (tx(Number::F64, &[4, 3], 95), "4 positions do not fit its length"),
        (tx(Number::F64, &[1 << 60, 3], 96), "do not fit its length"),
        (tx(Number::U8, &[4, 3], 12), "holds numbers of type `|u1`; positions are float64"),
    ];
    for (message, expected) in cases {
        assert!(message.contains(expected), "{message}\n{expected}");
    }
    for name in ["gateway_info.yml", "tx.npy", "spectra.npy"] {
        let message = with(&|folder: &Folder| fs::remove_file(folder.path("s").join(name)).unwrap());
        assert!(message.starts_with(&format!("cannot read DIR/s/{name}: ")), "{message}");
    }
    let message = with(&|folder: &Folder| {
        folder.write("train_index.txt", "1\n");
        folder.write("test_index.txt", "5\n");
    });
    assert_eq!(
        message,
        "DIR/s/test_index.txt:1:1: id 5 has no row in tx.npy, which has 4; add the row or remove the id"
    );
    for settings in [r#"root: """#, "elevation: (-180, 180)"] {
        assert!(Plugin::<dyn DataSource>::parse(&format!("Arrays({settings})")).is_err(), "{settings}");
    }
}
