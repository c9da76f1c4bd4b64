//! Shipped models: digests and sizes of their files, their predictions, and the card of each.

use pwrfgs::core::{Query, Real, ShippedFile, ShippedModel, files};
use pwrfgs::model::{Ensemble, file};
use std::path::Path;

/// Largest size of a file, bytes.
const LARGEST: usize = 300_000;
/// Tolerance of predictions, relative to the largest value if that is below 1.
const TOLERANCE: f64 = 1e-4;

/// Model with its SHA-256, and the predictions at three positions: four values, evenly spaced over those of all receivers.
struct Known {
    name: &'static str,
    digest: &'static str,
    predictions: [([f64; 3], [f64; 4]); 3],
}

const KNOWN: [Known; 3] = [
    Known {
        name: "ble",
        digest: "4cde0d663f02a7779d659b9f6fc94606442a9a199720a9feb731484252a6b53e",
        predictions: [
            ([16.5, 25.5, -0.1], [-84.518_87, -92.209_97, -87.706_46, -90.736_93]),
            ([44.0, 12.0, 0.0], [-91.981_72, -81.558_91, -79.867_84, -89.881_05]),
            ([43.0, 56.0, -0.1], [-94.686_98, -93.9184, -92.027_21, -86.397_68]),
        ],
    },
    Known {
        name: "office-channel",
        digest: "0fa3c62626c40d7294d099269cb724cd9419678babb26749f4abb5967c822a04",
        predictions: [
            ([3.0, 2.0, 1.2], [0.004_743_84, -0.005_212_49, 0.006_024_04, -0.000_309_234]),
            ([5.5, 4.0, 1.2], [-0.003_281_61, -0.000_698_483, 0.000_995_058, -0.003_777_17]),
            ([2.5, 3.5, 1.2], [-0.002_714_27, -0.004_606_4, 0.002_127_94, 0.002_496_42]),
        ],
    },
    Known {
        name: "s23",
        digest: "6987f4090886444cd74c403e12c08c23bab8e2ecffed5c7245fecbc10b7cf770",
        predictions: [
            ([0.1, -0.2, 1.2], [0.408_423, 0.353_218_3, 0.248_435_8, 0.826_71]),
            ([-0.4, -0.5, 1.0], [0.366_005_5, 0.233_773_9, 0.453_914_6, 1.019_991]),
            ([0.5, 0.3, 1.5], [0.213_522_6, 0.323_824_8, 0.257_176_9, 0.498_360_5]),
        ],
    },
];

/// Predictions for a transmitter at all receivers.
fn predict(model: &Ensemble, position: [f64; 3]) -> Vec<Real> {
    let prepared = model.prepare();
    let receivers = 0..prepared.receivers().len();
    receivers.flat_map(|receiver| prepared.predict_timed(Query::at(position, receiver)).0.pixels).collect()
}

#[test]
fn files_are_small_and_predict_as_when_they_were_made() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let shipped = ShippedModel::all();
    assert_eq!(shipped.iter().map(|model| model.name).collect::<Vec<_>>(), KNOWN.map(|known| known.name));
    let card = std::fs::read_to_string(folder.join("README.md")).unwrap();
    for (ShippedModel { name, bytes, pipeline, .. }, known) in shipped.iter().zip(KNOWN) {
        assert_eq!(*bytes, std::fs::read(folder.join(format!("{name}.safetensors"))).unwrap(), "{name}");
        assert_eq!(files::digest(bytes), known.digest, "{name}");
        assert!(bytes.len() <= LARGEST, "{name}: {} bytes", bytes.len());
        let section = card.split("\n## ").find(|section| section.starts_with(&format!("`{name}`"))).unwrap();
        for word in ["Data", "Licence", "Split", "Command", "Compression", known.digest, pipeline] {
            assert!(section.contains(word), "{name}: the card lacks {word}");
        }
        assert!(ShippedFile::find(ShippedFile::PIPELINES, Path::new(""), Path::new(pipeline)).is_some());
        let model = file::from_bytes(bytes).unwrap();
        assert!(!model.training_positions().is_empty(), "{name}");
        let found = known.predictions.map(|(position, _)| {
            let values = predict(&model, position);
            (position, [1, 2, 3, 4].map(|k| f64::from(values[k * values.len() / 5] as f32)))
        });
        for ((position, values), (_, expected)) in found.iter().zip(known.predictions) {
            let largest = expected.iter().fold(0.0, |most: f64, v| most.max(v.abs())).min(1.0);
            let is_near = values.iter().zip(expected).all(|(a, b)| (a - b).abs() <= TOLERANCE * largest);
            assert!(is_near, "{name} at {position:?}: {found:?}");
        }
    }
}
