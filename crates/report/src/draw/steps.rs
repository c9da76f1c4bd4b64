//! What charts over training steps share: the phases of algorithm 1 and step functions.

use super::charts::Band;
use crate::canvas::Colour;
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

/// More corners than this no print can show apart.
const CORNERS: usize = 4_000;

/// The corners of a step function through `points`: each change keeps the value before it up to its step. Of very many
/// the ends and extremes of short stretches remain.
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
    if drawn.len() <= CORNERS { drawn } else { drawn.chunks(4 * drawn.len() / CORNERS).flat_map(extremes).collect() }
}

/// First and last of some places, and the lowest and the highest between, in their order.
fn extremes(places: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let by_height = |a: &usize, b: &usize| places[*a].1.total_cmp(&places[*b].1);
    let all = 0..places.len();
    let mut kept = vec![0, places.len() - 1];
    kept.extend(all.clone().min_by(by_height));
    kept.extend(all.max_by(by_height));
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|k| places[k]).collect()
}

#[cfg(test)]
mod tests {
    use super::{CORNERS, stairs};

    #[test]
    fn a_step_function_has_corners_alone() {
        let points = [(1.0, 5.0), (2.0, 5.0), (3.0, 5.0), (4.0, 2.0), (5.0, 2.0)];
        assert_eq!(stairs(&points), [(1.0, 5.0), (3.0, 5.0), (4.0, 5.0), (4.0, 2.0), (5.0, 2.0)]);
        assert!(stairs(&[]).is_empty());
    }

    #[test]
    fn of_very_many_corners_the_extremes_remain() {
        let points: Vec<(f64, f64)> = (0..100_000).map(|k| (f64::from(k), f64::from(k * 7_919 % 1_000))).collect();
        let drawn = stairs(&points);
        assert!((1_000..=CORNERS).contains(&drawn.len()), "{} corners", drawn.len());
        assert_eq!((drawn[0], drawn.last()), (points[0], points.last()));
        assert!(drawn.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        for height in [0.0, 999.0] {
            assert!(drawn.iter().any(|p| p.1 == height));
        }
    }
}
