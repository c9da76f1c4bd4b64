//! `Posterior`: variance of a Gaussian process at fixed points while measurements are added (Rasmussen and Williams, Gaussian
//! Processes for Machine Learning, 2006, section 2.2, by a growing Cholesky factor).
//!
//! With prior covariance k, noise σ² and measured points s₁, .., sₙ, row i of the factor is
//! `V[i][p] = (k(p, sᵢ) − Σ_{l<i} V[l][p] V[l][sᵢ]) / √(v(sᵢ) + σ²)`, and the variance at p falls by `V[i][p]²`.

use pwrfgs_core::kriging::{Correlation, spatial_place};
use rayon::prelude::*;

/// Points per task; results do not depend on it.
const CHUNK: usize = 256;
/// Factor elements below this are neglected: they change a variance by less than its rounding error.
const NEGLIGIBLE: f64 = 1e-9;

/// Posterior variance of a process of variance 1 with known mean, at `P` points.
#[derive(Clone, Debug)]
pub(crate) struct Posterior {
    correlation: Correlation,
    /// Coordinates of the points in length scales, three columns `[P]`.
    columns: [Vec<f64>; 3],
    /// Factor `[n,P]`: one row per measurement.
    factor: Vec<f64>,
    /// Variances `[P]`.
    variances: Vec<f64>,
}

impl Posterior {
    /// Creates the prior at `points` (metres).
    pub(crate) fn new(correlation: Correlation, points: &[[f64; 3]]) -> Self {
        let column = |k: usize| points.iter().map(|point| correlation.scaled(spatial_place(*point))[k]).collect();
        let (factor, variances) = (Vec::new(), vec![1.0; points.len()]);
        Self { correlation, columns: [0, 1, 2].map(column), factor, variances }
    }

    /// Returns the number of points P.
    fn point_count(&self) -> usize {
        self.variances.len()
    }

    /// Returns the variances `[P]` without measurement noise.
    pub(crate) fn variances(&self) -> &[f64] {
        &self.variances
    }

    /// Returns the noise variance of a measurement.
    pub(crate) fn noise(&self) -> f64 {
        self.correlation.noise
    }

    /// Returns the prior covariance of points `p` and `q`.
    pub(crate) fn prior_covariance(&self, p: usize, q: usize) -> f64 {
        let squared: f64 = self.columns.iter().map(|column| (column[p] - column[q]).powi(2)).sum();
        self.correlation.kind.at(squared.sqrt())
    }

    /// Returns the rows of the factor, one per measurement, each `[P]`.
    pub(crate) fn factor_rows(&self) -> impl Iterator<Item = &[f64]> + Clone {
        self.factor.chunks_exact(self.point_count().max(1))
    }

    /// Adds a measurement at point `s`, which lowers the variances, and returns its row of the factor, `[P]`.
    pub(crate) fn add_measurement(&mut self, s: usize) -> &[f64] {
        let pivot = (self.variances[s] + self.correlation.noise).sqrt();
        let before: Vec<(f64, &[f64])> =
            self.factor_rows().map(|row| (row[s], row)).filter(|(at_s, _)| at_s.abs() > NEGLIGIBLE).collect();
        let mut row = vec![0.0; self.point_count()];
        row.par_chunks_mut(CHUNK).enumerate().for_each(|(c, part)| {
            let first = c * CHUNK;
            part.iter_mut().enumerate().for_each(|(i, value)| *value = self.prior_covariance(first + i, s));
            for (at_s, other) in &before {
                part.iter_mut().zip(&other[first..]).for_each(|(value, other)| *value -= at_s * other);
            }
            part.iter_mut().for_each(|value| *value /= pivot);
        });
        self.variances.iter_mut().zip(&row).for_each(|(v, u)| *v = (*v - u * u).max(0.0));
        let start = self.factor.len();
        self.factor.append(&mut row);
        &self.factor[start..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::kriging::{CorrelationKind, Mean, solve};

    fn exponential(scale: f64, noise: f64) -> Correlation {
        Correlation { kind: CorrelationKind::Exponential, scales: [scale, scale, scale, f64::INFINITY], noise }
    }

    /// One measurement at distance d leaves 1 − e^(−2d) / (1 + σ²); a second one in the middle of two points follows from the
    /// inverse of a 2 x 2 matrix.
    #[test]
    fn variance_of_one_and_two_measurements_has_closed_form() {
        let mut posterior = Posterior::new(exponential(2.0, 0.25), &[[0.0; 3], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]);
        posterior.add_measurement(1);
        let (near, far) = ((-0.5f64).exp(), (-1.0f64).exp());
        assert!((posterior.variances()[0] - (1.0 - near * near / 1.25)).abs() < 1e-15);
        posterior.add_measurement(2);
        assert!((posterior.variances()[0] - (1.0 - 2.0 * near * near / (1.25 + far))).abs() < 1e-15);
    }

    #[test]
    fn variance_equals_kriging_with_zero_mean() {
        let mut random = pwrfgs_core::rng::stream(1, "posterior", 0);
        let mut draw = || pwrfgs_core::rng::uniform_f64(&mut random);
        let points: Vec<[f64; 3]> = (0..600).map(|_| [4.0 * draw(), 3.0 * draw(), draw()]).collect();
        let correlation = exponential(0.8, 0.05);
        let mut posterior = Posterior::new(correlation, &points);
        let measured: Vec<usize> = (0..40).map(|k| 13 * k).collect();
        measured.iter().for_each(|&s| _ = posterior.add_measurement(s));
        let measured_points: Vec<_> = measured.iter().map(|&s| correlation.scaled(spatial_place(points[s]))).collect();
        for p in [1, 13, 299, 599] {
            let kriging =
                solve(&correlation, Mean::Zero, &measured_points, correlation.scaled(spatial_place(points[p])));
            let variance = posterior.variances()[p] + correlation.noise;
            assert!((variance - kriging.variance).abs() < 1e-9, "{variance} and {}", kriging.variance);
        }
    }
}
