//! Densification as in 3DGS (algorithm 1, line 9): clone, split, remove, reset opacities.

use crate::adam::Adam;
use crate::edit::{self, PerGaussianState, RemovalsByRule};
use crate::settings::Densify;
use pwrfgs_core::{CloudStats, GaussianCloud, Real, RowOrigin, Vec3, best, logit, rng, sigmoid};

/// Divisor of the scales of the two children of a split, as in 3DGS: 0.8 times the number of children.
pub(crate) const SPLIT_SHRINK: Real = 1.6;
/// Name of the rule that removes by size.
pub(crate) const SIZE_RULE: &str = "`large_above`";

/// Returns whether densification is due after `step`.
pub(crate) fn is_due(settings: &Densify, step: u64) -> bool {
    settings.every > 0 && step > settings.from && step.is_multiple_of(settings.every)
}

/// Returns whether opacities are reset after `step`, unless it ends densification.
pub(crate) fn is_reset_due(settings: &Densify, step: u64) -> bool {
    settings.reset_every > 0 && step.is_multiple_of(settings.reset_every)
}

/// Returns the size of the scene, metres: `extent_m`, or if it is 0, half the diagonal of the `bounds` of the scene.
pub(crate) fn extent(settings: &Densify, (low, high): ([Real; 3], [Real; 3])) -> Real {
    match settings.extent_m {
        0.0 => 0.5 * (Vec3::from_array(high) - Vec3::from_array(low)).length(),
        metres => metres,
    }
}

/// Clones small and splits large Gaussians with a strong 2-D gradient, then removes transparent and oversized ones; keeps
/// at least one. Statistics are reset. `extent` is the size of the scene, metres. Returns the number of Gaussians before
/// the removal, and the number to which each rule applies.
pub(crate) fn densify(
    settings: &Densify,
    extent: Real,
    (seed, step): (u64, u64),
    state: &mut PerGaussianState<'_>,
) -> (usize, RemovalsByRule) {
    let n = state.cloud.len();
    let chosen = select_strong(settings, n, state.stats);
    let (mut rows, mut children) = (Vec::with_capacity(n), Vec::new()); // children: new row and mean
    let mut copies = Vec::new(); // row and whether it is small
    for (i, chosen) in chosen.iter().enumerate() {
        let is_small = largest_scale(state.cloud, i) <= settings.clone_below * extent;
        if !chosen || is_small {
            rows.push(RowOrigin::Kept(i));
        }
        if *chosen {
            copies.extend(std::iter::repeat_n((i, is_small), if is_small { 1 } else { 2 }));
        }
    }
    let mut random = rng::stream(seed, "densify", step);
    for (i, is_small) in copies {
        if !is_small {
            children.push((rows.len(), draw_child_mean(state.cloud, i, &mut random)));
        }
        rows.push(RowOrigin::Copied(i));
    }
    edit::rewrite(&rows, state);
    for (row, mean) in children {
        state.cloud.means[row] = mean;
        state.cloud.log_scales[row].iter_mut().for_each(|s| *s -= SPLIT_SHRINK.ln());
    }
    let before = state.cloud.len();
    (before, remove_by_rules(settings, extent, step, state))
}

/// Returns whether each of the `n` Gaussians is densified: its mean gradient norm reaches the threshold. `max_gaussians`
/// limits this to the largest norms, because each densified Gaussian adds one.
fn select_strong(settings: &Densify, n: usize, stats: &CloudStats) -> Vec<bool> {
    let mean = |i: usize| if stats.visible[i] > 0.0 { stats.gradient[i] / stats.visible[i] } else { 0.0 };
    let mut strong: Vec<usize> = (0..n).filter(|&i| mean(i) >= settings.gradient_threshold).collect();
    if settings.max_gaussians > 0 {
        strong.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
        strong.truncate(settings.max_gaussians.saturating_sub(n));
    }
    let mut chosen = vec![false; n];
    strong.into_iter().for_each(|i| chosen[i] = true);
    chosen
}

/// Draws a point from Gaussian `i`: μ + R(q)·(s ∘ N(0, 1)).
fn draw_child_mean(cloud: &GaussianCloud, i: usize, random: &mut rng::Rng) -> [Real; 3] {
    let [w, x, y, z] = cloud.quats[i];
    let norm = (w * w + x * x + y * y + z * z).sqrt().max(1e-12); // no division by 0
    let (w, v) = (w / norm, Vec3::new(x, y, z) / norm);
    let offset = Vec3::from_array(cloud.log_scales[i].map(|s| s.exp() * rng::normal(random)));
    // Rotation by a unit quaternion: o + 2 v × (v × o + w o).
    let turned = offset + (v.cross(v.cross(offset) + offset * w)) * 2.0;
    (Vec3::from_array(cloud.means[i]) + turned).to_array()
}

/// Removes transparent Gaussians, and oversized ones after `large_after` steps; keeps at least one. Returns the rules
/// and the number of Gaussians to which each applies.
fn remove_by_rules(settings: &Densify, extent: Real, step: u64, state: &mut PerGaussianState<'_>) -> RemovalsByRule {
    let cloud = &*state.cloud;
    let size_limit =
        (settings.large_above > 0.0 && step > settings.large_after).then_some(settings.large_above * extent);
    let is_large = |i: usize| size_limit.is_some_and(|limit| largest_scale(cloud, i) > limit);
    let is_faint = |i: usize| sigmoid(cloud.opacity_logits[i]) < settings.opacity_floor;
    let mut keep: Vec<bool> = (0..cloud.len()).map(|i| !is_faint(i) && !is_large(i)).collect();
    let count = |applies: &dyn Fn(usize) -> bool| (0..cloud.len()).filter(|i| applies(*i)).count();
    let rules = vec![
        (format!("{SIZE_RULE}, {:.2} m", size_limit.unwrap_or_default()), count(&is_large)),
        (format!("`opacity_floor`, {}", settings.opacity_floor), count(&is_faint)),
    ];
    keep_best_if_none(&mut keep, &cloud.opacity_logits, "densification");
    edit::retain(&keep, state);
    rules
}

/// Returns the largest scale of Gaussian `i`, metres.
pub(crate) fn largest_scale(cloud: &GaussianCloud, i: usize) -> Real {
    cloud.log_scales[i].iter().fold(Real::MIN, |m, s| m.max(*s)).exp()
}

/// Keeps the Gaussian with the [best] score if `keep` has none, and warns that `subject` would remove all.
pub(crate) fn keep_best_if_none(keep: &mut [bool], scores: &[Real], subject: &str) {
    if keep.contains(&true) || keep.is_empty() {
        return;
    }
    tracing::warn!("{subject} would remove all Gaussians; the best one is kept");
    keep.copy_from_slice(&best(1, scores, |_| true));
}

/// Lowers all opacities to at most `limit`, and resets their moments.
pub(crate) fn reset_opacities(limit: Real, cloud: &mut GaussianCloud, adam: &mut Adam) {
    cloud.opacity_logits.iter_mut().for_each(|o| *o = o.min(logit(limit)));
    adam.cloud.iter_mut().for_each(|moments| moments.opacity_logits.fill(0.0));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adam::Adam;
    use crate::edit::GaussianIds;
    use pwrfgs_core::ExtraColumn;

    /// Creates a small, a large, a low-gradient and a transparent Gaussian, with a mask column and moments of 1.
    fn scene() -> (GaussianCloud, Adam, CloudStats) {
        let cloud = GaussianCloud {
            means: (0..4).map(|i| [i as Real, 0.0, 0.0]).collect(),
            log_scales: [0.001, 0.1, 0.1, 0.1].map(|s: Real| [s.ln(); 3]).to_vec(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            opacity_logits: [0.5, 0.5, 0.5, 0.001].map(logit).to_vec(),
            signals: (0..4).map(|i| [i as Real, 1.0]).collect(),
            extra: vec![ExtraColumn { name: "mask_logits".into(), width: 1, values: vec![1.0, 2.0, 3.0, 4.0] }],
        };
        let mut adam = Adam::new(&cloud, &[]);
        adam.cloud.iter_mut().for_each(|m| m.columns_mut().for_each(|(_, _, v)| v.fill(1.0)));
        let mut stats = CloudStats::zeros(4);
        stats.visible = vec![2.0, 2.0, 2.0, 0.0];
        stats.gradient = vec![1.0, 2.0, 0.0, 0.0];
        (cloud, adam, stats)
    }

    #[test]
    fn densify_clones_splits_and_removes_by_size_and_opacity() {
        let (mut cloud, mut adam, mut stats) = scene();
        let settings = Densify::default();
        let gaussian_ids = &mut GaussianIds::first(4);
        let mut state = PerGaussianState { cloud: &mut cloud, adam: &mut adam, stats: &mut stats, gaussian_ids };
        densify(&settings, 1.0, (0, 600), &mut state);
        // Kept: 0, 2. Cloned: 0. Split: 1 into two children, without the parent. Removed: 3.
        assert_eq!(cloud.signals.iter().map(|s| s[0]).collect::<Vec<_>>(), [0.0, 2.0, 0.0, 1.0, 1.0]);
        assert_eq!(cloud.extra[0].values, [1.0, 3.0, 1.0, 2.0, 2.0], "copies inherit the mask");
        assert_eq!(cloud.means[2], [0.0; 3], "a clone stays where it is");
        assert!(cloud.means[3] != cloud.means[4], "the children of a split part");
        let child = cloud.log_scales[3][0].exp();
        assert!((child - 0.1 / 1.6).abs() < 1e-6, "a child's scale is the parent's over 1.6, found {child}");
        assert_eq!(adam.cloud[0].opacity_logits, [1.0, 1.0, 0.0, 0.0, 0.0], "new rows have no moments");
        assert_eq!(adam.cloud[1].extra[0].values, [1.0, 1.0, 0.0, 0.0, 0.0]);
        assert_eq!(stats, CloudStats::zeros(5));
        assert_eq!(gaussian_ids.rows, [0, 2, 4, 5, 6], "children are somebody else");
    }

    #[test]
    fn densify_limit_selects_largest_gradients_first() {
        let (mut cloud, mut adam, mut stats) = scene();
        let settings = Densify { max_gaussians: 5, opacity_floor: 0.0, ..Densify::default() };
        let gaussian_ids = &mut GaussianIds::first(4);
        let mut state = PerGaussianState { cloud: &mut cloud, adam: &mut adam, stats: &mut stats, gaussian_ids };
        densify(&settings, 1.0, (0, 600), &mut state);
        assert_eq!(cloud.len(), 5);
        assert_eq!(cloud.signals.iter().filter(|s| s[0] == 1.0).count(), 2, "the large one had the larger gradient");
    }

    #[test]
    fn densify_keeps_last_gaussian() {
        let (mut cloud, mut adam, mut stats) = scene();
        let settings = Densify { opacity_floor: 0.9, gradient_threshold: 100.0, ..Densify::default() };
        let gaussian_ids = &mut GaussianIds::first(4);
        let mut state = PerGaussianState { cloud: &mut cloud, adam: &mut adam, stats: &mut stats, gaussian_ids };
        densify(&settings, 1.0, (0, 600), &mut state);
        assert_eq!(cloud.len(), 1);
    }

    #[test]
    fn best_gaussian_is_kept_and_nan_is_worst() {
        let mut keep = [false; 3];
        keep_best_if_none(&mut keep, &[Real::NAN, 0.5, 0.5], "a test");
        assert_eq!(keep, [false, true, false]);
    }

    #[test]
    fn reset_lowers_opacities_and_clears_only_their_moments() {
        let (mut cloud, mut adam, _) = scene();
        reset_opacities(0.01, &mut cloud, &mut adam);
        assert!(cloud.opacity_logits.iter().all(|o| sigmoid(*o) <= 0.010_001));
        assert!(adam.cloud[0].opacity_logits.iter().all(|m| *m == 0.0));
        assert!(adam.cloud[0].quats.iter().all(|m| *m == [1.0; 4]));
    }
}
