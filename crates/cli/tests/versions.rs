//! Model files of the current versions, committed in `models/`: they predict as when they were written, and older ones
//! are refused.
//!
//! If a format gets a new version, `PWRFGS_MODELS=write cargo test -p pwrfgs-cli --test cli -- versions::` writes them again.

use crate::common::{SMALL, refuse, succeed, write};
use crate::model_format::{models, of_carriers};
use pwrfgs::model::tensors::Tensors;
use pwrfgs::model::{Ensemble, file};
use pwrfgs_core::{End, Pose, Query, Real};
use std::path::{Path, PathBuf};

/// Name of a file, and format and version in its note.
const FILES: [(&str, &str); 6] = [
    ("spectra", r#""format":"pwrfgs-model","version":5"#),
    ("carriers", r#""format":"pwrfgs-model","version":7"#),
    ("moving", r#""format":"pwrfgs-model","version":8"#),
    ("ensemble", r#""format":"pwrfgs-ensemble","version":2"#),
    ("residuals", r#""format":"pwrfgs-ensemble","version":3"#),
    ("powers", r#""format":"pwrfgs-ensemble","version":3"#),
];
const POSITIONS: [[f64; 3]; 3] = [[0.4, -0.3, 1.1], [-1.25, 2.0, 0.2], [3.5, 2.5, 1.2]];
const TOLERANCE: f64 = 1e-4;

/// Folder of the committed files.
pub(crate) fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/models")
}

/// Mean, root mean square and largest value of the prediction at each position, one line per file.
fn predictions() -> String {
    let line = |(name, _): &(&str, &str)| {
        let ensemble = file::read_ensemble(&folder().join(format!("{name}.safetensors"))).unwrap();
        let prepared = ensemble.prepare();
        let numbers = POSITIONS.iter().flat_map(|at| {
            let pixels = prepared.predict_timed(Query::at(Pose::from(*at), 0)).0.pixels;
            let mean = |f: fn(f64) -> f64| pixels.iter().map(|v| f(*v as f64)).sum::<f64>() / pixels.len() as f64;
            [mean(|v| v), mean(|v| v * v).sqrt(), pixels.iter().fold(f64::MIN, |most, v| most.max(*v as f64))]
        });
        format!("{name} {}\n", numbers.map(|v| format!("{v:.7e}")).collect::<Vec<_>>().join(" "))
    };
    FILES.iter().map(line).collect()
}

/// Stores every fourth row and column of the residuals of 12 x 48 pixels, in 8 bits.
fn thin(tensors: &mut Tensors) {
    let links = tensors.shape("residuals.values").unwrap()[0];
    let values = tensors.take("residuals.values", &[links, 12 * 48]).unwrap();
    let rows = values.chunks_exact(48).step_by(4);
    let stored: Vec<Real> = rows.flat_map(|row| row.iter().step_by(4).copied()).collect();
    let unit = stored.iter().fold(0.0, |most: Real, v| most.max(v.abs())) / 127.0;
    tensors.put_i8("residuals.values", vec![links, 36], stored.iter().map(|v| (v / unit).round() as i8).collect());
    tensors.put("residuals.units", vec![links], vec![unit; links]);
    tensors.note = tensors.note.replace(r#""stride":1"#, r#""stride":4"#);
}

/// Writes the files again.
fn write_files() {
    let put = |name: &str, ensemble: &Ensemble| {
        file::write_ensemble(&folder().join(format!("{name}.safetensors")), ensemble).unwrap();
    };
    let mut small = models().skip(3).take(2); // of small networks
    let [first, second] = [small.next().unwrap(), small.next().unwrap()];
    let mut moving = first.clone();
    (moving.stages.setup.moving, moving.stages.setup.transmitter) = (End::Receiver, Some([0.5, 0.5, 2.0]));
    moving.stages.setup.receivers[0].pose.position = [0.0; 3];
    put("moving", &Ensemble::of(moving));
    put("carriers", &Ensemble::of(of_carriers("Factored(depth: 2, width: 8, carrier: 2)")));
    put("ensemble", &Ensemble::named(vec![("first".into(), first.clone()), ("second".into(), second)]).unwrap());
    put("spectra", &Ensemble::of(first));
    let temporary = tempfile::tempdir().unwrap();
    let here = temporary.path();
    let powers = include_str!("golden/powers.ron");
    let powers = powers.replace("SCENES", concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes"));
    let spectra = SMALL.replace("validation: 0.2", "validation: 0.3");
    let spectra = spectra.replace("Mlp(depth: 2, width: 16, skip: None)", "Factored(depth: 1, width: 8)");
    for (name, pipeline) in [("residuals", spectra), ("powers", powers)] {
        write(&here.join(format!("{name}.ron")), pipeline);
        succeed(here, &["run", &format!("{name}.ron"), "--out", name, "-q", "--set", "residuals=Kriged()"]);
        let bytes = std::fs::read(here.join(name).join("model.safetensors")).unwrap();
        let mut tensors = Tensors::from_bytes(&bytes).unwrap();
        // A share that short training does not reach, so that predictions depend on the network.
        tensors.note = tensors.note.replace(r#""share":0.0"#, r#""share":0.5"#);
        if name == "residuals" {
            thin(&mut tensors);
        }
        write(&folder().join(format!("{name}.safetensors")), tensors.to_bytes());
    }
}

#[test]
fn committed_models_predict_as_when_they_were_written() {
    let expected = folder().join("expected.txt");
    if std::env::var("PWRFGS_MODELS").is_ok_and(|value| value == "write") {
        write_files();
        std::fs::write(&expected, predictions()).unwrap();
    }
    let (expected, found) = (std::fs::read_to_string(expected).unwrap(), predictions());
    assert_eq!(expected.lines().count(), FILES.len());
    for (expected, found) in expected.lines().zip(found.lines()) {
        let (name, expected) = expected.split_once(' ').unwrap();
        let (own, found) = found.split_once(' ').unwrap();
        assert_eq!(name, own);
        let numbers = |text: &str| text.split(' ').map(|v| v.parse().unwrap()).collect::<Vec<f64>>();
        for (expected, found) in numbers(expected).into_iter().zip(numbers(found)) {
            let is_close = (expected - found).abs() <= TOLERANCE * expected.abs().max(1e-3);
            assert!(is_close, "{name}: {found}, expected {expected}");
        }
    }
}

#[test]
fn versions_are_those_of_the_page_and_older_ones_are_refused() {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/model-format.md")).unwrap();
    let temporary = tempfile::tempdir().unwrap();
    let here = temporary.path();
    for (name, head) in FILES {
        let bytes = std::fs::read(folder().join(format!("{name}.safetensors"))).unwrap();
        assert!(bytes.len() < 50_000, "{name} has {} bytes", bytes.len());
        let mut tensors = Tensors::from_bytes(&bytes).unwrap();
        assert!(tensors.note.starts_with(&format!("{{{head}")), "{name}: {}", tensors.note);
        let (format, version) = head.rsplit_once(':').unwrap();
        let format = format.split('"').nth(3).unwrap();
        let row = page.lines().find(|line| line.starts_with(&format!("| `{format}` |"))).unwrap();
        assert!(row.contains(&format!(" {version}")), "{format} {version}: {row}");
        tensors.note = tensors.note.replacen(&format!(":{version}"), ":1", 1);
        write(&here.join("old.safetensors"), tensors.to_bytes());
        let words: [&str; 3] = ["old.safetensors: ", &format!("a `{format}` of version 1, expected"), version];
        refuse(here, &["predict", "old.safetensors", "--tx=0,0,1", "--out", "o"], 2, &words);
    }
}
