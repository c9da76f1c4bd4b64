//! Pooled fit of received powers at receivers j: `RSSI = T + t_j - (G + g_j) log10(d) + s_j(x) + noise`.
//!
//! The processes `s_j` are independent and share correlation, variance and noise. Levels `t_j` ~ N(0, 15 dB) and slopes
//! `g_j` ~ N(0, 8 dB per decade) are marginalised in closed form (`marginal.rs`), as are T and G with wide priors, so the
//! likelihood is block diagonal by receiver plus a low rank. Each block follows the approximation of Vecchia (Journal of
//! the Royal Statistical Society B 50, 1988): the density of every power given the nearest of those before it in random
//! order.

mod marginal;

use super::likelihood::{IMPROVEMENT, NOISE};
use super::{Correlation, CorrelationKind, Mean, PathLoss, Place, Solution, StopCheck, position_of, solve};
use crate::blocks::{SiteSize, block_mean, block_of};
use crate::neighbours::{Nearest, nearest_before};
use crate::{Result, evenly, rng, statistics};
use marginal::{Moments, best_variance, trends};
use rayon::prelude::*;

/// Largest number of powers of a receiver in the likelihood: half of them the first in random order, whose density is a
/// joint one, the others from the rest, whose neighbours are near. Each is given some powers before it.
const CASES: usize = 320;
const GIVEN: usize = 16;
/// Largest number of powers of all receivers in the search, and smallest of each; above it, fewer receivers take part.
const SEARCHED: usize = 1_600;
const LEAST: usize = 40;
/// Prior of the length: median in units of the spacing of places, and standard deviation of its logarithm.
const LENGTH: f64 = 4.0;
const LENGTH_SPREAD: f64 = 1.5;
/// Shortest length in units of the spacing, and longest in units of the longest side of the site.
const LENGTHS: [f64; 2] = [0.5, 2.0];
/// Start of the noise, in units of the process variance.
const NOISE_START: f64 = 0.3;
/// Step sizes of the search over length and noise, in powers of two.
const STEPS: [f64; 4] = [2.0, 1.0, 0.5, 0.25];
/// Largest number of powers that compare correlation functions, and of neighbours that predict each.
const COMPARED: usize = 1_200;
const NEIGHBOURS: usize = 48;

/// Number of coordinates of a [`Place`].
const WIDTH: usize = 4;

/// Power of one link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerLink {
    /// Index of the receiver.
    pub receiver: usize,
    /// Place of the moving end, metres.
    pub place: Place,
    /// log10 of the distance of both ends in metres; `None` if it is unknown.
    pub log_distance: Option<f64>,
    /// Power, dB.
    pub value: f64,
}

/// Pooled fit of all receivers.
#[derive(Clone, Debug, PartialEq)]
pub struct PooledFit {
    /// Posterior mean of the path-loss model of each receiver. Without links it is the shared model; without distances
    /// its slope is 0.
    pub path_losses: Vec<PathLoss>,
    /// Correlation and noise of the processes about these models.
    pub correlation: Correlation,
    /// Variance of the processes, dB².
    pub variance: f64,
}

/// Fits the pooled model of `receivers` receivers to at most 320 powers each. The correlation is exponential or
/// has a long tail, whichever is more probable; Matern 3/2 if it lowers the mean absolute error of held-out blocks by more
/// than one standard error over blocks. `check` is called several times per second.
///
/// # Errors
/// An error of `check`.
///
/// # Panics
/// If a link has a receiver of `receivers` or more.
pub fn fit_pooled(links: &[PowerLink], receivers: usize, check: StopCheck<'_>) -> Result<PooledFit> {
    let powers = Powers::new(links, receivers);
    let short = powers.most_probable(CorrelationKind::Exponential, powers.start(), check)?;
    let long = powers.most_probable(CorrelationKind::LongTail, short.at, check)?;
    let smooth = powers.most_probable(CorrelationKind::Matern32, short.at, check)?.fit;
    let rough = if long.log_probability > short.log_probability { long.fit } else { short.fit };
    let errors = powers.block_errors(&rough).into_iter().zip(powers.block_errors(&smooth));
    let (gain, error) = block_mean(errors.map(|((block, rough), (_, smooth))| (block, rough - smooth)));
    Ok(if gain > error { smooth } else { rough })
}

/// Most probable fit with one kind of correlation.
struct KindFit {
    fit: PooledFit,
    /// Logarithms of its length and noise.
    at: [f64; 2],
    /// Logarithm of its probability, up to a constant.
    log_probability: f64,
}

/// Link in the likelihood, and the links that it is given.
type Case = (usize, Vec<usize>);

/// Powers, and how the likelihood uses them.
struct Powers<'a> {
    links: &'a [PowerLink],
    /// Links of each receiver.
    by_receiver: Vec<Vec<usize>>,
    /// Cases of each receiver.
    cases: Vec<Vec<Case>>,
    /// Power about its mean, 1, and log-distance about its mean (0 if unknown) of each link.
    rows: Vec<[f64; 3]>,
    /// Mean power and mean log-distance.
    mean: [f64; 2],
    site: SiteSize,
}

impl<'a> Powers<'a> {
    /// Selects the cases of the likelihood, and subtracts the means from powers and log-distances.
    fn new(links: &'a [PowerLink], receivers: usize) -> Self {
        let mean_power = finite_mean(links.iter().map(|link| link.value));
        let mean_log = finite_mean(links.iter().filter_map(|link| link.log_distance));
        let row = |link: &PowerLink| {
            [link.value - mean_power, 1.0, link.log_distance.map_or(0.0, |distance| distance - mean_log)]
        };
        let rows = links.iter().map(row).collect();
        let mut by_receiver = vec![Vec::new(); receivers];
        links.iter().enumerate().for_each(|(i, link)| by_receiver[link.receiver].push(i));
        let cases = by_receiver.par_iter().map(|receiver_links| select_cases(links, receiver_links)).collect();
        let site = SiteSize::new(links.iter().map(|link| position_of(link.place)));
        Self { links, by_receiver, cases, rows, mean: [mean_power, mean_log], site }
    }

    /// Returns the first point of the search: logarithms of length and noise.
    fn start(&self) -> [f64; 2] {
        [(LENGTH * self.site.spacing).ln(), NOISE_START.ln()]
    }

    /// Returns the most probable fit with one kind of correlation: a pattern search from `start`, the logarithms of length and
    /// noise, with the best variance at each point. Returns an error of `check`.
    fn most_probable(&self, kind: CorrelationKind, start: [f64; 2], check: StopCheck<'_>) -> Result<KindFit> {
        let correlation = |[length, noise]: [f64; 2]| {
            let length = length.exp();
            Correlation { kind, scales: [length, length, length, f64::INFINITY], noise: noise.exp() }
        };
        let observed: Vec<&Vec<Case>> = self.cases.iter().filter(|cases| !cases.is_empty()).collect();
        let count = (SEARCHED / observed.len().max(1)).max(LEAST);
        let searched: Vec<Vec<Case>> =
            evenly(&observed, SEARCHED / LEAST).into_iter().map(|cases| evenly(cases, count)).collect();
        let scale = statistics::mean(self.rows.iter().map(|row| row[0] * row[0]));
        let evaluate = |at: [f64; 2]| -> Result<(f64, f64)> {
            check()?;
            let (variance, log_likelihood) = best_variance(&self.moments(&searched, &correlation(at)), scale);
            let ([length, _], [prior_length, _]) = (at, self.start());
            let log_prior = -0.5 * ((length - prior_length) / LENGTH_SPREAD).powi(2);
            Ok((log_likelihood + log_prior, variance))
        };
        let longest = (LENGTHS[1] * self.site.longest).max(LENGTH * self.site.spacing);
        let ranges = [[LENGTHS[0] * self.site.spacing, longest], NOISE].map(|range| range.map(f64::ln));
        let (at, (log_probability, variance)) = search_pattern(start, ranges, evaluate)?;
        let correlation = correlation(at);
        let trends = trends(&self.moments(&self.cases, &correlation), variance);
        let by_receiver = trends.into_iter().zip(&self.by_receiver);
        let path_losses = by_receiver.map(|(trend, links)| self.path_loss(trend, links)).collect();
        Ok(KindFit { fit: PooledFit { path_losses, correlation, variance }, at, log_probability })
    }

    /// Computes the moments of the whitened powers of each receiver.
    fn moments(&self, cases: &[Vec<Case>], correlation: &Correlation) -> Vec<Moments> {
        let whiten = |(i, given): &Case| {
            let scaled = |i: usize| correlation.scaled(self.links[i].place);
            let places: Vec<Place> = given.iter().map(|&k| scaled(k)).collect();
            let Solution { weights, variance } = if given.is_empty() {
                Solution { weights: Vec::new(), variance: 1.0 + correlation.noise }
            } else {
                solve(correlation, Mean::Zero, &places, scaled(*i))
            };
            let mut row = self.rows[*i];
            for (k, weight) in given.iter().zip(weights) {
                row.iter_mut().zip(self.rows[*k]).for_each(|(v, other)| *v -= weight * other);
            }
            (row.map(|v| v / variance.sqrt()), variance)
        };
        let sum = |cases: &Vec<Case>| {
            let rows: Vec<_> = cases.par_iter().map(whiten).collect();
            let mut moments = Moments::default();
            rows.into_iter().for_each(|(row, variance)| moments.add(row, variance));
            moments
        };
        cases.iter().map(sum).collect()
    }

    /// Returns the path-loss model of a receiver with these `links`, from its level and rise about the means.
    fn path_loss(&self, [level, rise]: [f64; 2], links: &[usize]) -> PathLoss {
        let has_distances = links.is_empty() || links.iter().any(|&i| self.links[i].log_distance.is_some());
        let slope = if has_distances { 0.0 - rise } else { 0.0 }; // never -0
        let [mean_power, mean_log] = self.mean;
        PathLoss { level: mean_power + level + slope * mean_log, slope }
    }

    /// Returns (block, absolute error) of predictions from links of other blocks.
    fn block_errors(&self, fit: &PooledFit) -> Vec<([i64; 3], f64)> {
        let observed = self.by_receiver.iter().filter(|links| !links.is_empty()).count();
        let count = (COMPARED / observed.max(1)).max(1);
        self.by_receiver.iter().flat_map(|links| self.receiver_errors(fit, links, count)).collect()
    }

    /// Returns the errors of [`Self::block_errors`] at `count` of the `links` of one receiver.
    fn receiver_errors(&self, fit: &PooledFit, links: &[usize], count: usize) -> Vec<([i64; 3], f64)> {
        let edge = self.site.block_edge();
        let block = |i: usize| block_of(position_of(self.links[i].place), edge);
        // Without distances, slopes are 0.
        let residual = |i: usize| {
            let link = &self.links[i];
            link.value - fit.path_losses[link.receiver].power(link.log_distance.unwrap_or(0.0))
        };
        let scaled = |i: usize| fit.correlation.scaled(self.links[i].place);
        let nearest = Nearest::new(links, WIDTH, scaled);
        let blocks: Vec<[i64; 3]> = links.iter().map(|&i| block(i)).collect();
        let error = |&i: &usize| {
            let held_out = block(i);
            let near = nearest.find_where(&scaled(i), NEIGHBOURS, |k| blocks[k] != held_out).1;
            let places: Vec<Place> = near.iter().map(|(_, k)| scaled(*k)).collect();
            let weights =
                (!near.is_empty()).then(|| solve(&fit.correlation, Mean::Zero, &places, scaled(i)).weights)?;
            let predicted: f64 = near.iter().zip(weights).map(|((_, k), weight)| weight * residual(*k)).sum();
            Some((held_out, (residual(i) - predicted).abs()))
        };
        evenly(links, count).par_iter().filter_map(error).collect()
    }
}

/// Maximises the first number of `evaluate` from the point `at`, logarithms of length and noise, within `ranges`. Steps
/// change one of them, or both in opposite directions, since longer lengths go with less noise. Returns the best point and
/// the result of `evaluate` there, or its error.
fn search_pattern(
    mut at: [f64; 2],
    ranges: [[f64; 2]; 2],
    evaluate: impl Fn([f64; 2]) -> Result<(f64, f64)>,
) -> Result<([f64; 2], (f64, f64))> {
    let mut best = evaluate(at)?;
    for step in STEPS.map(|step| step * std::f64::consts::LN_2) {
        let mut is_better = true;
        while is_better {
            is_better = false;
            for [x, y] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, -1.0], [-1.0, 1.0]] {
                let next = [at[0] + step * x, at[1] + step * y];
                if next.iter().zip(ranges).any(|(v, [low, high])| *v < low || *v > high) {
                    continue;
                }
                let value = evaluate(next)?;
                if value.0 > best.0 + IMPROVEMENT * best.0.abs() {
                    (best, at, is_better) = (value, next, true);
                }
            }
        }
    }
    Ok((at, best))
}

/// Returns those of the `receiver_links` that enter the likelihood, at most [`CASES`], each with the nearest of those before it in
/// random order.
fn select_cases(links: &[PowerLink], receiver_links: &[usize]) -> Vec<Case> {
    let mut order = receiver_links.to_vec();
    rng::shuffle(&mut rng::stream(0, "kriging", 0), &mut order);
    let first = (CASES / 2).min(order.len());
    let later: Vec<usize> = (first..order.len()).collect();
    let ranks: Vec<usize> = (0..first).chain(evenly(&later, CASES - first)).collect();
    let given = nearest_before(&order, &ranks, GIVEN, WIDTH, |i| links[i].place);
    ranks.iter().map(|rank| order[*rank]).zip(given).collect()
}

/// Returns the mean of values; 0 without any, or if it is not finite.
fn finite_mean(values: impl Iterator<Item = f64>) -> f64 {
    Some(statistics::mean(values)).filter(|mean| mean.is_finite()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
