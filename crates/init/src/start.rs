//! Shared part of all initialisers: from centres and scales to a cloud of unconstrained columns.

use pwrfgs_core::{
    GaussianCloud, Real, logit, neighbours,
    rng::{self, Rng},
};

/// Smallest squared scale, m², as released: duplicate points have distance 0, and the logarithm must be finite.
const LEAST_SQUARE: Real = 1e-7;
/// Scale of a Gaussian without neighbours, m.
const LONELY: Real = 1.0;
/// Largest distance and scale: products of their squares stay finite in single precision.
const LARGEST: Real = 1e6;
/// Maximum number of Gaussians; larger numbers are rejected as typing errors, because they would exhaust the memory.
const MOST: usize = 10_000_000;
/// Maximum number of neighbours of the scale rule.
const MOST_NEIGHBOURS: usize = 1_000;

/// Returns the scale of each Gaussian, `[N]`, metres: root mean squared distance to its `nearest` neighbours, at least
/// sqrt(1e-7) m; 1 m without neighbours.
pub(crate) fn scales_from_neighbours(means: &[[Real; 3]], nearest: usize) -> Vec<Real> {
    let squares = neighbours::mean_of_k_nearest_squared(means, nearest);
    squares.into_iter().map(|s| if s.is_finite() { s.max(LEAST_SQUARE).sqrt() } else { LONELY }).collect()
}

/// Creates isotropic Gaussians `[N]` without rotation and of equal opacity. Both channels of each signal are uniform
/// between −1/2 and 1/2.
pub(crate) fn isotropic_cloud(means: Vec<[Real; 3]>, scales: &[Real], opacity: Real, rng: &mut Rng) -> GaussianCloud {
    let n = means.len();
    let mut channel = || rng::uniform(rng) - 0.5;
    GaussianCloud {
        log_scales: scales.iter().map(|s| [s.ln(); 3]).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        opacity_logits: vec![logit(opacity); n],
        signals: (0..n).map(|_| [channel(), channel()]).collect(),
        means,
        extra: Vec::new(),
    }
}

/// Rejects an opacity that cannot be trained: not a number, or within 1e-6 of 0 or 1, where its gradient vanishes.
pub(crate) fn check_opacity(opacity: Real) -> Result<(), String> {
    if (1e-6..=1.0 - 1e-6).contains(&opacity) {
        return Ok(());
    }
    Err(format!("`opacity` is {opacity}; give a number from 0.000001 to 0.999999, such as 0.1"))
}

/// Rejects values that are not above 0, or whose products overflow single precision. `meaning` ends the message.
pub(crate) fn check_positive(field: &str, value: Real, meaning: &str) -> Result<(), String> {
    if value > 0.0 && value <= LARGEST {
        return Ok(());
    }
    Err(format!("`{field}` is {value:?}; give a number above 0 and at most {LARGEST:e}: {meaning}"))
}

/// Rejects 0 and excessive numbers of Gaussians.
pub(crate) fn check_count(field: &str, count: usize) -> Result<(), String> {
    if (1..=MOST).contains(&count) {
        return Ok(());
    }
    Err(format!("`{field}` is {count}; give a number between 1 and {MOST}"))
}

/// Rejects a scale rule without neighbours, or with too many.
pub(crate) fn check_nearest(nearest: usize) -> Result<(), String> {
    if (1..=MOST_NEIGHBOURS).contains(&nearest) {
        return Ok(());
    }
    Err(format!(
        "`nearest` is {nearest}; give 1 for the paper's rule, 3 for the released one, {MOST_NEIGHBOURS} at most"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duplicates_and_single_points_have_finite_scales() {
        assert_eq!(scales_from_neighbours(&[[1.0; 3]], 1), [LONELY]);
        assert_eq!(scales_from_neighbours(&[[1.0; 3]; 3], 1), [LEAST_SQUARE.sqrt(); 3]);
        assert!(scales_from_neighbours(&[], 3).is_empty());
    }

    #[test]
    fn columns_have_documented_initial_values() {
        let mut random = rng::stream(0, "init", 0);
        let cloud = isotropic_cloud(vec![[0.0; 3]; 500], &[0.5; 500], 0.1, &mut random);
        assert!((cloud.opacity_logits[7] - -2.197_224_6).abs() < 1e-5);
        assert!((cloud.log_scales[7][2] - (0.5 as Real).ln()).abs() < 1e-6);
        assert!(cloud.quats.iter().all(|q| *q == [1.0, 0.0, 0.0, 0.0]));
        let signals = cloud.signals.as_flattened();
        assert!(signals.iter().all(|s| s.abs() <= 0.5));
        assert!(signals.iter().any(|s| *s > 0.4) && signals.iter().any(|s| *s < -0.4));
    }
}
