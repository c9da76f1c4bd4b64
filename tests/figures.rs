//! The figures that compare runs, drawn from small runs.

use crate::common::pipeline;
use pwrfgs::experiment::sweep::{ListedRun, Listing};
use pwrfgs::prelude::*;
use pwrfgs::report::{Study, figures};
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Two weights of the mask loss, two seeds each, in a sweep folder.
fn sweep(folder: &Path) {
    let mut runs = Vec::new();
    for lambda in ["0.0", "0.1"] {
        for seed in 0..2 {
            let pipeline = pipeline(&format!(
                "seed: {seed}, data: Teacher(gaussians: 6, samples: 60, width: 90, height: 24),
                 split: Random(test: 0.5), initializer: Grid(count: 30),
                 deformation: Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4),
                 pruners: [LearnableMask(lambda: {lambda}, learning_rate: 0.6)],
                 training: (steps: 20, batch: 2, densify_until: 5, prune_until: 15, prune_every: 5, validate_every: 0),
                 baselines: [MeanSpectrum(), NearestNeighbours(k: 1)]",
            ));
            let name = format!("{lambda}-{seed}");
            let stop = AtomicBool::new(false);
            pwrfgs::run(&pipeline, Path::new("."), &folder.join(&name), &mut Silent, &stop).unwrap();
            runs.push(ListedRun { folder: name, labels: vec![("lambda".into(), lambda.into())], seed });
        }
    }
    Listing { name: "lambda".into(), runs }.write(folder).unwrap();
}

#[test]
fn every_figure_stands_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    sweep(folder.path());
    let study = Study::read(&[folder.path().into()]).unwrap();
    assert_eq!((study.settings.len(), study.settings[0].variants.len()), (1, 2));
    let figures = figures::all(&study.settings[0], &|_, _| {}).unwrap();
    let names: Vec<&str> = figures.iter().map(|f| f.name.as_str()).collect();
    assert_eq!(names, ["gaussians", "ssim-n", "eta-n", "latency", "distance", "room", "spectra", "eta-snr"]);
    for figure in &figures {
        let name = &figure.name;
        assert!(figure.svg.contains("mm\"") && !figure.svg.contains("<text"), "{name}");
        // Embedded pictures may spell anything.
        let drawn: String =
            figure.svg.split("base64,").map(|part| part.split_once('"').map_or(part, |p| p.1)).collect();
        assert!(!drawn.contains("NaN") && !drawn.contains("inf"), "{name}");
        assert!(figure.png.starts_with(b"\x89PNG"), "{name}");
        assert!(figure.caption.ends_with('.') && !figure.title.is_empty(), "{name}: {}", figure.caption);
        figure.write(folder.path()).unwrap();
        assert_eq!(std::fs::read(folder.path().join(format!("{name}.png"))).unwrap(), figure.png);
    }
}
