//! Pruners by threshold or budget: low opacity, low blending weight, low rank in every pixel, or a fixed number of best-scored
//! Gaussians.

use crate::common::requested_statistic;
use crate::settings::check_share;
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext, best,
    sigmoid,
};
use serde::{Deserialize, Serialize};

/// Keeps Gaussians with an opacity o = σ(logit) of at least `epsilon` (WRF-GS).
///
/// At the value 0.005 of the paper this pruner removes nearly transparent Gaussians and complements
/// [`crate::LearnableMask`] (section IV; a Gaussian is kept only if both pruners keep it). Alone, with 0.005 to 0.5, it
/// is the WRF-GS baseline of fig. 2b. Opacity is not importance, so quality falls quickly. It acts at prune steps only.
/// Densification has its own threshold, `opacity_floor`, because every Gaussian starts at 0.1 and each opacity reset
/// sets it to 0.01 at most.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("OpacityThreshold(epsilon: 0.1)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct OpacityThreshold {
    /// Smallest opacity ε that is kept, from 0 (all Gaussians) to below 1.
    pub epsilon: Real,
}

impl Default for OpacityThreshold {
    fn default() -> Self {
        Self { epsilon: 0.005 }
    }
}

#[typetag::serde]
impl Pruner for OpacityThreshold {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<bool> {
        cloud.opacity_logits.iter().map(|logit| sigmoid(*logit) >= self.epsilon).collect()
    }

    fn acts_between(&self) -> bool {
        false
    }

    fn check(&self) -> Result<(), String> {
        if (0.0..1.0).contains(&self.epsilon) {
            return Ok(());
        }
        Err(format!("`epsilon` is {}; give an opacity from 0 to below 1, such as 0.005", self.epsilon))
    }
}

/// Keeps Gaussians with a blending weight of at least `threshold` in any pixel of any transmitter (RadSplat).
///
/// The score is max w, the largest blending weight γ·T over all pixels and training transmitters. A maximum keeps
/// Gaussians that a single pixel needs; a sum keeps Gaussians that are often visible. Of two equal Gaussians in one
/// direction, the front one is kept. Source: RadSplat, Niemeyer et al., 3DV 2025, eq. (12), with a threshold of 0.01,
/// and 0.25 for a light model.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("RadSplat(threshold: 0.01)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RadSplat {
    /// Smallest blending weight that is kept, from 0 to 1.
    pub threshold: Real,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for RadSplat {
    fn default() -> Self {
        Self { threshold: 0.01, transmitters: 0 }
    }
}

#[typetag::serde]
impl Pruner for RadSplat {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<bool> {
        let is_requested = stats.requested.largest_weight.len() == cloud.len();
        (0..cloud.len()).map(|i| !is_requested || stats.requested.largest_weight[i] >= self.threshold).collect()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::LargestWeight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        requested_statistic(&stats.requested.largest_weight, cloud)
    }

    fn check(&self) -> Result<(), String> {
        check_share("threshold", self.threshold)
    }
}

/// Keeps the best-scored Gaussians at each prune step, at most `training.target_count`.
///
/// Use it for a fixed memory or time budget. `densify.max_gaussians` complements it: it limits growth during
/// densification. The first prune step already removes all others; most pruners remove an equal share at each prune
/// step. Ties follow the order of the Gaussians. `Weight`, the blending weight used by importance-based
/// pruning of visual splatting, ranks best; `Opacity` and `OpacityVolume` need no render.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("TopK(score: Weight)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TopK {
    /// Score by which Gaussians are ranked.
    pub score: ImportanceScore,
}

/// Importance score of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum ImportanceScore {
    /// Sum of the blending weights γ·T over pixels and renders since the last densification; opacity if nothing was
    /// rendered since.
    #[default]
    Weight,
    /// Opacity.
    Opacity,
    /// Opacity times the product of the scales.
    OpacityVolume,
}

#[typetag::serde]
impl Pruner for TopK {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::UpperBound), requires_target: true, ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        best(context.target.unwrap_or(cloud.len()), &self.score(cloud, stats, context), |_| true)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        // NaN ranks lowest.
        let number = |s: Real| if s.is_nan() { Real::NEG_INFINITY } else { s };
        let has_weights = stats.weight.len() == cloud.len() && stats.weight.iter().any(|w| *w > 0.0);
        let volume = |(logit, scales): (&Real, &[Real; 3])| sigmoid(*logit) * scales.iter().sum::<Real>().exp();
        match self.score {
            ImportanceScore::Weight if has_weights => stats.weight.iter().copied().map(number).collect(),
            // The logit has the order of the opacity, and distinguishes opacities that round to 1.
            ImportanceScore::Weight | ImportanceScore::Opacity => {
                cloud.opacity_logits.iter().copied().map(number).collect()
            }
            ImportanceScore::OpacityVolume => {
                cloud.opacity_logits.iter().zip(&cloud.log_scales).map(volume).map(number).collect()
            }
        }
    }
}

/// Keeps the top-ranked Gaussian of every pixel of every transmitter (SafeguardGS).
///
/// In each pixel, splats are ranked by exp(−|‖s‖ − P|) · w, with the strength ‖s‖ of the splat, the measured value P of
/// the pixel and the blending weight w = γ·T. The first splat is kept: a visible one that agrees with the measurement.
/// No pixel loses all its Gaussians, which matters most for small N. With `training.target_count`, the kept
/// Gaussians rank first, ordered by weight. Source: SafeguardGS, Lee et al., 2024, with amplitudes in place of colours.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("SafeguardGs(transmitters: 64)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SafeguardGs {
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for SafeguardGs {
    fn default() -> Self {
        Self { transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for SafeguardGs {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<bool> {
        if stats.requested.top.len() == cloud.len() { stats.requested.top.clone() } else { vec![true; cloud.len()] }
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::Top { count: 1 }, Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let weight = requested_statistic(&stats.requested.weight, cloud);
        let (n, mut sorted) = (weight.len(), weight.clone());
        sorted.sort_by(Real::total_cmp);
        let rank = |w: &Real| sorted.partition_point(|other| other.total_cmp(w).is_lt());
        let is_top = |i: usize| stats.requested.top.get(i).is_some_and(|top| *top);
        weight.iter().enumerate().map(|(i, w)| (rank(w) + if is_top(i) { n } else { 0 }) as Real).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{cloud, context};
    use pwrfgs_core::{Phase, logit};

    #[test]
    fn keeps_opacities_of_at_least_epsilon() {
        let cloud = cloud(&[logit(0.0049), logit(0.0051), 0.0, 40.0, -40.0]);
        let keep = |epsilon| OpacityThreshold { epsilon }.keep(&cloud, &CloudStats::zeros(5), &context(Phase::Prune));
        assert_eq!(keep(0.005), [false, true, true, true, false]);
        assert_eq!(keep(0.5), [false, false, true, true, false]);
        assert_eq!(keep(0.0), [true; 5]);
    }

    fn kept(keep: usize, score: ImportanceScore, cloud: &GaussianCloud, weight: &[Real]) -> Vec<usize> {
        let stats = CloudStats { weight: weight.to_vec(), ..CloudStats::zeros(cloud.len()) };
        let context = StepContext { target: Some(keep), ..context(Phase::Prune) };
        let kept = TopK { score }.keep(cloud, &stats, &context);
        (0..cloud.len()).filter(|&i| kept[i]).collect()
    }

    #[test]
    fn each_score_has_its_own_ranking() {
        let mut cloud = cloud(&[0.0, 2.0, 1.0, -3.0]);
        cloud.log_scales[3] = [2.0; 3];
        let weight = [5.0, 0.0, 7.0, 6.0];
        assert_eq!(kept(2, ImportanceScore::Weight, &cloud, &weight), [2, 3]);
        assert_eq!(kept(2, ImportanceScore::Opacity, &cloud, &weight), [1, 2]);
        assert_eq!(kept(1, ImportanceScore::OpacityVolume, &cloud, &weight), [3]);
        assert_eq!(kept(2, ImportanceScore::Weight, &cloud, &[0.0; 4]), [1, 2], "nothing drawn: opacity decides");
    }

    #[test]
    fn target_count_is_exact_for_equal_scores() {
        let cloud = cloud(&[1.0; 9]);
        for score in [ImportanceScore::Weight, ImportanceScore::Opacity, ImportanceScore::OpacityVolume] {
            assert_eq!(kept(4, score, &cloud, &[2.0; 9]), [0, 1, 2, 3]);
            assert_eq!(kept(9, score, &cloud, &[2.0; 9]).len(), 9);
            assert_eq!(kept(90, score, &cloud, &[2.0; 9]).len(), 9);
        }
    }

    #[test]
    fn nan_scores_are_removed_first() {
        let cloud = cloud(&[Real::NAN, 0.0, -1.0]);
        assert_eq!(kept(2, ImportanceScore::Opacity, &cloud, &[0.0; 3]), [1, 2]);
    }
}
