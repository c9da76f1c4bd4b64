//! The equations of gains and of moves: the best gains of given positions, and joint refinement.
//!
//! With positions fixed, h is linear in the signals: min Σ|h − Σ s·e|² + Σ ridge·|s|², whose normal equations are
//! `(EᴴE + ridge)·s = Eᴴh`. They are written with s as two reals, so that one Cholesky serves gains and moves alike.
//!
//! [`refine`] moves all positions (and turns of the array) by Levenberg and Marquardt, gains solved inside. One step solves
//! the equations of gains and moves together, with damping on the moves alone, which is variable projection in Kaufman's
//! form; after a step the gains are solved exactly for the new places. Double precision.

use crate::virtual_transmitters::equations::{Normal, Rows};
use crate::virtual_transmitters::harmonics::{MOST, by_place, direction, harmonics, slopes};
use crate::virtual_transmitters::links::{Links, Sources};
use crate::virtual_transmitters::sweep::Grid;
use crate::virtual_transmitters::turn::{matrix, nudged, turned};
use pwrfgs_core::Real;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Blocks of rows whose equations are gathered apart, then added in order.
const BLOCKS: usize = 8;

/// The harmonics of what is the same in all directions.
const FLAT: [f64; MOST] = {
    let mut flat = [0.0; MOST];
    flat[0] = 1.0;
    flat
};

/// Rows times unknowns below which one thread is faster than several. The sums are the same.
const ALONE: usize = 1 << 18;

/// What is unknown: the signals `[N,K,2]`, then moves `[N,3]`, then turns `[N,3]` about the world's axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unknowns {
    Gains,
    Moves,
    MovesAndTurns,
}

impl Unknowns {
    /// Real numbers a source of `terms` harmonics.
    pub(crate) fn each(self, terms: usize) -> usize {
        match self {
            Self::Gains => 2 * terms,
            Self::Moves => 2 * terms + 3,
            Self::MovesAndTurns => 2 * terms + 6,
        }
    }
}

/// The best gains of `sources` at their places for `channel` `[M,A,F]`, with a `ridge` `[N]` on |s|².
///
/// Where the equations have no single solution, the gains stay, and the answer is false.
pub fn solve_gains(links: &Links<'_>, channel: &[[Real; 2]], sources: &mut Sources, ridge: &[f64]) -> bool {
    assert_eq!(channel.len(), links.len(), "one complex number a link");
    assert_eq!(ridge.len(), sources.len(), "one ridge a source");
    let items: Vec<usize> = (0..links.positions.len()).collect();
    gains(&Rows::new(links, channel, &items, usize::MAX, 0), sources, ridge).is_some()
}

/// [`solve_gains`] for rows; Σ|h − Σ s·e|² + Σ ridge·|s|² of the outcome.
pub(crate) fn gains(rows: &Rows, sources: &mut Sources, ridge: &[f64]) -> Option<f64> {
    let silent = Sources { gains: vec![[0.0; 2]; sources.gains.len()], ..sources.clone() };
    let normal = equations(rows, &silent, Unknowns::Gains);
    let found = normal.solve(|i| ridge[i / (2 * sources.terms())])?;
    // At the minimum, what is left is Σ|h|² − sᵀEᴴh.
    let explained: f64 = found.iter().zip(&normal.right).map(|(s, b)| s * b).sum();
    sources.gains = found.as_chunks::<2>().0.to_vec();
    Some((normal.square - explained).max(0.0))
}

/// The normal equations of a step from `sources`, without ridge or damping.
pub(crate) fn equations(rows: &Rows, sources: &Sources, unknowns: Unknowns) -> Normal {
    let p = unknowns.each(sources.terms()) * sources.len();
    let pairs = rows.len().div_ceil(2);
    let block = pairs.div_ceil(BLOCKS).max(32);
    let rotations: Vec<_> = sources.quats.iter().map(|q| matrix(*q)).collect();
    let gather = |b: usize| {
        let mut normal = Normal::new(p);
        let mut jacobian = vec![0.0; 4 * p];
        for pair in b * block..((b + 1) * block).min(pairs) {
            jacobian.fill(0.0);
            let mut rest = [0.0; 4];
            for (half, j) in jacobian.chunks_exact_mut((2 * p).max(1)).enumerate() {
                let i = 2 * pair + half;
                if i < rows.len() {
                    let [re, im] = row(rows, i, sources, &rotations, unknowns, j);
                    (rest[2 * half], rest[2 * half + 1]) = (re, im);
                }
            }
            normal.add_four(&jacobian, rest);
        }
        normal
    };
    let mut total = Normal::new(p);
    if rows.len() * p < ALONE {
        (0..pairs.div_ceil(block)).for_each(|b| total.add(&gather(b)));
    } else {
        let blocks: Vec<Normal> = (0..pairs.div_ceil(block)).into_par_iter().map(gather).collect();
        blocks.iter().for_each(|b| total.add(b));
    }
    total
}

/// The derivatives of row `i`, real part then imaginary part `[2,P]`; gives what is left of h.
fn row(
    rows: &Rows,
    i: usize,
    sources: &Sources,
    rotations: &[[[f64; 3]; 3]],
    unknowns: Unknowns,
    j: &mut [f64],
) -> [f64; 2] {
    let (n, terms) = (sources.len(), sources.terms());
    let (real, imaginary) = j.split_at_mut(unknowns.each(terms) * n);
    let k = std::f64::consts::TAU * rows.per_metre[i];
    let mut rest = rows.h[i];
    for g in 0..n {
        let r = turned(&rotations[g], rows.r[i]);
        let wave = rows.wave(i, sources.positions[g], r);
        let (gains, [re, im]) = (sources.gains_of(g), wave.e);
        let (u, far) = direction(sources.positions[g], rows.p[i]);
        let harmonics = if terms > 1 { harmonics(u) } else { FLAT };
        let mut heard = [0.0; 2];
        for (k, [x, y]) in gains.iter().enumerate() {
            let (at, re, im) = (2 * (terms * g + k), harmonics[k] * re, harmonics[k] * im);
            heard = [heard[0] + (x * re - y * im), heard[1] + (x * im + y * re)];
            (real[at], real[at + 1]) = (re, -im);
            (imaginary[at], imaginary[at + 1]) = (im, re);
        }
        rest = [rest[0] - heard[0], rest[1] - heard[1]];
        if unknowns == Unknowns::Gains {
            continue;
        }
        // ∂(s·e)/∂d = s·e·(−jk − 1/d).
        let by_d = [k * heard[1] - heard[0] / wave.d, -k * heard[0] - heard[1] / wave.d];
        let along = wave.by.map(|x| x / wave.d);
        let turn = if terms > 1 { by_turning(gains, u, far, wave.e) } else { [[0.0; 3]; 2] };
        let about =
            [r[1] * along[2] - r[2] * along[1], r[2] * along[0] - r[0] * along[2], r[0] * along[1] - r[1] * along[0]];
        for c in 0..3 {
            let at = 2 * terms * n + 3 * g + c;
            (real[at], imaginary[at]) = (by_d[0] * along[c] + turn[0][c], by_d[1] * along[c] + turn[1][c]);
            if unknowns == Unknowns::MovesAndTurns {
                let at = at + 3 * n;
                (real[at], imaginary[at]) = (by_d[0] * about[c], by_d[1] * about[c]);
            }
        }
    }
    rest
}

/// The derivative of the real and of the imaginary part of Σ c·Y(u)·e by the position, through the direction u alone.
fn by_turning(gains: &[[f64; 2]], u: [f64; 3], far: f64, [re, im]: [f64; 2]) -> [[f64; 3]; 2] {
    let mut d_u = [[0.0; 3]; 2];
    for ([x, y], slope) in gains.iter().zip(slopes(u)) {
        for c in 0..3 {
            d_u[0][c] += (x * re - y * im) * slope[c];
            d_u[1][c] += (x * im + y * re) * slope[c];
        }
    }
    d_u.map(|d_u| by_place(u, far, d_u))
}

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
) -> crate::virtual_transmitters::equations::Normal {
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
