//! Evaluation in parts: each metric sees its scope, few predictions are in memory, and scores equal those of all at once.

use crate::common::plugin;
use pwrfgs::core::Scope;
use pwrfgs::experiment::{EvaluationSet, Predictor, ScoredPredictor, Session};
use pwrfgs::metrics::{L1, Ssim};
use pwrfgs::prelude::*;
use std::path::Path;

/// How many predictions it is shown: one number a sample, or one in all.
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Counted {
    scope: String,
    whole: bool,
}

#[typetag::serde]
impl Metric for Counted {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let count = evaluation.predictions.len();
        assert_eq!(count, evaluation.truths.len());
        let values =
            if self.whole { Values::Whole(count as f64) } else { Values::PerSample(vec![count as f64; count]) };
        Ok(vec![Measurement {
            key: format!("counted_{}", self.scope),
            unit: String::new(),
            goal: Goal::Lower,
            values,
            note: None,
        }])
    }

    fn scope(&self) -> Scope {
        match self.scope.as_str() {
            "sample" => Scope::Sample,
            "model" => Scope::Model,
            _ => Scope::All,
        }
    }
}

fn data() -> Dataset {
    let source = "Teacher(gaussians: 3, samples: 300, width: 40, height: 10)";
    plugin::<dyn DataSource>(source).load(Path::new("."), &|_, _| {}).unwrap()
}

fn scores(data: &Dataset, part: &[usize], metrics: &[&str]) -> Result<Vec<Measurement>> {
    let plane = plugin::<dyn Projector>("Mercator()").plane(data.width, data.height);
    let metrics: Vec<Plugin<dyn Metric>> = metrics.iter().map(|text| plugin(text)).collect();
    let known: Vec<usize> = (0..50).collect();
    let fitted = plugin::<dyn Baseline>("NearestNeighbours()").fit(data, FittingSet::train(&known))?;
    let scored = ScoredPredictor { name: "3-NN", predictor: Predictor::Baseline(&*fitted), metrics: &metrics };
    EvaluationSet::new(data, part, &plane).score(scored, &mut Session::new(&mut NoopObserver))
}

#[test]
fn metric_receives_samples_of_its_scope() {
    let data = data();
    let part: Vec<usize> = (50..300).collect();
    let metrics = ["Counted(scope: \"sample\")", "Counted(whole: true)", "Counted(scope: \"model\", whole: true)"];
    let found = scores(&data, &part, &metrics).unwrap();
    let Values::PerSample(counts) = &found[0].values else { panic!("{found:?}") };
    assert!(counts.len() == 250 && counts.iter().all(|n| *n <= 64.0) && counts[0] > 1.0, "{counts:?}");
    assert_eq!((&found[1].values, &found[2].values), (&Values::Whole(250.0), &Values::Whole(0.0)));
    // One that looks at all of them and says otherwise would be wrong without a word.
    let message = scores(&data, &part, &["Counted(scope: \"sample\", whole: true)"]).unwrap_err();
    assert!(message.is_input() && message.to_string().contains("its `scope` should be `Scope::All`"), "{message}");
}

#[test]
fn streamed_scores_equal_scores_of_all_predictions() {
    let data = data();
    let part: Vec<usize> = (50..300).rev().collect();
    let fitted = plugin::<dyn Baseline>("NearestNeighbours()")
        .fit(&data, FittingSet::train(&(0..50).collect::<Vec<_>>()))
        .unwrap();
    let predictions: Vec<Image> = part.iter().map(|&i| fitted.predict(data.query(i))).collect();
    let truths: Vec<Image> = part.iter().map(|&i| data.image(i)).collect();
    let plane = plugin::<dyn Projector>("Mercator()").plane(data.width, data.height);
    let all = Evaluation { predictions: &predictions, truths: &truths, ..Evaluation::of(&data, &plane) };
    let streamed = scores(&data, &part, &["L1()", "Ssim()"]).unwrap();
    assert_eq!(streamed[0].values, L1 {}.evaluate(&all).unwrap()[0].values);
    assert_eq!(streamed[1].values, Ssim {}.evaluate(&all).unwrap()[0].values);
}

/// A data folder of arrays with 300 pictures, in a file that stays open.
fn stored(here: &Path) -> Dataset {
    let memory = data();
    let bytes: Vec<u8> = (0..300).flat_map(|i| memory.observations.raw(i).into_owned()).collect();
    let path = here.join("spectra");
    std::fs::write(&path, bytes).unwrap();
    let spectra = Spectra::open(&path, 0, pwrfgs::core::Number::U8, [300, 10, 40]).unwrap();
    Dataset { observations: spectra.into(), ..memory }
}

#[test]
fn streamed_training_and_scores_are_bit_identical() {
    let here = tempfile::tempdir().unwrap();
    let text = "Pipeline(name: \"file\", data: Teacher(), initializer: Grid(count: 8), deformation: Fixed(),
        training: (steps: 4, stride: 2, batch: 3, densify_until: 0, prune_until: 0))";
    let pipeline = Pipeline::parse(text, Path::new("file.ron")).unwrap();
    let partition = Partition { train: (0..200).collect(), validation: vec![], test: (200..300).collect() };
    let reached = |data: &Dataset| {
        let mut trainer = pipeline.trainer(data, &partition).unwrap();
        let losses: Vec<f64> = (0..4).map(|_| trainer.step().unwrap().loss).collect();
        (losses, format!("{:?}", scores(data, &partition.test, &["Ssim()"]).unwrap()))
    };
    assert_eq!(reached(&data()), reached(&stored(here.path())));
}

#[test]
fn truncated_file_stops_training_and_scoring_with_error() {
    let here = tempfile::tempdir().unwrap();
    let data = stored(here.path());
    let file = std::fs::File::options().write(true).open(here.path().join("spectra")).unwrap();
    file.set_len(60 * 400).unwrap();
    let part: Vec<usize> = (0..300).collect();
    let message = scores(&data, &part, &["Ssim()"]).unwrap_err().to_string();
    assert!(message.contains("file of spectra was changed or removed while open"), "{message}");
    let data = stored(here.path());
    let text = "Pipeline(name: \"file\", data: Teacher(), initializer: Grid(count: 8), deformation: Fixed(),
        training: (steps: 9, densify_until: 0, prune_until: 0))";
    let pipeline = Pipeline::parse(text, Path::new("file.ron")).unwrap();
    let partition = Partition { train: (100..200).collect(), validation: vec![], test: (200..300).collect() };
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    trainer.step().unwrap();
    std::fs::File::options().write(true).open(here.path().join("spectra")).unwrap().set_len(0).unwrap();
    let message = trainer.step().unwrap_err().to_string();
    assert!(message.starts_with("cannot read ") && message.contains("restore it"), "{message}");
}
