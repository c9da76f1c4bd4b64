//! `pwrfgs inspect` on a folder, on arrays and on a pipeline: output and errors.
use crate::common::{SMALL, refuse, stdout, succeed, write};
use pwrfgs::data::npy_header;
use pwrfgs_core::Number;
use std::path::Path;

#[test]
fn inspects_simulated_office_as_folder_and_as_pipeline() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/office.ron").canonicalize().unwrap();
    succeed(here, &["simulate", scene.to_str().unwrap(), "--samples", "80", "--out", "office", "-q"]);
    std::fs::remove_file(here.join("office/spectrum/00007.png")).unwrap();
    for index in ["train_index.txt", "test_index.txt"] {
        _ = std::fs::remove_file(here.join("office").join(index));
    }
    let message = stdout(&succeed(here, &["inspect", "office", "-q"]));
    for words in [
        "79 spectra of 360 x 90 pixels",
        "1 positions without a spectrum, 0 spectra without a position",
        "each spectrum runs from 0 to 1",
        "The recorded orientation fits the spectra.",
        "Official(",
        "TimeBlock()",
        "ceiling",
    ] {
        assert!(message.replace("\n               ", " ").contains(words), "`{words}` is not in {message}");
    }
    assert!(!message.contains("NaN"), "{message}");
    assert_eq!(stdout(&succeed(here, &["inspect", "office", "-q", "--threads", "1"])), message);

    write(&here.join("small.ron"), SMALL);
    let split = "split=Random(test: 0.3)";
    let message = stdout(&succeed(here, &["inspect", "small.ron", "-q", "--set", split]));
    assert!(message.contains("simulated") && message.contains("Random(test: 0.3, validation: 0.1) *"), "{message}");
    let message = stdout(&succeed(here, &["check", "small.ron"]));
    for words in ["boresight", "normalisation", "test distance", "\npose ", "\nmachine ", "; more if densification"] {
        assert!(message.contains(words), "`{words}` is not in {message}");
    }
    assert_eq!(timed(&message), ["8", "1"], "{message}");
    let message = stdout(&succeed(here, &["check", "small.ron", "--set", "training.densify.max_gaussians=20"]));
    assert!(!message.contains("; more if densification"), "the limit is in the estimate: {message}");
    let target = ["--set", "pruners=[RandomReference()]", "--set", "training.target_count=3"];
    let message = stdout(&succeed(here, &[&["check", "small.ron"][..], &target].concat()));
    assert_eq!(timed(&message), ["8", "3"], "{message}");
    assert_eq!(std::fs::read_dir(here).unwrap().count(), 2, "nothing is written");
}

/// Numbers of Gaussians in the line `time` of `check`.
fn timed(message: &str) -> Vec<&str> {
    let line = message.lines().find(|line| line.starts_with("time ")).unwrap();
    assert!(line.contains(" of training (") && line.contains(" ms per step with N = "), "{line}");
    line.split("N = ").skip(1).map(|rest| rest.split([',', ')']).next().unwrap()).collect()
}

#[test]
fn inspect_reports_outliers_in_array_data() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let (count, width, height) = (24usize, 16usize, 4usize);
    let pixel = |i: usize| ((i * 7919 + (i / 64) * 31) % 251) as u8;
    let mut pixels: Vec<u8> = (0..count * width * height).map(pixel).collect();
    pixels[5 * 64..6 * 64].fill(9); // id 6 is constant
    pixels.copy_within(0..64, 9 * 64); // id 10 equals id 1
    write(&here.join("s.npy"), [npy_header(Number::U8, &[count, height, width]), pixels].concat());
    let places = (0..count).flat_map(|i| [(i / 2) as f64 * 0.01, 0.0, 1.0]);
    let bytes: Vec<u8> = places.flat_map(f64::to_le_bytes).collect();
    write(&here.join("tx.npy"), [npy_header(Number::F64, &[count, 3]), bytes].concat());
    let pose = ["--receiver", "0,0,0", "--orientation", "0,0,0,1"];
    succeed(here, &[&["import", "--spectra", "s.npy", "--tx", "tx.npy", "--out", "mine", "-q"], &pose[..]].concat());
    let message = stdout(&succeed(here, &["inspect", "mine", "-q"])).replace("\n               ", " ");
    assert!(message.contains("1 constant (id 6), 2 equal to another (ids 1, 10)"), "{message}");
    assert!(message.contains("24 at the position of another") && !message.contains("simulated"), "{message}");
}

#[test]
fn rejects_folder_without_data() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("small.ron"), SMALL);
    write(&here.join("notes/a.txt"), "mine");
    write(&here.join("links.csv"), "x,y,z,receiver,rx_x,rx_y,rx_z,dbm\n1,2,1,hall,0,0,2,-61\n2,2,1,hall,0,0,2,-64\n");
    write(&here.join("s.NPY"), "");
    refuse(
        here,
        &["inspect", "links.csv"],
        2,
        &["links.csv: is a file", "`pwrfgs import --table links.csv --out FOLDER`"],
    );
    refuse(here, &["inspect", "s.NPY"], 2, &["s.NPY: is a file", "`pwrfgs import --spectra s.NPY --out FOLDER`"]);
    succeed(here, &["import", "--table", "links.csv", "--out", "data", "-q"]);
    refuse(
        here,
        &["inspect", "data/tx_pos.csv"],
        2,
        &["data/tx_pos.csv: is a file; give the folder of the data, data"],
    );
    refuse(here, &["inspect", "notes"], 2, &["notes", "received powers or channels", "name a data folder"]);
    refuse(here, &["inspect", "nowhere.ron"], 2, &["nowhere.ron"]);
    refuse(
        here,
        &["inspect", "small.ron", "--set", "split=Sparse(train: 100)", "--set", "nonsense=1"],
        2,
        &["nonsense"],
    );
}

/// On a terminal, a stage without a bar shows its name and its seconds.
#[test]
#[cfg(target_os = "linux")]
fn check_of_many_gaussians_shows_what_it_does() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("p.ron"), SMALL);
    let many = "initializer=Random(count: 400_000)";
    let command = format!("{} check p.ron --threads 1 --set '{many}'", env!("CARGO_BIN_EXE_pwrfgs"));
    let mut script = std::process::Command::new("script");
    let Ok(output) = script.args(["-qec", &command, "/dev/null"]).current_dir(folder.path()).output() else {
        return pwrfgs_core::testing::skipped("the program `script` is missing");
    };
    let text = stdout(&output);
    assert!(output.status.success() && text.contains("timing a few steps  1 s"), "{text}");
}
