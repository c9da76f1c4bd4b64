//! Predictions of other programs as a baseline: paths, and the note under every table. A metric of a user in every table.

use pwrfgs::core::Query;
use pwrfgs::experiment::RunOutcome;
use pwrfgs::prelude::*;
use pwrfgs::run;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// Always one grey, which a file holds.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct GreyOfAFile {
    #[schemars(extend("format" = "path"))]
    path: PathBuf,
}

#[typetag::serde]
impl Baseline for GreyOfAFile {
    fn name(&self) -> String {
        "grey".into()
    }

    fn fit<'a>(&self, data: &'a Dataset, _: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        let text = std::fs::read_to_string(&self.path).map_err(|e| Error::read(&self.path, e))?;
        Ok(Box::new(Grey(Image {
            pixels: vec![text.trim().parse().unwrap(); data.width * data.height],
            ..data.image(0)
        })))
    }
}

struct Grey(Image);

impl Predict for Grey {
    fn predict(&self, _: Query<'_>) -> Image {
        self.0.clone()
    }

    fn note(&self) -> Option<String> {
        Some("grey <is> no competitor".into())
    }
}

/// Largest error of a pixel; its key begins as that of a built-in metric.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct WorstPixel {}

#[typetag::serde]
impl Metric for WorstPixel {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let error = |(a, b): (&Image, &Image)| {
            a.pixels.iter().zip(&b.pixels).map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
        };
        let values = Values::PerSample(evaluation.predictions.iter().zip(evaluation.truths).map(error).collect());
        Ok(vec![Measurement { key: "latency_worst".into(), unit: "%".into(), goal: Goal::Lower, values, note: None }])
    }
}

/// Hears stages that reach their end.
#[derive(Default)]
struct Ear(Vec<String>);

impl Observer for Ear {
    fn on_stage(&mut self, name: &str, done: usize, total: usize) {
        if done == total && total > 0 {
            self.0.push(format!("{name}: {total}"));
        }
    }
}

#[test]
fn own_baseline_paths_resolve_and_note_is_under_every_table() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("grey.txt"), "0.25").unwrap();
    let text = r#"Pipeline(
        name: "grey",
        data: Teacher(gaussians: 4, samples: 20, width: 24, height: 12),
        initializer: Grid(count: 4),
        deformation: Fixed(),
        training: (steps: 2, densify_until: 0, prune_until: 0),
        baselines: [GreyOfAFile(path: "grey.txt"), GreyOfAFile(path: "grey.txt"), MeanSpectrum()],
    )"#;
    let pipeline = Pipeline::parse(text, Path::new("grey.ron")).unwrap();
    let out = here.join("run");
    let mut ear = Ear::default();
    let mut start = || match run(&pipeline, here, &out, &mut ear, &AtomicBool::new(false)).unwrap() {
        RunOutcome::Finished { scores, already } => {
            let latency = scores.metrics.iter().find(|m| m.key == "latency_total_ms").unwrap();
            assert!(latency.cells.iter().all(|cell| cell.numbers().len() == 1), "everybody is timed: {latency:?}");
            (scores.to_text(None), already)
        }
        stopped => panic!("{stopped:?}"),
    };
    let (table, already) = start();
    assert!(!already && table.contains("\nnote: grey <is> no competitor\n"), "{table}");
    assert_eq!(table.matches("no competitor").count(), 1, "said once: {table}");
    assert_eq!(start(), (table, true), "a finished run prints the same");
    for stage in ["spectra: 20", "predicting with the model: 4", "predicting with grey: 4", "scoring grey: 9"] {
        assert!(ear.0.iter().any(|reported| reported == stage), "{stage} is not in {:?}", ear.0);
    }
    let resolved = std::fs::read_to_string(out.join("pipeline.ron")).unwrap();
    let absolute = here.join("grey.txt").canonicalize().unwrap();
    assert_eq!(resolved.matches(absolute.to_str().unwrap()).count(), 2, "{resolved}");
    let report = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(report.contains("grey &lt;is&gt; no competitor"));
}

#[test]
fn own_metric_is_in_every_table() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"Pipeline(
        name: "worst",
        data: Teacher(gaussians: 4, samples: 20, width: 24, height: 12),
        initializer: Grid(count: 4),
        deformation: Fixed(),
        training: (steps: 2, densify_until: 0, prune_until: 0),
        baselines: [MeanSpectrum()],
        metrics: [Ssim(), Psnr(), WorstPixel()],
    )"#;
    let pipeline = Pipeline::parse(text, Path::new("worst.ron")).unwrap();
    let out = folder.path().join("run");
    run(&pipeline, Path::new(""), &out, &mut NoopObserver, &AtomicBool::new(false)).unwrap();
    let study = pwrfgs::experiment::Study::read(&[out]).unwrap();
    let report = folder.path().join("report");
    let printed =
        pwrfgs::report::write(&study, &pwrfgs::report::ReportOptions::default(), &report, &mut NoopObserver).unwrap();
    assert_eq!(printed.matches(" latency worst ↓").count(), 2, "scores and differences: {printed}");
    for name in ["report.html", "tables/1-scores.tex", "tables/1-differences.tex"] {
        let text = std::fs::read_to_string(report.join(name)).unwrap();
        assert!(text.contains("latency worst"), "{name}: {text}");
    }
    let further = std::fs::read_to_string(report.join("tables/1-further.tex")).unwrap();
    assert!(further.contains("PSNR") && !further.contains("worst"), "{further}");
}
