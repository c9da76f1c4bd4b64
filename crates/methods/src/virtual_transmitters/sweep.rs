//! Coarse-to-fine search for the part of the residual that one more transmitter would explain, in a cube about the links.
//!
//! A position e explains |eᴴr|²/|e|² with its best gain. In windows of rows, each with a gain of its own, it explains the
//! sum of |eᴴr|²/|e|² over windows. The sum is at least as much (Cauchy-Schwarz), and varies 2^l times slower over space
//! if windows are 2^l times narrower. The sweep scores all cells of a coarse grid in narrow windows, keeps the best
//! [`KEPT`], divides each into eight and doubles the width of the windows, until all rows are one window and cells have
//! the spacing of the grid. Blocks of [`LANES`] cells are evaluated in single precision. Maxima are wider at larger distances
//! from the links, so that each shell of the grid is twice as coarse as the inner one.
//!
//! Bound of the skipped cells: a cell is dropped only if [`KEPT`] others explain more in windows of the same level,
//! and no position explains more coherently than in windows of the same rows. The loss between the centre of a cell and
//! its corners is not bounded. A grid of at most [`START`](super::grid::START) cells is scored completely.
//!
//! [`mirror_images`] are the expected positions of images of given sources: mirrored in the planes half-way between pairs
//! of sources. If v' is the image of v behind a wall, the wall is the plane half-way between them, and every other source
//! has an image behind it too. There are so few such positions that little evidence distinguishes weak images of a
//! second reflection from noise.

use crate::virtual_transmitters::cis::Cis;
use crate::virtual_transmitters::equations::MeasurementRows;
use crate::virtual_transmitters::grid::{Cell, SearchGrid};
use crate::virtual_transmitters::links::VirtualSources;
use crate::virtual_transmitters::turn::{rotate_vector, rotation_matrix};
use crate::virtual_transmitters::windows::SearchLevel;
use pwrfgs_core::widest;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of cells that are evaluated together.
const LANES: usize = 32;
/// Number of cells between two reports of progress.
const BATCH: usize = 1 << 14;
/// Number of cells that are divided per level.
const KEPT: usize = 1 << 12;

/// Returns the best `most` positions of `grid` for the channel less the field of `sources`, best first; the result is
/// partial if `stop` is set. `levels` are from fine to coarse. The sweep starts from one of `share` cells, and keeps that
/// share of cells per level. `report` receives the number of scored cells, and the expected number of all.
pub(crate) fn sweep_cells(
    (levels, grid): (&[SearchLevel], &SearchGrid),
    sources: &VirtualSources,
    (most, share): (usize, usize),
    stop: &AtomicBool,
    report: &mut dyn FnMut(usize, usize),
) -> Vec<Cell> {
    let (mut best, mut done): (Vec<Cell>, usize) = (Vec::new(), 0);
    let divided = (KEPT / share).max(1);
    for (l, level) in levels.iter().enumerate().rev() {
        let start = l + 1 == levels.len();
        let eighths = if start { Vec::new() } else { divide_best_cells(std::mem::take(&mut best), divided) };
        let whole = if start { grid.cell_count(level.step) / share } else { eighths.len() };
        let total = done + whole + 8 * l * divided; // each finer level scores the eighths of the best cells
        let grid_cells = start.then(|| grid.cells(level.step).step_by(share)).into_iter().flatten();
        let mut cells = grid_cells.chain(eighths).peekable();
        let residual = level.rows.residual(sources);
        while cells.peek().is_some() && !stop.load(Ordering::Relaxed) {
            let mut batch: Vec<Cell> = cells.by_ref().take(BATCH).collect();
            score_cells((&residual, &level.ends), grid, &mut batch);
            done += batch.len();
            report(done, total.max(done));
            best.extend(batch);
            // Bounds the memory if windows with enough values still leave a fine grid.
            if best.len() > 16 * KEPT {
                best.sort_by(compare_cells);
                best.truncate(8 * KEPT);
            }
        }
    }
    keep_best_cells(&mut best, most, |cell| 2.0 * grid.step * grid.peak_width(cell.centre));
    best
}

/// Sets the explained energy of `cells`, which are sorted by rotation, for a residual in windows with these ends.
pub(crate) fn score_cells((residual, ends): (&MeasurementRows, &[usize]), grid: &SearchGrid, cells: &mut [Cell]) {
    for cells in cells.chunk_by_mut(|a, b| a.q == b.q) {
        let rows = &sweep_rows(residual, grid.quats[cells[0].q], grid.centre);
        let score = |cells| widest(CellBlock { rows, ends, centre: grid.centre, cells });
        cells.par_chunks_mut(LANES).for_each(score);
    }
}

/// Returns the eighths of the best `most` cells, sorted by rotation.
fn divide_best_cells(mut cells: Vec<Cell>, most: usize) -> Vec<Cell> {
    cells.sort_by(compare_cells);
    cells.truncate(most);
    cells.sort_by_key(|cell| cell.q);
    let eighth = |cell: Cell| {
        (0..8).map(move |i| {
            let by = |k: usize| if i >> k & 1 == 1 { cell.size / 4.0 } else { -cell.size / 4.0 };
            Cell { centre: [0, 1, 2].map(|k| cell.centre[k] + by(k)), size: cell.size / 2.0, ..cell }
        })
    };
    cells.into_iter().flat_map(eighth).collect()
}

/// Sorts `cells`, best first, and keeps the best `most`, none closer to a better one than `apart` of either, metres.
fn keep_best_cells(cells: &mut Vec<Cell>, most: usize, apart: impl Fn(&Cell) -> f64) {
    cells.sort_by(compare_cells);
    let mut kept: Vec<(Cell, f64)> = Vec::with_capacity(most);
    for cell in cells.iter() {
        let distance = apart(cell);
        let near = |(k, other): &(Cell, f64)| {
            (0..3).map(|c| (k.centre[c] - cell.centre[c]).powi(2)).sum::<f64>() < distance.max(*other).powi(2)
        };
        if !kept.iter().any(near) {
            kept.push((*cell, distance));
            if kept.len() == most {
                break;
            }
        }
    }
    *cells = kept.into_iter().map(|(cell, _)| cell).collect();
}

/// Compares cells by explained energy, best first, then by position and rotation.
pub(crate) fn compare_cells(a: &Cell, b: &Cell) -> std::cmp::Ordering {
    let by_energy = b.explains.total_cmp(&a.explains);
    let by_position = (0..3).fold(by_energy, |o, k| o.then_with(|| a.centre[k].total_cmp(&b.centre[k])));
    by_position.then(a.q.cmp(&b.q))
}

/// Returns the rows `[K,6]` for one rotation: p − R r relative to the centre of the cube (metres), wavelengths per metre,
/// real and imaginary part of the residual.
fn sweep_rows(rows: &MeasurementRows, quat: [f64; 4], centre: [f64; 3]) -> Vec<[f32; 6]> {
    let rotation = rotation_matrix(quat);
    let row = |i: usize| {
        let (p, r, [re, im]) = (rows.p[i], rotate_vector(&rotation, rows.r[i]), rows.h[i]);
        let [x, y, z] = [0, 1, 2].map(|k| (p[k] - r[k] - centre[k]) as f32);
        [x, y, z, rows.per_metre[i] as f32, re as f32, im as f32]
    };
    (0..rows.len()).map(row).collect()
}

/// Up to [`LANES`] cells of one rotation.
struct CellBlock<'a> {
    rows: &'a [[f32; 6]],
    /// End of each window in `rows`.
    ends: &'a [usize],
    centre: [f64; 3],
    cells: &'a mut [Cell],
}

impl pulp::WithSimd for CellBlock<'_> {
    type Output = ();

    /// Sets the explained energy Σ |eᴴr|²/|e|² over windows of each cell.
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let mut at = [[0.0_f32; LANES]; 3];
        for (l, cell) in self.cells.iter().enumerate() {
            (0..3).for_each(|k| at[k][l] = (cell.centre[k] - self.centre[k]) as f32);
        }
        let (mut explains, mut first) = ([0.0_f32; LANES], 0);
        for end in self.ends {
            let window = explained_energy(&self.rows[first..*end], &at);
            for l in 0..LANES {
                explains[l] += window[l];
            }
            first = *end;
        }
        self.cells.iter_mut().zip(explains).for_each(|(cell, explains)| cell.explains = f64::from(explains));
    }
}

/// Returns the explained energy |eᴴr|²/|e|² of one window at LANES positions relative to the centre.
#[inline(always)]
fn explained_energy(rows: &[[f32; 6]], [x, y, z]: &[[f32; LANES]; 3]) -> [f32; LANES] {
    let (mut re, mut im, mut energy) = ([0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
    for i in 0..rows.len() {
        let [px, py, pz, per_metre, h_re, h_im] = rows[i];
        for l in 0..LANES {
            let (dx, dy, dz) = (x[l] - px, y[l] - py, z[l] - pz);
            // Adds (1 mm)², so that no distance is 0.
            let d = dx.mul_add(dx, dy.mul_add(dy, dz.mul_add(dz, 1e-6))).sqrt();
            let inverse = 1.0 / d;
            let (cos, sin) = f32::cis(d * per_metre);
            // conj(e)·r with e = exp(-jkd)/d.
            re[l] = (h_re * cos - h_im * sin).mul_add(inverse, re[l]);
            im[l] = (h_re * sin + h_im * cos).mul_add(inverse, im[l]);
            energy[l] = inverse.mul_add(inverse, energy[l]);
        }
    }
    let mut out = [0.0; LANES];
    for l in 0..LANES {
        out[l] = (re[l] * re[l] + im[l] * im[l]) / energy[l];
    }
    out
}

/// Share of the moving positions that may be behind a wall, for example over the edge of a table.
const BEHIND: f64 = 0.02;

/// Returns the mirror images of all `sources` in all planes half-way between two of them that have nearly all `moving`
/// positions on one side. Excludes images outside `grid`, and those closer than `apart` (metres) to a source or to
/// each other.
pub(crate) fn mirror_images(sources: &[[f64; 3]], moving: &[[f64; 3]], grid: &SearchGrid, apart: f64) -> Vec<[f64; 3]> {
    let near = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>() < apart * apart;
    let mut images: Vec<[f64; 3]> = Vec::new();
    for (i, a) in sources.iter().enumerate() {
        for b in &sources[..i] {
            let Some(plane) = CutPlane::between(*a, *b).filter(|p| p.is_clear_of(moving)) else { continue };
            for v in sources {
                let image = plane.mirrored(*v);
                if grid.contains(image) && !sources.iter().chain(&images).any(|p| near(p, &image)) {
                    images.push(image);
                }
            }
        }
    }
    images
}

/// Plane n·x = at, with n of length 1.
struct CutPlane {
    n: [f64; 3],
    at: f64,
}

impl CutPlane {
    /// Creates the plane half-way between two positions; `None` if they are closer than a millimetre.
    fn between(a: [f64; 3], b: [f64; 3]) -> Option<Self> {
        let by = [0, 1, 2].map(|k| b[k] - a[k]);
        let length = by.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length < 1e-3 {
            return None;
        }
        let n = by.map(|x| x / length);
        Some(Self { n, at: (0..3).map(|k| n[k] * (a[k] + b[k]) / 2.0).sum() })
    }

    /// Returns the distance of `x` from the plane, metres, negative on the side of the first position.
    fn signed_distance(&self, x: &[f64; 3]) -> f64 {
        (0..3).map(|k| self.n[k] * x[k]).sum::<f64>() - self.at
    }

    /// Returns whether nearly all positions are on one side of the plane.
    fn is_clear_of(&self, positions: &[[f64; 3]]) -> bool {
        let above =
            positions.iter().filter(|p| self.signed_distance(p) > 0.0).count() as f64 / positions.len().max(1) as f64;
        above.min(1.0 - above) <= BEHIND
    }

    /// Returns the mirror image of `v`.
    fn mirrored(&self, v: [f64; 3]) -> [f64; 3] {
        let distance = self.signed_distance(&v);
        [0, 1, 2].map(|k| v[k] - 2.0 * distance * self.n[k])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_double_reflection_from_two_images() {
        let (node, wall, floor) = ([1.0, 0.5, 1.5], [-3.0, 0.5, 1.5], [1.0, 0.5, -1.5]);
        let positions = [[0.0, 0.0, 1.0], [1.0, 1.0, 2.0]];
        let grid = SearchGrid { centre: [0.0; 3], side: 1.0, half: 100.0, step: 1.0, quats: Vec::new() };
        let mirrored = mirror_images(&[node, wall, floor], &positions, &grid, 0.05);
        assert!(mirrored.iter().any(|p| (0..3).all(|k| (p[k] - [-3.0, 0.5, -1.5][k]).abs() < 1e-12)), "{mirrored:?}");
        let across = mirror_images(&[node, wall], &[[-2.0, 0.0, 1.0], [1.0, 1.0, 2.0]], &grid, 0.05);
        assert!(across.is_empty(), "no wall goes through where the moving end was: {across:?}");
    }
}
