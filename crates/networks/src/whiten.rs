//! The map that makes vectors uncorrelated, each number of variance 1: with it in front, every direction of the data is
//! learned equally fast, the faint ones too, in which channels of neighbouring frequencies differ.

use pwrfgs_core::{Cholesky, Conditions, Real};

/// Share of the mean variance that is added to every variance: fainter directions are noise, and are not made as loud.
const FAINTEST: f64 = 1e-3;
/// Vectors that it is worked out on, at most.
const MOST: usize = 4_000;

/// W `[D,D]` and b `[D]` such that W·(gain·x) + b has mean zero and nearly the covariance 1: W = L⁻¹ of the Cholesky factor
/// L of the covariance. `None` for no vectors, and for vectors that are all the same.
pub(super) fn whitening(vectors: Conditions<'_>, gain: f64) -> Option<(Vec<Real>, Vec<Real>)> {
    let d = vectors.width();
    let stride = vectors.len().div_ceil(MOST).max(1);
    let rows: Vec<Vec<f64>> = vectors
        .values()
        .chunks_exact(d)
        .step_by(stride)
        .map(|row| row.iter().map(|v| gain * f64::from(*v as f32)).collect())
        .collect();
    let n = rows.len() as f64;
    if rows.is_empty() {
        return None;
    }
    let mean: Vec<f64> = (0..d).map(|k| rows.iter().map(|row| row[k]).sum::<f64>() / n).collect();
    let mut covariance = vec![0.0; d * d];
    for row in &rows {
        for i in 0..d {
            let x = (row[i] - mean[i]) / n;
            (0..=i).for_each(|j| covariance[i * d + j] += x * (row[j] - mean[j]));
        }
    }
    let variance = (0..d).map(|k| covariance[k * d + k]).sum::<f64>() / d as f64;
    if variance.is_nan() || variance <= 0.0 {
        return None; // vectors that are all the same have no direction that could be made as loud as another
    }
    (0..d).for_each(|k| covariance[k * d + k] += FAINTEST * variance);
    let inverse = Cholesky::new(covariance, d)?.inverse_of_factor();
    let bias = (0..d).map(|i| -(0..=i).map(|j| inverse[i * d + j] * mean[j]).sum::<f64>() as Real).collect();
    Some((inverse.into_iter().map(|v| v as Real).collect(), bias))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;

    #[test]
    fn correlated_numbers_of_any_size_become_uncorrelated_ones() {
        let random = &mut rng::stream(0, "whiten", 0);
        let mut values: Vec<Real> = Vec::new();
        for _ in 0..2000 {
            let [a, b] = [rng::normal(random), rng::normal(random)];
            values.extend([3.0 + 10.0 * a, 0.5 * a + 4.0 * b]);
        }
        let (w, bias) = whitening(Conditions::new(2, &values), 2.0).unwrap();
        let white = |row: &[Real]| [0, 1].map(|i| (w[2 * i] * row[0] + w[2 * i + 1] * row[1]) * 2.0 + bias[i]);
        let mut sums = [0.0; 5];
        for row in values.chunks(2) {
            let [x, y] = white(row).map(|v| v as f64);
            [x, y, x * x, x * y, y * y].iter().zip(&mut sums).for_each(|(v, sum)| *sum += v / 2000.0);
        }
        let expected = [0.0, 0.0, 1.0, 0.0, 1.0];
        assert!(sums.iter().zip(expected).all(|(sum, e)| (sum - e).abs() < 0.01), "{sums:?}");
        assert!(whitening(Conditions::new(2, &[]), 1.0).is_none());
        assert!(
            whitening(Conditions::new(2, &[1.0, 2.0, 1.0, 2.0]), 1.0).is_none(),
            "constants have no direction at all"
        );
    }
}
