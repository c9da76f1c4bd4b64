//! Pruner that drives opacities towards a sparse vector.

use dfdx::prelude::{Rank0, SumTo};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, GaussianCloud, JsonSchema, Phase, Pruner, PrunerTraits, Real, StepContext, best,
    sigmoid,
    tape::{TraceScalar, TracedCloud, values},
};
use serde::{Deserialize, Serialize};

/// Column of z, the sparse opacities.
const SPARSE: &str = "spa_sparse";
/// Column of u, the scaled dual variable.
const DUAL: &str = "spa_dual";

/// Drives opacities towards a sparse vector with few non-zero entries, by ADMM (GaussianSpa).
///
/// Applies the alternating direction method of multipliers to the opacities o. Every `every` steps of the pruning
/// phase, z becomes o + u with all but the largest k entries set to 0, and u gains o − z. Between these steps the loss
/// gains rho/2 · Σ (o − z + u)². The opacities of superfluous Gaussians fade while training compensates for them. The
/// cut at the last prune step, to the k largest o + u, therefore changes little. Earlier prune steps remove no
/// Gaussians. Source: GaussianSpa, Zhang et al., CVPR 2025, algorithm 1, with rho 5e-4 and 80 % pruned after a first
/// half.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("GaussianSpa(every: 25)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GaussianSpa {
    /// Weight ρ of the distance to the sparse vector, above 0.
    pub rho: Real,
    /// Steps between two projections to the sparse vector, 1 or more.
    pub every: u64,
}

impl Default for GaussianSpa {
    fn default() -> Self {
        Self { rho: 0.0005, every: 50 }
    }
}

#[typetag::serde]
impl Pruner for GaussianSpa {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits {
            // Opacities are never negative: −1 means that no projection has been computed yet.
            columns: vec![ColumnSpec::state(SPARSE, -1.0), ColumnSpec::state(DUAL, 0.0)],
            budget: Some(Budget::FinalStep),
            requires_target: true,
            ..PrunerTraits::default()
        }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        let last = context.round > 0 && context.round == context.rounds;
        let count = if last { kept_count(cloud.len(), context) } else { cloud.len() };
        best(count, &self.score(cloud, stats, context), |_| true)
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        let (z, u) = (values(cloud.leaf(SPARSE)), values(cloud.leaf(DUAL)));
        if context.phase != Phase::Prune || z.is_empty() || z.iter().any(|z| *z < 0.0) {
            return None;
        }
        let away: Vec<Real> = z.iter().zip(u).map(|(z, u)| u - z).collect();
        Some((cloud.opacities() + cloud.constant(away)).square().sum::<Rank0, _>() * (0.5 * self.rho))
    }

    /// Projects the opacities to the sparse vector every `every` steps, and updates the dual variable.
    fn update(&self, cloud: &mut GaussianCloud, _: &CloudStats, context: &StepContext) {
        if context.phase != Phase::Prune || !context.step.is_multiple_of(self.every) || cloud.is_empty() {
            return;
        }
        let opacities: Vec<Real> = cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect();
        let Some(dual) = cloud.extra(DUAL).map(|column| column.values.clone()) else { return };
        let shifted: Vec<Real> = opacities.iter().zip(&dual).map(|(o, u)| o + u).collect();
        let largest = best(kept_count(cloud.len(), context), &shifted, |_| true);
        let projected = |(w, is_large): (&Real, bool)| if is_large { w.max(0.0) } else { 0.0 };
        let sparse: Vec<Real> = shifted.iter().zip(largest).map(projected).collect();
        for column in &mut cloud.extra {
            match column.name.as_str() {
                DUAL => {
                    let pairs = opacities.iter().zip(&sparse);
                    column.values.iter_mut().zip(pairs).for_each(|(u, (o, z))| *u += o - z);
                }
                SPARSE => column.values.clone_from(&sparse),
                _ => {}
            }
        }
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        let opacities = cloud.opacity_logits.iter().map(|o| sigmoid(*o));
        match cloud.extra(DUAL) {
            Some(dual) => opacities.zip(&dual.values).map(|(o, u)| o + u).collect(),
            None => opacities.collect(),
        }
    }

    fn check(&self) -> Result<(), String> {
        let Self { rho, every } = self;
        if !(rho.is_finite() && *rho > 0.0) {
            return Err(format!("`rho` is {rho}; give a number above 0, such as 0.0005"));
        }
        if *every == 0 {
            return Err("`every` is 0; give the number of steps between two projections, such as 50".to_owned());
        }
        Ok(())
    }
}

/// Returns k, the number of Gaussians to keep of `n`: the target, at least 1; all without a target.
fn kept_count(n: usize, context: &StepContext) -> usize {
    context.target.unwrap_or(n).clamp(1, n.max(1))
}
