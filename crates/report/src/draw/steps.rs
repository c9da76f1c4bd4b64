//! What charts over training steps share: the phases of algorithm 1 and step functions.

use super::canvas::Colour;
use super::charts::Band;
use pwrfgs_train::Training;

/// The three phases of algorithm 1, shaded.
pub(crate) fn phases(training: &Training) -> Vec<Band> {
    let (d, p, end) = (training.densify_until as f64, training.prune_until as f64, training.steps as f64);
    let band = |name, x, colour| Band { name, x, colour };
    vec![
        band("densify", (0.0, d), Colour::hex(0xe9_f0fa)),
        band("prune", (d, p), Colour::hex(0xfc_f0e2)),
        band("fine-tune", (p, end), Colour::hex(0xee_f6ee)),
    ]
}

/// The corners of a step function through `points`: each change keeps the value before it up to its step.
pub(crate) fn stairs(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut drawn: Vec<(f64, f64)> = Vec::new();
    for (i, &(step, n)) in points.iter().enumerate() {
        let changes = |k: usize| points.get(k).is_none_or(|p| p.1 != n);
        if i == 0 || changes(i - 1) || changes(i + 1) {
            if let Some(last) = drawn.last().filter(|last| last.1 != n) {
                drawn.push((step, last.1));
            }
            drawn.push((step, n));
        }
    }
    drawn
}

#[cfg(test)]
mod tests {
    use super::stairs;

    #[test]
    fn a_step_function_has_corners_alone() {
        let points = [(1.0, 5.0), (2.0, 5.0), (3.0, 5.0), (4.0, 2.0), (5.0, 2.0)];
        assert_eq!(stairs(&points), [(1.0, 5.0), (3.0, 5.0), (4.0, 5.0), (4.0, 2.0), (5.0, 2.0)]);
        assert!(stairs(&[]).is_empty());
    }
}
