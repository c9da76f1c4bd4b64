//! Equations of ordinary kriging by Cholesky factorisation (Rasmussen and Williams, Gaussian Processes for Machine
//! Learning, 2006, sections 2.2 and 2.7 with an unknown mean; Cressie, Statistics for Spatial Data, 1993): correlation,
//! prediction and trend.

use super::super::log_distance::{PathLoss, log_distance, points};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Cholesky, Dataset, Query, Real, Sampling};

/// Prediction at one position from other samples.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Solution {
    /// Weights of the samples; they add up to 1.
    pub(super) weights: Vec<f64>,
    /// Weights for a process of known zero mean: zero far from all positions.
    pub(super) simple: Vec<f64>,
    /// Variance of a measurement at the position about the prediction, noise included, in units of the process
    /// variance.
    pub(super) variance: f64,
}

/// Predicts a measurement at `at` from at least one sample at `places`, in units of the length scales.
pub(super) fn solve(correlation: &Correlation, places: &[[f64; 3]], at: [f64; 3]) -> Solution {
    let n = places.len();
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..i {
            factor[i * n + j] = correlation.kind.at(distance(places[i], places[j]));
        }
        factor[i * n + i] = 1.0 + correlation.noise;
    }
    // Rounding may cancel a pivot if positions coincide and noise is near zero.
    let factor = Cholesky::floored(factor, n, 1e-12);
    let towards: Vec<f64> = places.iter().map(|place| correlation.kind.at(distance(*place, at))).collect();
    let (mut simple, mut ones) = (towards.clone(), vec![1.0; n]);
    factor.solve(&mut simple);
    factor.solve(&mut ones);
    let total: f64 = ones.iter().sum();
    let lacking = 1.0 - simple.iter().sum::<f64>();
    let weights: Vec<f64> = simple.iter().zip(&ones).map(|(s, o)| s + o * lacking / total).collect();
    let explained: f64 = towards.iter().zip(&simple).map(|(t, s)| t * s).sum();
    let variance = 1.0 + correlation.noise - explained + lacking * lacking / total;
    Solution { weights, simple, variance: variance.max(correlation.noise) }
}

/// Correlation function over distance in units of the length scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CorrelationKind {
    /// exp(-d), Matern 1/2: continuous and rough.
    Exponential,
    /// (1 + sqrt(3) d) exp(-sqrt(3) d): differentiable once.
    Matern32,
    /// exp(-d^2 / 2): smooth.
    SquaredExponential,
}

impl CorrelationKind {
    pub(super) const ALL: [Self; 3] = [Self::Exponential, Self::Matern32, Self::SquaredExponential];

    /// Name for use in a sentence.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Exponential => "exponential",
            Self::Matern32 => "Matern 3/2",
            Self::SquaredExponential => "squared exponential",
        }
    }

    /// Correlation at distance `d`, in length scales.
    pub(super) fn at(self, d: f64) -> f64 {
        match self {
            Self::Exponential => (-d).exp(),
            Self::Matern32 => {
                let d = 3f64.sqrt() * d;
                (1.0 + d) * (-d).exp()
            }
            Self::SquaredExponential => (-0.5 * d * d).exp(),
        }
    }
}

/// Gaussian process of variance 1 with measurement noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Correlation {
    pub(super) kind: CorrelationKind,
    /// Length scales of x, y and z, metres.
    pub(super) scales_m: [f64; 3],
    /// Noise variance, relative to the process variance.
    pub(super) noise: f64,
}

impl Correlation {
    /// Position in units of the length scales.
    pub(super) fn scaled(&self, place: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| place[k] / self.scales_m[k])
    }
}

/// Trend that is subtracted from every observation.
pub(super) struct Trend<'a> {
    pub(super) data: &'a Dataset,
    pub(super) law: Option<PathLoss>,
}

impl<'a> Trend<'a> {
    /// Fits the trend to these links by least squares.
    pub(super) fn of(data: &'a Dataset, links: &[usize]) -> Self {
        Self { data, law: data.task().is_scalar.then(|| PathLoss::fit(&points(data, links))) }
    }

    /// Power of the path-loss model for a link, dBm; 0 without a model.
    pub(super) fn at(&self, query: Query<'_>) -> f64 {
        self.law.map_or(0.0, |law| law.at(log_distance(self.data, query)))
    }

    /// Residual of link `i` at every `stride`-th column of every `stride`-th row.
    pub(super) fn residual(&self, i: usize, stride: usize, out: &mut [Real]) {
        self.data.observations.sampled(i, Sampling::every(stride), out);
        if self.law.is_some() {
            out[0] -= self.at(self.data.query(i)) as Real;
        }
    }
}
