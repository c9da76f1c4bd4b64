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

/// Function that predicts some links and reports how many more are done.
type Predictor<'a> = dyn Fn(&[Query<'_>], &(dyn Fn(usize) + Sync)) -> Vec<Image> + 'a;

/// Receiver of predictions, observations and their links.
type Show<'a> = dyn FnMut(Vec<Image>, Vec<Image>, &[Link]) -> Result<()> + 'a;

/// Model or baseline to score.
#[derive(Clone, Copy)]
struct ScoredPredictor<'a> {
    predict: &'a Predictor<'a>,
    /// Facts for model metrics; `None` for a baseline.
    facts: Option<ModelFacts<'a>>,
    /// Function that predicts one link and returns the time per stage; `None` without timing.
    timed: Option<&'a dyn Fn(Query<'_>) -> StageTimes>,
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
    /// Creates a bench of the samples `part` on the pixels of `plane`.
    pub fn new(data: &'a Dataset, part: &[usize], plane: &'a ImagePlane) -> Self {
        Self { data, plane, part: part.to_vec(), links: part.iter().map(|&i| data.links[i]).collect() }
    }

    /// Measures `model`, called `name` in messages, by every metric. Without `facts`, model metrics and timing are
    /// omitted.
    ///
    /// # Errors
    /// A metric returns an error or a spectrum cannot be read; [`Error::Stopped`] once `stop` is set.
    pub fn model(
        &self,
        name: &str,
        model: &Prepared<'_>,
        facts: Option<ModelFacts<'_>>,
        metrics: &[Plugin<dyn Metric>],
        session: &mut Session<'_>,
    ) -> Result<Vec<Measurement>> {
        let timed = |query: Query<'_>| model.predict_timed(query).1;
        let scored = ScoredPredictor {
            predict: &|queries, done| {
                let images = model.predict_many(queries);
                done(queries.len());
                images
            },
            facts,
            timed: facts.is_some().then_some(&timed),
        };
        self.measure(name, scored, metrics, session)
    }

    /// Measures the baseline called `name` by every metric.
    ///
    /// # Errors
    /// Same as [`Self::model`].
    pub fn baseline(
        &self,
        name: &str,
        fitted: &dyn Predict,
        metrics: &[Plugin<dyn Metric>],
        session: &mut Session<'_>,
    ) -> Result<Vec<Measurement>> {
        let timed = |query: Query<'_>| {
            let begun = Instant::now();
            std::hint::black_box(fitted.predict(query));
            StageTimes { total: begun.elapsed().as_secs_f64(), ..StageTimes::default() }
        };
        let predict = |queries: &[Query<'_>], done: &(dyn Fn(usize) + Sync)| {
            let one = |query: &Query<'_>| {
                let image = fitted.predict(*query);
                done(1);
                image
            };
            queries.par_iter().map(one).collect()
        };
        self.measure(name, ScoredPredictor { predict: &predict, facts: None, timed: Some(&timed) }, metrics, session)
    }

    /// All measurements of the predictor `name`, in the order of `metrics`.
    fn measure(
        &self,
        name: &str,
        scored: ScoredPredictor<'_>,
        metrics: &[Plugin<dyn Metric>],
        session: &mut Session<'_>,
    ) -> Result<Vec<Measurement>> {
        let mut found: Vec<Vec<Measurement>> = vec![Vec::new(); metrics.len()];
        let together = metrics.iter().any(|m| m.scope() == Scope::All);
        let (mut predictions, mut truths) = (Vec::new(), Vec::new());
        let stop = session.stop;
        staged(session.observer, &format!("predicting with {name}"), |progress| {
            self.chunks(scored, stop, progress, &mut |some, of_them, links| {
                refuse_infinite(name, &some)?;
                let inputs = self.inputs(&some, &of_them, links, scored.facts, None);
                for (found, metric) in found.iter_mut().zip(metrics).filter(|(_, m)| m.scope() == Scope::Sample) {
                    append_measurements(found, metric.evaluate(&inputs)?, some.len())?;
                }
                if together {
                    predictions.extend(some);
                    truths.extend(of_them);
                }
                Ok(())
            })
        })?;
        session.check_stopped()?;
        if !self.part.is_empty() && metrics.iter().all(|m| m.scope() == Scope::Sample) {
            return Ok(found.into_iter().flatten().collect());
        }
        // Timed links are predicted one by one.
        let next = Cell::new(0);
        let timed = |one: &dyn Fn(Query<'_>) -> StageTimes| {
            next.set(next.get() + 1);
            one(self.data.query(self.part[(next.get() - 1) % self.part.len()]))
        };
        let timed = scored.timed.map(|one| move || timed(one));
        let timed = timed.as_ref().map(|timed| timed as &dyn Fn() -> StageTimes);
        staged(session.observer, &format!("scoring {name}"), |progress| {
            for (k, (found, metric)) in found.iter_mut().zip(metrics).enumerate() {
                match metric.scope() {
                    Scope::All => {
                        let all = self.inputs(&predictions, &truths, &self.links, scored.facts, timed);
                        *found = metric.evaluate(&all)?;
                    }
                    Scope::Model => *found = metric.evaluate(&self.inputs(&[], &[], &[], scored.facts, timed))?,
                    Scope::Sample if self.part.is_empty() => {
                        *found = metric.evaluate(&self.inputs(&[], &[], &[], None, None))?;
                    }
                    Scope::Sample => {}
                }
                progress(k + 1, metrics.len());
            }
            Ok(())
        })?;
        Ok(found.into_iter().flatten().collect())
    }

    /// Passes predictions and observations to `show`, chunk by chunk; `progress` counts samples.
    fn chunks(
        &self,
        scored: ScoredPredictor<'_>,
        stop: &AtomicBool,
        progress: Progress<'_>,
        show: &mut Show<'_>,
    ) -> Result<()> {
        let numbers = self.plane.width * self.plane.height;
        let size = (PIXELS / numbers.max(1)).clamp(1, if numbers == 1 { MANY } else { CHUNK });
        let done = AtomicUsize::new(0);
        let report_progress = |more: usize| progress(done.fetch_add(more, Ordering::Relaxed) + more, self.part.len());
        for (part, links) in self.part.chunks(size).zip(self.links.chunks(size)) {
            check_stopped(stop)?;
            let queries: Vec<Query<'_>> = part.iter().map(|&i| self.data.query(i)).collect();
            let predictions = (scored.predict)(&queries, &report_progress);
            let truths = part.par_iter().map(|&i| self.data.image(i)).collect();
            self.data.observations.check()?;
            show(predictions, truths, links)?;
        }
        Ok(())
    }

    fn inputs<'b>(
        &'b self,
        predictions: &'b [Image],
        truths: &'b [Image],
        links: &'b [Link],
        model: Option<ModelFacts<'b>>,
        timed_prediction: Option<&'b dyn Fn() -> StageTimes>,
    ) -> Evaluation<'b> {
        Evaluation { predictions, truths, links, model, timed_prediction, ..Evaluation::of(self.data, self.plane) }
    }
}

/// Appends the measurements of the next `count` samples.
///
/// # Errors
/// The metric does not give one number per sample.
pub fn append_measurements(all: &mut Vec<Measurement>, more: Vec<Measurement>, count: usize) -> Result<()> {
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
    if all.is_empty() {
        *all = more;
        return Ok(());
    }
    if all.len() != more.len() {
        return more.first().or(all.first()).map_or(Ok(()), broken);
    }
    for (all, more) in all.iter_mut().zip(more) {
        match (&mut all.values, more.values) {
            (Values::PerSample(all), Values::PerSample(more)) => all.extend(more),
            (Values::NotApplicable(_), Values::NotApplicable(_)) => {}
            _ => return broken(all),
        }
    }
    Ok(())
}
