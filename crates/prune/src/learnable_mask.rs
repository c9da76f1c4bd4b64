//! Learnable mask of the paper: m `[N]` is learned, M = 1[σ(m) ≥ threshold] multiplies opacity and scale (eqs.
//! (10)–(13)).
//!
//! This file is the worked example of a pruner that learns: a column, a gate and a penalty, written forward-only on the
//! tape of the step. dfdx differentiates; the file contains no derivative by hand.

use crate::common::{learned_column, shortened_rate};
use crate::settings::{check_rate, check_weight};
use dfdx::prelude::{MeanTo, Rank0};
use pwrfgs_core::{
    Budget, CloudStats, ColumnSpec, Gate, GaussianCloud, JsonSchema, Phase, Pruner, PrunerTraits, Real, StepContext,
    sigmoid,
    tape::{TraceScalar, TracedCloud, values},
};
use serde::{Deserialize, Serialize};

/// Gaussians that the paper keeps of [`PAPER_START`] points, by λ.
const PAPER: [(f64, f64); 4] = [(0.01, 2_613.0), (0.02, 157.0), (0.03, 24.0), (0.04, 8.0)];
/// Approximate number of points of the paper's cloud; `outlook` writes it.
const PAPER_START: f64 = 190_000.0;

/// Maximum number of counted steps until a mask closes.
const MOST_STEPS: u64 = 1_000_000;

/// Column of mask logits m.
const COLUMN: &str = "mask_logits";

/// Learns one mask per Gaussian under a penalty: the pruning strategy of P-WRFGS.
///
/// During training, opacity and scale are multiplied by M = sg(1[σ(m) ≥ threshold] − σ(m)) + σ(m), eq. (11). Its
/// forward value is 0 or 1 and its derivative is σ′(m). The loss gains lambda · mean σ(m), eqs. (12) and (13). Prune
/// steps remove the Gaussians with M = 0, eq. (10). A mask that has closed cannot reopen: a Gaussian with M = 0 is not
/// drawn and has no gradient from the spectrum, so that only the penalty moves it. The penalty gradient of one Gaussian
/// is lambda/N · σ(1−σ), and Adam divides it by its running magnitude. Masks of Gaussians that the spectra do not need
/// therefore close about 1,410 steps after the start at a rate of 0.01, for any lambda above 0 (730 steps at 0.02).
///
/// Use this pruner if training shall find the number of Gaussians for a quality. lambda decides a share of the start, not
/// a number: the penalty on one mask is lambda/N, and the gradient of the spectrum along a mask falls with N alike. The
/// share decreases as long as the pruning phase lasts, and with `learning_rate`. `pwrfgs check` states the share of the
/// paper for the start of a pipeline. Kept Gaussians after 40,000 steps:
///
/// | lambda | of 190,000 points (paper) | of 3,000 Gaussians (`pwrfgs-small.ron`) |
/// |---|---|---|
/// | 0.005 | - | 288 (9.6 %) |
/// | 0.0075 | - | 136 (4.5 %) |
/// | 0.01 | 2,613 (1.4 %) | 53 (1.8 %) |
/// | 0.02 | 157 (0.08 %) | 1 |
/// | 0.03 | 24 (0.013 %) | - |
/// | 0.04 | 8 (0.004 %) | - |
///
/// The threshold of 0.01 is that of the paper. The paper gives neither initial logit nor learning rate; their values are
/// those of Compact-3DGS.
///
/// To fix the number beforehand, set `training.target_count`. The target then decides how many Gaussians are kept, and
/// the masks decide which: each prune step keeps an equal share of them, those with the largest m. Until then, as many
/// masks stay open as the next prune step keeps: if fewer have σ(m) of at least the threshold, the threshold decreases.
/// λ is multiplied by the share of open masks among those that the step is to remove, so that the pressure ends when
/// enough masks are closed.
///
/// With tens of thousands of Gaussians, lambda/N is small against the noise of the gradient, and Adam divides by that
/// noise. The rate of 0.01 then needs the 20,000 steps of one transmitter that the paper uses. Two ways reduce the
/// cost:
///
/// - Train first and prune the trained model (`Trained` as the initializer), with 16 transmitters per step at 0.03 for
///   4,000 steps.
/// - Disable Adam for the masks, `LearnableMask(adam: false, learning_rate: 5)`. The result agrees within a tenth of N
///   and 0.002 of SSIM.
///
/// N decreases slowly for as long as the pruning phase lasts, so the length of this phase belongs to lambda. A rate of
/// 0.1 is faster still, but noise then closes masks for good: fewer Gaussians are left, and SSIM at equal N is lower.
/// The figures are in `docs/lab/paper.md`.
///
/// ```
/// # use pwrfgs_prune as _;
/// # use pwrfgs_core::{Plugin, Pruner, PrunerTraits};
/// Plugin::<dyn Pruner>::parse("LearnableMask(lambda: 0.02)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LearnableMask {
    /// Weight λ of the penalty, 0 or more.
    pub lambda: Real,
    /// Gaussians with σ(m) of at least this value are kept; between 0 and 1.
    pub threshold: Real,
    /// Initial mask logit m; σ(1) is 0.73.
    pub initial_logit: Real,
    /// Learning rate of the mask logit m; without Adam about 3 to 10.
    pub learning_rate: Real,
    /// Whether Adam updates the mask logit m. Without it, m −= rate · N · gradient.
    pub adam: bool,
}

impl Default for LearnableMask {
    fn default() -> Self {
        Self { lambda: 0.01, threshold: 0.01, initial_logit: 1.0, learning_rate: 0.01, adam: true }
    }
}

#[typetag::serde]
impl Pruner for LearnableMask {
    fn traits(&self) -> PrunerTraits {
        let column = ColumnSpec::learned(COLUMN, self.initial_logit, self.learning_rate);
        PrunerTraits {
            columns: vec![ColumnSpec { adam: self.adam, ..column }],
            budget: Some(Budget::Gradual),
            ..PrunerTraits::default()
        }
    }

    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        (context.phase != Phase::Finetune).then(|| {
            let masks = cloud.column(COLUMN).sigmoid();
            let threshold = self.open_threshold(&values(&masks), context);
            cloud.straight_through(masks, threshold).into()
        })
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        (context.phase != Phase::Finetune && !cloud.is_empty()).then(|| {
            let masks = cloud.column(COLUMN).sigmoid();
            let lambda = self.lambda * self.penalty_factor(&values(&masks), context);
            masks.mean::<Rank0, _>() * lambda
        })
    }

    fn score(&self, cloud: &GaussianCloud, _: &CloudStats, _: &StepContext) -> Vec<Real> {
        learned_column(cloud, COLUMN)
    }

    fn outlook(&self, initial: usize) -> Option<String> {
        let distance = |lambda: f64| (lambda - f64::from(self.lambda as f32)).abs();
        let (lambda, kept) = PAPER.into_iter().min_by(|(a, _), (b, _)| distance(*a).total_cmp(&distance(*b)))?;
        let share = kept / PAPER_START;
        let lambda_name = if distance(lambda) < 1e-6 { "this" } else { "the nearest published" };
        let number = match share * initial as f64 {
            few if few < 1.0 => "less than one".to_owned(),
            some => format!("{some:.0}"),
        };
        Some(format!(
            "LearnableMask: lambda decides a share that falls with the length of pruning; at {lambda_name} lambda, {lambda}, the \
             paper keeps {:.2} % of 190,000 points, which is {number} of these {initial} Gaussians",
            100.0 * share
        ))
    }

    fn shortened(&self, scale: f64) -> Option<Box<dyn Pruner>> {
        let learning_rate = shortened_rate(self.learning_rate, self.adam, scale);
        Some(Box::new(Self { learning_rate, ..self.clone() }))
    }

    fn steps_to_close(&self, decays: [Real; 2]) -> Option<u64> {
        (self.lambda > 0.0).then(|| self.steps_to_threshold(decays.map(f64::from)))
    }

    fn check(&self) -> Result<(), String> {
        let Self { lambda, threshold, initial_logit, learning_rate, .. } = self;
        check_weight("lambda", *lambda)?;
        if !(*threshold > 0.0 && *threshold < 1.0) {
            return Err(format!("`threshold` is {threshold}; give a number above 0 and below 1, such as 0.01"));
        }
        if !initial_logit.is_finite() || sigmoid(*initial_logit) < *threshold {
            return Err(format!(
                "`initial_logit` is {initial_logit}, which closes every gate from the start; raise it, such as to 1.0"
            ));
        }
        check_rate(*learning_rate)
    }
}

impl LearnableMask {
    /// Returns the value of σ(m) from which a mask is open: the threshold, or less if fewer masks than the next prune step
    /// keeps would be open.
    fn open_threshold(&self, masks: &[Real], context: &StepContext) -> Real {
        if context.target.is_none() {
            return self.threshold;
        }
        let Some(last) = context.next_quota(masks.len()).checked_sub(1) else { return self.threshold };
        let lowest_kept = *masks.to_vec().select_nth_unstable_by(last, |a, b| b.total_cmp(a)).1;
        lowest_kept.min(self.threshold)
    }

    /// Returns the factor on λ: 1 without a target; with one, the share still open of those that the next prune step
    /// removes.
    fn penalty_factor(&self, masks: &[Real], context: &StepContext) -> Real {
        if context.target.is_none() {
            return 1.0;
        }
        let (n, quota) = (masks.len(), context.next_quota(masks.len()));
        let open = masks.iter().filter(|mask| **mask >= self.threshold).count();
        open.saturating_sub(quota) as Real / (n - quota).max(1) as Real
    }

    /// Returns the number of steps in which the penalty alone moves a mask from its initial value below the threshold, by
    /// the update of the optimiser in double precision; at most [`MOST_STEPS`].
    fn steps_to_threshold(&self, [beta1, beta2]: [f64; 2]) -> u64 {
        let [rate, threshold, lambda] = [self.learning_rate, self.threshold, self.lambda].map(f64::from);
        let (mut m, mut first, mut second) = (f64::from(self.initial_logit), 0.0, 0.0);
        let sigmoid = |m: f64| 1.0 / (1.0 + (-m).exp());
        for step in 1..MOST_STEPS {
            let mask = sigmoid(m);
            let slope = mask * (1.0 - mask);
            first = beta1 * first + (1.0 - beta1) * slope;
            second = beta2 * second + (1.0 - beta2) * slope * slope;
            let unbias = |beta: f64| 1.0 - beta.powf(step as f64);
            let adam = first / unbias(beta1) / (second / unbias(beta2)).sqrt();
            // Adam divides λ/N out of the gradient; without it, the step is multiplied by N.
            m -= rate * if self.adam { adam } else { lambda * slope };
            if sigmoid(m) < threshold {
                return step;
            }
        }
        MOST_STEPS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{cloud, context, with_column};
    use dfdx::prelude::{AsArray, Backward, SumTo};

    /// Logits around the threshold at −4.595, far from it on both sides, and at it.
    const LOGITS: [Real; 7] = [1.0, -4.0, -4.594, -4.596, -9.0, 3.0, 0.0];

    fn masked(logits: &[Real]) -> GaussianCloud {
        let column = &LearnableMask::default().traits().columns[0];
        with_column(cloud(&vec![0.0; logits.len()]), column, logits)
    }

    /// Returns ∂/∂m of the sum of a gate, or of a penalty.
    fn derivative(traced: &TracedCloud, scalar: TraceScalar) -> Vec<Real> {
        scalar.backward().get(traced.leaf(COLUMN)).as_vec()
    }

    #[test]
    fn straight_through_gate_has_closed_form() {
        let (mask, traced) = (LearnableMask::default(), TracedCloud::new(&masked(&LOGITS)));
        let gate = mask.gate(&traced, &context(Phase::Densify)).unwrap().factor();
        assert_eq!(gate.as_vec(), [1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]);
        // Unequal cotangents reveal a wrong order.
        let weights: Vec<Real> = (0..LOGITS.len()).map(|i| i as Real - 2.5).collect();
        let computed = derivative(&traced, (gate * traced.constant(weights.clone())).sum());
        for ((computed, m), weight) in computed.iter().zip(LOGITS).zip(weights) {
            let s = sigmoid(m);
            assert!((computed - weight * s * (1.0 - s)).abs() < 1e-6, "m = {m}: {computed}");
        }
    }

    #[test]
    fn penalty_gradient_reaches_every_mask_logit() {
        let mask = LearnableMask { lambda: 0.03, ..LearnableMask::default() };
        let traced = TracedCloud::new(&masked(&LOGITS));
        let penalty = mask.penalty(&traced, &context(Phase::Prune)).unwrap();
        let n = LOGITS.len() as Real;
        let expected = 0.03 * LOGITS.iter().map(|m| sigmoid(*m)).sum::<Real>() / n;
        assert!((penalty.array() - expected).abs() < 1e-7);
        for (computed, m) in derivative(&traced, penalty).iter().zip(LOGITS) {
            let s = sigmoid(m);
            assert!((computed - 0.03 / n * s * (1.0 - s)).abs() < 1e-8, "m = {m}: {computed}");
        }
    }

    #[test]
    fn keeps_masks_of_at_least_threshold_to_last_bit() {
        let mask = LearnableMask::default();
        let edge = (0.01 as Real / 0.99).ln();
        let logits: Vec<Real> = (-500..500).map(|i| edge + i as Real * edge.abs() * Real::EPSILON).collect();
        let cloud = masked(&logits);
        let kept = mask.keep(&cloud, &CloudStats::zeros(cloud.len()), &context(Phase::Prune));
        let expected: Vec<bool> = logits.iter().map(|m| 1.0 / (1.0 + (-m).exp()) >= mask.threshold).collect();
        assert_eq!(kept, expected);
        assert!(kept.contains(&true) && kept.contains(&false));
        assert_eq!(mask.score(&cloud, &CloudStats::zeros(cloud.len()), &context(Phase::Prune)), logits);
    }

    #[test]
    fn target_keeps_enough_masks_open_and_ends_pressure() {
        let mask = LearnableMask { lambda: 0.03, ..LearnableMask::default() };
        // Five of seven are open by the threshold, and the only prune step keeps six.
        let moment = StepContext { rounds: 1, target: Some(6), ..context(Phase::Prune) };
        let open =
            |moment: &StepContext| values(&mask.gate(&TracedCloud::new(&masked(&LOGITS)), moment).unwrap().factor());
        assert_eq!(open(&moment), [1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0], "six stay open");
        let lambda = |logits: &[Real], moment: &StepContext| {
            let penalty = mask.penalty(&TracedCloud::new(&masked(logits)), moment).unwrap().array();
            penalty * logits.len() as Real / logits.iter().map(|m| sigmoid(*m)).sum::<Real>()
        };
        // The step is to close four of seven: all four, two or none of them are open.
        let moment = StepContext { target: Some(3), ..moment };
        for (logits, share) in [([1.0; 7], 1.0), ([1.0, 1.0, 1.0, 1.0, 1.0, -9.0, -9.0], 0.5), ([-9.0; 7], 0.0)] {
            assert!((lambda(&logits, &moment) - 0.03 * share).abs() < 1e-6, "{share}");
            assert!((lambda(&logits, &context(Phase::Prune)) - 0.03).abs() < 1e-6);
        }
        // After the last prune step there is nothing left to close.
        let after = StepContext { passed: 1, ..moment };
        assert_eq!((open(&after), lambda(&[1.0; 7], &after)), (vec![1.0; 7], 0.0));
    }

    #[test]
    fn unused_mask_closes_after_computed_number_of_steps() {
        // Rates of the paper and of the quickstart, and both without Adam; expected values from an independent
        // simulation.
        let steps = |rate, adam| {
            let mask = LearnableMask { learning_rate: rate, adam, ..LearnableMask::default() };
            mask.steps_to_close([0.9, 0.999])
        };
        assert_eq!([steps(0.01, true), steps(0.02, true)], [Some(1_410), Some(730)]);
        // dm/dt = −rate·lambda·σ(1−σ), so that t = (eᵐ − e⁻ᵐ + 2m)/(rate·lambda) between the end points.
        let integral = |m: f64| m.exp() - (-m).exp() + 2.0 * m;
        let expected = (integral(1.0) - integral((0.01_f64 / 0.99).ln())) / (5.0 * 0.01);
        let computed = steps(5.0, false).unwrap() as f64;
        assert!((computed / expected - 1.0).abs() < 0.01, "{computed} against {expected}");
        assert_eq!(LearnableMask { lambda: 0.0, ..LearnableMask::default() }.steps_to_close([0.9, 0.999]), None);
    }

    #[test]
    fn shorter_training_scales_mask_rate_within_limits() {
        let shortened = |text: &str, scale| {
            let pruner = pwrfgs_core::Plugin::<dyn Pruner>::parse(text).unwrap();
            pruner.shortened(scale).unwrap().traits().mask_rate().unwrap()
        };
        let near = |a: Real, b: Real| assert!((a - b).abs() < 1e-6, "{a} against {b}");
        for name in ["LearnableMask", "MaskGaussian", "Lp3dgs"] {
            near(shortened(&format!("{name}(learning_rate: 0.02)"), 0.25), 0.08);
            near(shortened(&format!("{name}(learning_rate: 0.02)"), 0.01), 0.1);
            near(shortened(&format!("{name}(learning_rate: 0.3)"), 0.5), 0.3);
        }
        near(shortened("LearnableMask(adam: false, learning_rate: 5)", 0.25), 20.0);
        near(shortened("LearnableMask(adam: false, learning_rate: 5)", 0.01), 50.0);
    }

    #[test]
    fn fine_tuning_ignores_masks() {
        let (mask, traced) = (LearnableMask::default(), TracedCloud::new(&cloud(&[0.0; 3])));
        assert!(mask.gate(&traced, &context(Phase::Finetune)).is_none());
        assert!(mask.penalty(&traced, &context(Phase::Finetune)).is_none());
    }
}
