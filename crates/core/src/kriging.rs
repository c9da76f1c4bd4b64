//! Kriging, the prediction of a Gaussian process over positions, by Cholesky factorisation (Rasmussen and Williams,
//! Gaussian Processes for Machine Learning, 2006, sections 2.2 and 2.7 with an unknown mean; Cressie, Statistics for
//! Spatial Data, 1993). This file holds correlation and prediction, and the path-loss model as trend of received powers.
//! `process.rs` fits both to a data set, by `pooled.rs` for powers and `spectra.rs` for other observations. `likelihood.rs`
//! fits a correlation to given samples.

mod likelihood;
mod pooled;
mod process;
mod spectra;

use crate::neighbours::{Nearest, distance};
use crate::{Cholesky, Result};
pub use likelihood::{HeldOutCases, SearchSpace, fit_correlation};
pub use pooled::{PooledFit, PowerLink, fit_pooled};
pub use process::{ProcessFit, ResidualTrend, fit_observations, fit_powers, link_place};
use serde::{Deserialize, Serialize};
pub use spectra::{JointLikelihood, fit_spectra};
use std::f64::consts::LN_10;

/// Position of a sample: x, y and z in metres, and its time in samples, 0 for processes over space alone.
pub type Place = [f64; 4];

/// Check that a long fit calls several times per second. An error, such as [`Error::Stopped`](crate::Error::Stopped), ends the
/// fit.
pub type StopCheck<'a> = &'a (dyn Fn() -> Result<()> + Sync);

/// Returns the place of a position, metres, at time 0: for processes over space alone.
pub fn spatial_place([x, y, z]: [f64; 3]) -> Place {
    [x, y, z, 0.0]
}

/// Returns the position of a place, metres, without its time.
fn position_of([x, y, z, _]: Place) -> [f64; 3] {
    [x, y, z]
}

/// Mean of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mean {
    /// Zero: the weights vanish far from all samples (simple kriging).
    Zero,
    /// Unknown: the weights add up to 1 (ordinary kriging).
    Unknown,
}

/// Prediction at one position from other samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Weights of the samples.
    pub weights: Vec<f64>,
    /// Variance of a measurement at the position about the prediction, noise included, in units of the process
    /// variance.
    pub variance: f64,
}

/// Predicts a measurement at `at` from at least one sample at `places`, both in units of the scales of `correlation`.
pub fn solve(correlation: &Correlation, mean: Mean, places: &[Place], at: Place) -> Solution {
    let factor = factor_covariance(correlation, places);
    let cross: Vec<f64> = places.iter().map(|position| correlation.kind.at(distance(*position, at))).collect();
    let mut weights = cross.clone();
    factor.solve(&mut weights);
    let explained: f64 = cross.iter().zip(&weights).map(|(c, w)| c * w).sum();
    let mut variance = 1.0 + correlation.noise - explained;
    if mean == Mean::Unknown {
        let mut ones = vec![1.0; places.len()];
        factor.solve(&mut ones);
        let (deficit, total) = (1.0 - weights.iter().sum::<f64>(), ones.iter().sum::<f64>());
        weights.iter_mut().zip(&ones).for_each(|(w, one)| *w += one * deficit / total);
        variance += deficit * deficit / total;
    }
    Solution { weights, variance: variance.max(correlation.noise) }
}

/// Factors the covariance `[n, n]` of measurements at `places`, which are in units of the length scales.
fn factor_covariance(correlation: &Correlation, places: &[Place]) -> Cholesky {
    let n = places.len();
    let mut covariance = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..i {
            covariance[i * n + j] = correlation.kind.at(distance(places[i], places[j]));
        }
        covariance[i * n + i] = 1.0 + correlation.noise;
    }
    // Rounding may cancel a pivot if positions coincide and noise is near zero.
    Cholesky::floored(covariance, n, 1e-12)
}

/// Predictor of a process from the nearest of its samples.
#[derive(Clone, Debug)]
pub struct LocalKriging {
    /// Correlation of the process.
    pub correlation: Correlation,
    mean: Mean,
    /// Places in units of the length scales.
    places: Vec<Place>,
    nearest: Nearest,
}

impl LocalKriging {
    /// Creates the predictor from samples at `places` (metres).
    pub fn new(correlation: Correlation, mean: Mean, places: impl Iterator<Item = Place>) -> Self {
        let places: Vec<Place> = places.map(|position| correlation.scaled(position)).collect();
        let nearest = Nearest::of(&places);
        Self { correlation, mean, places, nearest }
    }

    /// Predicts a measurement at `at` (metres) from the nearest samples, at most `count`: their indices, and the prediction.
    pub fn solve(&self, at: Place, count: usize) -> (Vec<usize>, Solution) {
        let at = self.correlation.scaled(at);
        let (samples, places) = self.find_nearest(at, count);
        let solution = solve(&self.correlation, self.mean, &places, at);
        (samples, solution)
    }

    /// Returns the weighted sum `[values]` of the samples of [`Self::solve`]: `add(sample, weight, sum)` adds the values of one
    /// sample, times its weight, to the sum.
    pub fn weighted_sum(
        &self,
        at: Place,
        count: usize,
        values: usize,
        mut add: impl FnMut(usize, f64, &mut [f64]),
    ) -> Vec<f64> {
        let (samples, Solution { weights, .. }) = self.solve(at, count);
        let mut sum = vec![0.0; values];
        samples.into_iter().zip(weights).for_each(|(k, weight)| add(k, weight, &mut sum));
        sum
    }

    /// Returns the samples nearest to `at`, at most `count`, and their places. All places are in units of the scales.
    fn find_nearest(&self, at: Place, count: usize) -> (Vec<usize>, Vec<Place>) {
        let samples: Vec<usize> = self.nearest.find(&at, count).1.into_iter().map(|(_, i)| i).collect();
        let places = samples.iter().map(|&i| self.places[i]).collect();
        (samples, places)
    }

    /// Returns the derivative of Σ d(i)·weight(i) of [`Self::solve`] by the position, 1/metre, with the nearest samples
    /// held fixed.
    pub fn solve_vjp(&self, at: Place, count: usize, d: impl Fn(usize) -> f64) -> [f64; 3] {
        let at = self.correlation.scaled(at);
        let (samples, places) = self.find_nearest(at, count);
        let factor = factor_covariance(&self.correlation, &places);
        // Weights are K⁻¹·c with the cross correlations c, plus the part of K⁻¹·1 that they lack to a sum of 1.
        let mut d_cross: Vec<f64> = samples.iter().map(|&i| d(i)).collect();
        factor.solve(&mut d_cross);
        if self.mean == Mean::Unknown {
            let mut ones = vec![1.0; places.len()];
            factor.solve(&mut ones);
            let share = d_cross.iter().sum::<f64>() / ones.iter().sum::<f64>();
            d_cross.iter_mut().zip(&ones).for_each(|(d, one)| *d -= share * one);
        }
        let mut d_at = [0.0; 3];
        for (position, d) in places.iter().zip(&d_cross) {
            let slope = d * self.correlation.kind.slope_over_distance(distance(*position, at));
            (0..3).for_each(|k| d_at[k] += slope * (at[k] - position[k]) / self.correlation.scales[k]);
        }
        d_at
    }
}

/// Correlation function over distance in units of the length scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CorrelationKind {
    /// exp(-d), Matern 1/2: continuous and rough.
    Exponential,
    /// (1 + sqrt(3) d) exp(-sqrt(3) d): differentiable once.
    Matern32,
    /// exp(-d^2 / 2): smooth.
    SquaredExponential,
    /// 1 / (1 + d): exponentials of all lengths, rough and with a long tail (generalised Cauchy; Gneiting and Schlather, SIAM
    /// Review 46, 2004).
    LongTail,
}

impl CorrelationKind {
    /// All functions.
    pub const ALL: [Self; 4] = [Self::Exponential, Self::Matern32, Self::SquaredExponential, Self::LongTail];

    /// Returns its name for use in a sentence.
    pub fn words(self) -> &'static str {
        match self {
            Self::Exponential => "exponential",
            Self::Matern32 => "Matern 3/2",
            Self::SquaredExponential => "squared exponential",
            Self::LongTail => "long-tailed",
        }
    }

    /// Returns the correlation at distance `d`, in length scales.
    pub fn at(self, d: f64) -> f64 {
        match self {
            Self::Exponential => (-d).exp(),
            Self::Matern32 => {
                let d = 3f64.sqrt() * d;
                (1.0 + d) * (-d).exp()
            }
            Self::SquaredExponential => (-0.5 * d * d).exp(),
            Self::LongTail => 1.0 / (1.0 + d),
        }
    }

    /// Returns ρ′(d)/d of the correlation ρ of [`Self::at`]; 0 at d = 0 where it has no derivative.
    fn slope_over_distance(self, d: f64) -> f64 {
        match self {
            Self::Exponential | Self::LongTail if d == 0.0 => 0.0,
            Self::Exponential => -(-d).exp() / d,
            Self::Matern32 => -3.0 * (-3f64.sqrt() * d).exp(),
            Self::SquaredExponential => -(-0.5 * d * d).exp(),
            Self::LongTail => -1.0 / ((1.0 + d) * (1.0 + d) * d),
        }
    }
}

/// Gaussian process of variance 1 with measurement noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correlation {
    /// Correlation function.
    pub kind: CorrelationKind,
    /// Length scales of x, y and z in metres, and time scale in samples: infinite if time has no effect.
    pub scales: [f64; 4],
    /// Noise variance, relative to the process variance.
    pub noise: f64,
}

impl Correlation {
    /// Converts a place to units of the scales.
    pub fn scaled(&self, position: Place) -> Place {
        [0, 1, 2, 3].map(|k| position[k] / self.scales[k])
    }
}

/// Minimum distance, metres: the model is singular at the receiver.
const NEAREST_M: f64 = 0.01;

/// Path-loss model RSSI = level - slope log10(d / m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathLoss {
    /// T, dBm at 1 m.
    pub level: f64,
    /// 10 gamma, dB per decade.
    pub slope: f64,
}

impl PathLoss {
    /// Fits (log10 of the distance, dBm) by least squares; a constant if all distances are equal, 0 dBm without points.
    pub fn fit(points: &[(f64, f64)]) -> Self {
        Self::fit_groups(&[points]).0
    }

    /// Fits one slope for several groups of (log10 of the distance, dBm), with one level per group. Returns the model of the
    /// first group, and the level of each. A group without points gets the mean level of all points.
    pub fn fit_groups(groups: &[&[(f64, f64)]]) -> (Self, Vec<f64>) {
        let mean = |points: &[(f64, f64)]| {
            let n = points.len().max(1) as f64;
            (points.iter().map(|(x, _)| x).sum::<f64>() / n, points.iter().map(|(_, y)| y).sum::<f64>() / n)
        };
        let means: Vec<(f64, f64)> = groups.iter().map(|points| mean(points)).collect();
        let (mut spread, mut fall) = (0.0, 0.0);
        for (points, (x_mean, y_mean)) in groups.iter().zip(&means) {
            for (x, y) in *points {
                spread += (x - x_mean) * (x - x_mean);
                fall -= (x - x_mean) * (y - y_mean);
            }
        }
        // Below, distances are equal up to rounding.
        let slope = if spread > 1e-9 { fall / spread } else { 0.0 };
        let level = |(x, y): (f64, f64)| y + slope * x;
        let common = level(mean(&groups.concat()));
        let levels: Vec<f64> =
            groups.iter().zip(means).map(|(points, m)| if points.is_empty() { common } else { level(m) }).collect();
        (Self { level: levels.first().copied().unwrap_or(common), slope }, levels)
    }

    /// Computes the derivative of the power of a link from `from` to `to` by `from`, dB/m; 0 within 0.01 m.
    pub fn power_gradient(&self, from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
        let distance = distance(from, to);
        let radial = if distance > NEAREST_M { -self.slope / (LN_10 * distance * distance) } else { 0.0 };
        [0, 1, 2].map(|k| radial * (from[k] - to[k]))
    }

    /// Computes the power in dBm at a distance, given as its log10 in metres.
    pub fn power(&self, log_m: f64) -> f64 {
        self.level - self.slope * log_m
    }
}

/// Returns log10 of the distance between two positions, metres. Distances below 0.01 m count as 0.01 m.
pub fn log_distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    distance(from, to).max(NEAREST_M).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_agree_with_central_differences() {
        let places: Vec<Place> =
            (0..40).map(f64::from).map(|i| spatial_place([i.sin(), (2.0 * i).cos(), 0.0])).collect();
        let (at, value) = ([0.21, -0.34, 0.4], |i: usize| (i as f64).cos());
        let check = |f: &dyn Fn([f64; 3]) -> f64, d: [f64; 3]| {
            for k in 0..3 {
                let shifted = |h: f64| f(std::array::from_fn(|j| if j == k { at[j] + h } else { at[j] }));
                let difference = (shifted(1e-6) - shifted(-1e-6)) / 2e-6;
                assert!((difference - d[k]).abs() < 1e-7 * difference.abs().max(1.0), "{difference} and {}", d[k]);
            }
        };
        for (kind, mean) in
            CorrelationKind::ALL.into_iter().flat_map(|kind| [(kind, Mean::Zero), (kind, Mean::Unknown)])
        {
            let correlation = Correlation { kind, scales: [0.5, 0.8, 1.2, f64::INFINITY], noise: 0.05 };
            let kriging = LocalKriging::new(correlation, mean, places.iter().copied());
            let sum = |at: [f64; 3]| {
                let (near, solution) = kriging.solve(spatial_place(at), 12);
                near.iter().zip(&solution.weights).map(|(&i, w)| w * value(i)).sum()
            };
            check(&sum, kriging.solve_vjp(spatial_place(at), 12, value));
            let d = kriging.solve_vjp(places[3], 12, value);
            assert!(d.iter().all(|d| d.is_finite()), "{kind:?} at a sample: {d:?}");
        }
        let law = PathLoss { level: -40.0, slope: 21.0 };
        check(&|at| law.power(log_distance(at, [1.0, 2.0, 0.5])), law.power_gradient(at, [1.0, 2.0, 0.5]));
        assert_eq!(law.power_gradient(at, at), [0.0; 3]);
    }

    #[test]
    fn fits_path_loss_and_returns_constant_if_degenerate() {
        let law = PathLoss { level: -40.0, slope: 21.0 };
        let on = |law: PathLoss, xs: &[f64]| xs.iter().map(|x| (*x, law.power(*x))).collect::<Vec<_>>();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} instead of {b}");
        let fitted = PathLoss::fit(&on(law, &[0.1, 0.5, 1.3]));
        close(fitted.level, -40.0);
        close(fitted.slope, 21.0);
        assert_eq!(PathLoss::fit(&[(0.5, -60.0), (0.5, -62.0)]), PathLoss { level: -61.0, slope: 0.0 });
        let other = on(PathLoss { level: -50.0, ..law }, &[0.7, 0.9]);
        let (shared, levels) = PathLoss::fit_groups(&[&on(law, &[0.1, 1.0]), &other, &[]]);
        close(shared.slope, 21.0);
        close(levels[0], -40.0);
        close(levels[1], -50.0);
        close(levels[2], -45.0);
    }
}
