//! Evaluation: the model and every baseline on the test part, by every metric of the pipeline.
//!
//! Baselines make no choices, so they are fitted on training and validation together: the stronger floor.

use crate::scores::{MODEL, Scores};
use pwrfgs_core::{
    Dataset, Error, Evaluation, Image, ImagePlane, Measurement, Metric, ModelFacts, Partition, Plugin, Predict, Real,
    Result,
};
use pwrfgs_model::Model;
use pwrfgs_train::Pipeline;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Transmitters predicted in one call.
const CHUNK: usize = 64;

/// Scores, and what they were computed from.
#[derive(Debug)]
pub struct Assessment {
    /// All measurements.
    pub scores: Scores,
    /// The model's predictions, one a test sample, not clamped.
    pub predictions: Vec<Image>,
    /// The measured spectra in the same order.
    pub truths: Vec<Image>,
}

/// Scores `model` and the pipeline's baselines on the test part of `data`.
///
/// # Errors
/// Where the model draws pictures of another size than the data hold, or a metric or baseline refuses.
pub fn evaluate(model: &Model, pipeline: &Pipeline, data: &Dataset, partition: &Partition) -> Result<Assessment> {
    let plane = &model.stages.plane;
    if (plane.width, plane.height) != (data.width, data.height) {
        return Err(Error::Config(format!(
            "the model draws {}x{} pixels and the spectra of the data have {}x{}; evaluate it on data like those it was \
             trained on",
            plane.width, plane.height, data.width, data.height
        )));
    }
    let test = Bench::new(data, &partition.test, plane);
    let predictions = predict(model, &test.txs);
    let next = AtomicUsize::new(0);
    let timed = || model.predict_timed(test.txs[next.fetch_add(1, Ordering::Relaxed) % test.txs.len()]).1;
    let facts = ModelFacts {
        means: &model.cloud.means,
        gaussian_bytes: model.gaussian_bytes(),
        network_bytes: model.network_bytes(),
        timed_prediction: &timed,
    };
    let own = test.measure(&pipeline.metrics, &predictions, Some(facts))?;
    let mut predictors = vec![(MODEL.to_owned(), own)];
    let mut known = [partition.train.as_slice(), &partition.validation].concat();
    known.sort_unstable();
    let mut notes: Vec<String> = Vec::new();
    for baseline in &pipeline.baselines {
        let fitted = baseline.fit(data, &known)?;
        predictors.push((baseline.name(), test.baseline(&*fitted, &pipeline.metrics)?));
        notes.extend(fitted.note().filter(|note| !notes.contains(note)));
    }
    let ids = partition.test.iter().map(|&i| data.samples[i].id).collect();
    Ok(Assessment { scores: Scores { ids, predictors, notes }, predictions, truths: test.truths })
}

/// Predictions for all of `txs`, a chunk at a time.
pub(crate) fn predict(model: &Model, txs: &[[Real; 3]]) -> Vec<Image> {
    txs.chunks(CHUNK).flat_map(|chunk| model.predict_many(chunk)).collect()
}

/// A part of the data set to score on.
pub(crate) struct Bench<'a> {
    data: &'a Dataset,
    plane: &'a ImagePlane,
    pub(crate) txs: Vec<[Real; 3]>,
    truths: Vec<Image>,
}

impl<'a> Bench<'a> {
    /// The samples `part`, on the pixels of `plane`.
    pub(crate) fn new(data: &'a Dataset, part: &[usize], plane: &'a ImagePlane) -> Self {
        let txs = part.iter().map(|&i| data.samples[i].tx).collect();
        Self { data, plane, txs, truths: part.par_iter().map(|&i| data.image(i)).collect() }
    }

    /// Every measurement of `predictions`.
    pub(crate) fn measure(
        &self,
        metrics: &[Plugin<dyn Metric>],
        predictions: &[Image],
        model: Option<ModelFacts<'_>>,
    ) -> Result<Vec<Measurement>> {
        let (truths, plane, scene) = (self.truths.as_slice(), self.plane, &self.data.scene);
        let evaluation = Evaluation { predictions, truths, plane, scene, model };
        let all: Result<Vec<_>> = metrics.iter().map(|metric| metric.evaluate(&evaluation)).collect();
        Ok(all?.into_iter().flatten().collect())
    }

    /// Every measurement of a baseline.
    pub(crate) fn baseline(&self, fitted: &dyn Predict, metrics: &[Plugin<dyn Metric>]) -> Result<Vec<Measurement>> {
        let predictions: Vec<Image> = self.txs.par_iter().map(|tx| fitted.predict(*tx)).collect();
        self.measure(metrics, &predictions, None)
    }
}
