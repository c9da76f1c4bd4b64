//! Kriging, the prediction of a Gaussian process over positions, by Cholesky factorisation (Rasmussen and Williams,
//! Gaussian Processes for Machine Learning, 2006, sections 2.2 and 2.7 with an unknown mean; Cressie, Statistics for
//! Spatial Data, 1993): correlation and prediction; `likelihood.rs` fits the correlation.

mod likelihood;

use crate::Cholesky;
use crate::neighbours::distance;
pub use likelihood::{HeldOutCases, SearchSpace, most_likely};
use serde::{Deserialize, Serialize};

/// Position of a sample: x, y and z in metres, and its time in samples, 0 for processes over space alone.
pub type Place = [f64; 4];

/// Returns the place of a transmitter at `tx` (metres), without time.
pub fn in_space([x, y, z]: [f64; 3]) -> Place {
    [x, y, z, 0.0]
}

/// Prediction at one position from other samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// Weights of the samples; they add up to 1.
    pub weights: Vec<f64>,
    /// Weights for a process of known zero mean: zero far from all positions.
    pub simple: Vec<f64>,
    /// Variance of a measurement at the position about the prediction, noise included, in units of the process
    /// variance.
    pub variance: f64,
}

/// Predicts a measurement at `at` from at least one sample at `places`, in units of the length scales.
pub fn solve(correlation: &Correlation, places: &[Place], at: Place) -> Solution {
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CorrelationKind {
    /// exp(-d), Matern 1/2: continuous and rough.
    Exponential,
    /// (1 + sqrt(3) d) exp(-sqrt(3) d): differentiable once.
    Matern32,
    /// exp(-d^2 / 2): smooth.
    SquaredExponential,
}

impl CorrelationKind {
    /// All functions.
    pub const ALL: [Self; 3] = [Self::Exponential, Self::Matern32, Self::SquaredExponential];

    /// Returns its name for use in a sentence.
    pub fn words(self) -> &'static str {
        match self {
            Self::Exponential => "exponential",
            Self::Matern32 => "Matern 3/2",
            Self::SquaredExponential => "squared exponential",
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
    /// Returns the place in units of the scales.
    pub fn scaled(&self, place: Place) -> Place {
        [0, 1, 2, 3].map(|k| place[k] / self.scales[k])
    }
}
