//! `Agreement`: distances of new measurements from the predictions of a model.

use crate::findings::cloud::{extent, longest_side};
use crate::session::{Observer, run_stage};
use crate::text::{format_length, grouped, number};
use pwrfgs_core::statistics::{quantile, sorted};
use pwrfgs_core::{Dataset, Image, Predict as _, Result, Task};
use pwrfgs_model::{Ensemble, Interval, IntervalFactors};
use rayon::prelude::*;

/// Number of links predicted together.
const CHUNK: usize = 64;
/// Level of the intervals; lower if the model has fewer than 99 calibration blocks.
const LEVEL: f64 = 0.99;

/// Distances of measurements from the predictions of a model, and its intervals around them.
#[derive(Clone, Debug)]
pub struct Agreement {
    task: Task,
    /// Scores of the predictions by the first metric, ascending.
    scores: Vec<f64>,
    /// Level of the intervals, and number of links outside; `None` if the model has no calibration.
    intervals: Option<(f64, usize)>,
    /// Numbers of transmitters that are extrapolations, and that are farther from the training positions than the
    /// length of their site, and the limits in metres; `None` if the model has no training positions.
    positions: Option<[(usize, f64); 2]>,
    transmitters: usize,
}

impl Agreement {
    /// Compares all links of `data` with their predictions; the model predicts such observations
    /// ([`check_alike`](crate::check_alike)).
    ///
    /// # Errors
    /// If a spectrum cannot be read.
    pub fn measure(model: &Ensemble, data: &Dataset, observer: &mut dyn Observer) -> Result<Self> {
        let (ready, task) = (model.prepare(), data.task());
        let calibration = model.calibration().map(|calibration| {
            let blocks = calibration.block_count() as f64;
            let level = LEVEL.min(blocks / (blocks + 1.0));
            calibration.factors(level).map(|factors| (level, factors))
        });
        let calibration = calibration.transpose()?;
        let score_link = |(i, prediction): (&usize, Image)| {
            let (prediction, truth) = (task.shown(prediction), data.image(*i));
            let score = task.score(&prediction, &truth);
            let deviation = ready.deviation(data.query(*i)).unwrap_or(1.0); // as in the calibration
            let is_out = |(_, factors): &(f64, IntervalFactors)| {
                is_outside(&factors.interval(task, &prediction, deviation), &truth, score)
            };
            (score, calibration.as_ref().is_some_and(is_out))
        };
        let links: Vec<usize> = (0..data.len()).collect();
        let compared = run_stage(observer, "comparing with the model", |progress| {
            let mut compared = Vec::with_capacity(links.len());
            for chunk in links.chunks(CHUNK) {
                let queries = data.queries(chunk);
                compared.par_extend(chunk.par_iter().zip(ready.predict_many(&queries)).map(score_link));
                progress(compared.len(), links.len());
            }
            compared
        });
        data.observations.check()?;
        let outside = compared.iter().filter(|(_, is_outside)| *is_outside).count();
        let scores = sorted(compared.into_iter().map(|(score, _)| score));
        Ok(Self {
            task,
            scores,
            intervals: calibration.map(|(level, _)| (level, outside)),
            positions: count_distant(model, data),
            transmitters: data.locations.len(),
        })
    }

    /// Returns whether most links that should lie inside the intervals of the model lie outside, or most transmitters are
    /// farther from the training positions than the site is long: so far away, intervals are too wide to decide. False for a
    /// model without calibration.
    pub fn is_far(&self) -> bool {
        // With few calibration blocks, the level is low and many links of right data lie outside.
        let count = self.scores.len() as f64;
        let is_missed = |(level, outside): (f64, usize)| count - (outside as f64) < level * count / 2.0;
        let is_elsewhere = self.positions.is_some_and(|[_, (count, _)]| 2 * count > self.transmitters);
        self.intervals.is_some_and(|interval| is_missed(interval) || is_elsewhere)
    }
}

/// Counts the transmitters that are farther from all training positions than a limit: that of extrapolations, then the length
/// of the site. Returns each count with its limit in metres; `None` if the model has no training positions, or they have no
/// extent.
fn count_distant(model: &Ensemble, data: &Dataset) -> Option<[(usize, f64); 2]> {
    let positions: Vec<[f64; 3]> = data.locations.iter().map(pwrfgs_core::Location::position).collect();
    let distances = model.training_distances(&positions)?;
    let site = extent(model.training_positions()).map(longest_side).filter(|site| *site > 0.0)?;
    Some(
        [distances.limit, site].map(|limit| (distances.metres.iter().filter(|metres| **metres > limit).count(), limit)),
    )
}

impl std::fmt::Display for Agreement {
    /// Writes `SSIM 0.931 (median; 0.902 to 0.957, 10 % to 90 %), 3 of 150 spectra outside the 99 % intervals of the
    /// model`, and the numbers of distant transmitters if there are any.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [low, middle, high] = [0.1, 0.5, 0.9].map(|q| number(quantile(&self.scores, q)));
        write!(f, "{} {middle} (median; {low} to {high}, 10 % to 90 %)", self.task.headline.name)?;
        if let Some((level, outside)) = self.intervals {
            let [outside, count] = [outside, self.scores.len()].map(|count| grouped(count as i64));
            let (things, percent) = (self.task.counted[1], (1000.0 * level).floor() / 10.0);
            write!(f, ", {outside} of {count} {things} outside the {percent} % intervals of the model")?;
        }
        let beyond = self.positions.into_iter().flatten().filter(|(count, _)| *count > 0);
        beyond.into_iter().try_for_each(|(count, limit)| {
            let [count, total] = [count, self.transmitters].map(|count| grouped(count as i64));
            write!(
                f,
                ", {count} of {total} transmitters more than {} from all training positions",
                format_length(limit)
            )
        })
    }
}

/// Returns whether a measurement lies outside its interval: by `score`, the SSIM of the prediction, if the interval bounds it,
/// otherwise by the only value of the observation.
fn is_outside(interval: &Interval, truth: &Image, score: f64) -> bool {
    match interval.ssim {
        Some(bound) => score < bound,
        None => !(interval.lower.pixels[0]..=interval.upper.pixels[0]).contains(&truth.pixels[0]),
    }
}
