//! `EvaluationSet`: scores predictors on a set of samples, chunk by chunk.
//!
//! Only the predictions and spectra of one chunk are in memory (unless a metric needs all), so memory does not grow
//! with the number of samples.

use crate::session::{Session, run_stage};
use pwrfgs_core::plugin::title_of;
use pwrfgs_core::{
    Dataset, Error, Evaluation, Image, ImagePlane, Link, Measurement, Metric, ModelFacts, Plugin, Predict, Query,
    Result, Scope, StageTimes, Values, check_stopped,
};
use pwrfgs_model::Prepared;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Largest number of links per prediction call.
const CHUNK: usize = 64;
/// Largest number of links per prediction call if an observation is a single number.
const MANY: usize = 4096;
/// Largest number of pixels per prediction call for larger images; 8 bytes each with the measured ones.
const PIXELS: usize = 1 << 21;

/// Model or baseline that predicts the samples.
#[derive(Clone, Copy)]
pub enum Predictor<'a> {
    /// Model, with facts for model metrics. Without facts, model metrics and timing are omitted.
    Model(&'a Prepared<'a>, Option<ModelFacts<'a>>),
    /// Fitted baseline.
    Baseline(&'a dyn Predict),
}

impl<'a> Predictor<'a> {
    /// Predicts the links; `done` gets the number of links completed since its last call.
    fn predict(self, queries: &[Query<'_>], done: &(dyn Fn(usize) + Sync)) -> Vec<Image> {
        match self {
            Self::Model(model, _) => {
                let images = model.predict_many(queries);
                done(queries.len());
                images
            }
            Self::Baseline(fitted) => {
                let predict_one = |query: &Query<'_>| {
                    let image = fitted.predict(*query);
                    done(1);
                    image
                };
                queries.par_iter().map(predict_one).collect()
            }
        }
    }

    /// Predicts one link and returns the time per stage; for a baseline only `total`.
    fn time(self, query: Query<'_>) -> StageTimes {
        match self {
            Self::Model(model, _) => {
                let (_, times) = model.predict_timed(query);
                times
            }
            Self::Baseline(fitted) => {
                let begun = Instant::now();
                std::hint::black_box(fitted.predict(query));
                StageTimes { total: begun.elapsed().as_secs_f64(), ..StageTimes::default() }
            }
        }
    }

    /// Returns the facts for model metrics; `None` for a baseline, or a model without them.
    const fn facts(self) -> Option<ModelFacts<'a>> {
        match self {
            Self::Model(_, facts) => facts,
            Self::Baseline(_) => None,
        }
    }

    /// Returns whether metrics may time predictions: not those of a model without facts.
    const fn is_timed(self) -> bool {
        !matches!(self, Self::Model(_, None))
    }
}

/// Predictor, and the metrics to score it by.
#[derive(Clone, Copy)]
pub struct ScoredPredictor<'a> {
    /// Name in messages.
    pub name: &'a str,
    /// The model or baseline.
    pub predictor: Predictor<'a>,
    /// The metrics.
    pub metrics: &'a [Plugin<dyn Metric>],
}

/// Measurements of a predictor so far.
struct OpenMeasurements {
    /// Measurements by each metric.
    by_metric: Vec<Vec<Measurement>>,
    /// Energies of the samples for each metric of [`Scope::Energies`].
    energies: Vec<Vec<[f64; 2]>>,
    /// Predictions and observations if a metric needs all of them, otherwise empty.
    images: [Vec<Image>; 2],
}

/// Returns an error for predictions that are not finite, which would give invalid scores.
fn check_finite(name: &str, predictions: &[Image]) -> Result<()> {
    if predictions.iter().all(|image| image.pixels.iter().all(|p| p.is_finite())) {
        return Ok(());
    }
    let advice = "if it is a model, train it again with lower learning rates";
    Err(Error::Config(format!("{name} predicts numbers that are not finite; {advice}")))
}

/// Samples of the data set to score on.
#[derive(Debug)]
pub struct EvaluationSet<'a> {
    data: &'a Dataset,
    plane: &'a ImagePlane,
    /// Indices of the links, and the links.
    samples: Vec<usize>,
    links: Vec<Link>,
}

impl<'a> EvaluationSet<'a> {
    /// Creates the set of `samples` (indices of links) on the pixels of `plane`.
    pub fn new(data: &'a Dataset, samples: &[usize], plane: &'a ImagePlane) -> Self {
        Self { data, plane, samples: samples.to_vec(), links: samples.iter().map(|&i| data.links[i]).collect() }
    }

    /// Measures a predictor by all its metrics, in their order.
    ///
    /// # Errors
    /// A metric returns an error, a prediction is not finite, a spectrum cannot be read, or the GPU fails; [`Error::Stopped`]
    /// once the session is stopped.
    pub fn score(&self, scored: ScoredPredictor<'_>, session: &mut Session<'_>) -> Result<Vec<Measurement>> {
        let mut measurements = self.measure_chunks(scored, session)?;
        session.check_stopped()?;
        pwrfgs_core::device::check()?;
        if self.samples.is_empty() || scored.metrics.iter().any(|m| m.scope() != Scope::Sample) {
            self.measure_whole(scored, &mut measurements, session)?;
        }
        Ok(measurements.by_metric.into_iter().flatten().collect())
    }

    /// Predicts all samples chunk by chunk and measures them by the metrics of single samples. Also collects the energies and
    /// images that other metrics need.
    fn measure_chunks(&self, scored: ScoredPredictor<'_>, session: &mut Session<'_>) -> Result<OpenMeasurements> {
        let ScoredPredictor { name, predictor, metrics } = scored;
        let needs_all = metrics.iter().any(|m| m.scope() == Scope::All);
        let evaluation = Evaluation { model: predictor.facts(), ..Evaluation::of(self.data, self.plane) };
        let mut open = OpenMeasurements {
            by_metric: vec![Vec::new(); metrics.len()],
            energies: vec![Vec::new(); metrics.len()],
            images: Default::default(),
        };
        let pixels = self.plane.width * self.plane.height;
        let size = (PIXELS / pixels.max(1)).clamp(1, if pixels == 1 { MANY } else { CHUNK });
        let (done, stop) = (AtomicUsize::new(0), session.stop);
        run_stage(session.observer, &format!("predicting with {name}"), |progress| {
            let count = |more: usize| progress(done.fetch_add(more, Ordering::Relaxed) + more, self.samples.len());
            for (samples, links) in self.samples.chunks(size).zip(self.links.chunks(size)) {
                check_stopped(stop)?;
                let queries = self.data.queries(samples);
                let predictions = predictor.predict(&queries, &count);
                let truths: Vec<Image> = samples.par_iter().map(|&i| self.data.image(i)).collect();
                self.data.observations.check()?;
                check_finite(name, &predictions)?;
                let chunk = Evaluation { predictions: &predictions, truths: &truths, links, ..evaluation };
                for (k, metric) in metrics.iter().enumerate() {
                    match metric.scope() {
                        Scope::Sample => {
                            append_measurements(&mut open.by_metric[k], metric.evaluate(&chunk)?, samples.len())?;
                        }
                        Scope::Energies => {
                            let energies = metric.energies(&chunk)?;
                            check_energies(&title_of(metric), energies.len(), samples.len())?;
                            open.energies[k].extend(energies);
                        }
                        Scope::Model | Scope::All => {}
                    }
                }
                if needs_all {
                    open.images[0].extend(predictions);
                    open.images[1].extend(truths);
                }
            }
            Ok(open)
        })
    }

    /// Adds the measurements by the metrics of the whole model and of all samples; for an empty set, also by those of single
    /// samples, and without times.
    fn measure_whole(
        &self,
        ScoredPredictor { name, predictor, metrics }: ScoredPredictor<'_>,
        measurements: &mut OpenMeasurements,
        session: &mut Session<'_>,
    ) -> Result<()> {
        // Latency is that of links predicted one by one.
        let count = &Cell::new(0);
        let is_timed = predictor.is_timed() && !self.samples.is_empty();
        let timer = is_timed.then_some(move || self.time_next(predictor, count));
        let timed_prediction = timer.as_ref().map(|timer| timer as &dyn Fn() -> StageTimes);
        let OpenMeasurements { by_metric, energies, images: [predictions, truths] } = measurements;
        let empty = Evaluation::of(self.data, self.plane);
        let whole = Evaluation { model: predictor.facts(), timed_prediction, ..empty };
        let all = Evaluation { links: &self.links, ..whole };
        run_stage(session.observer, &format!("scoring {name}"), |progress| {
            for (k, (measured, metric)) in by_metric.iter_mut().zip(metrics).enumerate() {
                match metric.scope() {
                    Scope::Energies => {
                        *measured = metric.evaluate(&Evaluation { energies: &energies[k], ..all })?;
                    }
                    Scope::All => *measured = metric.evaluate(&Evaluation { predictions, truths, ..all })?,
                    Scope::Model => *measured = metric.evaluate(&whole)?,
                    Scope::Sample if self.samples.is_empty() => *measured = metric.evaluate(&empty)?,
                    Scope::Sample => {}
                }
                progress(k + 1, metrics.len());
            }
            Ok(())
        })
    }

    /// Times the prediction of the next sample in turn; `count` counts the calls.
    fn time_next(&self, predictor: Predictor<'_>, count: &Cell<usize>) -> StageTimes {
        let next = count.replace(count.get() + 1) % self.samples.len();
        predictor.time(self.data.query(self.samples[next]))
    }
}

/// Returns an error unless the number of pairs of energies `given` by the metric `name` is `count`, the number of samples.
fn check_energies(name: &str, given: usize, count: usize) -> Result<()> {
    if given == count {
        return Ok(());
    }
    let problem = format!("returns {given} pairs of energies for {count} samples");
    Err(Error::Config(format!("the metric `{name}` {problem}; it should return one pair for each")))
}

/// Appends to `measured` the measurements `more` of one metric on the next `count` samples.
///
/// # Errors
/// The metric does not give one number per sample, or gives other measurements than for earlier samples.
pub fn append_measurements(measured: &mut Vec<Measurement>, more: Vec<Measurement>, count: usize) -> Result<()> {
    let broken = |m: &Measurement| {
        Err(Error::Config(format!(
            "the metric `{}` has `Scope::Sample`, but does not give one number per sample; its `scope` should be \
             `Scope::All`",
            m.key
        )))
    };
    for m in &more {
        if matches!(&m.values, Values::PerSample(values) if values.len() != count)
            || matches!(m.values, Values::Whole(_))
        {
            return broken(m);
        }
    }
    if measured.is_empty() {
        *measured = more;
        return Ok(());
    }
    if measured.len() != more.len() {
        return more.first().or(measured.first()).map_or(Ok(()), broken);
    }
    for (earlier, more) in measured.iter_mut().zip(more) {
        match (&mut earlier.values, more.values) {
            (Values::PerSample(values), Values::PerSample(more)) => values.extend(more),
            (Values::NotApplicable(_), Values::NotApplicable(_)) => {}
            _ => return broken(earlier),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn metric_without_one_pair_of_energies_per_sample_is_refused() {
        assert!(super::check_energies("Snr", 3, 3).is_ok());
        let error = super::check_energies("Snr", 0, 3).unwrap_err().to_string();
        let expected = "the metric `Snr` returns 0 pairs of energies for 3 samples; it should return one pair for each";
        assert!(error.contains(expected), "{error}");
    }
}
