//! `pwrfgs import`: NumPy files become data for training, and failed imports write no files.

use crate::common::{SMALL, call, pwrfgs, python, refuse, stderr, stdout, succeed, write};
use pwrfgs::data::{npy_header, npy_header_as};
use pwrfgs_core::Number;
use std::fmt::Write as _;
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use wait4::Wait4;
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

/// Pictures of a lobe that follows the transmitter, in every form that is understood and some that are not.
const MAKE: &str = r#"
import numpy as np
rng = np.random.default_rng(0)
tx = rng.uniform([-2, -2, 0.5], [2, 2, 1.5], (40, 3))
azimuth = np.degrees(np.arctan2(tx[:, 1], tx[:, 0])) % 360
columns = (np.arange(48) * 7.5 - azimuth[:, None] + 180) % 360 - 180
rows = np.arange(12) * 7.5 - 30
s = np.exp(-(columns[:, None, :] / 40) ** 2 - (rows[None, :, None] / 30) ** 2)
np.save("tx.npy", tx)
np.save("tx_f.npy", np.asfortranarray(tx).astype(np.float32))
np.savetxt("tx.csv", tx, delimiter=",", header="x,y,z", comments="")
np.save("f64.npy", s)
np.save("f32.npy", s.astype("<f4"))
np.save("u16.npy", np.round(s * 65535).astype(np.uint16))
np.save("u8.npy", np.round(s * 255).astype(np.uint8))
np.savez("all.npz", spectra=s, tx=tx)
np.savez_compressed("small.npz", pictures=s.astype("f4"), positions=tx)
np.save("db.npy", 20 * np.log10(s + 1e-5))
np.save("large.npy", 255 * s)
np.save("turned.npy", s.transpose(0, 2, 1).copy())
np.save("fortran.npy", np.asfortranarray(s))
np.save("big.npy", s.astype(">f4"))
np.save("complex.npy", s.astype(np.complex64))
np.save("half.npy", s.astype(np.float16))
"#;

const POSE: [&str; 4] = ["--receiver", "0,0,-0.5", "--orientation", "0,0,0,1"];

fn arguments<'a>(spectra: &'a str, tx: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let named: &[&str] = if tx.is_empty() { &[] } else { &["--tx", tx] };
    [&["import", "--spectra", spectra], named, &POSE, more].concat()
}

/// An array's bytes behind its header, which ends with a line.
fn numbers(path: &Path) -> Vec<u8> {
    let bytes = fs::read(path).unwrap();
    let header = bytes.iter().position(|b| *b == b'\n').unwrap() + 1;
    bytes[header..].to_vec()
}

#[test]
fn trains_on_arrays_saved_by_numpy() {
    let Some(python) = python("what NumPy saves has not been imported") else { return };
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let made = Command::new(python).args(["-c", MAKE]).current_dir(here).output().unwrap();
    assert!(made.status.success(), "{}", stderr(&made));
    let mut kept = Vec::new();
    for (k, (spectra, tx)) in [
        ("f32.npy", "tx.npy"),
        ("f64.npy", "tx_f.npy"),
        ("u16.npy", "tx.csv"),
        ("u8.npy", "tx.npy"),
        ("all.npz", ""),
        ("small.npz:pictures", "small.npz:positions"),
        ("large.npy --scale 0.00392156862745098", "tx.npy"),
    ]
    .into_iter()
    .enumerate()
    {
        let (out, mut words) = (format!("data/{k}"), spectra.split(' '));
        let (spectra, more) = (words.next().unwrap(), words.chain(["--out", &out]).collect::<Vec<_>>());
        let message = stderr(&succeed(here, &arguments(spectra, tx, &more)));
        assert!(message.contains("40 spectra of 48 x 12 pixels"), "{message}");
        assert!(
            message.contains(&format!("    data: Arrays(root: \"{out}\"),\n    split: Random(test: 0.2),\n")),
            "{message}"
        );
        kept.push(numbers(&here.join(&out).join("spectra.npy")));
    }
    // Double precision becomes single, whatever it came in.
    assert!(kept[0] == kept[1] && kept[0] == kept[4] && kept[0] == kept[5]);
    assert_eq!(kept[0], numbers(&here.join("f32.npy")));
    assert_eq!(kept[2], numbers(&here.join("u16.npy")));
    assert_eq!(kept[3], numbers(&here.join("u8.npy")));
    let pipeline = SMALL
        .replace("Teacher(gaussians: 4, samples: 40, width: 48, height: 12)", "Arrays(root: \"data/2\")")
        .replace("Official(validation: 0.2)", "Random(test: 0.2)");
    fs::write(here.join("small.ron"), pipeline).unwrap();
    let run = succeed(here, &["run", "small.ron"]);
    assert!(stdout(&run).contains("ssim"), "{}", stdout(&run));

    for (spectra, words) in [
        ("db.npy", "as decibels are; spectra are linear"),
        ("large.npy", "and spectra are from 0 to 1; give --scale 0.0039"),
        ("turned.npy", "save s.transpose(0, 2, 1)"),
        ("fortran.npy", "is in Fortran order; save numpy.ascontiguousarray(fortran)"),
        ("big.npy", "numbers of type `>f4`"),
        ("complex.npy", "numpy.abs"),
        ("half.npy", "numbers of type `<f2`"),
        ("all.npz:other", "no array `other`"),
        ("none.npy", "cannot read none.npy"),
    ] {
        refuse(here, &arguments(spectra, "tx.npy", &["--out", "data/bad"]), 2, &[words]);
    }
    refuse(here, &arguments("f32.npy", "tx.npy", &["--out", "data/0"]), 2, &["data/0 is not empty"]);
    refuse(here, &arguments("f32.npy", "", &["--out", "data/bad"]), 2, &["name the transmitters with --tx"]);
    let mut names: Vec<_> = fs::read_dir(here.join("data")).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["0", "1", "2", "3", "4", "5", "6"]);
}

/// Archive with these arrays.
fn archive(arrays: &[(&str, &[u8])], method: CompressionMethod) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in arrays {
        archive.start_file(*name, SimpleFileOptions::default().compression_method(method)).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// Array of these numbers.
fn array(number: Number, shape: &[usize], bytes: impl IntoIterator<Item = u8>) -> Vec<u8> {
    npy_header(number, shape).into_iter().chain(bytes).collect()
}

#[test]
fn rejects_archive_with_a_flipped_bit() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    // 1.0 with the highest bit of its exponent flipped is infinite: the damage is reported, not the value.
    let spectra = array(Number::F32, &[4, 6, 24], [1.0_f32; 576].into_iter().flat_map(f32::to_le_bytes));
    let tx = array(Number::F64, &[4, 3], (0..12).flat_map(|v| f64::from(v).to_le_bytes()));
    for method in [CompressionMethod::Stored, CompressionMethod::Deflated] {
        let whole = archive(&[("spectra.npy", &spectra), ("tx.npy", &tx)], method);
        write(&here.join("a.npz"), &whole);
        succeed(here, &arguments("a.npz", "", &["--out", "whole"]));
        fs::remove_dir_all(here.join("whole")).unwrap();
        for (own, name) in [(&spectra, "spectra"), (&tx, "tx")] {
            let mut damaged = whole.clone();
            if let Some(start) = damaged.windows(own.len()).position(|part| part == own.as_slice()) {
                damaged[start + own.len() - 1] ^= 0x40;
            } else {
                // The checksum in the list of entries, at the end of the archive.
                let file = format!("{name}.npy").into_bytes();
                let listed = damaged.windows(file.len()).rposition(|part| part == file).unwrap();
                damaged[listed - 30] ^= 1;
            }
            write(&here.join("a.npz"), damaged);
            let words = format!("a.npz:{name}: is damaged (Invalid checksum); copy the archive again");
            refuse(here, &arguments("a.npz", "", &["--out", "out"]), 2, &[&words]);
            assert!(!here.join("out").exists());
        }
    }
}

#[test]
fn rejects_arrays_that_expand_beyond_the_limits() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let tx = |rows: usize| array(Number::F64, &[rows, 3], vec![0; 24 * rows]);
    let spectra = |shape: [usize; 3]| array(Number::U8, &shape, vec![64; shape.iter().product()]);
    for (spectra, tx, words) in [
        (spectra([4, 6, 24]), tx(2_000_001), "a.npz:tx: holds 2000001 positions, more than 2000000; give parts"),
        (
            spectra([1, 1 << 12, (1 << 13) + 1]),
            tx(1),
            "a.npz:spectra: has shape [1, 4096, 8193], so 33558528 bytes per spectrum, more than 33554432",
        ),
    ] {
        let bytes = archive(&[("spectra.npy", &spectra), ("tx.npy", &tx)], CompressionMethod::Deflated);
        assert!(bytes.len() < 100_000, "{} bytes", bytes.len());
        write(&here.join("a.npz"), bytes);
        refuse(here, &arguments("a.npz", "", &["--out", "out"]), 2, &[words]);
    }
}

#[test]
fn rejects_positions_that_its_reader_refuses() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("s.npy"), array(Number::U8, &[2, 6, 24], [64; 288]));
    for (value, words) in [(1e300, "tx.npy: tx[1] is 1e300 m, beyond 1e8 m"), (f64::NAN, "tx.npy: tx[1] is not finite")]
    {
        let values = [0.0, 1.0, 2.0, 3.0, 4.0, value];
        write(&here.join("tx.npy"), array(Number::F64, &[2, 3], values.into_iter().flat_map(f64::to_le_bytes)));
        refuse(here, &arguments("s.npy", "tx.npy", &["--out", "out"]), 2, &[words]);
    }
}

#[test]
fn rejects_invalid_pose() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for (receiver, orientation, words) in [
        ("0,0", "0,0,0,1", "--receiver 0,0: expected x,y,z in metres, each at most 1e8"),
        ("0,0,0", "0,0,1", "--orientation 0,0,1: expected a unit quaternion x,y,z,w"),
        ("0,0,0", "0,0,0,2", "orientation of the receiver: the quaternion has length 2"),
    ] {
        let pose = ["--receiver", receiver, "--orientation", orientation, "--out", "data"];
        let arguments = [&["import", "--spectra", "s.npy", "--tx", "tx.npy"][..], &pose].concat();
        refuse(here, &arguments, 2, &[words]);
    }
    assert_eq!(call(here, &["import", "--spectra", "s.npy"]).status.code(), Some(2));
}

#[test]
fn import_rejects_shape_that_contradicts_angles() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let array = |number, shape: &[usize], bytes: Vec<u8>| [npy_header(number, shape), bytes].concat();
    write(&here.join("s.npy"), array(Number::U8, &[20, 18, 36], (0..20 * 18 * 36).map(|i| (i % 251) as u8).collect()));
    let tx: Vec<u8> = (0..60).flat_map(|i| (f64::from(i) / 10.0).to_le_bytes()).collect();
    write(&here.join("tx.npy"), array(Number::F64, &[20, 3], tx));
    let import = arguments("s.npy", "tx.npy", &["--out", "mine"]);
    refuse(here, &import, 2, &["s.npy: is 36 x 18 pixels", "such as --elevation -90,90 for a full sphere"]);
    for (elevation, words) in [("-90", "expected two numbers in degrees"), ("0,200", "degrees from -90 to 90")] {
        refuse(here, &[&import[..], &["--elevation", elevation]].concat(), 2, &[words]);
    }
    assert!(!here.join("mine").exists());
    succeed(here, &[&import[..], &["--elevation", "-90,90"]].concat());
    let message = stdout(&succeed(here, &["init", "mine", "--out", "mine.ron"]));
    assert!(message.contains("20 spectra of 36 x 18 pixels"), "{message}");
}

/// Folder of simulated channels with other gains, as `change` makes them of the position, and real and imaginary part.
fn changed(here: &Path, name: &str, change: impl Fn(usize, [f32; 2]) -> [f32; 2]) {
    let bytes = fs::read(here.join("right/channel.npy")).unwrap();
    let parts: Vec<f32> = bytes[128..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
    let gains = parts.as_chunks().0.iter().enumerate().flat_map(|(i, gain)| change(i / 256, *gain));
    let body = gains.flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    for file in ["tx_pos.csv", "receiver.yml"] {
        write(&here.join(name).join(file), fs::read(here.join("right").join(file)).unwrap());
    }
    write(&here.join(name).join("channel.npy"), [&bytes[..128], &body].concat());
}

#[test]
fn wrong_channels_are_noticed_and_right_ones_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let size = ["--samples", "60", "--points", "100", "--snr-db", "30"];
    succeed(
        here,
        &[&["simulate", "office-channel", "--layout", "channels", "--no-paths", "--out", "right", "-q"][..], &size]
            .concat(),
    );
    let turned = |m: usize, [re, im]: [f32; 2]| {
        let (sin, cos) = (2.4 * (m * m) as f32).sin_cos();
        [re * cos - im * sin, re * sin + im * cos]
    };
    changed(here, "conjugated", |_, [re, im]| [re, -im]);
    changed(here, "magnitudes", |_, [re, im]| [re.hypot(im), 0.0]);
    changed(here, "decibels", |_, [re, im]| [20.0 * re.hypot(im).log10(), 0.0]);
    changed(here, "phases", turned);
    changed(here, "zeros", |m, gain| if m % 4 == 0 { [0.0; 2] } else { gain });
    for (name, words) in [
        ("right", ""),
        ("conjugated", "conjugate: the conjugate fits better: the direct path has "),
        (
            "magnitudes",
            "channel-phase: all imaginary parts are 0: these are amplitudes, which have no phase; use powers",
        ),
        (
            "decibels",
            "channel-phase: all imaginary parts are 0: these are levels in dB, which have no phase; use powers",
        ),
        ("phases", "phase-coherence: the phases of neighbouring positions are not coherent"),
        ("zeros", "zero-channels: 15 of 60 channels are zero, not received, and are left out"),
    ] {
        let pipeline = format!("{name}.ron");
        let is_error = ["conjugated", "magnitudes", "decibels"].contains(&name);
        for command in [&["inspect", name][..], &["init", name, "--out", &pipeline]] {
            let output = call(here, command);
            let message = stderr(&output);
            assert_eq!(output.status.code(), Some(if is_error && command[0] == "init" { 2 } else { 0 }), "{message}");
            let is_right = if words.is_empty() { !message.contains("warning") } else { message.contains(words) };
            assert!(is_right, "{command:?}: {message}");
        }
    }
    let message = stdout(&succeed(here, &["inspect", "phases"]));
    assert!(message.contains("phases         not coherent; if the chip"), "{message}");
}

#[test]
fn channels_of_a_chip_become_powers_or_channels() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("tx.csv"), "x,y,z\n1,2,1\n2,2,1\n3,2,1\n");
    // Pairs of imaginary and real parts [M, F, 2] of one antenna; nothing is received at the first position.
    let numbers = (0..3 * 4 * 2).map(|i: i16| if i < 8 { 0 } else { 3 * i - 40 });
    write(
        &here.join("csi.npy"),
        [npy_header_as("<i2", &[3, 4, 2]), numbers.flat_map(i16::to_le_bytes).collect::<Vec<u8>>()].concat(),
    );
    let import = ["import", "--channels", "csi.npy", "--tx", "tx.csv", "--receiver", "0,0,2"];
    let band = ["--axes", "m,f,ir", "--carrier-hz", "2.437e9", "--spacing-hz", "312500", "--out", "csi"];
    let message = stderr(&succeed(here, &[&import[..], &band].concat()));
    assert!(message.contains("3 positions, 1 antennas, 4 subcarriers of complex numbers (axes m,f,ir)"), "{message}");
    assert!(message.contains("1 of 3 channels are zero, not received, and left out; the first is 0"), "{message}");
    assert!(message.contains("2 channels of 1 antenna x 4 subcarriers in csi; next: `pwrfgs init csi`"), "{message}");
    let powers = ["--axes", "m,f,ir", "--powers", "--out", "powers"];
    let message = stderr(&succeed(here, &[&import[..], &powers].concat()));
    assert!(message.contains("8 received powers at 4 receivers in powers"), "{message}");
    assert!(fs::read_to_string(here.join("powers/manifest.json")).unwrap().contains("\"unit\": \"dB (relative)\""));
    let facts = stdout(&succeed(here, &["inspect", "powers"]));
    assert!(facts.contains("relative received power") && !facts.contains("dBm"), "{facts}");
    let positions: Vec<u8> = (0..90).flat_map(|i| f64::from(i * i % 37).to_le_bytes()).collect();
    write(&here.join("tx.npy"), [npy_header(Number::F64, &[30, 3]), positions].concat());
    let numbers: Vec<u8> = (0..30 * 2).flat_map(|i: i16| (1 + i * i % 59).to_le_bytes()).collect();
    write(&here.join("amplitudes.npy"), [npy_header_as("<i2", &[30, 2]), numbers].concat());
    let many = ["import", "--channels", "amplitudes.npy", "--tx", "tx.npy", "--receiver", "0,0,2", "--axes", "m,f"];
    let all = ["--powers", "--accept", "row-order", "--accept", "position-unit", "--out", "many"];
    succeed(here, &[&many[..], &all].concat());
    succeed(here, &["init", "many", "--out", "many.ron"]);
    succeed(here, &["run", "many.ron", "--scale", "0.001", "--set", "split=Random()", "--out", "run", "-q"]);
    succeed(here, &["map", "run", "--plane", "z=1", "--step", "1", "--out", "map", "-q"]);
    let map = fs::read_to_string(here.join("map/map.csv")).unwrap();
    assert!(map.contains(",relative received power,dB,") && !map.contains("dBm"), "{map}");
    assert!(
        fs::read_to_string(here.join("powers/gateway_rssi.csv")).unwrap().starts_with("subcarrier 0,subcarrier 1,")
    );
    refuse(
        here,
        &[&import[..], &["--out", "bad"]].concat(),
        2,
        &["these are real numbers of both signs, without imaginary"],
    );
    write(&here.join("csi.mat"), "MATLAB");
    let mat = ["import", "--channels", "csi.mat", "--tx", "tx.csv", "--receiver", "0,0,2", "--out", "bad"];
    let line = "import numpy, scipy.io; numpy.save('csi.npy', scipy.io.loadmat('csi.mat')['NAME'])";
    refuse(here, &mat, 2, &["csi.mat: is a MATLAB file; convert it in Python", line]);
    for wrong in [&["--axes", "m,f,ir"][..], &["--channels", "csi.npy"], &["--channels", "csi.npy", "--scale", "2"]] {
        assert_eq!(call(here, &[&["import", "--out", "bad"][..], wrong].concat()).status.code(), Some(2));
    }
    assert!(!here.join("bad").exists());
}

/// A table is accepted or refused by the readings that it holds, not by its bytes, before they are read.
#[test]
#[cfg(target_os = "linux")]
fn import_refuses_readings_that_do_not_fit_into_memory() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let import = |name: &str, cell: &dyn Fn(usize) -> &'static str| {
        let mut text = "x,y,z".to_owned();
        (0..2_000).for_each(|r| _ = write!(text, ",ap{r}"));
        for i in 0..2_000 {
            _ = write!(text, "\n{},{},1.2", i % 50, i / 50);
            (0..2_000).for_each(|r| text += cell(i * 2_000 + r));
        }
        write(&here.join(name), text);
        // 400 MB of address space; 4 million readings need 360 MB.
        let script =
            format!("ulimit -v 400000; exec {} import --table {name} --out d -q", env!("CARGO_BIN_EXE_pwrfgs"));
        std::process::Command::new("sh").args(["-c", &script]).env("RAYON_NUM_THREADS", "1").current_dir(here).output()
    };
    let full = import("full.csv", &|_| ",-6").unwrap();
    let message = String::from_utf8_lossy(&full.stderr).into_owned();
    assert_eq!(full.status.code(), Some(2), "{message}");
    assert!(message.contains("full.csv: needs 0.4 GB of memory, more than the 0."), "{message}");
    assert!(message.contains(" GB that are available; give the table in parts"), "{message}");
    assert!(!here.join("d").exists());
    let sparse = import("sparse.csv", &|k| if k % 50 == 0 { ",-6" } else { "," }).unwrap();
    assert!(sparse.status.success(), "{}", String::from_utf8_lossy(&sparse.stderr));
}

/// Peak memory of imports of powers: at most 90 bytes held a reading, with many and with few receivers.
#[test]
#[cfg(target_os = "linux")]
fn import_holds_at_most_90_bytes_a_reading() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let peak = |positions: usize, receivers: usize| {
        let mut text = "x,y,z".to_owned();
        (0..receivers).for_each(|r| _ = write!(text, ",ap{r}"));
        for i in 0..positions {
            let [x, y] = [0.754_877_666_2, 0.569_840_291].map(|ratio| 100.0 * (i as f64 * ratio).fract());
            _ = write!(text, "\n{x:.3},{y:.3},1.2");
            (0..receivers).for_each(|r| _ = write!(text, ",{:.1}", -40.0 - 0.2 * (x - 10.0 * r as f64).abs()));
        }
        std::fs::write(here.join("t.csv"), text).unwrap();
        let out = format!("{positions}-{receivers}");
        let mut import = pwrfgs(here);
        import.args(["import", "--table", "t.csv", "--out", &out, "-q"]).stderr(Stdio::null());
        let used = import.spawn().unwrap().wait4().unwrap();
        assert!(used.status.success());
        used.rusage.maxrss as f64
    };
    for (receivers, positions) in [(5, [4_000, 84_000]), (20, [1_000, 21_000])] {
        let [few, many] = positions.map(|positions| peak(positions, receivers));
        let each = (many - few) / (receivers * (positions[1] - positions[0])) as f64;
        assert!(each < 90.0, "{each} bytes a reading of {receivers} receivers");
    }
}
