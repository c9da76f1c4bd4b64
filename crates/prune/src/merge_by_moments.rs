//! Pruner that merges close Gaussians into one with their joint mean and covariance.

use crate::covariance::Covariance;
use pwrfgs_core::{
    Budget, CloudEdit, CloudStats, GaussianCloud, JsonSchema, Pruner, PrunerTraits, Real, RowOrigin, StepContext,
    logit, neighbours, sigmoid,
};
use serde::{Deserialize, Serialize};

/// Merges the nearest pairs of Gaussians into one Gaussian with their joint mean and covariance.
///
/// The mass of a Gaussian is its opacity times the product of its scales. Pairs are merged in the order of Ward's
/// criterion, m₁m₂/(m₁+m₂) · ‖μ₁ − μ₂‖², each Gaussian with its nearest neighbour and once per pass, until the number
/// of the prune step is reached. The merged Gaussian has the mean and covariance of the mixture, the mean signal, and
/// an opacity that preserves the mass, at most 0.99. Merging loses detail, but unlike removal it leaves no empty
/// regions. The network computes the signals of a merged Gaussian from its new centre.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("MergeByMoments()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MergeByMoments {}

#[typetag::serde]
impl Pruner for MergeByMoments {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::PrunerManaged), requires_target: true, ..PrunerTraits::default() }
    }

    fn edit(&self, cloud: &GaussianCloud, _: &CloudStats, context: &StepContext) -> Option<CloudEdit> {
        let n = cloud.len();
        let count = context.quota(n, context.target?).max(1);
        if count >= n || cloud.means.as_flattened().iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mut edit = CloudEdit { cloud: cloud.clone(), rows: (0..n).map(RowOrigin::Kept).collect() };
        while edit.rows.len() > count {
            merge_pass(&mut edit, count);
        }
        Some(edit)
    }
}

/// Returns the mass of Gaussian `i`: opacity times the product of the scales, m³.
fn gaussian_mass(cloud: &GaussianCloud, i: usize) -> f64 {
    let volume: f64 = cloud.log_scales[i].iter().map(|s| f64::from(*s)).sum::<f64>().exp();
    f64::from(sigmoid(cloud.opacity_logits[i])) * volume
}

/// Merges pairs of nearest neighbours, lowest cost first and each Gaussian once, until `count` are left or no pair
/// remains.
fn merge_pass(edit: &mut CloudEdit, count: usize) {
    let CloudEdit { cloud, rows } = edit;
    let n = cloud.len();
    let nearest = neighbours::k_nearest(&cloud.means, &cloud.means, 2.min(n));
    let masses: Vec<f64> = (0..n).map(|i| gaussian_mass(cloud, i)).collect();
    let pair = |i: usize| {
        let &(j, squared) = nearest[i].iter().find(|(j, _)| *j != i)?;
        let (a, b) = (masses[i], masses[j]);
        Some((a * b / (a + b).max(f64::MIN_POSITIVE) * f64::from(squared), i.min(j), i.max(j)))
    };
    let mut pairs: Vec<(f64, usize, usize)> = (0..n).filter_map(pair).collect();
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    let (mut taken, mut removed) = (vec![false; n], vec![false; n]);
    let mut remaining = n;
    for (_, i, j) in pairs {
        if remaining > count && !taken[i] && !taken[j] {
            merge_rows(cloud, [i, j], [masses[i], masses[j]]);
            rows[i] = RowOrigin::Copied(rows[i].source());
            (taken[i], taken[j], removed[j]) = (true, true, true);
            remaining -= 1;
        }
    }
    let kept: Vec<usize> = (0..n).filter(|&i| !removed[i]).collect();
    *cloud = cloud.select(&kept);
    *rows = kept.iter().map(|&i| rows[i]).collect();
}

/// Replaces row `i` by the merged Gaussian of rows `i` and `j`, whose masses are `a` and `b`.
fn merge_rows(cloud: &mut GaussianCloud, [i, j]: [usize; 2], [a, b]: [f64; 2]) {
    let mass = (a + b).max(f64::MIN_POSITIVE);
    let (a, b) = if a + b > 0.0 { (a / mass, b / mass) } else { (0.5, 0.5) };
    let covariances = [Covariance::new(cloud, i), Covariance::new(cloud, j)];
    let means = [cloud.means[i], cloud.means[j]].map(|mean| mean.map(f64::from));
    let between: [f64; 3] = std::array::from_fn(|k| means[0][k] - means[1][k]);
    let joint = Covariance(std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            a * covariances[0].0[r][c] + b * covariances[1].0[r][c] + a * b * between[r] * between[c]
        })
    }));
    let (scales, quat) = joint.principal_axes();
    let volume: f64 = scales.iter().product();
    // These limits keep logarithms and logits finite.
    cloud.log_scales[i] = scales.map(|s| s.max(1e-9).ln() as Real);
    cloud.quats[i] = quat.map(|q| q as Real);
    cloud.opacity_logits[i] = logit((mass / volume.max(1e-30)).clamp(1e-6, 0.99) as Real);
    let mix = |x: Real, y: Real| (a * f64::from(x) + b * f64::from(y)) as Real;
    cloud.means[i] = std::array::from_fn(|k| mix(cloud.means[i][k], cloud.means[j][k]));
    cloud.signals[i] = std::array::from_fn(|k| mix(cloud.signals[i][k], cloud.signals[j][k]));
    for column in &mut cloud.extra {
        for k in 0..column.width {
            column.values[i * column.width + k] =
                mix(column.values[i * column.width + k], column.values[j * column.width + k]);
        }
    }
}
