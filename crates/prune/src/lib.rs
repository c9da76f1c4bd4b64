//! Pruners, which choose the Gaussians to keep: the learnable mask of the paper, opacity thresholds, budgets and
//! published strategies.
//!
//! The trainer calls the pruners at the prune steps of algorithm 1. It removes each Gaussian that at least one pruner
//! of the list rejects. If all Gaussians would be removed, it keeps the one with the best score.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod common;
mod control_gs;
mod covariance;
mod gaussian_spa;
mod gradients;
mod learnable_mask;
mod lp_3dgs;
mod mask_gaussian;
mod mcmc;
mod merge_by_moments;
mod mini_splatting;
mod natural_selection;
mod pup_3dgs;
mod references;
mod settings;
mod shares;
mod thresholds;

pub use control_gs::ControlGs;
pub use gaussian_spa::GaussianSpa;
pub use gradients::{Taming3dgs, TrimmingTheFat};
pub use learnable_mask::LearnableMask;
pub use lp_3dgs::Lp3dgs;
pub use mask_gaussian::MaskGaussian;
pub use mcmc::Mcmc;
pub use merge_by_moments::MergeByMoments;
pub use mini_splatting::{MiniSplatting, SelectionRule};
pub use natural_selection::NaturalSelection;
pub use pup_3dgs::Pup3dgs;
pub use references::{GreedyElimination, RandomReference};
pub use shares::{LightGaussian, LinkReduction, SignalContribution, SpeedySplat};
pub use thresholds::{ImportanceScore, OpacityThreshold, RadSplat, SafeguardGs, TopK};

/// Gaussian clouds and pruning contexts for tests.
#[cfg(test)]
mod fixture {
    use pwrfgs_core::{ColumnSpec, ExtraColumn, GaussianCloud, Phase, Real, StepContext, Vec3};

    pub(crate) fn context(phase: Phase) -> StepContext {
        StepContext::new(21_000, phase, 0)
    }

    /// Creates a cloud of N Gaussians with unit scale and these opacity logits.
    pub(crate) fn cloud(opacity_logits: &[Real]) -> GaussianCloud {
        let n = opacity_logits.len();
        GaussianCloud {
            means: (0..n).map(|i| Vec3::splat(i as Real).to_array()).collect(),
            log_scales: vec![[0.0; 3]; n],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: opacity_logits.to_vec(),
            signals: vec![[0.0; 2]; n],
            extra: vec![],
        }
    }

    /// Adds a column as the trainer does.
    pub(crate) fn with_column(mut cloud: GaussianCloud, column: &ColumnSpec, values: &[Real]) -> GaussianCloud {
        let (name, width) = (column.name.to_owned(), column.width);
        cloud.extra.push(ExtraColumn { name, width, values: values.to_vec() });
        cloud
    }
}

#[cfg(test)]
mod laws;

#[cfg(test)]
mod tests {
    use pwrfgs_core::{Plugin, Pruner};

    #[test]
    fn rejects_values_out_of_range() {
        for (text, field) in [
            ("LearnableMask(lambda: -0.01)", "lambda"),
            ("LearnableMask(lambda: NaN)", "lambda"),
            ("LearnableMask(threshold: 0.0)", "threshold"),
            ("LearnableMask(threshold: 1.0)", "threshold"),
            ("LearnableMask(initial_logit: -9.0)", "initial_logit"),
            ("LearnableMask(initial_logit: inf)", "initial_logit"),
            ("LearnableMask(learning_rate: 0.0)", "learning_rate"),
            ("OpacityThreshold(epsilon: 1.0)", "epsilon"),
            ("OpacityThreshold(epsilon: NaN)", "epsilon"),
            ("OpacityThreshold(epsilon: -0.1)", "epsilon"),
        ] {
            let why = Plugin::<dyn Pruner>::parse(text).unwrap_err();
            assert!(why.contains(&format!("`{field}`")), "{text}: {why}");
        }
    }
}
