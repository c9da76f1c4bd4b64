//! `EvaluationSet`: scores predictors on a set of samples, chunk by chunk.
//!
//! Only the predictions and spectra of one chunk are in memory (unless a metric needs all), so memory does not grow
//! with the number of samples.

use crate::session::{Session, staged};
use pwrfgs_core::{
    Dataset, Error, Evaluation, Image, ImagePlane, Link, Measurement, Metric, ModelFacts, Plugin, Predict, Progress,
    Query, Result, Scope, StageTimes, Values, check_stopped,
};
use pwrfgs_model::Prepared;
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

/// Largest number of links per prediction call, and of single numbers.
const CHUNK: usize = 64;
const MANY: usize = 4096;
/// Largest number of pixels per prediction call for larger images; 8 bytes each with the measured ones.
const PIXELS: usize = 1 << 21;

/// Function that predicts links and reports how many more are done.
type Predictor<'a> = dyn Fn(&[Query<'_>], &(dyn Fn(usize) + Sync)) -> Vec<Image> + 'a;

/// Function that takes the predictions, observations and links of one chunk.
type Visit<'a> = dyn FnMut(Vec<Image>, Vec<Image>, &[Link]) -> Result<()> + 'a;

/// Model or baseline, and the metrics to score it by.
#[derive(Clone, Copy)]
struct ScoredPredictor<'a> {
    /// Name in messages.
    name: &'a str,
    metrics: &'a [Plugin<dyn Metric>],
    predict: &'a Predictor<'a>,
    /// Facts for model metrics; `None` for a baseline.
    facts: Option<ModelFacts<'a>>,
    /// Function that predicts one link and returns the time per stage; `None` without timing.
    time: Option<&'a dyn Fn(Query<'_>) -> StageTimes>,
}

/// Returns an error for predictions that are not finite, which would give invalid scores.
fn refuse_infinite(name: &str, predictions: &[Image]) -> Result<()> {
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
    part: Vec<usize>,
    links: Vec<Link>,
}

impl<'a> EvaluationSet<'a> {
    /// Creates the set of the samples `part` on the pixels of `plane`.
    pub fn new(data: &'a Dataset, part: &[usize], plane: &'a ImagePlane) -> Self {
        Self { data, plane, part: part.to_vec(), links: part.iter().map(|&i| data.links[i]).collect() }
    }

    /// Measures `model`, called `name` in messages, by every metric. Without `facts`, model metrics and timing are
    /// omitted.
    ///
    /// # Errors
    /// A metric returns an error or a spectrum cannot be read; [`Error::Stopped`] once `stop` is set.
    pub fn score_model(
        &self,
        name: &str,
        model: &Prepared<'_>,
        facts: Option<ModelFacts<'_>>,
        metrics: &[Plugin<dyn Metric>],
        session: &mut Session<'_>,
    ) -> Result<Vec<Measurement>> {
        let time = |query: Query<'_>| model.predict_timed(query).1;
        let predictor = ScoredPredictor {
            name,
            metrics,
            predict: &|queries, done| {
                let images = model.predict_many(queries);
                done(queries.len());
                images
            },
            facts,
            time: facts.is_some().then_some(&time),
        };
        self.measure(predictor, session)
    }

    /// Measures the baseline called `name` by every metric.
    ///
    /// # Errors
    /// Same as [`Self::score_model`].
    pub fn score_baseline(
        &self,
        name: &str,
        fitted: &dyn Predict,
        metrics: &[Plugin<dyn Metric>],
        session: &mut Session<'_>,
    ) -> Result<Vec<Measurement>> {
        let time = |query: Query<'_>| {
            let begun = Instant::now();
            std::hint::black_box(fitted.predict(query));
            StageTimes { total: begun.elapsed().as_secs_f64(), ..StageTimes::default() }
        };
        let predict = |queries: &[Query<'_>], done: &(dyn Fn(usize) + Sync)| {
            let predict_one = |query: &Query<'_>| {
                let image = fitted.predict(*query);
                done(1);
                image
            };
            queries.par_iter().map(predict_one).collect()
        };
        let predictor = ScoredPredictor { name, metrics, predict: &predict, facts: None, time: Some(&time) };
        self.measure(predictor, session)
    }

    /// Measures a predictor by all its metrics, in their order.
    fn measure(&self, predictor: ScoredPredictor<'_>, session: &mut Session<'_>) -> Result<Vec<Measurement>> {
        let metrics = predictor.metrics;
        let mut measurements: Vec<Vec<Measurement>> = vec![Vec::new(); metrics.len()];
        let images = self.measure_chunks(predictor, &mut measurements, session)?;
        session.check_stopped()?;
        pwrfgs_core::device::check()?;
        if self.part.is_empty() || metrics.iter().any(|m| m.scope() != Scope::Sample) {
            self.measure_whole(predictor, &images, &mut measurements, session)?;
        }
        Ok(measurements.into_iter().flatten().collect())
    }

    /// Predicts all samples and adds the measurements by the metrics of single samples, one list per metric. Returns
    /// predictions and observations if a metric needs all of them, otherwise nothing.
    fn measure_chunks(
        &self,
        ScoredPredictor { name, metrics, predict, facts, .. }: ScoredPredictor<'_>,
        measurements: &mut [Vec<Measurement>],
        session: &mut Session<'_>,
    ) -> Result<[Vec<Image>; 2]> {
        let evaluation = Evaluation { model: facts, ..Evaluation::of(self.data, self.plane) };
        let needs_all = metrics.iter().any(|m| m.scope() == Scope::All);
        let ([mut predictions, mut truths], stop) = (<[Vec<Image>; 2]>::default(), session.stop);
        staged(session.observer, &format!("predicting with {name}"), |progress| {
            self.predict_chunks(predict, stop, progress, &mut |predicted, measured, links| {
                refuse_infinite(name, &predicted)?;
                let chunk = Evaluation { predictions: &predicted, truths: &measured, links, ..evaluation };
                let per_sample = |(_, metric): &(_, &Plugin<dyn Metric>)| metric.scope() == Scope::Sample;
                for (so_far, metric) in measurements.iter_mut().zip(metrics).filter(per_sample) {
                    append_measurements(so_far, metric.evaluate(&chunk)?, predicted.len())?;
                }
                if needs_all {
                    predictions.extend(predicted);
                    truths.extend(measured);
                }
                Ok(())
            })
        })?;
        Ok([predictions, truths])
    }

    /// Adds the measurements by the metrics of the whole model and of all samples; of an empty set, by all metrics.
    fn measure_whole(
        &self,
        ScoredPredictor { name, metrics, facts, time, .. }: ScoredPredictor<'_>,
        [predictions, truths]: &[Vec<Image>; 2],
        measurements: &mut [Vec<Measurement>],
        session: &mut Session<'_>,
    ) -> Result<()> {
        // Latency is that of links predicted one by one.
        let count = &Cell::new(0);
        let timer = time.map(|time| move || self.time_next(time, count));
        let timed_prediction = timer.as_ref().map(|timer| timer as &dyn Fn() -> StageTimes);
        let samples = Evaluation::of(self.data, self.plane);
        let whole = Evaluation { model: facts, timed_prediction, ..samples };
        let all = Evaluation { predictions, truths, links: &self.links, ..whole };
        staged(session.observer, &format!("scoring {name}"), |progress| {
            for (k, (measured, metric)) in measurements.iter_mut().zip(metrics).enumerate() {
                match metric.scope() {
                    Scope::All => *measured = metric.evaluate(&all)?,
                    Scope::Model => *measured = metric.evaluate(&whole)?,
                    Scope::Sample if self.part.is_empty() => *measured = metric.evaluate(&samples)?,
                    Scope::Sample => {}
                }
                progress(k + 1, metrics.len());
            }
            Ok(())
        })
    }

    /// Times the prediction of the next sample in turn; `count` counts the calls.
    fn time_next(&self, time: &dyn Fn(Query<'_>) -> StageTimes, count: &Cell<usize>) -> StageTimes {
        let next = count.replace(count.get() + 1) % self.part.len();
        time(self.data.query(self.part[next]))
    }

    /// Predicts the samples chunk by chunk and passes predictions and observations to `visit`; `progress` counts
    /// samples.
    fn predict_chunks(
        &self,
        predict: &Predictor<'_>,
        stop: &AtomicBool,
        progress: Progress<'_>,
        visit: &mut Visit<'_>,
    ) -> Result<()> {
        let numbers = self.plane.width * self.plane.height;
        let size = (PIXELS / numbers.max(1)).clamp(1, if numbers == 1 { MANY } else { CHUNK });
        let done = AtomicUsize::new(0);
        let report_progress = |more: usize| progress(done.fetch_add(more, Ordering::Relaxed) + more, self.part.len());
        for (part, links) in self.part.chunks(size).zip(self.links.chunks(size)) {
            check_stopped(stop)?;
            let queries: Vec<Query<'_>> = part.iter().map(|&i| self.data.query(i)).collect();
            let predictions = predict(&queries, &report_progress);
            let truths = part.par_iter().map(|&i| self.data.image(i)).collect();
            self.data.observations.check()?;
            visit(predictions, truths, links)?;
        }
        Ok(())
    }
}

/// Appends to `measured` the measurements `more` of one metric on the next `count` samples.
///
/// # Errors
/// The metric does not give one number per sample.
pub fn append_measurements(measured: &mut Vec<Measurement>, more: Vec<Measurement>, count: usize) -> Result<()> {
    let broken = |m: &Measurement| {
        Err(Error::Config(format!(
            "the metric `{}` says that it looks at one sample at a time, but does not give one number each; its \
             `scope` should be `Scope::All`",
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
