//! `Pruner`: which Gaussians stay.

use crate::{
    CloudStats, GaussianCloud, Moment, Real, plugin_kind,
    tape::{Trace, TraceScalar, Traced},
};

/// Decides which Gaussians stay. An immutable value: whatever it must remember lives in columns it asks for.
///
/// Only [`Pruner::keep`] is required. A learned strategy adds columns, a gate and a penalty, written forward-only on the
/// step's tape. Worked example: `pwrfgs_prune::LearnableMask`.
#[typetag::serde]
pub trait Pruner: erased_serde::Serialize + std::any::Any + std::fmt::Debug + Send + Sync {
    /// True for each Gaussian that stays, `[N]`; asked at the prune steps of algorithm 1. Several pruners: all must agree.
    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool>;

    /// Columns to add to the cloud. They survive clone, split, prune and checkpoints.
    fn columns(&self) -> Vec<ColumnSpec> {
        Vec::new()
    }

    /// A factor `[N]` on opacity and scale while training; several gates multiply. A Gaussian whose factor is 0 is
    /// dropped before the network and costs nothing.
    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Trace> {
        let _ = (cloud, moment);
        None
    }

    /// A number added to the loss in the densification and pruning phases.
    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        let _ = (cloud, moment);
        None
    }

    /// New values for columns it asked for that are not learned (moving averages, duals), once after each step.
    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, moment: &Moment) {
        let _ = (cloud, stats, moment);
    }

    /// How much each Gaussian matters, `[N]`, larger is better: who survives when all pruners together would leave
    /// nothing. Opacity by default.
    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats) -> Vec<Real> {
        let _ = stats;
        cloud.opacity_logits.clone()
    }

    /// One line for `pwrfgs plugins`.
    fn about(&self) -> &'static str {
        ""
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Pruner);

/// A column `[N, width]` that a pruner asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnSpec {
    /// Unique within the pipeline; two pruners naming the same column share it.
    pub name: &'static str,
    /// Numbers a Gaussian.
    pub width: usize,
    /// Initial value.
    pub init: Real,
    /// Learning rate for Adam, or `None` for state that only [`Pruner::update`] changes.
    pub learning_rate: Option<Real>,
}
