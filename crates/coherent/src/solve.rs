//! The equations of gains and of moves, and the best gains of given positions.
//!
//! With positions fixed, h is linear in the signals: min Σ|h − Σ s·e|² + Σ ridge·|s|², whose normal equations are
//! `(EᴴE + ridge)·s = Eᴴh`. They are written with s as two reals, so that one Cholesky serves gains and moves alike.

use crate::links::{Links, Sources};
use crate::normal::Normal;
use crate::rows::Rows;
use crate::turn::{matrix, turned};
use pwrfgs_core::Real;
use rayon::prelude::*;

/// Blocks of rows whose equations are gathered apart, then added in order.
const BLOCKS: usize = 8;

/// Rows times unknowns below which one thread is faster than several. The sums are the same.
const ALONE: usize = 1 << 18;

/// What is unknown: the signals `[N,2]`, then moves `[N,3]`, then turns `[N,3]` about the world's axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unknowns {
    Gains,
    Moves,
    MovesAndTurns,
}

impl Unknowns {
    /// Real numbers a source.
    pub(crate) fn each(self) -> usize {
        match self {
            Self::Gains => 2,
            Self::Moves => 5,
            Self::MovesAndTurns => 8,
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
    let silent = Sources { gains: vec![[0.0; 2]; sources.len()], ..sources.clone() };
    let normal = equations(rows, &silent, Unknowns::Gains);
    let found = normal.solve(|i| ridge[i / 2])?;
    // At the minimum, what is left is Σ|h|² − sᵀEᴴh.
    let explained: f64 = found.iter().zip(&normal.right).map(|(s, b)| s * b).sum();
    sources.gains = found.as_chunks::<2>().0.to_vec();
    Some((normal.square - explained).max(0.0))
}

/// The normal equations of a step from `sources`, without ridge or damping.
pub(crate) fn equations(rows: &Rows, sources: &Sources, unknowns: Unknowns) -> Normal {
    let p = unknowns.each() * sources.len();
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
    let n = sources.len();
    let (real, imaginary) = j.split_at_mut(unknowns.each() * n);
    let k = std::f64::consts::TAU * rows.per_metre[i];
    let mut rest = rows.h[i];
    for g in 0..n {
        let r = turned(&rotations[g], rows.r[i]);
        let wave = rows.wave(i, sources.positions[g], r);
        let ([x, y], [re, im]) = (sources.gains[g], wave.e);
        let heard = [x * re - y * im, x * im + y * re];
        rest = [rest[0] - heard[0], rest[1] - heard[1]];
        (real[2 * g], real[2 * g + 1]) = (re, -im);
        (imaginary[2 * g], imaginary[2 * g + 1]) = (im, re);
        if unknowns == Unknowns::Gains {
            continue;
        }
        // ∂(s·e)/∂d = s·e·(−jk − 1/d).
        let by_d = [k * heard[1] - heard[0] / wave.d, -k * heard[0] - heard[1] / wave.d];
        let along = wave.by.map(|x| x / wave.d);
        let about =
            [r[1] * along[2] - r[2] * along[1], r[2] * along[0] - r[0] * along[2], r[0] * along[1] - r[1] * along[0]];
        for c in 0..3 {
            let at = 2 * n + 3 * g + c;
            (real[at], imaginary[at]) = (by_d[0] * along[c], by_d[1] * along[c]);
            if unknowns == Unknowns::MovesAndTurns {
                let at = at + 3 * n;
                (real[at], imaginary[at]) = (by_d[0] * about[c], by_d[1] * about[c]);
            }
        }
    }
    rest
}
