//! Runs that are stopped during scoring.

use pwrfgs::experiment::{Observer, RunOutcome};
use pwrfgs::prelude::*;
use pwrfgs::run;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Asks to stop as soon as a stage begins.
struct Impatient {
    at: &'static str,
    stop: Arc<AtomicBool>,
}

impl Observer for Impatient {
    fn on_stage(&mut self, name: &str, _: usize, _: usize) {
        if name == self.at {
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

#[test]
fn run_stopped_during_scoring_keeps_model_and_is_scored_on_resume() {
    let text = r#"Pipeline(
        name: "stopping",
        data: Teacher(gaussians: 4, samples: 20, width: 24, height: 12),
        initializer: Grid(count: 4),
        deformation: Fixed(),
        training: (steps: 3, densify_until: 0, prune_until: 0),
        baselines: [MeanSpectrum(), NearestNeighbours(k: 1)],
    )"#;
    let pipeline = Pipeline::parse(text, Path::new("stopping.ron")).unwrap();
    for at in ["predicting with the model", "predicting with mean spectrum"] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("run");
        let start = |at| {
            let stop = Arc::new(AtomicBool::new(false));
            let mut observer = Impatient { at, stop: Arc::clone(&stop) };
            let outcome = run(&pipeline, folder.path(), &out, &mut observer, &stop).unwrap();
            assert_eq!(stop.load(Ordering::Relaxed), !at.is_empty(), "there is a stage called {at}");
            outcome
        };
        assert!(matches!(start(at), RunOutcome::Unscored), "{at}");
        assert!(!out.join("scores.csv").exists(), "nothing half done is written");
        let model = std::fs::read(out.join("model.safetensors")).unwrap();
        assert!(matches!(start(""), RunOutcome::Finished { already: false, .. }), "{at}");
        assert_eq!(std::fs::read(out.join("model.safetensors")).unwrap(), model);
    }
}
