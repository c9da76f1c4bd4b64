//! Share of a model in its predictions, chosen by the errors at links that it did not train on.

use super::Samples;
use crate::residuals::{ShareGain, place};
use pwrfgs_core::kriging::{Correlation, LocalKriging, ProcessFit, ResidualTrend};
use pwrfgs_core::{Result, check_stopped, evenly, statistics::mean};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Number of links that choose the share: of all receivers, and at least of each.
const CASES: usize = 600;
const LEAST_CASES: usize = 40;
/// Compared shares of the prediction of the model, 0 first.
const SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Compared factors on the noise of the observations for shares above 0, 1 first: residuals of a good model are mostly noise.
const NOISES: [f64; 5] = [1.0, 4.0, 16.0, 64.0, 256.0];
/// Smallest gain in parts of the error; smaller ones are rounding errors.
const LEAST_GAIN: f64 = 1e-6;

/// Share of the model, and factors on noise and variance of Kriging.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    pub(super) share: f64,
    noise: f64,
    variance: f64,
}

impl Choice {
    /// Kriging without the model.
    const KRIGING: Self = Self { share: 0.0, noise: 1.0, variance: 1.0 };

    /// Lists the choices that are compared: every noise for each share, those of Kriging first. [`noise_index`] has the same
    /// order.
    fn candidates() -> Vec<Self> {
        SHARES.map(|share| NOISES.map(|noise| Self { share, noise, variance: 1.0 })).concat()
    }

    /// Returns the fit of residuals, given that of Kriging: with this share, and noise and variance times these factors.
    pub(super) fn apply(self, fit: &ProcessFit) -> ProcessFit {
        let correlation = Correlation { noise: self.noise * fit.correlation.noise, ..fit.correlation };
        let trend = ResidualTrend { share: self.share, ..fit.trend };
        ProcessFit { trend, variance: self.variance * fit.variance, correlation }
    }
}

/// Returns the index in [`NOISES`] of the noise of a candidate; also the index of the candidate of Kriging with that noise.
fn noise_index(candidate: usize) -> usize {
    candidate % NOISES.len()
}

/// Mean absolute error of a held-out link, and its mean squared error in units of the predicted variance.
#[derive(Clone, Copy, Debug)]
struct CaseError {
    absolute: f64,
    relative_square: f64,
}

impl Samples<'_> {
    /// Chooses the share of the model with the smallest error at left-out links, if its gain over Kriging exceeds one standard
    /// error over blocks; otherwise Kriging. Also returns the gain of the best share above 0; `None` without left-out links.
    ///
    /// Kind and length scales of the correlation stay those of the observations: of residuals of left-out links, there are too
    /// few. Returns an error once the fit is stopped.
    pub(super) fn choose_share(
        &self,
        kriging: &[Option<ProcessFit>],
        neighbours: usize,
    ) -> Result<(Choice, Option<ShareGain>)> {
        let (candidates, errors) = (Choice::candidates(), self.block_errors(kriging, neighbours)?);
        let gain_over = |reference: usize, c: usize| {
            let gain_of_case = |case: &Vec<CaseError>| case[reference].absolute - case[c].absolute;
            ShareGain::of(&errors.values().map(|cases| mean(cases.iter().map(gain_of_case))).collect::<Vec<_>>())
        };
        // More noise can help without the model too, so the gain is over the better of Kriging and of Kriging with that noise.
        let gain = |c: usize| {
            let (kriging, same_noise) = (gain_over(0, c), gain_over(noise_index(c), c));
            if same_noise.mean < kriging.mean { same_noise } else { kriging }
        };
        let gains = (NOISES.len()..candidates.len()).map(|c| (c, gain(c))).filter(|(_, gain)| gain.mean.is_finite());
        let best = gains.reduce(|best, next| if next.1.mean > best.1.mean { next } else { best });
        let least = LEAST_GAIN * mean(errors.values().flatten().map(|case| case[0].absolute));
        Ok(match best {
            Some((c, gain)) if gain.blocks > 1 && gain.mean > gain.standard_error.max(least) => {
                let variance = mean(errors.values().flatten().map(|case| case[c].relative_square));
                (Choice { variance, ..candidates[c] }, Some(gain))
            }
            best => (Choice::KRIGING, best.map(|(_, gain)| gain)),
        })
    }

    /// Returns the errors at left-out links, by block: a list per link, with the error of each candidate. Returns an error once
    /// the fit is stopped.
    fn block_errors(
        &self,
        kriging: &[Option<ProcessFit>],
        neighbours: usize,
    ) -> Result<BTreeMap<usize, Vec<Vec<CaseError>>>> {
        let parts: BTreeSet<usize> = self.known.left_out.iter().copied().flatten().collect();
        let mut errors: BTreeMap<usize, Vec<Vec<CaseError>>> = BTreeMap::new();
        for part in parts {
            // The path-loss models that decide about a left-out link are not fitted to it.
            let refitted =
                if self.known.data.task().has_path_loss { self.fit_kriging(Some(part))? } else { kriging.to_vec() };
            for (links, fit) in self.known.by_receiver().iter().zip(&refitted) {
                let Some(fit) = fit.as_ref().filter(|fit| fit.variance > 0.0) else { continue };
                let (held_out, trained) = links.iter().partition(|&&k| self.known.left_out[k] == Some(part));
                let cases = HeldOutPart { samples: self, part, held_out, trained, fit, neighbours }.errors();
                cases.into_iter().for_each(|(k, error)| errors.entry(self.known.blocks[k]).or_default().push(error));
            }
            check_stopped(self.known.stop)?;
        }
        Ok(errors)
    }
}

/// Links of a receiver in a part that members left out, and the links that predict them.
struct HeldOutPart<'a> {
    samples: &'a Samples<'a>,
    part: usize,
    held_out: Vec<usize>,
    trained: Vec<usize>,
    /// Fit of Kriging without the part.
    fit: &'a ProcessFit,
    /// Number of links per prediction.
    neighbours: usize,
}

impl HeldOutPart<'_> {
    /// Returns some held-out links, evenly chosen, each with the errors of all candidates fitted to the links
    /// `trained`; empty without such links.
    fn errors(&self) -> Vec<(usize, Vec<CaseError>)> {
        let Self { samples, held_out, trained, .. } = self;
        if trained.is_empty() {
            return Vec::new();
        }
        let processes = NOISES.map(|noise| {
            let places = trained.iter().map(|&k| place(samples.places[k]));
            Choice { noise, ..Choice::KRIGING }.apply(self.fit).process(places)
        });
        let left_out = |k: &&usize| samples.known.left_out[**k].is_some();
        let left_out_count = held_out.len() + trained.iter().filter(left_out).count();
        let part_share = held_out.len() as f64 / left_out_count as f64;
        let count = (CASES / samples.known.data.scene.receivers.len()).max(LEAST_CASES) as f64 * part_share;
        let case = |k: usize| (k, self.case_errors(k, &processes));
        evenly(held_out, count.ceil() as usize).into_par_iter().map(case).collect()
    }

    /// Returns the errors of all candidates at known link `k`, given a process per noise of [`NOISES`].
    fn case_errors(&self, k: usize, processes: &[LocalKriging; NOISES.len()]) -> Vec<CaseError> {
        let by_noise = processes.each_ref().map(|process| self.kriging_errors(k, process));
        let error = |(c, choice): (usize, &Choice)| {
            let (pairs, variance) = &by_noise[noise_index(c)];
            let errors = || pairs.iter().map(|[y, f]| y - choice.share * f);
            let scale = variance * self.fit.variance;
            CaseError { absolute: mean(errors().map(f64::abs)), relative_square: mean(errors().map(|e| e * e / scale)) }
        };
        Choice::candidates().iter().enumerate().map(error).collect()
    }

    /// Returns the errors at known link `k` of Kriging the observations and of Kriging the predictions, both less their path
    /// loss, from the links `trained`, and the variance relative to that of the process. With a share b, the error is the first
    /// minus b times the second.
    fn kriging_errors(&self, k: usize, process: &LocalKriging) -> (Vec<[f64; 2]>, f64) {
        let Self { samples, trained, fit, .. } = self;
        let predicted = &samples.predicted[self.part];
        let (near, solution) = process.solve(place(samples.places[k]), self.neighbours);
        let mut errors = vec![[0.0; 2]; samples.link_values];
        let terms = near.into_iter().map(|j| trained[j]).zip(solution.weights.iter().map(|weight| -weight));
        for (link, weight) in std::iter::once((k, 1.0)).chain(terms) {
            let path_loss = fit.trend.expected(0.0, place(samples.places[link]));
            let values = link * samples.link_values..(link + 1) * samples.link_values;
            for ((error, y), f) in errors.iter_mut().zip(&samples.observed[values.clone()]).zip(&predicted[values]) {
                error[0] += weight * (*y as f64 - path_loss);
                error[1] += weight * (*f as f64 - path_loss);
            }
        }
        (errors, solution.variance)
    }
}
