//! Pruner based on single pixels: the most important Gaussians per pixel (SafeguardGS).

use crate::rounds::requested_statistic;
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Needs, Pruner, PrunerTraits, Real, Statistic, StepContext,
};
use serde::{Deserialize, Serialize};

/// Keeps the top-ranked Gaussians of every pixel of every transmitter (SafeguardGS).
///
/// In each pixel, splats are ranked by exp(−|‖s‖ − P|) · w, with the strength ‖s‖ of the splat, the measured value P of
/// the pixel and the blending weight w = γ·T. The first `of_pixel` splats are kept: visible ones that agree with the
/// measurement. No pixel loses all its Gaussians, which matters most for small N. With `training.target_count`, the kept
/// Gaussians rank first, ordered by weight. Source: SafeguardGS, Lee et al., 2024, with amplitudes in place of colours.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("SafeguardGs(of_pixel: 1)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SafeguardGs {
    /// Number of Gaussians kept per pixel, from 1 to 64.
    pub of_pixel: usize,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for SafeguardGs {
    fn default() -> Self {
        Self { of_pixel: 1, transmitters: 256 }
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
        Needs::of(&[Statistic::Top { count: self.of_pixel }, Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Vec<Real> {
        let weight = requested_statistic(&stats.requested.weight, cloud);
        let (n, mut sorted) = (weight.len(), weight.clone());
        sorted.sort_by(Real::total_cmp);
        let rank = |w: &Real| sorted.partition_point(|other| other.total_cmp(w).is_lt());
        let safe = |i: usize| stats.requested.top.get(i).is_some_and(|top| *top);
        weight.iter().enumerate().map(|(i, w)| (rank(w) + if safe(i) { n } else { 0 }) as Real).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_places(self.of_pixel)
    }
}

fn check_places(of_pixel: usize) -> Result<(), String> {
    if (1..=64).contains(&of_pixel) {
        return Ok(());
    }
    Err(format!("`of_pixel` is {of_pixel}; give a number from 1 to 64"))
}
