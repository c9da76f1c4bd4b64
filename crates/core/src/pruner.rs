//! `Pruner`: selection of the Gaussians to keep.

use crate::{
    CloudEdit, CloudStats, Gate, GaussianCloud, Needs, Real, StepContext, plugin_kind,
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
    /// a Gaussian is kept if all keep it. By default, keeps the Gaussians with an open gate ([`Gate::open`]), and all without
    /// a gate.
    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        self.gate(&TracedCloud::new(cloud), context).map_or_else(|| vec![true; cloud.len()], Gate::open)
    }

    /// Returns the statistics for [`CloudStats::requested`] at a prune step, computed by a pass over training transmitters;
    /// nothing if they do not affect the decision. `cloud` is empty when the pipeline is checked.
    fn needs(&self, cloud: &GaussianCloud, context: &StepContext) -> Needs {
        Needs::nothing()
    }

    /// Returns a factor `[N]` on each Gaussian during training; several gates multiply. [`Gate`] defines its effect,
    /// and whether closed Gaussians are skipped; `trace.into()` is a factor on opacity and scale that skips Gaussians
    /// with factor 0.
    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        None
    }

    /// Returns a term added to the loss in the densification and pruning phases.
    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        None
    }

    /// Updates requested columns that are not learned (moving averages, dual variables), once after each step. A
    /// strategy that moves Gaussians (noise on means) does so here too.
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

    /// Returns requested columns and the way in which a target number is reached.
    fn traits(&self) -> PrunerTraits {
        PrunerTraits::default()
    }

    /// Returns a sentence on the number that these settings keep of `initial` Gaussians without a target, for `pwrfgs
    /// check`; `None` if nothing is known.
    fn outlook(&self, initial: usize) -> Option<String> {
        None
    }

    /// Rejects invalid settings when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Pruner);

/// Requested columns of a [`Pruner`], and the way in which it reaches a target number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PrunerTraits {
    /// Columns to add to the cloud. They survive clone, split, prune and checkpoints.
    pub columns: Vec<ColumnSpec>,
    /// Way in which it reaches `training.target_count`; `None` if not supported.
    pub budget: Option<Budget>,
    /// Whether it may add Gaussians until that number is reached.
    pub grows: bool,
    /// Setting that a shorter training increases; `None` if no setting depends on the length.
    pub mask_rate: Option<MaskRate>,
    /// Closing of the mask of an unneeded Gaussian; `None` without such masks.
    pub mask_fall: Option<MaskFall>,
    /// Reason why it cannot run, with the next step: for example, a pruner in another language needs a program that
    /// runs it.
    pub unavailable: Option<String>,
}

/// Learning rate of masks among the settings of a pruner. A training of `scale` times the steps, below 1, divides it by
/// `scale`, so that masks fall equally far in fewer steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskRate {
    /// Name of the setting.
    pub field: &'static str,
    /// Value of the setting.
    pub value: Real,
    /// Maximum value in a shorter training: faster masks close because of noise.
    pub most: Real,
}

impl MaskRate {
    /// Creates the setting `learning_rate` for masks with Adam.
    pub fn adam(value: Real) -> Self {
        Self { field: "learning_rate", value, most: value.max(0.1) }
    }

    /// Returns the value in a training of `scale` times the steps.
    pub fn shortened(&self, scale: f64) -> Real {
        ((f64::from(self.value) / scale) as Real).min(self.most)
    }
}

/// Mask logit m with a penalty on σ(m) only: its gradient is σ(m)·(1 − σ(m)) times a positive factor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskFall {
    /// Initial value of m.
    pub from: Real,
    /// Value of σ(m) at which the mask closes.
    pub to: Real,
    /// Learning rate.
    pub rate: Real,
    /// Positive factor if m moves by its gradient; `None` with Adam, whose steps do not depend on it.
    pub pressure: Option<Real>,
}

/// Maximum number of counted steps until a mask closes.
const MOST_STEPS: u64 = 1_000_000;

impl MaskFall {
    /// Returns the number of training steps until the mask closes, by the update of the optimiser in double precision;
    /// `decays` are those of Adam's moments.
    pub fn steps(&self, decays: [Real; 2]) -> u64 {
        let [beta1, beta2] = decays.map(f64::from);
        let [rate, threshold] = [self.rate, self.to].map(f64::from);
        let (mut m, mut first, mut second) = (f64::from(self.from), 0.0, 0.0);
        let mut step = |k: u64| {
            let open = 1.0 / (1.0 + (-m).exp());
            let slope = open * (1.0 - open);
            first = beta1 * first + (1.0 - beta1) * slope;
            second = beta2 * second + (1.0 - beta2) * slope * slope;
            let unbias = |beta: f64| 1.0 - beta.powf(k as f64);
            let adam = first / unbias(beta1) / (second / unbias(beta2)).sqrt();
            m -= rate * self.pressure.map_or(adam, |pressure| f64::from(pressure) * slope);
            1.0 / (1.0 + (-m).exp()) < threshold
        };
        (1..MOST_STEPS).find(|k| step(*k)).unwrap_or(MOST_STEPS)
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

impl Budget {
    /// Returns the Gaussians to keep for a `target`, from the votes of all pruners (`agreed`) and the `scores` of the
    /// pruner with the target: the best, ties by index. Gaussians that a pruner rejected rank after all others.
    pub fn settle(self, target: usize, agreed: &[bool], scores: &[Real], context: &StepContext) -> Vec<bool> {
        let open = agreed.iter().filter(|own| **own).count();
        let count = match self {
            Self::PrunerManaged => return vec![true; agreed.len()],
            Self::UpperBound => return agreed.to_vec(),
            Self::Gradual => context.quota(agreed.len(), target),
            Self::FinalStep if context.round > 0 && context.round == context.rounds => target,
            Self::FinalStep => open.max(target),
        };
        best(count, scores, |i| agreed[i])
    }
}

/// Returns `true` for the `count` best by `scores`, `preferred` ones first; ties by index. NaN ranks last.
pub fn best(count: usize, scores: &[Real], preferred: impl Fn(usize) -> bool) -> Vec<bool> {
    let number = |i: usize| if scores[i].is_nan() { Real::NEG_INFINITY } else { scores[i] };
    let mut order: Vec<usize> = (0..scores.len()).collect();
    // The sort is stable, so that ties stay in order.
    order.sort_by(|&i, &j| preferred(j).cmp(&preferred(i)).then(number(j).total_cmp(&number(i))));
    let mut kept = vec![false; scores.len()];
    order.into_iter().take(count).for_each(|i| kept[i] = true);
    kept
}

/// Column `[N, width]` that a pruner requests.
#[derive(Clone, Debug, PartialEq)]
pub struct ColumnSpec {
    /// Name, unique within the pipeline; two pruners with the same column share it.
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
