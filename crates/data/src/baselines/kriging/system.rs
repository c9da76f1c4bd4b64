//! The equations of ordinary kriging, by Cholesky's method (Rasmussen and Williams, Gaussian Processes for Machine
//! Learning, 2006, sections 2.2 and 2.7 with a mean that is not known; Cressie, Statistics for Spatial Data, 1993).

use super::correlation::Correlation;
use pwrfgs_core::neighbours::distance;

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
    cholesky(&mut factor, n);
    let towards: Vec<f64> = places.iter().map(|place| correlation.kind.at(distance(*place, at))).collect();
    let (mut simple, mut ones) = (towards.clone(), vec![1.0; n]);
    solve_in_place(&factor, &mut simple);
    solve_in_place(&factor, &mut ones);
    let total: f64 = ones.iter().sum();
    let lacking = 1.0 - simple.iter().sum::<f64>();
    let weights: Vec<f64> = simple.iter().zip(&ones).map(|(s, o)| s + o * lacking / total).collect();
    let explained: f64 = towards.iter().zip(&simple).map(|(t, s)| t * s).sum();
    let variance = 1.0 + correlation.noise - explained + lacking * lacking / total;
    Solution { weights, simple, variance: variance.max(correlation.noise) }
}

/// The lower triangle of a positive definite matrix `[n,n]` becomes that of its Cholesky factor; the upper is not looked at.
fn cholesky(a: &mut [f64], n: usize) {
    for i in 0..n {
        for j in 0..=i {
            let (row, other) = (&a[i * n..i * n + j], &a[j * n..j * n + j]);
            let rest = a[i * n + j] - row.iter().zip(other).map(|(x, y)| x * y).sum::<f64>();
            // Rounding may leave nothing of a pivot where places coincide and there is next to no noise.
            a[i * n + j] = if i == j { rest.max(1e-12).sqrt() } else { rest / a[j * n + j] };
        }
    }
}

/// b becomes the solution of L Lt x = b.
fn solve_in_place(factor: &[f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        let known: f64 = (0..i).map(|j| factor[i * n + j] * b[j]).sum();
        b[i] = (b[i] - known) / factor[i * n + i];
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|j| factor[j * n + i] * b[j]).sum();
        b[i] = (b[i] - known) / factor[i * n + i];
    }
}
