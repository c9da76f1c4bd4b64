//! Pruner by the sensitivity of the spectra to position and scale.

use crate::common::ranking_traits;
use pwrfgs_core::{CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext};
use serde::{Deserialize, Serialize};

/// Removes the Gaussians whose position and scale have the least influence on the spectra (PUP-3DGS).
///
/// The score is log det of the 6 × 6 Fisher matrix Σ J Jᵀ, J = ∂P̂/∂(mean, log scale) with constant signals, over
/// pixels and training transmitters. If the spectra do not depend on a direction, such as the distance from a single
/// receiver, every determinant would be 0. Therefore 1e-6 times the mean diagonal of the matrix is added. Source:
/// PUP-3DGS, Hanson et al., CVPR 2025, eq. (11), with the logarithm of the scale in place of the scale; the paper
/// removes 80 % of the Gaussians at once, then half of the rest.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("Pup3dgs(transmitters: 64)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Pup3dgs {
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

/// Ridge on the diagonal of the Fisher matrix, relative to its mean.
const RIDGE: Real = 1e-6;

impl Default for Pup3dgs {
    fn default() -> Self {
        Self { transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for Pup3dgs {
    fn traits(&self) -> PrunerTraits {
        ranking_traits()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::Fisher], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        if stats.requested.fisher.len() != cloud.len() {
            return cloud.opacity_logits.clone();
        }
        stats.requested.fisher.iter().map(|fisher| log_det(fisher, f64::from(RIDGE)) as Real).collect()
    }
}

/// Returns log det of a symmetric 6 × 6 matrix given by its upper triangle, with `ridge` times the mean diagonal added
/// to its diagonal; −∞ for zeros. Uses the Cholesky decomposition.
fn log_det(triangle: &[Real; 21], ridge: f64) -> f64 {
    let mut a = [[0.0f64; 6]; 6];
    let mut entries = triangle.iter();
    for i in 0..6 {
        for j in i..6 {
            let v = f64::from(*entries.next().expect("twenty-one numbers"));
            (a[i][j], a[j][i]) = (v, v);
        }
    }
    let mean = (0..6).map(|i| a[i][i]).sum::<f64>() / 6.0;
    let mut sum = 0.0;
    for j in 0..6 {
        let pivot = a[j][j] + ridge * mean - (0..j).map(|k| a[j][k] * a[j][k]).sum::<f64>();
        // Rounding may leave slightly less than the added ridge.
        let pivot = pivot.max(0.5 * ridge * mean);
        sum += pivot.ln();
        let root = pivot.sqrt();
        a[j][j] = root;
        for i in j + 1..6 {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            a[i][j] = (a[i][j] - dot) / root;
        }
    }
    if sum.is_nan() { f64::NEG_INFINITY } else { sum }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_determinants_match_known_matrices() {
        // diag(1, 2, .., 6) has determinant 720; that of a product of two known factors is the squared product of the
        // diagonal.
        let mut diagonal = [0.0; 21];
        let mut index = 0;
        for i in 0..6 {
            diagonal[index] = (i + 1) as Real;
            index += 6 - i;
        }
        assert!((log_det(&diagonal, 1e-12) - 720f64.ln()).abs() < 1e-6);
        let factor = |i: usize, j: usize| match i.cmp(&j) {
            std::cmp::Ordering::Equal => 1.0 + i as f64,
            std::cmp::Ordering::Greater => 0.3 * (i + j) as f64,
            std::cmp::Ordering::Less => 0.0,
        };
        let mut full = [0.0; 21];
        let mut entries = full.iter_mut();
        for i in 0..6 {
            for j in i..6 {
                *entries.next().unwrap() = (0..6).map(|k| factor(i, k) * factor(j, k)).sum::<f64>() as Real;
            }
        }
        assert!((log_det(&full, 1e-12) - 2.0 * 720f64.ln()).abs() < 1e-3);
        assert_eq!(log_det(&[0.0; 21], 1e-6), f64::NEG_INFINITY);
    }
}
