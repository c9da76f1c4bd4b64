//! Joint refinement: all positions (and turns of the array) by Levenberg and Marquardt, gains solved inside.
//!
//! One step solves the equations of gains and moves together, with damping on the moves alone, which is variable
//! projection in Kaufman's form; after a step the gains are solved exactly for the new places. Double precision.

use crate::virtual_transmitters::links::Sources;
use crate::virtual_transmitters::rows::Rows;
use crate::virtual_transmitters::solve::{Unknowns, equations, gains};
use crate::virtual_transmitters::sweep::Grid;
use crate::virtual_transmitters::turn::nudged;
use std::sync::atomic::{AtomicBool, Ordering};

/// How [`refine`] walks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walk<'a> {
    /// Steps at most.
    pub(crate) steps: usize,
    /// Farthest that a source moves in a step, metres, in the middle of the grid; more where hills are wider.
    pub(crate) farthest: f64,
    pub(crate) grid: &'a Grid,
    /// Whether arrays are turned too.
    pub(crate) turns: bool,
    /// Set where it is to end.
    pub(crate) stop: &'a AtomicBool,
}

/// A step that gains less than this share of the cost is the last.
const ENOUGH: f64 = 1e-6;

/// Moves `sources` downhill; the cost Σ|h − Σ s·e|² + Σ ridge·|s|² where it ends, `None` where there is no solution.
pub(crate) fn refine(rows: &Rows, sources: &mut Sources, ridge: &[f64], walk: Walk<'_>) -> Option<f64> {
    let mut cost = gains(rows, sources, ridge)?;
    let unknowns = if walk.turns { Unknowns::MovesAndTurns } else { Unknowns::Moves };
    let mut damping = 1e-2;
    let mut normal = with_ridge(rows, sources, unknowns, ridge);
    for _ in 0..walk.steps {
        if walk.stop.load(Ordering::Relaxed) {
            break;
        }
        let (fixed, p) = (2 * sources.gains.len(), normal.unknowns());
        let Some(step) = normal.solve(|i| if i < fixed { 0.0 } else { damping * normal.matrix[i * p + i] + 1e-30 })
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
fn with_ridge(
    rows: &Rows,
    sources: &Sources,
    unknowns: Unknowns,
    ridge: &[f64],
) -> crate::virtual_transmitters::normal::Normal {
    let mut normal = equations(rows, sources, unknowns);
    let p = normal.unknowns();
    for (i, gain) in sources.gains.as_flattened().iter().enumerate() {
        let ridge = ridge[i / (2 * sources.terms())];
        normal.matrix[i * p + i] += ridge;
        normal.right[i] -= ridge * gain;
    }
    normal
}

/// `sources` after a step, no move farther than allowed and no turn by more than half a radian.
fn apply(sources: &Sources, step: &[f64], walk: Walk<'_>) -> Sources {
    let (n, moves) = (sources.len(), 2 * sources.gains.len());
    let mut out = sources.clone();
    let within = |by: [f64; 3], most: f64| {
        let length = by.iter().map(|x| x * x).sum::<f64>().sqrt();
        by.map(|x| x * (most / length.max(f64::MIN_POSITIVE)).min(1.0))
    };
    for g in 0..n {
        let at = |first: usize| [step[first], step[first + 1], step[first + 2]];
        let by = within(at(moves + 3 * g), walk.farthest * walk.grid.width(out.positions[g]));
        (0..3).for_each(|c| out.positions[g][c] += by[c]);
        if walk.turns {
            out.quats[g] = nudged(out.quats[g], within(at(moves + 3 * n + 3 * g), 0.5));
        }
    }
    out
}
