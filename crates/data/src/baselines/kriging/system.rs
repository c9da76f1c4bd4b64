//! The equations of ordinary kriging, by Cholesky's method (Rasmussen and Williams, Gaussian Processes for Machine
//! Learning, 2006, sections 2.2 and 2.7 with a mean that is not known; Cressie, Statistics for Spatial Data, 1993).

use super::correlation::Correlation;
use pwrfgs_core::{Cholesky, neighbours::distance};

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
