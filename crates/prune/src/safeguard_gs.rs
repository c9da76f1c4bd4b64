//! Whatever some pixel needs.

use crate::rounds::asked;
use pwrfgs_core::{
    Budget, CloudStats, GaussianCloud, JsonSchema, Moment, Needs, Pruner, PrunerTraits, Real, Statistic,
};
use serde::{Deserialize, Serialize};

/// Keeps the top-ranked Gaussians of every pixel of every transmitter (SafeguardGS).
///
/// In each pixel splats are ranked by exp(−|‖s‖ − P|) · w, with the splat's own strength ‖s‖, what was measured there P, and
/// the blending weight w = γ·T: those that show, and show what is there. The first `of_pixel` are safe (SafeguardGS, Lee et
/// al., 2024, with amplitudes in place of colours). No pixel is left empty, which matters most when few are left. With
/// `training.target` those that are safe come first, by weight.
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
        PrunerTraits { budget: Some(Budget::Rounds), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<bool> {
        if stats.asked.top.len() == cloud.len() { stats.asked.top.clone() } else { vec![true; cloud.len()] }
    }

    fn needs(&self, _: &GaussianCloud, _: &Moment) -> Needs {
        Needs::of(&[Statistic::Top { count: self.of_pixel }, Statistic::Weight], self.transmitters)
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &Moment) -> Vec<Real> {
        let weight = asked(&stats.asked.weight, cloud);
        let (n, mut sorted) = (weight.len(), weight.clone());
        sorted.sort_by(Real::total_cmp);
        let rank = |w: &Real| sorted.partition_point(|other| other.total_cmp(w).is_lt());
        let safe = |i: usize| stats.asked.top.get(i).is_some_and(|top| *top);
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
