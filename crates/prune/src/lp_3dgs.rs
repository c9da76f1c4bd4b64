//! Learned mask on top of an importance score.

use crate::common::{logistic_noise, quantile, shortened_rate};
use crate::settings::{check_rate, check_weight};
use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs_core::{
    Budget, CloudEdit, CloudStats, ColumnSpec, Gate, GaussianCloud, JsonSchema, Needs, Phase, Pruner, PrunerTraits,
    Real, RowOrigin, Statistic, StepContext, rng,
    tape::{Trace, TraceScalar, TracedCloud},
};
use serde::{Deserialize, Serialize};

/// Column of logits m.
const COLUMN: &str = "lp_logits";
/// Column of ln(S/S̃).
const IMPORTANCE: &str = "lp_importance";
/// Initial mask logit m; σ(3) is 0.95, so that training starts with nearly all Gaussians.
const INITIAL_LOGIT: Real = 3.0;
/// Lower limit of the importance, so that its logarithm is finite.
const FAINTEST: Real = 1e-6;
/// Temperature of the Gumbel-sigmoid; lower values give samples closer to 0 or 1.
const TEMPERATURE: Real = 0.5;

/// Learns masks that start from an importance score per Gaussian (LP-3DGS).
///
/// The keep probability is σ(m + ln(S/S̃)). The importance S of a Gaussian is its largest blending weight in any pixel
/// of any transmitter, as in RadSplat; S̃ is the median. The ratio S/S̃ multiplies the odds of a learned logit m.
/// During training, γ of a Gaussian is multiplied by the relaxed sample σ((m + ln(S/S̃) + g)/0.5) with logistic noise g.
/// The loss gains lambda times the mean keep probability. Prune steps keep the Gaussians with a probability of at least
/// one half. S is measured at each prune step; before the first, S/S̃ is 1.
/// Source: LP-3DGS, Zhang et al., NeurIPS 2024, section 3.2, whose Gumbel-sigmoid mask finds the share to prune by
/// itself.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("Lp3dgs(lambda: 0.02)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Lp3dgs {
    /// Weight λ of the penalty, 0 or more.
    pub lambda: Real,
    /// Learning rate of the mask logit m (Adam).
    pub learning_rate: Real,
    /// Number of training transmitters used for the score; 0 for all.
    pub transmitters: usize,
}

impl Default for Lp3dgs {
    fn default() -> Self {
        Self { lambda: 0.01, learning_rate: 0.01, transmitters: 256 }
    }
}

#[typetag::serde]
impl Pruner for Lp3dgs {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits {
            columns: vec![
                ColumnSpec::learned(COLUMN, INITIAL_LOGIT, self.learning_rate),
                ColumnSpec::state(IMPORTANCE, 0.0),
            ],
            budget: Some(Budget::FinalStep),
            ..PrunerTraits::default()
        }
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        // A logit of 0 is a probability of one half.
        self.score(cloud, stats, context).iter().map(|logit| *logit >= 0.0).collect()
    }

    fn needs(&self, _: &GaussianCloud, _: &StepContext) -> Needs {
        Needs::of(&[Statistic::LargestWeight], self.transmitters)
    }

    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        if context.phase == Phase::Finetune {
            return None;
        }
        let mut random = rng::stream(context.seed, "pruner Lp3dgs", context.step);
        let noise = cloud.constant(logistic_noise(cloud.len(), &mut random));
        Some(Gate::Existence(((keep_logits(cloud) + noise) / TEMPERATURE).sigmoid()))
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase != Phase::Finetune && !cloud.is_empty())
            .then(|| keep_logits(cloud).sigmoid().mean::<Rank0, _>() * self.lambda)
    }

    /// Sets the column of importance from the requested statistic; `None` without statistic or Gaussians.
    fn edit(&self, cloud: &GaussianCloud, stats: &CloudStats, _: &StepContext) -> Option<CloudEdit> {
        let importance = &stats.requested.largest_weight;
        if importance.len() != cloud.len() || cloud.is_empty() {
            return None;
        }
        let median = quantile(importance, 0.5).max(FAINTEST);
        let mut cloud = cloud.clone();
        let column = cloud.extra.iter_mut().find(|column| column.name == IMPORTANCE)?;
        column.values = importance.iter().map(|s| (s.max(FAINTEST) / median).ln()).collect();
        let rows = (0..cloud.len()).map(RowOrigin::Kept).collect();
        Some(CloudEdit { cloud, rows })
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        match (cloud.extra(COLUMN), cloud.extra(IMPORTANCE)) {
            (Some(m), Some(s)) => m.values.iter().zip(&s.values).map(|(m, s)| m + s).collect(),
            _ => cloud.opacity_logits.clone(),
        }
    }

    fn shortened(&self, scale: f64) -> Option<Box<dyn Pruner>> {
        let learning_rate = shortened_rate(self.learning_rate, true, scale);
        Some(Box::new(Self { learning_rate, ..self.clone() }))
    }

    fn check(&self) -> Result<(), String> {
        check_weight("lambda", self.lambda)?;
        check_rate(self.learning_rate)
    }
}

/// Returns the logits m + ln(S/S̃) of the keep probabilities on the tape; only m is learned.
fn keep_logits(cloud: &TracedCloud) -> Trace {
    cloud.column(COLUMN) + cloud.leaf(IMPORTANCE).clone()
}
