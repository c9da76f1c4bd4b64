//! `FastGs`: removal by large errors.

use crate::check_share;
use pwrfgs::prelude::*;

/// Removes Gaussians that repeatedly cover pixels with large errors (FastGS).
///
/// For each training transmitter, the pixels of high error that a Gaussian covers are counted and multiplied by the
/// mean absolute error of the spectrum. The sums, scaled to 0 to 1, are the blame score; Gaussians above `blame` are
/// removed. A pixel has a high error if its error exceeds the fraction `high` of the range from the smallest to the
/// largest error of the spectrum. The score finds large, misplaced Gaussians. It does not measure importance: on s23, it
/// scores below random removal at N = 24, 157 and 2,613. Source: FastGS, Ren et al., 2025, view-consistent pruning.
///
/// ```
/// # use more_pruners as _;
/// # use pwrfgs::prelude::*;
/// Plugin::<dyn Pruner>::parse("FastGs(blame: 0.9)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FastGs {
    /// Gaussians with a larger blame score are removed, from 0 to 1.
    pub blame: Real,
    /// Threshold of a large error, between the smallest (0) and the largest (1) error of a spectrum.
    pub high: Real,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for FastGs {
    fn default() -> Self {
        Self { blame: 0.9, high: 0.1, transmitters: 64 }
    }
}

#[typetag::serde]
impl Pruner for FastGs {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        let known = stats.requested.high_error.len() == cloud.len();
        self.score(cloud, stats, context).iter().map(|score| !known || *score >= 1.0 - self.blame).collect()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::Error { high: self.high }], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let blame = &stats.requested.high_error;
        if blame.len() != cloud.len() {
            return cloud.opacity_logits.clone(); // no pass over the spectra yet
        }
        let (low, high) = blame.iter().fold((Real::INFINITY, 0.0 as Real), |(a, b), v| (a.min(*v), b.max(*v)));
        let width = (high - low).max(Real::MIN_POSITIVE);
        blame.iter().map(|v| 1.0 - (v - low) / width).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_share("blame", self.blame)?;
        check_share("high", self.high)
    }
}
