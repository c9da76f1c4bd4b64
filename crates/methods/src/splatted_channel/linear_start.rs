//! Initialisation for channels with features: the best linear map from features to channels, as signals of the
//! Gaussians.
//!
//! With waves W `[AF, N]`, basis Φ `[N, J]` of the Gaussians and features x `[D]`, a channel is h = L·W·Φ·B·x. Ridge
//! regression on the training set gives the map R from x to h; B is then the regularised (WΦ)⁺·R/L. All computations
//! use double precision.

use super::waves::Waves;
use super::{SplattedChannel, offsets_mut, split_weights};
use pwrfgs_core::{
    Cholesky, Conditions, Dataset, End, GaussianCloud, LinearPart, MeasurementSetup, Parameters, Real, ReceiverState,
};
use rayon::prelude::*;

/// Weight of both ridge penalties, relative to the mean of the diagonal.
const RIDGE: f64 = 1e-4;
/// Maximum number of links in the fit.
const MOST: usize = 8_000;

impl SplattedChannel {
    /// Initialises the linear part of the deformation, the signals and the level, and returns `true`. Returns `false` and
    /// changes nothing if the deformation has no linear part, for several receivers or a moving receiver, without channels,
    /// or without a unique solution.
    pub(super) fn start_linear(
        &self,
        setup: &MeasurementSetup,
        data: &Dataset,
        train: &[usize],
        cloud: &mut GaussianCloud,
        weights: &mut [Real],
    ) -> bool {
        let part = pwrfgs_core::evenly(train, MOST);
        let features: Vec<Real> = part.iter().filter_map(|&i| data.query(i).features).flatten().copied().collect();
        let network = split_weights(setup, weights).0.len();
        let conditions = Conditions::new(self.deformation.traits().inputs, &features);
        let linear = self.deformation.linear_part(&weights[..network], &cloud.means, conditions);
        let (Some(linear), [_], End::Transmitter) = (linear, setup.receivers.as_slice(), setup.moving) else {
            return false;
        };
        let parameters = Parameters { cloud, gate: None, existence: None, weights };
        let waves = Waves::new(setup, ReceiverState { receiver: 0, pose: setup.pose() }, &parameters);
        let Some(measured) = data.observations.channels() else { return false };
        let channels: Vec<&[[Real; 2]]> = part.iter().map(|&i| measured.of(i)).collect();
        let Some(map) = fit_ridge(&linear, &channels) else { return false };
        let responses = waves.basis_channels(&linear.basis, linear.functions);
        let Some(coefficients) = solve_basis(&responses, linear.functions, &map) else { return false };
        // Signals have a magnitude of about 1; the level contains the rest.
        let size = (coefficients.iter().flatten().map(|v| v * v).sum::<f64>() / linear.inputs as f64).sqrt();
        let level = if size > 0.0 { size } else { 1.0 };
        cloud.signals.fill([0.0; 2]);
        weights[linear.cleared.clone()].fill(0.0);
        for (i, gain) in coefficients.iter().enumerate() {
            let (k, j) = (i / linear.functions, i % linear.functions);
            (0..2).for_each(|c| weights[linear.weight_index(c, k, j)] = (gain[c] / level) as Real);
        }
        offsets_mut(setup, weights).fill(level.log10() as Real);
        true
    }
}

/// Fits R `[D, AF]`, the complex map from features to channels, by ridge regression; `None` without channels or without
/// a unique solution.
fn fit_ridge(linear: &LinearPart, channels: &[&[[Real; 2]]]) -> Option<Vec<Vec<[f64; 2]>>> {
    let d = linear.inputs;
    let rows: Vec<&[Real]> = linear.values.chunks_exact(d).collect();
    let mut gram: Vec<f64> = vec![0.0; d * d];
    gram.par_chunks_exact_mut(d).enumerate().for_each(|(i, out)| {
        for row in &rows {
            let x = row[i] as f64;
            out.iter_mut().zip(*row).for_each(|(sum, v)| *sum += x * *v as f64);
        }
    });
    let factor = ridge_factor(gram, d)?;
    let numbers = channels.first()?.len();
    // Map to the real (c = 0) or imaginary part of value n.
    let part = |n: usize, c: usize| {
        let mut right = vec![0.0; d];
        for (row, channel) in rows.iter().zip(channels) {
            let y = channel[n][c] as f64;
            right.iter_mut().zip(*row).for_each(|(sum, v)| *sum += y * *v as f64);
        }
        factor.solve(&mut right);
        right
    };
    let column =
        |n: usize| -> Vec<[f64; 2]> { part(n, 0).into_iter().zip(part(n, 1)).map(|(re, im)| [re, im]).collect() };
    let columns: Vec<Vec<[f64; 2]>> = (0..numbers).into_par_iter().map(column).collect();
    Some((0..d).map(|k| columns.iter().map(|column| column[k]).collect()).collect())
}

/// Solves V·b = r for every row r of R in the least-squares sense; returns all b, B `[D, J]`. V `[AF, J]` (`responses`) is
/// the received channel per basis function, R `[D, AF]` is `map`. `None` without a unique solution.
fn solve_basis(responses: &[[f64; 2]], functions: usize, map: &[Vec<[f64; 2]>]) -> Option<Vec<[f64; 2]>> {
    let (j, numbers) = (functions, responses.len() / functions.max(1));
    // Complex unknowns as pairs of real ones: [[Re, -Im], [Im, Re]] of VᴴV.
    let mut gram = vec![0.0; 4 * j * j];
    for a in 0..j {
        for b in 0..j {
            let (mut re, mut im) = (0.0, 0.0);
            for n in 0..numbers {
                let ([ar, ai], [br, bi]) = (responses[n * j + a], responses[n * j + b]);
                re += ar * br + ai * bi;
                im += ar * bi - ai * br;
            }
            gram[a * 2 * j + b] = re;
            gram[(a + j) * 2 * j + b + j] = re;
            gram[a * 2 * j + b + j] = -im;
            gram[(a + j) * 2 * j + b] = im;
        }
    }
    let factor = ridge_factor(gram, 2 * j)?;
    let coefficients = |row: &Vec<[f64; 2]>| {
        let mut right = vec![0.0; 2 * j];
        for n in 0..numbers {
            let [hr, hi] = row[n];
            for a in 0..j {
                let [vr, vi] = responses[n * j + a];
                right[a] += vr * hr + vi * hi;
                right[a + j] += vr * hi - vi * hr;
            }
        }
        factor.solve(&mut right);
        (0..j).map(|a| [right[a], right[a + j]]).collect::<Vec<_>>()
    };
    Some(map.par_iter().flat_map_iter(coefficients).collect())
}

/// Returns the Cholesky factor of a symmetric matrix `[n, n]` with [`RIDGE`] times the mean of its diagonal added to the
/// diagonal; `None` if the sum is not positive definite.
fn ridge_factor(mut a: Vec<f64>, n: usize) -> Option<Cholesky> {
    let mean = (0..n).map(|k| a[k * n + k]).sum::<f64>() / n.max(1) as f64;
    (0..n).for_each(|k| a[k * n + k] += RIDGE * mean + f64::MIN_POSITIVE); // above 0 for a zero matrix too
    Cholesky::new(a, n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solve_basis_recovers_map_from_received_channels() {
        // Two functions and two values: V is invertible, so B is V⁻¹R up to the ridge.
        let responses = [[1.0, 0.5], [0.0, 1.0], [0.3, 0.0], [2.0, -1.0]];
        let expected = [[0.7, -0.2], [0.1, 0.9]];
        let times = |v: [f64; 2], b: [f64; 2]| [v[0] * b[0] - v[1] * b[1], v[0] * b[1] + v[1] * b[0]];
        let received: Vec<[f64; 2]> = (0..2)
            .map(|n| {
                let [a, b] = [0, 1].map(|j| times(responses[n * 2 + j], expected[j]));
                [a[0] + b[0], a[1] + b[1]]
            })
            .collect();
        let solution = solve_basis(&responses, 2, &[received]).unwrap();
        for (solution, expected) in solution.iter().zip(expected) {
            assert!(
                (solution[0] - expected[0]).abs() < 2e-3 && (solution[1] - expected[1]).abs() < 2e-3,
                "{solution:?}"
            );
        }
    }
}
