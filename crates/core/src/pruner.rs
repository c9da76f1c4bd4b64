//! `Pruner`: selection of the Gaussians to keep.

use crate::{
    CloudEdit, CloudStats, Gate, GaussianCloud, Needs, Plugin, Real, StepContext, plugin_kind,
    tape::{TraceScalar, TracedCloud},
};

/// Selects the Gaussians to keep. A pruner is immutable: its state is in columns that it requests; state of the whole
/// pipeline is a column with equal values.
///
/// All functions have defaults. A learned strategy adds columns, a gate and a penalty, written forward-only on the tape
/// of the step. Worked example: `pwrfgs_prune::LearnableMask`.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Pruner: crate::plugin::PluginObject {
    /// Returns `true` for each Gaussian to keep, `[N]`. Called at the prune steps of algorithm 1; with several pruners,
    /// a Gaussian is kept if all keep it. By default, keeps the Gaussians with an open gate ([`Gate::open_mask`]), and
    /// all without a gate.
    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        self.gate(&TracedCloud::new(cloud), context).map_or_else(|| vec![true; cloud.len()], Gate::open_mask)
    }

    /// Returns the statistics for [`CloudStats::requested`] at a prune step, computed by a pass over training transmitters;
    /// none by default, or if they do not affect the decision. `cloud` is empty when the pipeline is checked.
    fn needs(&self, cloud: &GaussianCloud, context: &StepContext) -> Needs {
        Needs::default()
    }

    /// Returns a factor `[N]` on each Gaussian in the densification and pruning phases; several gates multiply. [`Gate`] defines
    /// its effect, and whether closed Gaussians are skipped; `trace.into()` is a factor on opacity and scale that skips
    /// Gaussians with factor 0. `None` without a gate.
    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        None
    }

    /// Returns a term added to the loss in the densification and pruning phases; `None` by default.
    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        None
    }

    /// Returns whether it acts between prune steps: by a gate, a penalty or an update. Only steps in which no pruner acts run on
    /// a [device that keeps the parameters](crate::DeviceStepper).
    fn acts_between(&self) -> bool {
        true
    }

    /// Updates requested columns that are not learned (moving averages, dual variables), after each step of the densification and
    /// pruning phases, before [`Pruner::edit`]. [`CloudStats::requested`] is empty. A strategy that moves Gaussians (noise on
    /// means) does so here too.
    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, context: &StepContext) {}

    /// Returns a new cloud at a prune step, before the calls of [`Pruner::keep`], with moved or merged Gaussians.
    /// `None` for no change.
    fn edit(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Option<CloudEdit> {
        None
    }

    /// Returns the importance of each Gaussian, `[N]`, larger is better. It selects Gaussians under a
    /// [`PrunerTraits::budget`], and the one to keep if all pruners together would remove all. Opacity by default.
    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<Real> {
        cloud.opacity_logits.clone()
    }

    /// Returns the requested columns, and how the pruner reaches a target number.
    fn traits(&self) -> PrunerTraits {
        PrunerTraits::default()
    }

    /// Returns a sentence on the number that these settings keep of `initial` Gaussians without a target, for `pwrfgs
    /// check`; `None` if nothing is known.
    fn outlook(&self, initial: usize) -> Option<String> {
        None
    }

    /// Returns this pruner for a training of `scale` times the steps, below 1, with a learning rate at which masks close
    /// in fewer steps; `None` if no setting depends on the number of steps.
    fn shortened(&self, scale: f64) -> Option<Box<dyn Pruner>> {
        None
    }

    /// Returns the number of training steps until the mask of an unneeded Gaussian closes, with Adam moments of these
    /// `decays`; `None` if it is unknown.
    fn steps_to_close(&self, decays: [Real; 2]) -> Option<u64> {
        None
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Pruner);

/// Requested columns of a [`Pruner`], and how it reaches a target number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PrunerTraits {
    /// Columns to add to the cloud. They survive clone, split, prune and checkpoints.
    pub columns: Vec<ColumnSpec>,
    /// Way in which it reaches `training.target_count`; `None` if not supported.
    pub budget: Option<Budget>,
    /// Whether it removes Gaussians only to reach that number; such a pipeline is rejected without a target.
    pub requires_target: bool,
    /// Whether it may add Gaussians until that number is reached.
    pub grows: bool,
    /// Reason why it cannot run, with the next step: for example, a pruner in another language needs a program that
    /// runs it.
    pub unavailable: Option<String>,
}

impl PrunerTraits {
    /// Returns the learning rate of the masks: that of the first learned column; `None` without such a column.
    pub fn mask_rate(&self) -> Option<Real> {
        self.columns.iter().find_map(|column| column.learning_rate)
    }
}

/// Way in which a pruner reaches [`StepContext::target`], the number of Gaussians at the end of pruning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// The best by [`Pruner::score`], reduced by an equal share at each prune step; [`Pruner::keep`] is not used.
    Gradual,
    /// [`Pruner::keep`] decides, with at least the target number; at the last prune step exactly this number, by
    /// [`Pruner::score`].
    FinalStep,
    /// [`Pruner::edit`] reaches the target; no other pruner removes Gaussians.
    PrunerManaged,
    /// [`Pruner::keep`] leaves at most this number at each prune step; fewer are allowed.
    UpperBound,
}

/// `training.target_count` and the pruner that must reach it: the first that supports a target.
#[derive(Clone, Copy, Debug)]
pub struct PruneTarget {
    /// Index of the pruner in the list.
    pub pruner: usize,
    /// Way in which the pruner reaches the target.
    pub budget: Budget,
    /// Number of Gaussians at the end of pruning.
    pub target: usize,
}

impl PruneTarget {
    /// Returns `target` with the first pruner that supports one; `None` if `target` is 0, or no pruner does.
    pub fn of(pruners: &[Plugin<dyn Pruner>], target: usize) -> Option<Self> {
        let mut budgets = pruners.iter().enumerate().filter_map(|(k, pruner)| Some((k, pruner.traits().budget?)));
        let (pruner, budget) = budgets.next().filter(|_| target > 0)?;
        Some(Self { pruner, budget, target })
    }

    /// Returns whether the target is exact rather than an upper limit.
    pub fn is_exact(&self) -> bool {
        self.budget != Budget::UpperBound
    }

    /// Returns whether its pruner, or a densification up to `densified` Gaussians, may reach `n` Gaussians.
    pub fn can_reach(&self, pruners: &[Plugin<dyn Pruner>], densified: usize, n: usize) -> bool {
        densified >= n || pruners[self.pruner].traits().grows
    }
}

/// Returns `context` for each pruner; only the first that supports a target, as in [`PruneTarget::of`], receives
/// [`StepContext::target`].
pub fn prune_contexts(pruners: &[Plugin<dyn Pruner>], context: &StepContext) -> Vec<StepContext> {
    let first = pruners.iter().position(|pruner| pruner.traits().budget.is_some());
    let context_of = |k: usize| StepContext { target: context.target.filter(|_| first == Some(k)), ..*context };
    (0..pruners.len()).map(context_of).collect()
}

/// Returns `true` for the `count` best by `scores`, `[N]`. All `preferred` ones rank before the others, ties by index, NaN last.
pub fn best(count: usize, scores: &[Real], preferred: impl Fn(usize) -> bool) -> Vec<bool> {
    let number = |i: usize| if scores[i].is_nan() { Real::NEG_INFINITY } else { scores[i] };
    let mut order: Vec<usize> = (0..scores.len()).collect();
    // The sort is stable, so that ties stay in order.
    order.sort_by(|&i, &j| preferred(j).cmp(&preferred(i)).then(number(j).total_cmp(&number(i))));
    let mut is_best = vec![false; scores.len()];
    order.into_iter().take(count).for_each(|i| is_best[i] = true);
    is_best
}

/// Column `[N, width]` that a pruner requests.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnSpec {
    /// Name. Pruners that request one name share the column, as the first of them specifies it.
    pub name: &'static str,
    /// Number of values per Gaussian.
    pub width: usize,
    /// Initial value.
    pub init: Real,
    /// Learning rate, or `None` for state that only [`Pruner::update`] changes.
    pub learning_rate: Option<Real>,
    /// Whether Adam updates it. Otherwise x −= rate · N · ∂loss/∂x: the effect of a penalty on the mean over Gaussians
    /// then does not decrease with N, and is not divided by the noise of the gradient.
    pub adam: bool,
}

impl ColumnSpec {
    /// Creates a column with one value per Gaussian, learned by Adam at `rate`.
    pub fn learned(name: &'static str, init: Real, rate: Real) -> Self {
        Self { name, width: 1, init, learning_rate: Some(rate), adam: true }
    }

    /// Creates a column with one value per Gaussian that only [`Pruner::update`] and [`Pruner::edit`] change.
    pub fn state(name: &'static str, init: Real) -> Self {
        Self { name, width: 1, init, learning_rate: None, adam: true }
    }
}
