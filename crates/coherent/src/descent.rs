//! Joint refinement: all positions (and turns of the array) by Levenberg and Marquardt, gains solved inside.
//!
//! One step solves the equations of gains and moves together, with damping on the moves alone, which is variable
//! projection in Kaufman's form; after a step the gains are solved exactly for the new places. Double precision.

use crate::links::Sources;
use crate::rows::Rows;
use crate::solve::{Unknowns, equations, gains};
use crate::turn::nudged;

/// How [`refine`] walks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walk {
    /// Steps at most.
    pub(crate) steps: usize,
    /// Farthest that a source moves in a step, metres.
    pub(crate) farthest: f64,
    /// Whether arrays are turned too.
    pub(crate) turns: bool,
}

/// A step that gains less than this share of the cost is the last.
const ENOUGH: f64 = 1e-6;

/// Moves `sources` downhill; the cost Σ|h − Σ s·e|² + Σ ridge·|s|² where it ends, `None` where there is no solution.
pub(crate) fn refine(rows: &Rows, sources: &mut Sources, ridge: &[f64], walk: Walk) -> Option<f64> {
    let mut cost = gains(rows, sources, ridge)?;
    let unknowns = if walk.turns { Unknowns::MovesAndTurns } else { Unknowns::Moves };
    let mut damping = 1e-2;
    let mut normal = with_ridge(rows, sources, unknowns, ridge);
    for _ in 0..walk.steps {
        let n = sources.len();
        let p = normal.unknowns();
        let Some(step) = normal.solve(|i| if i < 2 * n { 0.0 } else { damping * normal.matrix[i * p + i] + 1e-30 })
        else {
            damping = (damping * 10.0).max(1e-3);
            continue;
        };
        let mut moved = apply(sources, &step, walk);
        match gains(rows, &mut moved, ridge) {
            Some(new) if new < cost => {
                let gained = (cost - new) / cost.max(f64::MIN_POSITIVE);
                (*sources, cost) = (moved, new);
                damping = (damping * 0.2).max(1e-9);
                if gained < ENOUGH {
                    break;
                }
                normal = with_ridge(rows, sources, unknowns, ridge);
            }
            _ => damping *= 5.0,
        }
        if damping > 1e8 {
            break;
        }
    }
    Some(cost)
}

/// The equations, those of the gains with their ridge.
fn with_ridge(rows: &Rows, sources: &Sources, unknowns: Unknowns, ridge: &[f64]) -> crate::normal::Normal {
    let mut normal = equations(rows, sources, unknowns);
    let p = normal.unknowns();
    for g in 0..sources.len() {
        for c in 0..2 {
            let i = 2 * g + c;
            normal.matrix[i * p + i] += ridge[g];
            normal.right[i] -= ridge[g] * sources.gains[g][c];
        }
    }
    normal
}

/// `sources` after a step, no move farther than allowed and no turn by more than half a radian.
fn apply(sources: &Sources, step: &[f64], walk: Walk) -> Sources {
    let n = sources.len();
    let mut out = sources.clone();
    let within = |by: [f64; 3], most: f64| {
        let length = by.iter().map(|x| x * x).sum::<f64>().sqrt();
        by.map(|x| x * (most / length.max(f64::MIN_POSITIVE)).min(1.0))
    };
    for g in 0..n {
        let at = |first: usize| [step[first], step[first + 1], step[first + 2]];
        let by = within(at(2 * n + 3 * g), walk.farthest);
        (0..3).for_each(|c| out.positions[g][c] += by[c]);
        if walk.turns {
            out.quats[g] = nudged(out.quats[g], within(at(5 * n + 3 * g), 0.5));
        }
    }
    out
}
