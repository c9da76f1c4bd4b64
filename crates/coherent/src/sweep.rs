//! The grid: how much of the residual one more transmitter would explain, at every place of a box.
//!
//! A place e explains |eᴴr|²/|e|² with its best gain. Places are taken sixteen times two along x at once, in single
//! precision; only the best are kept, apart by half a wavelength, so memory does not grow with the grid.

use crate::cis::{Cis, widest};
use crate::rows::Rows;
use crate::turn::{matrix, turned};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Places that are tried at once.
const LANES: usize = 32;

/// A box and the distance of its places, metres, and the rotations that are tried at each.
#[derive(Clone, Debug)]
pub(crate) struct Grid {
    pub(crate) low: [f64; 3],
    pub(crate) high: [f64; 3],
    pub(crate) step: f64,
    pub(crate) quats: Vec<[f64; 4]>,
}

/// A place where something may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Peak {
    pub(crate) place: [f64; 3],
    pub(crate) quat: [f64; 4],
    /// Energy that it explains with its best gain.
    pub(crate) explains: f64,
}

impl Grid {
    /// Places along each axis.
    fn counts(&self) -> [usize; 3] {
        [0, 1, 2].map(|k| ((self.high[k] - self.low[k]) / self.step).ceil().max(0.0) as usize + 1)
    }

    /// Places times rotations.
    pub(crate) fn len(&self) -> usize {
        self.counts().iter().product::<usize>() * self.quats.len()
    }
}

/// The best `most` places of `grid` for the residual `rows`, the best first; what was found so far where `stop` is set.
pub(crate) fn sweep(rows: &Rows, grid: &Grid, most: usize, apart: f64, stop: &AtomicBool) -> Vec<Peak> {
    let [_, ny, nz] = grid.counts();
    let tasks: Vec<(usize, usize)> = (0..grid.quats.len()).flat_map(|q| (0..nz).map(move |z| (q, z))).collect();
    let turned: Vec<Heard> = grid.quats.iter().map(|q| Heard::new(rows, *q, grid.low)).collect();
    let layer = |&(q, z): &(usize, usize)| {
        let mut found = Vec::new();
        if stop.load(Ordering::Relaxed) {
            return found;
        }
        let mut least = 0.0;
        for y in 0..ny {
            let at = [y as f64 * grid.step, z as f64 * grid.step];
            widest(Line { heard: &turned[q], grid, at, quat: grid.quats[q], found: &mut found, least });
            if found.len() > 8 * most {
                thin(&mut found, most, apart);
                least = if found.len() == most { found[most - 1].explains } else { 0.0 };
            }
        }
        thin(&mut found, most, apart);
        found
    };
    let layers: Vec<Vec<Peak>> = tasks.par_iter().map(layer).collect();
    let mut found = layers.concat();
    thin(&mut found, most, apart);
    found
}

/// The best `most`, none within `apart` of a better one.
pub(crate) fn thin(found: &mut Vec<Peak>, most: usize, apart: f64) {
    found.sort_by(|a, b| b.explains.total_cmp(&a.explains).then_with(|| by_place(a, b)));
    let mut kept: Vec<Peak> = Vec::with_capacity(most);
    for peak in found.iter() {
        let near = |k: &Peak| (0..3).map(|c| (k.place[c] - peak.place[c]).powi(2)).sum::<f64>() < apart * apart;
        if !kept.iter().any(near) {
            kept.push(*peak);
            if kept.len() == most {
                break;
            }
        }
    }
    *found = kept;
}

fn by_place(a: &Peak, b: &Peak) -> std::cmp::Ordering {
    (0..3).fold(std::cmp::Ordering::Equal, |o, k| o.then_with(|| a.place[k].total_cmp(&b.place[k])))
}

/// The rows for one rotation, relative to the corner of the box: p − R r, wavelengths in a metre, residual.
struct Heard {
    rows: Vec<[f32; 6]>,
}

impl Heard {
    fn new(rows: &Rows, quat: [f64; 4], low: [f64; 3]) -> Self {
        let rotation = matrix(quat);
        let row = |i: usize| {
            let (p, r, [re, im]) = (rows.p[i], turned(&rotation, rows.r[i]), rows.h[i]);
            let [x, y, z] = [0, 1, 2].map(|k| (p[k] - r[k] - low[k]) as f32);
            [x, y, z, rows.per_metre[i] as f32, re as f32, im as f32]
        };
        Self { rows: (0..rows.len()).map(row).collect() }
    }
}

/// All places of one line along x.
struct Line<'a> {
    heard: &'a Heard,
    grid: &'a Grid,
    /// y and z from the corner of the box, metres.
    at: [f64; 2],
    quat: [f64; 4],
    found: &'a mut Vec<Peak>,
    /// What explains less is not kept.
    least: f64,
}

impl pulp::WithSimd for Line<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Grid { low, step, .. } = *self.grid;
        let [nx, ..] = self.grid.counts();
        let at = self.at.map(|x| x as f32);
        let mut first = 0;
        while first < nx {
            let mut x = [0.0_f32; LANES];
            for l in 0..LANES {
                x[l] = ((first + l) as f64 * step) as f32;
            }
            let explains = explained(&self.heard.rows, &x, at);
            for l in 0..LANES.min(nx - first) {
                // A maximum along the line: its neighbours are the same hill.
                let falls =
                    (l == 0 || explains[l - 1] <= explains[l]) && (l + 1 == LANES || explains[l + 1] <= explains[l]);
                if falls && f64::from(explains[l]) > self.least {
                    let place = [f64::from(x[l]) + low[0], self.at[0] + low[1], self.at[1] + low[2]];
                    self.found.push(Peak { place, quat: self.quat, explains: f64::from(explains[l]) });
                }
            }
            first += LANES;
        }
    }
}

/// |eᴴr|²/|e|² at LANES places.
#[inline(always)]
fn explained(rows: &[[f32; 6]], x: &[f32; LANES], at: [f32; 2]) -> [f32; LANES] {
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
