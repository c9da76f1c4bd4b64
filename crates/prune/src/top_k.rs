//! A budget at once: the best Gaussians stay.

use pwrfgs_core::{Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Pruner, PrunerTraits, Real, best, sigmoid};
use serde::{Deserialize, Serialize};

/// Keeps the best-scored Gaussians at each prune step, at most `training.target`.
///
/// Use it where memory or time is given; `densify.max_gaussians` is its companion, which keeps densification from growing
/// far beyond. Equal scores are taken in the order of the Gaussians. `Weight`, the part in the image that importance-based
/// pruning of visual splatting uses, is the best guide; `Opacity` and `OpacityVolume` need no image.
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
    pub score: Score,
}

/// Importance score of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Score {
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
        PrunerTraits { budget: Some(Budget::AtMost), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        best(moment.target.unwrap_or(cloud.len()), &self.score(cloud, stats, moment), |_| true)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        // What is not a number counts as least.
        let number = |s: Real| if s.is_nan() { Real::NEG_INFINITY } else { s };
        let seen = stats.weight.len() == cloud.len() && stats.weight.iter().any(|w| *w > 0.0);
        let volume = |(logit, scales): (&Real, &[Real; 3])| sigmoid(*logit) * scales.iter().sum::<Real>().exp();
        match self.score {
            Score::Weight if seen => stats.weight.iter().copied().map(number).collect(),
            // The logit orders as the opacity does, and tells apart what rounds to 1.
            Score::Weight | Score::Opacity => cloud.opacity_logits.iter().copied().map(number).collect(),
            Score::OpacityVolume => {
                cloud.opacity_logits.iter().zip(&cloud.log_scales).map(volume).map(number).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{cloud, moment};
    use pwrfgs_core::Phase;

    fn kept(keep: usize, score: Score, cloud: &GaussianCloud, weight: &[Real]) -> Vec<usize> {
        let stats = CloudStats { weight: weight.to_vec(), ..CloudStats::zeros(cloud.len()) };
        let moment = Moment { target: Some(keep), ..moment(Phase::Prune) };
        let kept = TopK { score }.keep(cloud, &stats, &moment);
        (0..cloud.len()).filter(|&i| kept[i]).collect()
    }

    #[test]
    fn each_score_has_its_own_best() {
        let mut cloud = cloud(&[0.0, 2.0, 1.0, -3.0]);
        cloud.log_scales[3] = [2.0; 3];
        let weight = [5.0, 0.0, 7.0, 6.0];
        assert_eq!(kept(2, Score::Weight, &cloud, &weight), [2, 3]);
        assert_eq!(kept(2, Score::Opacity, &cloud, &weight), [1, 2]);
        assert_eq!(kept(1, Score::OpacityVolume, &cloud, &weight), [3]);
        assert_eq!(kept(2, Score::Weight, &cloud, &[0.0; 4]), [1, 2], "nothing drawn: opacity decides");
    }

    #[test]
    fn the_budget_is_exact_even_among_equals() {
        let cloud = cloud(&[1.0; 9]);
        for score in [Score::Weight, Score::Opacity, Score::OpacityVolume] {
            assert_eq!(kept(4, score, &cloud, &[2.0; 9]), [0, 1, 2, 3]);
            assert_eq!(kept(9, score, &cloud, &[2.0; 9]).len(), 9);
            assert_eq!(kept(90, score, &cloud, &[2.0; 9]).len(), 9);
        }
    }

    #[test]
    fn what_is_not_a_number_goes_first() {
        let cloud = cloud(&[Real::NAN, 0.0, -1.0]);
        assert_eq!(kept(2, Score::Opacity, &cloud, &[0.0; 3]), [1, 2]);
    }
}
