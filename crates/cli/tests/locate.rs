//! Positions of transmitters from powers and spectra, and data that are refused.

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

/// Median and mean error in metres of a row of the table.
fn errors(line: &str) -> [f64; 2] {
    let mut cells = line.split_whitespace().filter(|cell| cell.contains('.')).map(|cell| cell.parse().unwrap());
    [cells.next().unwrap(), cells.next().unwrap()]
}

/// Whether closed outlines hold a point: a ray from it crosses them an odd number of times.
fn holds(outlines: &serde_json::Value, [x, y]: [f64; 2]) -> bool {
    let corner = |corner: &serde_json::Value| [0, 1].map(|k| corner[k].as_f64().unwrap());
    let crossings = outlines.as_array().unwrap().iter().flat_map(|outline| {
        let corners: Vec<[f64; 2]> = outline.as_array().unwrap().iter().map(corner).collect();
        (0..corners.len()).map(move |k| [corners[k], corners[(k + 1) % corners.len()]])
    });
    let crosses =
        |[a, b]: &[[f64; 2]; 2]| (a[1] > y) != (b[1] > y) && a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) > x;
    crossings.filter(crosses).count() % 2 == 1
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
    let rows: Vec<&str> = table.lines().skip(2).collect();
    let centre = rows.iter().find(|row| row.starts_with("centre of the positions")).unwrap();
    assert!(errors(rows[0])[0] < errors(centre)[0] && errors(rows[0])[1] < errors(centre)[1], "{table}");
    assert!(table.contains("nearest fingerprint") && table.contains("predicted"), "{table}");
    let is_named = |row: &&str| row.contains(" 0 %") == row.starts_with("measured fingerprints");
    assert!(rows.iter().take_while(|row| !row.contains("nearest")).all(is_named), "{table}");
    assert!(table.contains("minus baseline, mean error in metres ↓)"), "{table}");
    assert!(table.contains("the validation samples lie between the training positions"), "{table}");
    assert!(table.contains("measured") && stderr(&message).contains("validation positions"), "{table}");
    let quick = stdout(&succeed(here, &["locate", MODEL, "--no-kriging"]));
    assert!(!quick.contains("Kriging") && quick.contains("nearest fingerprint"), "{quick}");
    assert_eq!(quick.lines().nth(2), Some(rows[0]), "the row of the model does not change");
    let read = |name: &str| std::fs::read_to_string(here.join("located").join(name)).unwrap();
    let list = read("locations.csv");
    assert_eq!(list.lines().count(), 1 + 15, "{list}");
    assert!(list.lines().skip(1).all(|line| line.ends_with(",yes") || line.ends_with(",no")), "{list}");
    let regions: serde_json::Value = serde_json::from_str(&read("regions.json")).unwrap();
    let regions = regions.as_array().unwrap();
    assert!(regions.iter().all(|own| own["outlines"][0].as_array().is_some_and(|corners| corners.len() >= 4)));
    for (region, row) in regions.iter().zip(list.lines().skip(1)) {
        let cells: Vec<&str> = row.split(',').collect();
        let truth = [cells[7], cells[8]].map(|cell| cell.parse().unwrap());
        assert_eq!(holds(&region["outlines"], truth), cells[11] == "yes", "{row}: outlines hold what the table says");
        let estimate = [0, 1].map(|k| region["position"][k].as_f64().unwrap());
        assert!(holds(&region["outlines"], estimate), "{row}: the estimate is inside");
    }
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
    assert!(message.contains("validation samples: median error") && message.contains("centre of the positions"));
    write(&here.join("quoted.csv"), "\"south\",\"north\"\n\"-58.5\",-41.2\n-50,nan\n");
    assert_eq!(stdout(&succeed(here, &locate("quoted.csv"))), message, "quotes change nothing");
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
        ("north,north\n-50,-60\n", ["o.csv:1:7", "a second column"]),
        ("north,south\n,\n", ["row 1", "no receiver has a power"]),
        ("north,south\n-50\n", ["o.csv:2:4", "`south`"]),
        ("north,south\n-50,high\n", ["o.csv:2:5", "not a number"]),
        ("north,south\n-50,inf\n", ["o.csv:2:5", "not finite"]),
        ("north,south\n-50,1e30\n", ["o.csv:2:5", "not a power in dBm"]),
        ("north,south\n", ["no row", "o.csv"]),
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
