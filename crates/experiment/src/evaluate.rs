//! Evaluation: the model and every baseline on the test part, by every metric of the pipeline.
//!
//! Baselines make no choices, so they are fitted on training and validation together: the stronger floor.

use crate::observer::{Observer, staged};
use crate::scores::{MODEL, Scores};
use pwrfgs_core::{
    Dataset, Error, Evaluation, Image, ImagePlane, Measurement, Metric, ModelFacts, Partition, Plugin, Predict,
    Progress, Real, Result, StageTimes,
};
use pwrfgs_model::{Model, Prepared};
use pwrfgs_train::Pipeline;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

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

/// Scores `model`, or an ensemble of them, and the pipeline's baselines on the test part of `data`.
///
/// # Errors
/// Where the model draws pictures of another size than the data hold, or a metric or baseline refuses;
/// [`Error::Stopped`] once `stop` is set.
pub fn evaluate(
    model: &Prepared<'_>,
    pipeline: &Pipeline,
    data: &Dataset,
    partition: &Partition,
    observer: &mut dyn Observer,
    stop: &AtomicBool,
) -> Result<Assessment> {
    let plane = model.plane();
    if (plane.width, plane.height) != (data.width, data.height) {
        return Err(Error::Config(format!(
            "the model draws {}x{} pixels and the spectra of the data have {}x{}; evaluate it on data like those it was \
             trained on",
            plane.width, plane.height, data.width, data.height
        )));
    }
    if let Some(drawn) = plane.elevation().filter(|drawn| *drawn != data.elevation) {
        return Err(Error::Config(format!(
            "the model draws elevations of {} to {} degrees and the spectra of the data are of {} to {}; evaluate it on \
             data like those it was trained on",
            drawn.first, drawn.last, data.elevation.first, data.elevation.last
        )));
    }
    let test = Bench::new(data, &partition.test, plane);
    let predictions = staged(observer, "predicting with the model", |progress| test.predict(model, stop, progress))?;
    go_on(stop)?;
    let means: Vec<[Real; 3]> = model.models().flat_map(|m| m.means_from(data.scene.origin)).collect();
    let facts = ModelFacts {
        means: &means,
        gaussian_bytes: model.models().map(Model::gaussian_bytes).sum(),
        network_bytes: model.models().map(Model::network_bytes).sum(),
    };
    let own = staged(observer, "scoring the model", |progress| {
        let timed = test.in_turn(|tx| model.predict_timed(tx).1);
        test.measure(&pipeline.metrics, &predictions, Some(facts), Some(&timed), progress)
    })?;
    let mut predictors = vec![(MODEL.to_owned(), own)];
    let (mut notes, mut bounds): (Vec<String>, Vec<String>) = Default::default();
    let known = partition.known();
    for baseline in &pipeline.baselines {
        go_on(stop)?;
        let fitted = baseline.fit(data, &known)?;
        let name = baseline.name();
        let measured = test.baseline(&name, &*fitted, &pipeline.metrics, observer)?;
        bounds.extend(fitted.knows_scene().then(|| name.clone()));
        predictors.push((name, measured));
        notes.extend(fitted.note().filter(|note| !notes.contains(note)));
    }
    let ids = partition.test.iter().map(|&i| data.samples[i].id).collect();
    Ok(Assessment { scores: Scores { ids, predictors, bounds, notes }, predictions, truths: test.truths })
}

/// [`Error::Stopped`] once `stop` is set.
pub(crate) fn go_on(stop: &AtomicBool) -> Result<()> {
    if stop.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
}

/// A part of the data set to score on.
#[derive(Debug)]
pub struct Bench<'a> {
    data: &'a Dataset,
    plane: &'a ImagePlane,
    txs: Vec<[f64; 3]>,
    truths: Vec<Image>,
}

impl<'a> Bench<'a> {
    /// The samples `part`, on the pixels of `plane`.
    pub fn new(data: &'a Dataset, part: &[usize], plane: &'a ImagePlane) -> Self {
        let txs = part.iter().map(|&i| data.samples[i].tx).collect();
        Self { data, plane, txs, truths: part.par_iter().map(|&i| data.image(i)).collect() }
    }

    /// Predictions of `model`, a chunk at a time.
    ///
    /// # Errors
    /// [`Error::Stopped`] once `stop` is set.
    pub fn predict(&self, model: &Prepared<'_>, stop: &AtomicBool, progress: Progress<'_>) -> Result<Vec<Image>> {
        let mut all = Vec::with_capacity(self.txs.len());
        for chunk in self.txs.chunks(CHUNK) {
            go_on(stop)?;
            all.extend(model.predict_many(chunk));
            progress(all.len(), self.txs.len());
        }
        Ok(all)
    }

    /// Every measurement of `predictions`; `progress` counts metrics.
    ///
    /// # Errors
    /// Where a metric refuses.
    pub fn measure(
        &self,
        metrics: &[Plugin<dyn Metric>],
        predictions: &[Image],
        model: Option<ModelFacts<'_>>,
        timed_prediction: Option<&dyn Fn() -> StageTimes>,
        progress: Progress<'_>,
    ) -> Result<Vec<Measurement>> {
        let (truths, plane, scene) = (self.truths.as_slice(), self.plane, &self.data.scene);
        let evaluation = Evaluation { predictions, truths, plane, scene, model, timed_prediction };
        let mut all = Vec::new();
        for (done, metric) in metrics.iter().enumerate() {
            all.extend(metric.evaluate(&evaluation)?);
            progress(done + 1, metrics.len());
        }
        Ok(all)
    }

    /// Every measurement of a baseline called `name`.
    ///
    /// # Errors
    /// Where a metric refuses.
    pub fn baseline(
        &self,
        name: &str,
        fitted: &dyn Predict,
        metrics: &[Plugin<dyn Metric>],
        observer: &mut dyn Observer,
    ) -> Result<Vec<Measurement>> {
        let predictions: Vec<Image> = staged(observer, &format!("predicting with {name}"), |progress| {
            let done = AtomicUsize::new(0);
            let predict = |tx: &[f64; 3]| {
                let image = fitted.predict(*tx);
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, self.txs.len());
                image
            };
            self.txs.par_iter().map(predict).collect()
        });
        let timed = self.in_turn(|tx| {
            let begun = Instant::now();
            std::hint::black_box(fitted.predict(tx));
            StageTimes { total: begun.elapsed().as_secs_f64(), ..StageTimes::default() }
        });
        staged(observer, &format!("scoring {name}"), |progress| {
            self.measure(metrics, &predictions, None, Some(&timed), progress)
        })
    }

    /// Times a prediction for the next transmitter at every call, one after the other.
    fn in_turn(&self, time: impl Fn([f64; 3]) -> StageTimes) -> impl Fn() -> StageTimes {
        let next = Cell::new(0);
        move || time(self.txs[next.replace(next.get() + 1) % self.txs.len()])
    }
}
