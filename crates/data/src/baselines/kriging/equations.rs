//! The equations of ordinary kriging, by Cholesky's method (Rasmussen and Williams, Gaussian Processes for Machine
//! Learning, 2006, sections 2.2 and 2.7 with a mean that is not known; Cressie, Statistics for Spatial Data, 1993): how
//! much two places have in common, what is predicted from others, and what the process is about.

use super::super::log_distance::{Law, log_distance, points};
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Cholesky, Dataset, Query, Real, Sampling};

/// The prediction of one place from others.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Solution {
    /// What each of the others counts; they add up to 1.
    pub(super) weights: Vec<f64>,
    /// The same where the mean of the process is known to be zero: far from all places they are zero.
    pub(super) simple: Vec<f64>,
    /// Variance of a measurement there, noise included, about the prediction, in units of the process.
    pub(super) variance: f64,
}

/// Predicts a measurement at `at` from those at `places`, of which there is at least one, all in units of the length scales.
pub(super) fn solve(correlation: &Correlation, places: &[[f64; 3]], at: [f64; 3]) -> Solution {
    let n = places.len();
    let mut factor = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..i {
            factor[i * n + j] = correlation.kind.at(distance(places[i], places[j]));
        }
        factor[i * n + i] = 1.0 + correlation.noise;
    }
    // Rounding may leave nothing of a pivot where places coincide and there is next to no noise.
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

/// Shape of a correlation over distance in units of the length scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// exp(-d), Matern 1/2: continuous and rough.
    Exponential,
    /// (1 + sqrt(3) d) exp(-sqrt(3) d): differentiable once.
    Matern32,
    /// exp(-d^2 / 2): smooth.
    SquaredExponential,
}

impl Kind {
    pub(super) const ALL: [Self; 3] = [Self::Exponential, Self::Matern32, Self::SquaredExponential];

    /// As a sentence says it.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Exponential => "exponential",
            Self::Matern32 => "Matern 3/2",
            Self::SquaredExponential => "squared exponential",
        }
    }

    /// Of distance `d` in length scales.
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

/// A Gaussian process of variance 1, and the noise of each measurement of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Correlation {
    pub(super) kind: Kind,
    /// Length scales of x, y and z, metres.
    pub(super) scales_m: [f64; 3],
    /// Variance of the noise, in units of that of the process.
    pub(super) noise: f64,
}

impl Correlation {
    /// A place in units of the length scales.
    pub(super) fn scaled(&self, place: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| place[k] / self.scales_m[k])
    }
}

/// What is taken off every observation first.
pub(super) struct Trend<'a> {
    pub(super) data: &'a Dataset,
    pub(super) law: Option<Law>,
}

impl<'a> Trend<'a> {
    /// By least squares of these links.
    pub(super) fn of(data: &'a Dataset, links: &[usize]) -> Self {
        Self { data, law: data.task().is_scalar.then(|| Law::fit(&points(data, links))) }
    }

    /// dBm that the law gives a link; 0 without one.
    pub(super) fn at(&self, query: Query<'_>) -> f64 {
        self.law.map_or(0.0, |law| law.at(log_distance(self.data, query)))
    }

    /// What is left of link `i`, every `stride`-th number of every `stride`-th row.
    pub(super) fn residual(&self, i: usize, stride: usize, out: &mut [Real]) {
        self.data.observations.sampled(i, Sampling::every(stride), out);
        if self.law.is_some() {
            out[0] -= self.at(self.data.query(i)) as Real;
        }
    }
}
