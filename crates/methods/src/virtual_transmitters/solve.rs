//! Equations of gains and moves: the best gains for given positions, and joint refinement.
//!
//! With fixed positions, h is linear in the signals: min Σ|h − Σ s·e|² + Σ ridge·|s|², with normal equations `(EᴴE +
//! ridge)·s = Eᴴh`. They use two real numbers per s, so that one Cholesky decomposition serves gains and moves.
//!
//! [`refine_positions`] moves all positions (and array rotations) by the Levenberg-Marquardt method, with the gains solved
//! inside. One step solves the equations of gains and moves together, with damping on the moves only, which is variable
//! projection in Kaufman's form. After each step the gains are solved exactly for the new positions. All computations
//! use double precision.

use crate::virtual_transmitters::equations::{MeasurementRows, NormalEquations};
use crate::virtual_transmitters::grid::SearchGrid;
use crate::virtual_transmitters::harmonics::{
    MOST, direction_and_distance, direction_vjp, harmonic_gradients, harmonics,
};
use crate::virtual_transmitters::links::VirtualSources;
use crate::virtual_transmitters::turn::{MatrixRows, rotate_quat, rotate_vector, rotation_matrix};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of blocks of rows whose equations are accumulated separately, then added in order.
const BLOCKS: usize = 8;

/// Harmonics of an isotropic source.
const FLAT: [f64; MOST] = {
    let mut flat = [0.0; MOST];
    flat[0] = 1.0;
    flat
};

/// Rows times unknowns below which one thread is faster than several. The results are equal.
const ALONE: usize = 1 << 18;

/// Unknowns: the signals `[N,K,2]`, then moves `[N,3]`, then rotations `[N,3]` about the world axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unknowns {
    Gains,
    Moves,
    MovesAndTurns,
}

impl Unknowns {
    /// Returns the number of real unknowns per source with `terms` harmonics.
    pub(crate) fn per_source(self, terms: usize) -> usize {
        match self {
            Self::Gains => 2 * terms,
            Self::Moves => 2 * terms + 3,
            Self::MovesAndTurns => 2 * terms + 6,
        }
    }
}

/// Sets the gains of `sources` to the best at their positions, with a `ridge` on |s|². Returns Σ|h − Σ s·e|² + Σ
/// ridge·|s|² of the solution; without a unique solution, returns `None` and leaves the gains.
pub(crate) fn solve_gains(rows: &MeasurementRows, sources: &mut VirtualSources, ridge: f64) -> Option<f64> {
    let normal = gain_equations(rows, sources);
    let solution = normal.solve(|_| ridge)?;
    sources.gains = solution.as_chunks::<2>().0.to_vec();
    Some(minimum_cost(&normal, &solution))
}

/// Returns the cost of [`solve_gains`] without each source in turn `[N]`; `f64::MAX` without a unique solution.
pub(crate) fn costs_without_each(rows: &MeasurementRows, sources: &VirtualSources, ridge: f64) -> Vec<f64> {
    let normal = gain_equations(rows, sources);
    let each = Unknowns::Gains.per_source(sources.harmonic_count());
    let cost = |g: usize| {
        let others = normal.without(g * each..(g + 1) * each);
        Some(minimum_cost(&others, &others.solve(|_| ridge)?))
    };
    (0..sources.len()).into_par_iter().map(|g| cost(g).unwrap_or(f64::MAX)).collect()
}

/// Returns the normal equations of all gains at the positions of `sources`, without ridge.
fn gain_equations(rows: &MeasurementRows, sources: &VirtualSources) -> NormalEquations {
    let silent = VirtualSources { gains: vec![[0.0; 2]; sources.gains.len()], ..sources.clone() };
    normal_equations(rows, &silent, Unknowns::Gains)
}

/// Returns the cost of the `solution` of equations of gains: at the minimum, Σ|h|² − sᵀEᴴh.
fn minimum_cost(normal: &NormalEquations, solution: &[f64]) -> f64 {
    let explained: f64 = solution.iter().zip(&normal.right).map(|(s, b)| s * b).sum();
    (normal.square - explained).max(0.0)
}

/// Returns the normal equations of a step from `sources`, without ridge or damping.
fn normal_equations(rows: &MeasurementRows, sources: &VirtualSources, unknowns: Unknowns) -> NormalEquations {
    let p = unknowns.per_source(sources.harmonic_count()) * sources.len();
    let pairs = rows.len().div_ceil(2); // of complex rows: four rows of J
    let block = pairs.div_ceil(BLOCKS).max(32); // fewer are not worth a task
    let rotations: Vec<_> = sources.quats.iter().map(|q| rotation_matrix(*q)).collect();
    let gather = |b: usize| {
        let mut normal = NormalEquations::new(p);
        let mut jacobian = vec![0.0; 4 * p];
        for pair in b * block..((b + 1) * block).min(pairs) {
            jacobian.fill(0.0);
            let mut residuals = [0.0; 4];
            for (half, jacobian) in jacobian.chunks_exact_mut((2 * p).max(1)).enumerate() {
                let i = 2 * pair + half;
                if i < rows.len() {
                    let [re, im] = fill_jacobian(rows, i, sources, &rotations, unknowns, jacobian);
                    (residuals[2 * half], residuals[2 * half + 1]) = (re, im);
                }
            }
            normal.add_four_rows(&jacobian, residuals);
        }
        normal
    };
    let mut total = NormalEquations::new(p);
    if rows.len() * p < ALONE {
        (0..pairs.div_ceil(block)).for_each(|b| total.add_equations(&gather(b)));
    } else {
        let blocks: Vec<NormalEquations> = (0..pairs.div_ceil(block)).into_par_iter().map(gather).collect();
        blocks.iter().for_each(|b| total.add_equations(b));
    }
    total
}

/// Sets `jacobian` `[2,P]` to the derivatives of real and imaginary part of row `i` by all unknowns, in the order of
/// [`Unknowns`]; returns the residual of h. `rotations` are the matrices of the quaternions of `sources`.
fn fill_jacobian(
    rows: &MeasurementRows,
    i: usize,
    sources: &VirtualSources,
    rotations: &[MatrixRows],
    unknowns: Unknowns,
    jacobian: &mut [f64],
) -> [f64; 2] {
    let (n, terms) = (sources.len(), sources.harmonic_count());
    let (real, imaginary) = jacobian.split_at_mut(unknowns.per_source(terms) * n);
    let (wavenumber, mut residual) = (std::f64::consts::TAU * rows.per_metre[i], rows.h[i]);
    for g in 0..n {
        let r = rotate_vector(&rotations[g], rows.r[i]);
        let wave = rows.wave(i, sources.positions[g], r);
        let (gains, [re, im]) = (sources.source_gains(g), wave.e);
        let (u, far) = direction_and_distance(sources.positions[g], rows.p[i]);
        let harmonics = if terms > 1 { harmonics(u) } else { FLAT };
        let mut received = [0.0; 2];
        for (k, [x, y]) in gains.iter().enumerate() {
            let (at, re, im) = (2 * (terms * g + k), harmonics[k] * re, harmonics[k] * im);
            received = [received[0] + (x * re - y * im), received[1] + (x * im + y * re)];
            (real[at], real[at + 1]) = (re, -im);
            (imaginary[at], imaginary[at + 1]) = (im, re);
        }
        residual = [residual[0] - received[0], residual[1] - received[1]];
        if unknowns == Unknowns::Gains {
            continue;
        }
        // ∂(s·e)/∂d = s·e·(−jk − 1/d).
        let by_d = [wavenumber * received[1] - received[0] / wave.d, -wavenumber * received[0] - received[1] / wave.d];
        let along = wave.by.map(|x| x / wave.d);
        let by_u = if terms > 1 { direction_gradient(gains, u, far, wave.e) } else { [[0.0; 3]; 2] };
        let about =
            [r[1] * along[2] - r[2] * along[1], r[2] * along[0] - r[0] * along[2], r[0] * along[1] - r[1] * along[0]];
        for c in 0..3 {
            let at = 2 * terms * n + 3 * g + c;
            (real[at], imaginary[at]) = (by_d[0] * along[c] + by_u[0][c], by_d[1] * along[c] + by_u[1][c]);
            if unknowns == Unknowns::MovesAndTurns {
                let at = at + 3 * n;
                (real[at], imaginary[at]) = (by_d[0] * about[c], by_d[1] * about[c]);
            }
        }
    }
    residual
}

/// Returns the derivatives of real and imaginary part of Σ c·Y(u)·e by the position, through the direction u only.
fn direction_gradient(gains: &[[f64; 2]], u: [f64; 3], far: f64, [re, im]: [f64; 2]) -> [[f64; 3]; 2] {
    let mut d_u = [[0.0; 3]; 2];
    for ([x, y], slope) in gains.iter().zip(harmonic_gradients(u)) {
        for c in 0..3 {
            d_u[0][c] += (x * re - y * im) * slope[c];
            d_u[1][c] += (x * im + y * re) * slope[c];
        }
    }
    d_u.map(|d_u| direction_vjp(u, far, d_u))
}

/// Options of [`refine_positions`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct RefineOptions<'a> {
    /// Maximum number of steps.
    pub(crate) steps: usize,
    /// Weight of the penalty on |s|².
    pub(crate) ridge: f64,
    /// Maximum move of a source per step, metres, at the centre of the grid; larger where maxima are wider.
    pub(crate) farthest: f64,
    pub(crate) grid: &'a SearchGrid,
    /// Whether arrays are rotated too.
    pub(crate) turns: bool,
    /// Stops the refinement once set.
    pub(crate) stop: &'a AtomicBool,
}

/// Relative gain in cost below which a step is the last.
const ENOUGH: f64 = 1e-6;

/// Moves `sources` downhill by Levenberg-Marquardt steps; returns the final cost Σ|h − Σ s·e|² + Σ ridge·|s|², or `None`
/// if the gains have no unique solution.
pub(crate) fn refine_positions(
    rows: &MeasurementRows,
    sources: &mut VirtualSources,
    options: RefineOptions<'_>,
) -> Option<f64> {
    let ridge = options.ridge;
    let mut cost = solve_gains(rows, sources, ridge)?;
    let mut damping = 1e-2; // falls after a step that lowers the cost, rises otherwise
    let mut normal = ridge_equations(rows, sources, options);
    for _ in 0..options.steps {
        if options.stop.load(Ordering::Relaxed) {
            break;
        }
        let (fixed, p) = (2 * sources.gains.len(), normal.unknown_count());
        let Some(step) = normal.solve(|i| if i < fixed { 0.0 } else { damping * normal.matrix[i * p + i] + 1e-30 })
        else {
            damping = (damping * 10.0).max(1e-3);
            continue;
        };
        let mut moved = apply_step(sources, &step, options);
        match solve_gains(rows, &mut moved, ridge) {
            Some(new) if new < cost => {
                let gained = (cost - new) / cost.max(f64::MIN_POSITIVE);
                (*sources, cost) = (moved, new);
                damping = (damping * 0.2).max(1e-9);
                if gained < ENOUGH {
                    break;
                }
                normal = ridge_equations(rows, sources, options);
            }
            _ => damping *= 5.0,
        }
        if damping > 1e8 {
            break;
        }
    }
    Some(cost)
}

/// Returns the normal equations of a step from `sources`, with the ridge on the gains.
fn ridge_equations(rows: &MeasurementRows, sources: &VirtualSources, options: RefineOptions<'_>) -> NormalEquations {
    let unknowns = if options.turns { Unknowns::MovesAndTurns } else { Unknowns::Moves };
    let mut normal = normal_equations(rows, sources, unknowns);
    let p = normal.unknown_count();
    for (i, gain) in sources.gains.as_flattened().iter().enumerate() {
        normal.matrix[i * p + i] += options.ridge;
        normal.right[i] -= options.ridge * gain;
    }
    normal
}

/// Returns `sources` after a step of moves and rotations, with moves limited as in `options` and rotations to half a
/// radian. The gains stay.
fn apply_step(sources: &VirtualSources, step: &[f64], options: RefineOptions<'_>) -> VirtualSources {
    let (n, moves) = (sources.len(), 2 * sources.gains.len());
    let mut out = sources.clone();
    let within = |by: [f64; 3], most: f64| {
        let length = by.iter().map(|x| x * x).sum::<f64>().sqrt();
        by.map(|x| x * (most / length.max(f64::MIN_POSITIVE)).min(1.0))
    };
    for g in 0..n {
        let at = |first: usize| [step[first], step[first + 1], step[first + 2]];
        let by = within(at(moves + 3 * g), options.farthest * options.grid.peak_width(out.positions[g]));
        (0..3).for_each(|c| out.positions[g][c] += by[c]);
        if options.turns {
            out.quats[g] = rotate_quat(out.quats[g], within(at(moves + 3 * n + 3 * g), 0.5));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtual_transmitters::turn::IDENTITY;
    use crate::virtual_transmitters::{ChannelInputs, field, snr_db};
    use pwrfgs_core::{Real, rng};

    #[test]
    #[cfg_attr(feature = "f64", ignore = "searched in single precision")]
    fn gains_at_given_positions_are_exact() {
        let mut random = rng::stream(7, "places", 0);
        let draw = |_| [0.0, 1.0, 0.0].map(|first| first + 2.0 * rng::uniform(&mut random));
        let positions: Vec<[Real; 3]> = (0..30).map(draw).collect();
        let mut truth = VirtualSources::default();
        for (place, gain) in [([1.1, 0.3, 1.4], [1.0, 0.0]), ([-1.3, 0.3, 1.4], [-0.6, 0.3])] {
            truth.push(place, IDENTITY, gain);
        }
        for (place, gain) in [([1.1, 0.3, -1.4], [-0.5, 0.0]), ([-1.3, 0.3, -1.4], [0.3, -0.2])] {
            truth.push(place, IDENTITY, gain);
        }
        let links = ChannelInputs { positions: &positions, antennas: &[[0.0; 3]], frequencies: &[0.6e9] };
        let h = field(&truth.to_cloud(), None, &links);
        let rows = MeasurementRows::new(
            &links,
            &h.chunks(1).collect::<Vec<_>>(),
            (&(0..30).collect::<Vec<_>>(), &[0]),
            usize::MAX,
            0,
        );
        let mut solved = VirtualSources { gains: vec![[0.0; 2]; 4], ..truth.clone() };
        assert!(solve_gains(&rows, &mut solved, 0.0).is_some());
        for (a, b) in solved.gains.iter().flatten().zip(truth.gains.iter().flatten()) {
            assert!((a - b).abs() < 1e-4, "{solved:?}");
        }
        let costs = costs_without_each(&rows, &truth, 1e-6);
        for (g, cost) in costs.into_iter().enumerate() {
            let expected = solve_gains(&rows, &mut truth.without(g), 1e-6).unwrap();
            assert!((cost - expected).abs() < 1e-9 * expected, "{g}: {cost} is not {expected}");
        }
        let mut twice = truth.select(&[0, 0]);
        assert!(
            solve_gains(&rows, &mut twice, 0.0).is_none() || snr_db(&field(&twice.to_cloud(), None, &links), &h) > 0.0
        );
        let mut small = truth.clone();
        assert!(solve_gains(&rows, &mut small, 1e9).is_some());
        assert!(small.gains.iter().flatten().all(|s| s.abs() < 1e-3), "a ridge shrinks");
    }
}
