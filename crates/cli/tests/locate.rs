//! Transmitters are located from powers and spectra; what cannot be located is refused.

use crate::common::{SMALL, refuse, stderr, stdout, succeed, write};
use crate::links::hall;
use pwrfgs_core::Number;
use pwrfgs_core::npy::npy_header;
use std::path::Path;

const MODEL: &str = "run/model.safetensors";

/// `hall` with validation samples for regions.
pub(crate) fn hall_with_validation(here: &Path) {
    hall(here);
    std::fs::remove_dir_all(here.join("run")).unwrap();
    let split = "split=Random(test: 0.25, validation: 0.3)";
    succeed(here, &["run", "p.ron", "--out", "run", "--set", split, "-q"]);
}

/// Errors in metres of the row that starts with `name`: median and mean.
fn errors(table: &str, name: &str) -> [f64; 2] {
    let line = table.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("no {name} in {table}"));
    let mut cells = line[name.len()..].split_whitespace().map(|cell| cell.parse().unwrap());
    [cells.next().unwrap(), cells.next().unwrap()]
}

/// File of an array whose values are all equal.
fn array(shape: &[usize], value: f32) -> Vec<u8> {
    let values = value.to_le_bytes().repeat(shape.iter().product());
    [npy_header(Number::F32, shape), values].concat()
}

#[test]
fn test_samples_are_located_beside_baselines() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall_with_validation(here);
    let message = succeed(here, &["locate", MODEL, "--out", "located", "--pictures", "2"]);
    let table = stdout(&message);
    let (own, centre) = (errors(&table, "model"), errors(&table, "centre of the positions"));
    assert!(own[0] < centre[0] && own[1] < centre[1], "{table}");
    assert!(table.contains("nearest fingerprint") && table.contains("fingerprints of Kriging"), "{table}");
    assert!(table.contains("measured") && stderr(&message).contains("validation positions"), "{table}");
    let read = |name: &str| std::fs::read_to_string(here.join("located").join(name)).unwrap();
    let list = read("locations.csv");
    assert_eq!(list.lines().count(), 1 + 15, "{list}");
    assert!(list.lines().skip(1).all(|line| line.ends_with(",yes") || line.ends_with(",no")), "{list}");
    let regions: serde_json::Value = serde_json::from_str(&read("regions.json")).unwrap();
    let regions = regions.as_array().unwrap();
    assert!(regions.iter().all(|own| own["outlines"][0].as_array().is_some_and(|corners| corners.len() >= 4)));
    let pictures = here.join("located").read_dir().unwrap().map(|e| e.unwrap().path());
    let pictures: Vec<_> = pictures.filter(|path| path.extension().is_some_and(|e| e == "png")).collect();
    assert_eq!(pictures.len(), 3, "errors.png and two samples");
    assert!(pictures.iter().all(|path| image::open(path).is_ok()));
}

#[test]
fn powers_of_files_are_located_and_invalid_ones_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    hall_with_validation(here);
    let locate = |file: &'static str| ["locate", MODEL, file];
    write(&here.join("o.csv"), "south,north\n-58.5,-41.2\n-50,\n");
    let message = stdout(&succeed(here, &locate("o.csv")));
    assert!(message.contains("00001") && message.contains("00002") && message.contains("region"), "{message}");
    let inside = succeed(here, &["locate", MODEL, "o.csv", "--prior", "0,5,0,6", "--out", "out"]);
    let list = std::fs::read_to_string(here.join("out/locations.csv")).unwrap();
    for line in list.lines().skip(1) {
        let x: f64 = line.split(',').nth(1).unwrap().parse().unwrap();
        assert!((0.0..=5.0).contains(&x), "{line}: {}", stderr(&inside));
    }
    refuse(here, &["locate", MODEL, "o.csv", "--out", "out"], 2, &["out"]);
    refuse(here, &["locate", MODEL, "o.csv", "--prior", "50,60,0,6"], 2, &["--prior", "no training position"]);
    refuse(here, &["locate", MODEL, "o.csv", "--prior", "5,0,0,6"], 2, &["--prior", "the smaller first"]);
    for (text, words) in [
        ("north,soth\n-50,-50\n", ["soth", "did you mean"]),
        ("north,north\n-50,-60\n", ["o.csv:1:1", "occurs twice"]),
        ("north,south\n,\n", ["row 1", "no receiver has a power"]),
        ("north,south\n-50\n", ["o.csv:2:1", "1 cells"]),
        ("north,south\n-50,high\n", ["o.csv:2:1", "`high` is no number"]),
        ("north,south\n-50,inf\n", ["row 1", "inf"]),
        ("north,south\n-50,1e30\n", ["row 1: a power is", "give dBm"]),
        ("north,south\n", ["truncated", "o.csv"]),
    ] {
        write(&here.join("o.csv"), text);
        refuse(here, &locate("o.csv"), 2, &words);
    }
    write(&here.join("o.npy"), array(&[2, 3], 0.0));
    refuse(here, &locate("o.npy"), 2, &["has shape [2, 3]", "[B, 2]"]);
    write(&here.join("o.npy"), &array(&[3, 2], -50.0)[..140]);
    refuse(here, &locate("o.npy"), 2, &["has shape [3, 2], but not its length"]);
    write(&here.join("o.npy"), [npy_header(Number::U16, &[1, 2]), vec![0; 4]].concat());
    refuse(here, &locate("o.npy"), 2, &["`<u2`", "astype"]);
    refuse(here, &locate("o.png"), 2, &["no file of received powers", "CSV"]);
}

#[test]
fn spectra_are_located_and_other_images_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("p.ron"), SMALL);
    succeed(here, &["run", "p.ron", "--out", "run", "-q"]);
    assert!(stdout(&succeed(here, &["locate", MODEL])).contains("simulated"));
    image::GrayImage::new(48, 12).save(here.join("o.png")).unwrap();
    assert!(stdout(&succeed(here, &["locate", MODEL, "o.png"])).contains("00001"));
    image::GrayImage::new(12, 48).save(here.join("turned.png")).unwrap();
    refuse(here, &["locate", MODEL, "turned.png"], 2, &["12 x 48", "48 x 12"]);
    image::GrayImage::new(8192, 2049).save(here.join("large.png")).unwrap();
    refuse(here, &["locate", MODEL, "large.png"], 2, &["8192 x 2049 pixels, more than 16777216"]);
    write(&here.join("o.npy"), array(&[1, 12, 48], 1e30));
    refuse(here, &["locate", MODEL, "o.npy"], 2, &["observation 1 has the value 1e30", "from 0 to 1"]);
    write(&here.join("o.npy"), array(&[1, 12, 48], f32::NAN));
    refuse(here, &["locate", MODEL, "o.npy"], 2, &["observation 1", "not finite"]);
    std::fs::rename(here.join("run/pipeline.ron"), here.join("p2.ron")).unwrap();
    refuse(here, &["locate", MODEL], 2, &["no pipeline.ron next to this model"]);
}
