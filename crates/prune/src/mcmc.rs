//! Pruner that relocates faint Gaussians to opaque ones.

use crate::covariance::Covariance;
use crate::settings::check_weight;
use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs_core::{
    Budget, CloudEdit, CloudStats, GaussianCloud, JsonSchema, Phase, Pruner, PrunerTraits, Real, RowOrigin,
    StepContext, logit, rng, sigmoid,
    tape::{TraceScalar, TracedCloud},
};
use serde::{Deserialize, Serialize};

/// Moves faint Gaussians onto others, drawn by opacity, without changing the spectra (3DGS-MCMC).
///
/// At a prune step, each Gaussian of opacity 0.005 or less moves onto another Gaussian, drawn with probability
/// proportional to opacity. If k Gaussians then share a position, each takes the opacity 1 − (1 − o)^(1/k), so that
/// their joint transmittance is that of the original. Their scales preserve the blended amplitude: s · o / Σᵢ Σⱼ (i−1
/// over j) (−1)^j o′^(j+1) / √(j+1), i from 1 to k, j below i. The loss gains 0.01 times the mean opacity and 0.01
/// times the mean scale in metres. Noise moves the centres, of faint Gaussians more than of opaque ones: noise
/// · σ(100 (0.005 − o)) · Σ · N(0, 1). Source: 3D Gaussian splatting as Markov chain Monte Carlo, Kheradmand et al.,
/// NeurIPS 2024, eq. (9).
///
/// `training.target_count` is the maximum N. Above it, prune steps remove the Gaussians of lowest opacity in rounds. Below
/// it, each prune step adds at most 5 % of N, in the same way as faint Gaussians move. Without a target, N
/// is constant.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("Mcmc(noise: 0.5)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Mcmc {
    /// Random motion of faint Gaussians per step, 1/m, 0 or more. The paper decreases it from 80 to 0.8 with the
    /// learning rate of the means; here it is constant, because the pruning phase is short.
    pub noise: Real,
}

/// Largest opacity of a Gaussian that moves, as published.
const FAINT: Real = 0.005;
/// Steepness of the noise over opacity, as published.
const STEEPNESS: Real = 100.0;
/// Share of N that a prune step may add, as published.
const GROWTH: Real = 0.05;
/// Weight of the mean opacity in the loss, and of the mean scale in metres, as published.
const PENALTY: Real = 0.01;

impl Default for Mcmc {
    fn default() -> Self {
        Self { noise: 1.0 }
    }
}

#[typetag::serde]
impl Pruner for Mcmc {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { budget: Some(Budget::Gradual), grows: true, ..PrunerTraits::default() }
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase != Phase::Finetune && !cloud.is_empty()).then(|| {
            let opacity = cloud.opacities().mean::<Rank0, _>() * PENALTY;
            opacity + cloud.column("log_scales").exp().mean::<Rank0, _>() * PENALTY
        })
    }

    fn update(&self, cloud: &mut GaussianCloud, _: &CloudStats, context: &StepContext) {
        if self.noise == 0.0 {
            return;
        }
        let mut random = rng::stream(context.seed, "pruner Mcmc noise", context.step);
        for i in 0..cloud.len() {
            let size = self.noise * sigmoid(STEEPNESS * (FAINT - sigmoid(cloud.opacity_logits[i])));
            let draw = [(); 3].map(|()| rng::normal(&mut random));
            let covariance = Covariance::new(cloud, i).0;
            for k in 0..3 {
                cloud.means[i][k] += size * (0..3).map(|j| covariance[k][j] as Real * draw[j]).sum::<Real>();
            }
        }
    }

    /// Moves faint Gaussians onto others and adds copies up to the target; `None` if no row changes.
    fn edit(&self, cloud: &GaussianCloud, _: &CloudStats, context: &StepContext) -> Option<CloudEdit> {
        if context.round == 0 {
            return None;
        }
        let n = cloud.len();
        let opacities: Vec<f64> = cloud.opacity_logits.iter().map(|o| f64::from(sigmoid(*o))).collect();
        let is_opaque = |i: &usize| opacities[*i] > f64::from(FAINT);
        let mut alive: Vec<usize> = (0..n).filter(is_opaque).collect();
        if alive.is_empty() {
            alive = (0..n).collect(); // if all are faint, none counts as faint
        }
        let room = context.target.map_or(0, |target| target.saturating_sub(n));
        let last = context.round == context.rounds;
        let added = if last { room } else { room.min((f64::from(GROWTH) * n as f64) as usize) };
        if alive.is_empty() || (alive.len() == n && added == 0) {
            return None;
        }
        let mut random = rng::stream(context.seed, "pruner Mcmc", context.step);
        let drawn = draw_by_opacity(&alive, &opacities, n - alive.len() + added, &mut random);
        let mut shared = vec![1usize; n]; // Gaussians at the position of each row
        drawn.iter().for_each(|&i| shared[i] += 1);
        // Faint Gaussians take the positions of the first draws, new rows those of the others.
        let mut sources = drawn.into_iter();
        let mut rows: Vec<RowOrigin> = (0..n).map(RowOrigin::Kept).collect();
        for (i, row) in rows.iter_mut().enumerate() {
            if alive.len() < n && !is_opaque(&i) {
                *row = RowOrigin::Copied(sources.next().expect("one draw per faint Gaussian"));
            }
        }
        rows.extend(sources.map(RowOrigin::Copied));
        let order: Vec<usize> = rows.iter().map(|row| row.source()).collect();
        let mut moved = cloud.select(&order);
        for (k, &source) in order.iter().enumerate().filter(|(_, source)| shared[**source] > 1) {
            let (opacity, shrink) = shared_opacity_and_scale(opacities[source], shared[source]);
            moved.opacity_logits[k] = logit(opacity as Real);
            moved.log_scales[k].iter_mut().for_each(|s| *s += shrink.ln() as Real);
            rows[k] = RowOrigin::Copied(source); // Gaussians at a shared position restart their moments
        }
        Some(CloudEdit { cloud: moved, rows })
    }

    fn check(&self) -> Result<(), String> {
        check_weight("noise", self.noise)
    }
}

/// Draws `count` Gaussians of `alive` with replacement, each with probability proportional to its opacity.
fn draw_by_opacity(alive: &[usize], opacities: &[f64], count: usize, random: &mut rng::Rng) -> Vec<usize> {
    let (mut sum, mut sums) = (0.0, Vec::with_capacity(alive.len()));
    for &i in alive {
        sum += opacities[i];
        sums.push(sum);
    }
    let draw = |_| {
        let drawn = f64::from(rng::uniform(random)) * sum;
        alive[sums.partition_point(|s| *s <= drawn).min(alive.len() - 1)]
    };
    (0..count).map(draw).collect()
}

/// Returns the opacity of each of `k` Gaussians that share a position, and the factor on their scales, such that together
/// they blend as one Gaussian of `opacity`; eq. (9) of 3DGS-MCMC.
fn shared_opacity_and_scale(opacity: f64, k: usize) -> (f64, f64) {
    let k = k.min(50); // for larger k, rounding dominates the alternating sum
    let shared = (1.0 - (1.0 - opacity).powf(1.0 / k as f64)).clamp(1e-6, 1.0 - 1e-6); // a finite logit
    let mut sum = 0.0;
    for i in 1..=k {
        let mut binomial = 1.0;
        for j in 0..i {
            let sign = if j % 2 == 0 { 1.0 } else { -1.0 };
            sum += sign * binomial * shared.powi(j as i32 + 1) / ((j + 1) as f64).sqrt();
            binomial *= (i - 1 - j) as f64 / (j + 1) as f64;
        }
    }
    (shared, if sum > 0.0 { opacity / sum } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_preserve_opacity_of_original() {
        // Amplitude over a line through both: o₂ = 1 − √(1−o); 2 o₂ s′ − o₂² s′/√2 = o s.
        for opacity in [0.05, 0.3, 0.8] {
            let (shared, shrink) = shared_opacity_and_scale(opacity, 2);
            assert!((1.0 - (1.0 - shared).powi(2) - opacity).abs() < 1e-12);
            assert!((shrink * (2.0 * shared - shared * shared / 2f64.sqrt()) - opacity).abs() < 1e-12, "{opacity}");
        }
        assert!((shared_opacity_and_scale(0.3, 1).1 - 1.0).abs() < 1e-12);
    }
}
