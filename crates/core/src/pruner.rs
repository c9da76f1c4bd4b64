//! `Pruner`: which Gaussians stay.

use crate::{
    CloudStats, Edit, Gate, GaussianCloud, Moment, Needs, Real, Result, plugin_kind,
    tape::{TraceScalar, Traced},
};

/// Decides which Gaussians stay. An immutable value: whatever it must remember lies in columns it asks for, or in its
/// [`Pruner::state`].
///
/// Only [`Pruner::keep`] is required. A learned strategy adds columns, a gate and a penalty, written forward-only on the
/// step's tape. Worked example: `pwrfgs_prune::LearnableMask`.
#[typetag::serde]
pub trait Pruner:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// True for each Gaussian that stays, `[N]`; asked at the prune steps of algorithm 1. Several pruners: all must agree.
    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool>;

    /// What [`CloudStats::asked`] shall hold at a prune step, computed by a pass over training transmitters; nothing where it
    /// would decide nothing. When the pipeline is checked, `cloud` is empty.
    fn needs(&self, cloud: &GaussianCloud, moment: &Moment) -> Needs {
        let _ = (cloud, moment);
        Needs::nothing()
    }

    /// Columns to add to the cloud. They survive clone, split, prune and checkpoints.
    fn columns(&self) -> Vec<ColumnSpec> {
        Vec::new()
    }

    /// A factor `[N]` on each Gaussian while training; several gates multiply. [`Gate`] says what it multiplies, and
    /// whether a closed Gaussian may be left out; `trace.into()` is a factor on opacity and scale, left out where it is 0.
    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Gate> {
        let _ = (cloud, moment);
        None
    }

    /// A number added to the loss in the densification and pruning phases.
    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        let _ = (cloud, moment);
        None
    }

    /// New values for columns it asked for that are not learned (moving averages, duals), once after each step. A strategy
    /// that moves Gaussians (noise on means) does so here too.
    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, moment: &Moment) {
        let _ = (cloud, stats, moment);
    }

    /// Another cloud in place of this one at a prune step, before anybody is asked what to keep: Gaussians moved onto
    /// others, or merged. `None`: nothing to change.
    fn edit(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Option<Edit> {
        let _ = (cloud, stats, moment);
        None
    }

    /// How much each Gaussian matters, `[N]`, larger is better: who stays under a [`Pruner::budget`], and who survives when
    /// all pruners together would leave nothing. Opacity by default.
    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<Real> {
        let _ = (stats, moment);
        cloud.opacity_logits.clone()
    }

    /// The exact number of Gaussians at the end of pruning, where one is set.
    fn budget(&self) -> Option<Budget> {
        None
    }

    /// The same, asked for an exact number; `None` where it takes none.
    fn with_target(&self, target: usize) -> Option<Box<dyn Pruner>> {
        let _ = target;
        None
    }

    /// Whether it may add Gaussians until its [`Pruner::budget`] is reached.
    fn grows(&self) -> bool {
        false
    }

    /// Training steps after which it removes a Gaussian that the data do not need: what it learns has to fall from its
    /// initial value to a threshold. `decays` are those of Adam's two moments. `None` if it does not depend on that.
    fn steps_to_remove(&self, decays: [Real; 2]) -> Option<u64> {
        let _ = decays;
        None
    }

    /// The same for a training of `scale` times the steps, below 1: what it learns falls as far in fewer steps. `None` if
    /// nothing changes.
    fn shortened(&self, scale: f64) -> Option<Box<dyn Pruner>> {
        let _ = scale;
        None
    }

    /// Numbers that it remembers of the pipeline, as they are at the start; `None`: nothing. They are kept in checkpoints
    /// and shown as [`CloudStats::state`].
    fn state(&self) -> Option<Vec<Real>> {
        None
    }

    /// New values of its [`Pruner::state`], once after each prune step: `n` Gaussians were there before, `cloud` is left.
    fn advance(&self, state: &mut [Real], n: usize, cloud: &GaussianCloud, moment: &Moment) {
        let _ = (state, n, cloud, moment);
    }

    /// Whether it can be asked at all: one that is written in another language wants a program that runs it. A training
    /// asks before anything else.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn ready(&self) -> Result<()> {
        Ok(())
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Pruner);

/// An exact number of Gaussians at the end of pruning, and how it is come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// The best by [`Pruner::score`], fewer at each prune step by the same share; [`Pruner::keep`] is not asked.
    Rounds(usize),
    /// Whatever [`Pruner::keep`] says, but never fewer, and at the last prune step exactly so many, by [`Pruner::score`].
    AtLast(usize),
    /// [`Pruner::edit`] sees to it, and nobody else takes any.
    Own(usize),
    /// [`Pruner::keep`] leaves no more at any prune step; fewer will do.
    AtMost(usize),
}

impl Budget {
    /// The number.
    pub fn target(self) -> usize {
        match self {
            Self::Rounds(n) | Self::AtLast(n) | Self::Own(n) | Self::AtMost(n) => n,
        }
    }

    /// What stays of those that all pruners `agreed` on, given the `scores` of the pruner whose budget it is: the best, ties
    /// by index. Who was refused by somebody comes after all others.
    pub fn settle(self, agreed: &[bool], scores: &[Real], moment: &Moment) -> Vec<bool> {
        let open = agreed.iter().filter(|own| **own).count();
        let count = match self {
            Self::Own(_) => return vec![true; agreed.len()],
            Self::AtMost(_) => return agreed.to_vec(),
            Self::Rounds(target) => moment.quota(agreed.len(), target),
            Self::AtLast(target) if moment.round > 0 && moment.round == moment.rounds => target,
            Self::AtLast(target) => open.max(target),
        };
        best(count, scores, |i| agreed[i])
    }
}

/// True for the `count` best by `scores`, those that are `preferred` first; ties by index. What is not a number is worst.
pub fn best(count: usize, scores: &[Real], preferred: impl Fn(usize) -> bool) -> Vec<bool> {
    let number = |i: usize| if scores[i].is_nan() { Real::NEG_INFINITY } else { scores[i] };
    let mut order: Vec<usize> = (0..scores.len()).collect();
    // Stable, so that equal scores stay in order.
    order.sort_by(|&i, &j| preferred(j).cmp(&preferred(i)).then(number(j).total_cmp(&number(i))));
    let mut kept = vec![false; scores.len()];
    order.into_iter().take(count).for_each(|i| kept[i] = true);
    kept
}

/// A column `[N, width]` that a pruner asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnSpec {
    /// Unique within the pipeline; two pruners naming the same column share it.
    pub name: &'static str,
    /// Numbers a Gaussian.
    pub width: usize,
    /// Initial value.
    pub init: Real,
    /// Learning rate, or `None` for state that only [`Pruner::update`] changes.
    pub learning_rate: Option<Real>,
    /// Whether Adam moves it. Where not, x −= rate · N · ∂loss/∂x: the pull of a penalty on the mean over Gaussians then does
    /// not thin out with N, and is not divided by the noise of the picture's derivative either.
    pub adam: bool,
}

impl ColumnSpec {
    /// One number a Gaussian, learned by Adam at `rate`.
    pub fn learned(name: &'static str, init: Real, rate: Real) -> Self {
        Self { name, width: 1, init, learning_rate: Some(rate), adam: true }
    }

    /// One number a Gaussian that only [`Pruner::update`] and [`Pruner::edit`] change.
    pub fn state(name: &'static str, init: Real) -> Self {
        Self { name, width: 1, init, learning_rate: None, adam: true }
    }
}
