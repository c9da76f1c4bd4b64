//! Published pruners that score below random removal on s23 at N = 24, 157 and 2,613, with published and with fitted
//! constants (docs/results.md). `use more_pruners as _;` links them into a program. `pareto.ron` has their runs.

use pwrfgs::core::{best, neighbours, sigmoid};
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
        let is_requested = stats.requested.high_error.len() == cloud.len();
        self.score(cloud, stats, context).iter().map(|score| !is_requested || *score >= 1.0 - self.blame).collect()
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

/// Removes the less opaque half of the Gaussians with many overlaps (Reduced-3DGS).
///
/// Two Gaussians overlap if their centres are closer than the sum of their largest scales. For each Gaussian the
/// `neighbours` nearest ones are tested. A Gaussian is crowded if its overlap count exceeds the mean by more than
/// `deviations` standard deviations. Prune steps remove the `share` of the crowded Gaussians with the lowest opacity.
/// The score uses only the cloud, so it works for any method. Under `training.target_count` the Gaussians with the highest
/// counts are removed first, then those of lowest opacity. On s23, it scores below random removal at N = 24, 157 and
/// 2,613. Source: Reducing the memory footprint of 3DGS, Papantonakis et al., I3D 2024, with spheres in place of its ray
/// test.
///
/// ```
/// # use more_pruners as _;
/// # use pwrfgs::prelude::*;
/// Plugin::<dyn Pruner>::parse("Reduced3dgs(deviations: 1.0)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Reduced3dgs {
    /// Number of nearest neighbours tested for overlap, 1 or more.
    pub neighbours: usize,
    /// Gaussians with an overlap count this many standard deviations above the mean are crowded.
    pub deviations: Real,
    /// Share of the crowded Gaussians that is removed, from 0 to 1.
    pub share: Real,
}

impl Default for Reduced3dgs {
    fn default() -> Self {
        Self { neighbours: 30, deviations: 1.0, share: 0.5 }
    }
}

#[typetag::serde]
impl Pruner for Reduced3dgs {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), ..PrunerTraits::default() }
    }

    fn keep(&self, cloud: &GaussianCloud, _: &CloudStats, context: &StepContext) -> Vec<bool> {
        let mut keep = vec![true; cloud.len()];
        if context.round == 0 {
            return keep;
        }
        let counts = overlap_counts(cloud, self.neighbours);
        let n = counts.len().max(1) as Real;
        let mean = counts.iter().sum::<Real>() / n;
        let deviation = (counts.iter().map(|c| (c - mean).powi(2)).sum::<Real>() / n).sqrt();
        let crowded: Vec<usize> =
            (0..counts.len()).filter(|&i| counts[i] > mean + self.deviations * deviation).collect();
        let opacities: Vec<Real> = crowded.iter().map(|&i| cloud.opacity_logits[i]).collect();
        let removed = (crowded.len() as f64 * f64::from(self.share) + 1e-6).floor() as usize; // 0.7 of 10 are 7
        let kept = best(crowded.len() - removed, &opacities, |_| true);
        crowded.iter().zip(kept).for_each(|(&i, stays)| keep[i] = stays);
        keep
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        let counts = overlap_counts(cloud, self.neighbours);
        cloud.opacity_logits.iter().zip(counts).map(|(o, count)| sigmoid(*o) - count).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_share("share", self.share)?;
        check_neighbours(self)
    }
}

/// Rejects a number of neighbours of 0 and infinite deviations.
fn check_neighbours(settings: &Reduced3dgs) -> Result<(), String> {
    if settings.neighbours == 0 || !settings.deviations.is_finite() {
        return Err(
            "`neighbours` must be at least 1 and `deviations` a finite number; give 30 and 1.0, for example".to_owned()
        );
    }
    Ok(())
}

/// Returns the number of its `count` nearest neighbours that each Gaussian overlaps; 0 if a position is not finite.
fn overlap_counts(cloud: &GaussianCloud, count: usize) -> Vec<Real> {
    let finite = cloud.means.as_flattened().iter().all(|v| v.is_finite());
    if !finite || cloud.len() < 2 {
        return vec![0.0; cloud.len()];
    }
    let radius = |i: usize| cloud.log_scales[i].iter().copied().fold(Real::NEG_INFINITY, Real::max).exp();
    let nearest = neighbours::k_nearest(&cloud.means, &cloud.means, (count + 1).min(cloud.len()));
    let touching = |(i, near): (usize, &Vec<(usize, Real)>)| {
        let touches = |&&(j, squared): &&(usize, Real)| j != i && squared.sqrt() < radius(i) + radius(j);
        near.iter().filter(touches).count() as Real
    };
    nearest.iter().enumerate().map(touching).collect()
}

/// Rejects a number outside 0 to 1; the error names the `field`.
fn check_share(field: &str, value: Real) -> Result<(), String> {
    if (0.0..=1.0).contains(&value) { Ok(()) } else { Err(format!("`{field}` is {value}; give a number from 0 to 1")) }
}

#[cfg(test)]
mod tests;
