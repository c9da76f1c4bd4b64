//! Axes in any order and number types, left-out zeros, powers, and messages.

use super::*;
use crate::{npy_header, npy_header_as};
use pwrfgs_core::Number;
use std::fs;
use tempfile::TempDir;

const SIZE: [usize; 3] = [4, 3, 2];

/// Folder with positions of four transmitters and of three antennas.
fn folder() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("tx.csv"), "x,y,z\n1,2,1\n2,2,1\n3,2,1\n4,2,1\n").unwrap();
    fs::write(folder.path().join("ant.csv"), "x,y,z\n-0.06,0,0\n0,0,0\n0.06,0,0\n").unwrap();
    folder
}

fn import(folder: &TempDir, files: &[&str], axes: &str) -> ChannelImport {
    let at = |name: &&str| folder.path().join(name);
    ChannelImport {
        channels: files.iter().map(at).collect(),
        imag: Vec::new(),
        axes: axes.into(),
        tx: Some(at(&"tx.csv")),
        receiver: Pose { position: [0.0, 0.0, 2.0], ..Pose::IDENTITY },
        antennas: Some(at(&"ant.csv")),
        carrier_hz: Some(2.4e9),
        spacing_hz: Some(1e6),
        powers: false,
        name: "csi".into(),
        simulated: false,
    }
}

/// Integer parts of the gain of a cell, none of them zero.
fn gain(index: [usize; 3]) -> [i16; 2] {
    let i = ((index[0] * SIZE[1] + index[1]) * SIZE[2] + index[2]) as i16;
    [1 + i, -3 * i - 1]
}

/// Writes integers `[.., parts]` with axes of these names and lengths; `parts` of each gain are a last axis.
fn write(folder: &TempDir, name: &str, descr: &str, axes: &str, parts: impl Fn([i16; 2]) -> Vec<i16>) {
    let names: Vec<char> = axes.chars().collect();
    let lengths: Vec<usize> = names.iter().map(|axis| SIZE["maf".find(*axis).unwrap()]).collect();
    let (mut numbers, count) = (Vec::new(), lengths.iter().product::<usize>());
    for mut i in 0..count {
        let mut index = [0; 3];
        for (axis, length) in names.iter().zip(&lengths).rev() {
            index["maf".find(*axis).unwrap()] = i % length;
            i /= length;
        }
        numbers.extend(parts(gain(index)));
    }
    let is_complex = descr.contains('c');
    let width = numbers.len() / count;
    let shape: Vec<usize> = lengths.into_iter().chain((width > 1 && !is_complex).then_some(width)).collect();
    let bytes = numbers.into_iter().flat_map(|v| match descr {
        "<i2" => v.to_le_bytes().to_vec(),
        ">i2" => v.to_be_bytes().to_vec(),
        "<f4" | "<c8" => f32::from(v).to_le_bytes().to_vec(),
        ">c16" => f64::from(v).to_be_bytes().to_vec(),
        other => unreachable!("{other}"),
    });
    let header = npy_header_as(descr, &shape);
    fs::write(folder.path().join(name), header.into_iter().chain(bytes).collect::<Vec<u8>>()).unwrap();
}

fn gains(data: &Dataset) -> Vec<[Real; 2]> {
    data.observations.channels().unwrap().gains.clone()
}

#[test]
fn all_forms_of_equal_channels_are_equal() {
    let folder = folder();
    write(&folder, "maf.npy", "<c8", "maf", |g| g.to_vec());
    let (data, notes) = import(&folder, &["maf.npy"], "m,a,f").read().unwrap();
    assert_eq!(notes, ["4 positions, 3 antennas, 2 subcarriers of complex numbers (axes m,a,f)"]);
    let expected = gains(&data);
    let all = (0..4).flat_map(|m| (0..3).flat_map(move |a| (0..2).map(move |f| gain([m, a, f]).map(Real::from))));
    assert_eq!(expected, all.collect::<Vec<_>>());
    assert_eq!(data.observations.frequencies_hz(), [2.3995e9, 2.4005e9]);
    for order in ["mfa", "amf", "afm", "fma", "fam"] {
        write(&folder, "h.npy", ">c16", order, |g| g.to_vec());
        let axes: Vec<String> = order.chars().map(String::from).collect();
        assert_eq!(gains(&import(&folder, &["h.npy"], &axes.join(",")).read().unwrap().0), expected, "{order}");
    }
    write(&folder, "ri.npy", "<i2", "fma", |g| g.to_vec());
    write(&folder, "ir.npy", ">i2", "maf", |[re, im]| vec![im, re]);
    write(&folder, "re.npy", "<i2", "amf", |[re, _]| vec![re]);
    write(&folder, "im.npy", "<f4", "amf", |[_, im]| vec![im]);
    for (file, axes) in [("ri.npy", "f,m,a,ri"), ("ir.npy", "m, a, f, ir")] {
        assert_eq!(gains(&import(&folder, &[file], axes).read().unwrap().0), expected, "{file}");
    }
    let imag = vec![folder.path().join("im.npy")];
    let parts = ChannelImport { imag, ..import(&folder, &["re.npy"], "a,m,f") };
    assert_eq!(gains(&parts.read().unwrap().0), expected);
    // A Fortran array [F,A,M] has the bytes of a C array [M,A,F].
    let bytes = fs::read(folder.path().join("maf.npy")).unwrap();
    let text = String::from_utf8_lossy(&bytes[..128]).replace("False", "True ").replace("(4, 3, 2)", "(2, 3, 4)");
    let text = [&b"\x93"[..], &text.as_bytes()["\u{fffd}".len()..]].concat();
    fs::write(folder.path().join("fortran.npy"), [&text[..], &bytes[128..]].concat()).unwrap();
    assert_eq!(gains(&import(&folder, &["fortran.npy"], "f,a,m").read().unwrap().0), expected);
    // Two files of two positions, along m.
    let halves = |range: std::ops::Range<usize>| [npy_header_as("<c8", &[2, 3, 2]), bytes[range].to_vec()].concat();
    fs::write(folder.path().join("1.npy"), halves(128..224)).unwrap();
    fs::write(folder.path().join("2.npy"), halves(224..320)).unwrap();
    assert_eq!(gains(&import(&folder, &["1.npy", "2.npy"], "m,a,f").read().unwrap().0), expected);
    let out = folder.path().join("out");
    let read = crate::save(&data, &out).unwrap().load("".as_ref(), &|_, _| {}).unwrap();
    assert_eq!((gains(&read), &read.scene.receivers[0].antennas), (expected, &data.scene.receivers[0].antennas));
}

/// Channels of which position 0, antenna 1 and subcarrier 1 are zero.
fn zeros(folder: &TempDir, name: &str) {
    let value = |i: usize| if i < 6 || i / 2 % 3 == 1 || i % 2 == 1 { 0.0 } else { 10.0 + i as f32 };
    let bytes = (0..24).flat_map(|i| [value(i), value(i) / 2.0]).flat_map(f32::to_le_bytes);
    fs::write(folder.path().join(name), npy_header_as("<c8", &SIZE).into_iter().chain(bytes).collect::<Vec<u8>>())
        .unwrap();
}

#[test]
fn leaves_out_and_counts_zeros() {
    let folder = folder();
    zeros(&folder, "h.npy");
    let import = import(&folder, &["h.npy"], "m,a,f");
    let (data, notes) = import.read().unwrap();
    assert_eq!(
        notes[1..],
        [
            "1 of 4 channels are zero, not received, and left out; the first is 0",
            "1 of 3 antennas are zero, not received, and left out; the first is 1",
            "1 of 2 subcarriers are zero, not received, and left out; the first is 1"
        ]
    );
    assert_eq!(gains(&data).iter().map(|[re, _]| *re).collect::<Vec<_>>(), [16.0, 20.0, 22.0, 26.0, 28.0, 32.0]);
    assert_eq!((data.sample(0).id, data.sample(0).position()), (1, [2.0, 2.0, 1.0]));
    assert_eq!(data.scene.receivers[0].antennas, [[-0.06, 0.0, 0.0], [0.06, 0.0, 0.0]]);
    assert_eq!(data.observations.frequencies_hz(), [2.3995e9]);
    let (powers, _) = ChannelImport { powers: true, ..import }.read().unwrap();
    assert_eq!((powers.len(), powers.scene.receivers[0].name.as_str()), (3, "subcarrier 0"));
    let power = |a: f64, b: f64| (1.25 * (a * a + b * b) / 2.0).log10() * 10.0;
    let expected = [(16.0, 20.0), (22.0, 26.0), (28.0, 32.0)].map(|(a, b)| power(a, b) - power(28.0, 32.0));
    for (value, expected) in powers.observations.powers().unwrap().iter().zip(expected) {
        assert!((*value as f64 - expected).abs() < 1e-5, "{value} {expected}");
    }
    assert_eq!(powers.title, "csi (relative dB)");
}

#[test]
fn amplitudes_and_decibels_become_powers_only() {
    let folder = folder();
    let number = |f: fn(f32) -> f32| (1..=12).flat_map(move |i| f(i as f32).to_le_bytes());
    let write = |name: &str, f| {
        let bytes = npy_header(Number::F32, &[4, 3]).into_iter().chain(number(f)).collect::<Vec<u8>>();
        fs::write(folder.path().join(name), bytes).unwrap();
    };
    write("a.npy", |v| v);
    write("db.npy", |v| 20.0 * v.log10() - 90.0);
    write("re.npy", |v| v - 6.0);
    let refused = |name: &str, powers| {
        ChannelImport { powers, ..import(&folder, &[name], "m,a") }.read().unwrap_err().to_string()
    };
    assert!(refused("a.npy", false).ends_with("a.npy: these are amplitudes, which have no phase; add --powers"));
    assert!(refused("db.npy", false).ends_with("db.npy: these are levels in dB, which have no phase; add --powers"));
    for powers in [false, true] {
        assert!(refused("re.npy", powers).contains("real numbers of both signs"));
    }
    let powers = |name: &str| {
        let import =
            ChannelImport { powers: true, carrier_hz: None, antennas: None, ..import(&folder, &[name], "m,a") };
        import.read().unwrap().0
    };
    let (a, db) = (powers("a.npy"), powers("db.npy"));
    let names: Vec<&str> = a.scene.receivers.iter().map(|receiver| receiver.name.as_str()).collect();
    assert_eq!((a.len(), names), (12, vec!["antenna 0", "antenna 1", "antenna 2"]));
    let (a, db) = (a.observations.powers().unwrap(), db.observations.powers().unwrap());
    assert!(a.iter().zip(db).all(|(a, db)| (a - db).abs() < 1e-4) && a[11] == 0.0, "{a:?} {db:?}");
    assert!((a[0] as f64 + 20.0 * 12f64.log10()).abs() < 1e-5);
}

#[test]
fn reports_what_does_not_fit() {
    let folder = folder();
    write(&folder, "h.npy", "<c8", "maf", |g| g.to_vec());
    write(&folder, "ri.npy", "<f4", "maf", |g| g.to_vec());
    fs::write(folder.path().join("a.mat"), "MATLAB 5.0").unwrap();
    fs::write(folder.path().join("half.npy"), npy_header_as("<f2", &[4, 3, 2])).unwrap();
    let mut nan = fs::read(folder.path().join("ri.npy")).unwrap();
    nan[128 + 4 * 13..128 + 4 * 14].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(folder.path().join("nan.npy"), &nan).unwrap();
    fs::write(folder.path().join("short.npy"), &nan[..nan.len() - 1]).unwrap();
    fs::write(folder.path().join("zero.npy"), [npy_header_as("<c8", &SIZE), vec![0; 192]].concat()).unwrap();
    for (file, axes, words) in [
        ("h.npy", "m,f,a", "has 2 antennas, and --antennas 3; give the position of each"),
        ("h.npy", "a,m,f", "holds channels of 3 positions, and --tx has 4; give as many of each, or correct --axes"),
        ("h.npy", "m,a", "has complex numbers of shape [4, 3, 2]; --axes names every axis once"),
        ("h.npy", "m,a,ri", "has complex numbers"),
        ("h.npy", "m,m,f", "has complex numbers"),
        ("h.npy", "m,a,b", "has complex numbers"),
        ("h.npy", "", "has complex numbers"),
        ("ri.npy", "m,a,f", "has real numbers of shape [4, 3, 2, 2]; --axes names every axis once"),
        ("ri.npy", "m,ri,f,a", "has real numbers"),
        ("ri.npy", "m,a,ri,ir", "has real numbers"),
        ("nan.npy", "m,a,f,ri", "nan[1, 0, 0, 1] is NaN; give finite numbers"),
        ("short.npy", "m,a,f,ri", "do not fit its length"),
        ("half.npy", "m,a,f", "holds numbers of type `<f2`; give complex numbers"),
        ("zero.npy", "m,a,f", "is zero throughout; give channels that were received"),
        ("a.mat", "m,a,f", "scipy.io.loadmat('"),
        ("none.npy", "m,a,f", "none.npy"),
        ("tx.csv", "m,a,f", "channels are an array .npy or an archive .npz"),
    ] {
        let message = import(&folder, &[file], axes).read().unwrap_err();
        assert!(message.to_string().contains(words), "{file} {axes}: {message}");
    }
    let good = import(&folder, &["h.npy"], "m,a,f");
    let twice = ChannelImport { imag: vec![PathBuf::new(); 2], ..good.clone() };
    assert!(twice.read().unwrap_err().to_string().contains("--imag names 2 files, and --channels 1"));
    let complex = ChannelImport { imag: good.channels.clone(), ..good.clone() };
    assert!(complex.read().unwrap_err().to_string().contains("give real arrays of one shape"));
    let alone = ChannelImport { carrier_hz: None, ..good.clone() };
    assert!(alone.read().unwrap_err().to_string().contains("--carrier-hz is missing"));
    let alone = ChannelImport { carrier_hz: Some(2400.0), ..good.clone() };
    assert!(alone.read().unwrap_err().to_string().contains("between 1e6 and 1e12 Hz"));
    let alone = ChannelImport { spacing_hz: None, ..good };
    assert!(alone.read().unwrap_err().to_string().contains("has 2 subcarriers, but `spacing_hz` is missing"));
}
