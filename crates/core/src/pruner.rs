//! `Pruner`: which Gaussians stay.

use crate::{
    CloudStats, Edit, Gate, GaussianCloud, Moment, Needs, Real, plugin_kind,
    tape::{TraceScalar, Traced},
};

/// Decides which Gaussians stay. An immutable value: whatever it must remember lies in columns that it asks for; a number
/// of the whole pipeline is a column of one value.
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

    /// How much each Gaussian matters, `[N]`, larger is better: who stays under a [`PrunerTraits::budget`], and who survives when
    /// all pruners together would leave nothing. Opacity by default.
    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<Real> {
        let _ = (stats, moment);
        cloud.opacity_logits.clone()
    }

    /// What it asks for before the first step, and how it comes to a number of Gaussians.
    fn traits(&self) -> PrunerTraits {
        PrunerTraits::default()
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Pruner);

/// What a [`Pruner`] asks for, and how it comes to a number of Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PrunerTraits {
    /// Columns to add to the cloud. They survive clone, split, prune and checkpoints.
    pub columns: Vec<ColumnSpec>,
    /// How it reaches `training.target`; `None` if it cannot.
    pub budget: Option<Budget>,
    /// Whether it may add Gaussians until that number is reached.
    pub grows: bool,
    /// The setting that a shorter training raises; `None` if nothing depends on the length.
    pub mask_rate: Option<MaskRate>,
    /// How a mask of a Gaussian that the data do not need closes; `None` if it has no such masks.
    pub mask_fall: Option<MaskFall>,
    /// Why it cannot be asked at all, and what to do: one that is written in another language wants a program that runs it.
    pub unavailable: Option<String>,
}

/// A learning rate of masks among the settings of a pruner. A training of `scale` times the steps, below 1, divides it by
/// `scale`, so that masks fall as far in fewer steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskRate {
    /// Name of the setting.
    pub field: &'static str,
    /// Its value.
    pub value: Real,
    /// The largest value that a shorter training gives it: a faster mask closes by chance.
    pub most: Real,
}

impl MaskRate {
    /// The setting `learning_rate` of masks that Adam moves.
    pub fn adam(value: Real) -> Self {
        Self { field: "learning_rate", value, most: value.max(0.1) }
    }

    /// The value in a training of `scale` times the steps.
    pub fn shortened(&self, scale: f64) -> Real {
        ((f64::from(self.value) / scale) as Real).min(self.most)
    }
}

/// A mask logit m under the pressure of a penalty on σ(m) alone: its derivative is σ(m)·(1 − σ(m)) times a positive number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskFall {
    /// m at the start.
    pub from: Real,
    /// σ(m) at which the mask closes.
    pub to: Real,
    /// Learning rate.
    pub rate: Real,
    /// That number if m moves by its derivative; `None` if Adam moves it, whose steps do not depend on it.
    pub pressure: Option<Real>,
}

/// Most steps that are counted until a mask closes.
const MOST_STEPS: u64 = 1_000_000;

impl MaskFall {
    /// Training steps until the mask closes, by the update of the optimiser in double precision; `decays` are those of Adam's
    /// two moments.
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

/// How a pruner reaches [`Moment::target`], the number of Gaussians at the end of pruning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// The best by [`Pruner::score`], fewer at each prune step by the same share; [`Pruner::keep`] is not asked.
    Rounds,
    /// Whatever [`Pruner::keep`] says, but never fewer, and at the last prune step exactly so many, by [`Pruner::score`].
    AtLast,
    /// [`Pruner::edit`] sees to it, and nobody else takes any.
    Own,
    /// [`Pruner::keep`] leaves no more at any prune step; fewer will do.
    AtMost,
}

impl Budget {
    /// What stays of those that all pruners `agreed` on, given the `scores` of the pruner that has to reach `target`: the
    /// best, ties by index. Who was refused by somebody comes after all others.
    pub fn settle(self, target: usize, agreed: &[bool], scores: &[Real], moment: &Moment) -> Vec<bool> {
        let open = agreed.iter().filter(|own| **own).count();
        let count = match self {
            Self::Own => return vec![true; agreed.len()],
            Self::AtMost => return agreed.to_vec(),
            Self::Rounds => moment.quota(agreed.len(), target),
            Self::AtLast if moment.round > 0 && moment.round == moment.rounds => target,
            Self::AtLast => open.max(target),
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
