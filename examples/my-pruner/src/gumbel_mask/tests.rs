//! Tests of the formula and gradient of the gate, and of the kept Gaussians.

use super::*;
use dfdx::prelude::{AsArray, Backward, SumTo};
use pwrfgs::core::{ExtraColumn, sigmoid};

fn context(step: u64, phase: Phase) -> StepContext {
    StepContext::new(step, phase, 7)
}

/// Gaussians with these gate logits.
fn gated(logits: &[Real]) -> GaussianCloud {
    let column = &GumbelMask::default().traits().columns[0];
    let mut cloud = GaussianCloud::zeros(logits.len());
    cloud.extra.push(ExtraColumn { name: column.name.into(), width: column.width, values: logits.to_vec() });
    cloud
}

fn gate(mask: &GumbelMask, logits: &[Real], step: u64) -> Vec<Real> {
    mask.gate(&TracedCloud::new(&gated(logits)), &context(step, Phase::Densify)).unwrap().factor().as_vec()
}

#[test]
fn gate_is_relaxed_bernoulli_sample() {
    let mask = GumbelMask { temperature: 0.7, ..GumbelMask::default() };
    let logits: Vec<Real> = (0..4000).map(|i| if i % 4 == 3 { -0.1 } else { (i % 4) as Real * 0.8 }).collect();
    let found = gate(&mask, &logits, 5);
    // The same stream, the formula in double precision.
    let mut random = rng::stream(7, "pruner GumbelMask", 5);
    for (m, y) in logits.iter().zip(&found) {
        let u = (rng::uniform(&mut random) as f64).clamp(1e-6, 1.0 - 1e-6);
        let expected = 1.0 / (1.0 + (-(*m as f64 + (u / (1.0 - u)).ln()) / 0.7).exp());
        let expected = if *m < 0.0 { 0.0 } else { expected };
        assert!((*y as f64 - expected).abs() < 1e-4, "m = {m}: {y} is not {expected}");
    }
    // Open with probability σ(m): a thousand samples each, three standard deviations.
    for (k, m) in [0.0, 0.8, 1.6].into_iter().enumerate() {
        let open = found.iter().skip(k).step_by(4).filter(|y| **y > 0.5).count() as Real / 1000.0;
        let p = sigmoid(m);
        assert!((open - p).abs() < 3.0 * (p * (1.0 - p) / 1000.0).sqrt(), "m = {m}: open {open}, expected {p}");
    }
}

#[test]
fn noise_depends_on_step_and_is_reproduced_on_resume() {
    let mask = GumbelMask::default();
    let logits = [0.5; 50];
    assert_eq!(gate(&mask, &logits, 9), gate(&mask, &logits, 9));
    let (a, b) = (gate(&mask, &logits, 9), gate(&mask, &logits, 10));
    assert!(a.iter().zip(&b).all(|(a, b)| a != b));
    let other = StepContext { seed: 8, ..context(9, Phase::Densify) };
    assert_ne!(mask.gate(&TracedCloud::new(&gated(&logits)), &other).unwrap().factor().as_vec(), a);
}

#[test]
fn gate_derivative_has_closed_form() {
    let mask = GumbelMask { temperature: 0.5, ..GumbelMask::default() };
    let logits = [0.0, 0.3, 1.0, 2.0, -0.2, 5.0];
    let traced = TracedCloud::new(&gated(&logits));
    let gate = mask.gate(&traced, &context(3, Phase::Prune)).unwrap().factor();
    let y = gate.as_vec();
    // Cotangents that differ, so that a mixed-up order would show.
    let weights: Vec<Real> = (0..logits.len()).map(|i| i as Real - 2.5).collect();
    let loss: TraceScalar = (gate * traced.constant(weights.clone())).sum();
    let found = loss.backward().get(traced.leaf(COLUMN)).as_vec();
    for i in 0..logits.len() {
        let expected = weights[i] * y[i] * (1.0 - y[i]) / 0.5;
        assert!((found[i] - expected).abs() < 1e-5, "m = {}: {} is not {expected}", logits[i], found[i]);
    }
    assert_eq!(found[4], 0.0, "a shut gate has no derivative from the picture");
}

#[test]
fn penalty_gradient_reaches_every_gate() {
    let mask = GumbelMask { lambda: 0.03, ..GumbelMask::default() };
    let logits = [3.0, 0.0, -0.5, 1.0];
    let traced = TracedCloud::new(&gated(&logits));
    let penalty = mask.penalty(&traced, &context(3, Phase::Prune)).unwrap();
    assert!((penalty.array() - 0.03 * logits.map(sigmoid).iter().sum::<Real>() / 4.0).abs() < 1e-7);
    for (found, m) in penalty.backward().get(traced.leaf(COLUMN)).as_vec().iter().zip(logits) {
        let s = sigmoid(m);
        assert!((found - 0.03 / 4.0 * s * (1.0 - s)).abs() < 1e-8, "m = {m}: {found}");
    }
}

#[test]
fn keeps_gaussians_of_non_negative_logit_for_any_noise() {
    // At the lowest temperature, where gates are closest to 0; at the edge, and far from it.
    let mask = GumbelMask { temperature: 0.2, ..GumbelMask::default() };
    let near = (-2000..2000).map(|i| i as Real * Real::EPSILON);
    let logits: Vec<Real> = near.chain([-0.0, 9.0, -9.0, Real::MIN_POSITIVE, -Real::MIN_POSITIVE]).collect();
    let cloud = gated(&logits);
    let expected: Vec<bool> = logits.iter().map(|m| *m >= 0.0).collect();
    for step in 1..50 {
        let kept = mask.keep(&cloud, &CloudStats::zeros(cloud.len()), &context(step, Phase::Prune));
        assert_eq!(kept, expected, "step {step}");
    }
    // The largest noise.
    assert!(sigmoid(logistic(0.0) / 0.2) > 0.0 && logistic(1.0).is_finite());
    assert_eq!(mask.score(&cloud, &CloudStats::zeros(cloud.len()), &context(0, Phase::Prune)), logits);
}

#[test]
fn fine_tuning_ignores_gates_and_keeps_all() {
    let (mask, cloud) = (GumbelMask::default(), GaussianCloud::zeros(3));
    let (traced, context) = (TracedCloud::new(&cloud), context(9, Phase::Finetune));
    assert!(mask.gate(&traced, &context).is_none() && mask.penalty(&traced, &context).is_none());
    assert_eq!(mask.keep(&cloud, &CloudStats::zeros(3), &context), [true; 3]);
}

#[test]
fn rejects_invalid_mask_settings() {
    assert!(Plugin::<dyn Pruner>::parse("GumbelMask()").is_ok());
    for (field, wrong) in [
        ("lambda", "-0.1"),
        ("temperature", "0.1"),
        ("temperature", "NaN"),
        ("initial_logit", "0.0"),
        ("initial_logit", "inf"),
        ("learning_rate", "0"),
    ] {
        let why = Plugin::<dyn Pruner>::parse(&format!("GumbelMask({field}: {wrong})")).unwrap_err();
        assert!(why.contains(&format!("`{field}`")) && why.contains("; set "), "{why}");
    }
}
