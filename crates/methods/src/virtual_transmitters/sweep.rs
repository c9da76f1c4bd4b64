//! Grid search: the part of the residual that one more transmitter would explain, at every position of a cube about the
//! links.
//!
//! A position e explains |eᴴr|²/|e|² with its best gain. Blocks of [`LANES`] positions along x are evaluated in single
//! precision. Only the best are kept, one per maximum, so that memory does not grow with the grid. Maxima are
//! wider at larger distances from the links, so that each shell of the grid is twice as coarse as the inner one.
//!
//! [`mirror_images`] are the expected positions of images of known sources: mirrored in the planes that pairs of sources
//! share. If v' is the image of v behind a wall, the wall is the plane half-way between them, and every other source
//! has an image behind it too. There are so few such positions that little evidence distinguishes weak images of a
//! second reflection from noise.

use crate::virtual_transmitters::cis::Cis;
use crate::virtual_transmitters::equations::MeasurementRows;
use crate::virtual_transmitters::turn::{rotate_vector, rotation_matrix};
use pwrfgs_core::{evenly, widest};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Number of positions that are evaluated together.
const LANES: usize = 32;

/// Time of the lines that are timed.
const TIMED: Duration = Duration::from_millis(400);

/// Cube in shells, metres, and the rotations that are evaluated at each position.
#[derive(Clone, Debug)]
pub(crate) struct SearchGrid {
    /// Centre of the links.
    pub(crate) centre: [f64; 3],
    /// Longest side of the bounding box of the links.
    pub(crate) side: f64,
    /// Half an edge of the cube.
    pub(crate) half: f64,
    /// Grid spacing in the innermost shell, which extends a `side` in every direction.
    pub(crate) step: f64,
    pub(crate) quats: Vec<[f64; 4]>,
}

/// Candidate position of a source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Peak {
    pub(crate) position: [f64; 3],
    pub(crate) quat: [f64; 4],
    /// Energy that it explains with its best gain.
    pub(crate) explains: f64,
}

/// Positions between two cubes, with the spacing `step`.
#[derive(Clone, Copy, Debug)]
struct Shell {
    /// Half an edge of the inner and of the outer cube.
    hollow: f64,
    half: f64,
    step: f64,
}

impl Shell {
    /// Returns the number of positions along an edge of the outer cube.
    fn edge_point_count(&self) -> usize {
        (2.0 * self.half / self.step).ceil() as usize + 1
    }

    /// Returns the coordinate of position `i` along an axis, relative to the centre of the cube, metres.
    fn coordinate(&self, i: usize) -> f64 {
        i as f64 * self.step - self.half
    }

    /// Returns the segments outside the inner cube of a line along x at `y` and `z`, as first index and number of
    /// positions; the second is empty if the line misses the inner cube.
    fn segments(&self, [y, z]: [f64; 2]) -> [(usize, usize); 2] {
        let count = self.edge_point_count();
        if y.abs().max(z.abs()) >= self.hollow {
            return [(0, count), (count, 0)];
        }
        let inside = |i: &usize| self.coordinate(*i).abs() < self.hollow;
        let first = (0..count).find(inside).unwrap_or(count);
        let last = (first..count).find(|i| !inside(i)).unwrap_or(count);
        [(0, first), (last, count - last)]
    }
}

/// Positions of a shell at one height, for one rotation.
#[derive(Clone, Copy, Debug)]
struct Layer {
    shell: Shell,
    /// Index of the rotation.
    q: usize,
    z: usize,
}

impl Layer {
    /// Returns the number of positions on every `stride`th line.
    fn position_count(&self, stride: usize) -> usize {
        let Self { shell, z, .. } = self;
        let line = |y| {
            shell.segments([shell.coordinate(y), shell.coordinate(*z)]).iter().map(|(_, count)| count).sum::<usize>()
        };
        (0..shell.edge_point_count()).step_by(stride).map(line).sum()
    }
}

impl SearchGrid {
    /// Returns the width of maxima at `position`, relative to that in the innermost shell, at least 1. Maximum moves and
    /// the distance between distinct positions scale with it.
    pub(crate) fn peak_width(&self, position: [f64; 3]) -> f64 {
        let off = [0, 1, 2].map(|k| (position[k] - self.centre[k]).abs());
        (2.0 * off.into_iter().fold(0.0, f64::max) / self.side).max(1.0)
    }

    /// Returns whether a position is inside the cube.
    pub(crate) fn contains(&self, position: [f64; 3]) -> bool {
        (0..3).all(|k| (position[k] - self.centre[k]).abs() <= self.half)
    }

    /// Returns all layers of all shells, for each rotation.
    fn layers(&self) -> Vec<Layer> {
        let layers = |shell: Shell| {
            let layer = move |q| (0..shell.edge_point_count()).map(move |z| Layer { shell, q, z });
            (0..self.quats.len()).flat_map(layer)
        };
        self.shells().into_iter().flat_map(layers).collect()
    }

    /// Returns the shells from the inside out, each twice as large and as coarse as the one before.
    fn shells(&self) -> Vec<Shell> {
        let mut shells = vec![Shell { hollow: 0.0, half: self.half.min(self.side), step: self.step }];
        while let Some(last) = shells.last().copied().filter(|last| last.half < self.half) {
            shells.push(Shell { hollow: last.half, half: self.half.min(2.0 * last.half), step: 2.0 * last.step });
        }
        shells
    }

    /// Returns the approximate number of candidates: positions times rotations.
    pub(crate) fn candidate_count(&self) -> usize {
        let cube = |edge: f64, step: f64| (edge / step).powi(3);
        let positions = |s: &Shell| cube(2.0 * s.half, s.step) - cube(2.0 * s.hollow, s.step);
        (self.shells().iter().map(positions).sum::<f64>() as usize).max(1) * self.quats.len()
    }

    /// Sorts `peaks`, best first, and keeps the best `most`, one per maximum of the grid.
    pub(crate) fn keep_best_peaks(&self, peaks: &mut Vec<Peak>, most: usize) {
        keep_best_peaks(peaks, most, |peak| 2.0 * self.step * self.peak_width(peak.position));
    }
}

/// Returns the best `most` positions of `grid` for the residual `rows`, best first; the result is partial if `stop` is
/// set.
pub(crate) fn sweep_grid(rows: &MeasurementRows, grid: &SearchGrid, most: usize, stop: &AtomicBool) -> Vec<Peak> {
    sweep_lines(rows, grid, (&grid.layers(), 1), most, stop)
}

/// Sweeps a few lines for about [`TIMED`]; returns the best `most` positions in them, and the expected time of the whole
/// sweep, seconds. A busy machine only makes a pass slower, so the fastest pass counts.
pub(crate) fn time_sweep(rows: &MeasurementRows, grid: &SearchGrid, most: usize) -> (Vec<Peak>, f64) {
    let layers = evenly(&grid.layers(), 2 * rayon::current_num_threads());
    let (all, mut best) = (Instant::now(), f64::INFINITY);
    let mut stride = layers.iter().map(|layer| layer.shell.edge_point_count()).max().unwrap_or(1);
    let mut passes = 0;
    loop {
        let begun = Instant::now();
        let peaks = sweep_lines(rows, grid, (&layers, stride), most, &AtomicBool::new(false));
        let positions: usize = layers.iter().map(|layer| layer.position_count(stride)).sum();
        best = best.min(begun.elapsed().as_secs_f64() / positions.max(1) as f64);
        passes += 1;
        if stride == 1 || (passes > 2 && all.elapsed() > TIMED) {
            return (peaks, best * grid.candidate_count() as f64);
        }
        stride = stride.div_ceil(3);
    }
}

/// Sweeps every `stride`th line of some layers; returns the best `most` peaks, best first.
fn sweep_lines(
    rows: &MeasurementRows,
    grid: &SearchGrid,
    (layers, stride): (&[Layer], usize),
    most: usize,
    stop: &AtomicBool,
) -> Vec<Peak> {
    let measured: Vec<Vec<[f32; 6]>> = grid.quats.iter().map(|q| sweep_rows(rows, *q, grid.centre)).collect();
    let layer = |&Layer { shell, q, z }: &Layer| {
        let mut peaks = Vec::new();
        let mut least = 0.0;
        for y in (0..shell.edge_point_count()).step_by(stride) {
            if stop.load(Ordering::Relaxed) {
                return peaks;
            }
            let at = [shell.coordinate(y), shell.coordinate(z)];
            for (from, count) in shell.segments(at) {
                let stretch = (shell.coordinate(from), count, shell.step);
                widest(SweepLine {
                    measured: &measured[q],
                    grid,
                    stretch,
                    at,
                    quat: grid.quats[q],
                    peaks: &mut peaks,
                    least,
                });
            }
            if peaks.len() > 8 * most {
                grid.keep_best_peaks(&mut peaks, most);
                least = if peaks.len() == most { peaks[most - 1].explains } else { 0.0 };
            }
        }
        grid.keep_best_peaks(&mut peaks, most);
        peaks
    };
    let layers: Vec<Vec<Peak>> = layers.par_iter().map(layer).collect();
    let mut peaks = layers.concat();
    grid.keep_best_peaks(&mut peaks, most);
    peaks
}

/// Sorts `peaks`, best first, and keeps the best `most`, none closer to a better one than `apart` of either, metres.
pub(crate) fn keep_best_peaks(peaks: &mut Vec<Peak>, most: usize, apart: impl Fn(&Peak) -> f64) {
    peaks.sort_by(|a, b| b.explains.total_cmp(&a.explains).then_with(|| compare_positions(a, b)));
    let mut kept: Vec<(Peak, f64)> = Vec::with_capacity(most);
    for peak in peaks.iter() {
        let distance = apart(peak);
        let near = |(k, other): &(Peak, f64)| {
            (0..3).map(|c| (k.position[c] - peak.position[c]).powi(2)).sum::<f64>() < distance.max(*other).powi(2)
        };
        if !kept.iter().any(near) {
            kept.push((*peak, distance));
            if kept.len() == most {
                break;
            }
        }
    }
    *peaks = kept.into_iter().map(|(peak, _)| peak).collect();
}

/// Compares positions by x, then y, then z.
fn compare_positions(a: &Peak, b: &Peak) -> std::cmp::Ordering {
    (0..3).fold(std::cmp::Ordering::Equal, |o, k| o.then_with(|| a.position[k].total_cmp(&b.position[k])))
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

/// Segment of one line along x.
struct SweepLine<'a> {
    measured: &'a [[f32; 6]],
    grid: &'a SearchGrid,
    /// First position relative to the centre of the cube, metres, number of positions, and their spacing.
    stretch: (f64, usize, f64),
    /// Coordinates y and z relative to the centre of the cube, metres.
    at: [f64; 2],
    quat: [f64; 4],
    peaks: &'a mut Vec<Peak>,
    /// Smallest explained energy that is kept.
    least: f64,
}

impl pulp::WithSimd for SweepLine<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let (start, count, step) = self.stretch;
        let centre = self.grid.centre;
        let at = self.at.map(|x| x as f32);
        let mut first = 0;
        while first < count {
            let mut x = [0.0_f32; LANES];
            for l in 0..LANES {
                x[l] = (start + (first + l) as f64 * step) as f32;
            }
            let explains = explained_energy(self.measured, &x, at);
            for l in 0..LANES.min(count - first) {
                // Maximum along the line: its neighbours belong to the same maximum.
                let is_peak =
                    (l == 0 || explains[l - 1] <= explains[l]) && (l + 1 == LANES || explains[l + 1] <= explains[l]);
                if is_peak && f64::from(explains[l]) > self.least {
                    let position = [f64::from(x[l]) + centre[0], self.at[0] + centre[1], self.at[1] + centre[2]];
                    self.peaks.push(Peak { position, quat: self.quat, explains: f64::from(explains[l]) });
                }
            }
            first += LANES;
        }
    }
}

/// Returns the explained energy |eᴴr|²/|e|² at LANES positions `x` (relative to the centre) of the line at y, z `at`.
#[inline(always)]
fn explained_energy(rows: &[[f32; 6]], x: &[f32; LANES], at: [f32; 2]) -> [f32; LANES] {
    let (mut re, mut im, mut energy) = ([0.0_f32; LANES], [0.0_f32; LANES], [0.0_f32; LANES]);
    for i in 0..rows.len() {
        let [px, py, pz, per_metre, h_re, h_im] = rows[i];
        let across = (at[0] - py) * (at[0] - py) + (at[1] - pz) * (at[1] - pz) + 1e-6;
        for l in 0..LANES {
            let dx = x[l] - px;
            let d2 = dx.mul_add(dx, across);
            let d = d2.sqrt();
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

/// Returns a peak without explained energy per rotation and position.
pub(crate) fn unscored_peaks(positions: &[[f64; 3]], quats: &[[f64; 4]]) -> Vec<Peak> {
    let peak = |quat, position| Peak { position, quat, explains: 0.0 };
    quats.iter().flat_map(|quat| positions.iter().map(|position| peak(*quat, *position))).collect()
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
