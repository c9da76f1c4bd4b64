//! The measured numbers, one row each, in double precision: what gains and positions are fitted to.

use crate::virtual_transmitters::field::CLOSEST;
use crate::virtual_transmitters::harmonics::gain;
use crate::virtual_transmitters::links::{Links, Sources};
use crate::virtual_transmitters::turn::{matrix, turned};
use pwrfgs_core::{Real, SPEED_OF_LIGHT, evenly, rng};
use rayon::prelude::*;

/// K rows, one column a quantity.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows {
    /// The moving end `[K,3]`, metres.
    pub(crate) p: Vec<[f64; 3]>,
    /// The antenna in the node's frame `[K,3]`, metres.
    pub(crate) r: Vec<[f64; 3]>,
    /// Wavelengths in a metre `[K]`.
    pub(crate) per_metre: Vec<f64>,
    /// h `[K]`.
    pub(crate) h: Vec<[f64; 2]>,
}

impl Rows {
    /// The rows of the items listed; of more than `most`, an equal number of each item, drawn at random.
    pub(crate) fn new(links: &Links<'_>, channel: &[[Real; 2]], items: &[usize], most: usize, seed: u64) -> Self {
        let subcarriers = links.frequencies.len();
        let each = links.antennas.len() * subcarriers;
        let taken = (most / items.len().max(1)).clamp(1, each);
        let items = evenly(items, most);
        let mut order: Vec<usize> = (0..each).collect();
        let mut out = Self::default();
        for m in items {
            if taken < each {
                rng::shuffle(&mut rng::stream(seed, "rows", m as u64), &mut order);
            }
            for &k in &order[..taken] {
                out.p.push(links.positions[m].map(f64::from));
                out.r.push(links.antennas[k / subcarriers].map(f64::from));
                out.per_metre.push(links.frequencies[k % subcarriers] / SPEED_OF_LIGHT);
                out.h.push(channel[m * each + k].map(f64::from));
            }
        }
        out
    }

    /// K.
    pub(crate) fn len(&self) -> usize {
        self.h.len()
    }

    /// Σ|h|².
    pub(crate) fn energy(&self) -> f64 {
        self.h.iter().map(|[re, im]| re * re + im * im).sum()
    }

    /// |s|² of the sources, each the mean over the directions in which it is heard, and the mean of all.
    pub(crate) fn signal(&self, sources: &Sources) -> f64 {
        let of = |g: usize| {
            let heard = |p: &[f64; 3]| gain(sources.gains_of(g), sources.positions[g], *p);
            self.p.iter().map(|p| heard(p).iter().map(|x| x * x).sum::<f64>()).sum::<f64>() / self.len().max(1) as f64
        };
        let each: Vec<f64> = (0..sources.len()).into_par_iter().map(of).collect();
        each.iter().sum::<f64>() / sources.len().max(1) as f64
    }

    /// The same rows with h less what the sources send.
    pub(crate) fn residual(&self, sources: &Sources) -> Self {
        let rotations: Vec<_> = sources.quats.iter().map(|q| matrix(*q)).collect();
        let rest = |i: usize| {
            let mut rest = self.h[i];
            for g in 0..sources.len() {
                let e = self.wave(i, sources.positions[g], turned(&rotations[g], self.r[i])).e;
                let [x, y] = gain(sources.gains_of(g), sources.positions[g], self.p[i]);
                rest = [rest[0] - (x * e[0] - y * e[1]), rest[1] - (x * e[1] + y * e[0])];
            }
            rest
        };
        let h = (0..self.len()).into_par_iter().with_min_len(1024).map(rest).collect();
        Self { h, ..self.clone() }
    }

    /// What a transmitter at `v` of signal 1, whose antenna is turned to `turned`, is heard as in row `i`.
    #[inline(always)]
    pub(crate) fn wave(&self, i: usize, v: [f64; 3], turned: [f64; 3]) -> Wave {
        let by = [0, 1, 2].map(|k| v[k] + turned[k] - self.p[i][k]);
        let d = (by[0] * by[0] + by[1] * by[1] + by[2] * by[2]).sqrt().max(CLOSEST);
        let cycles = d * self.per_metre[i];
        let (sin, cos) = ((cycles - cycles.round()) * std::f64::consts::TAU).sin_cos();
        Wave { by, d, e: [cos / d, -sin / d] }
    }
}

/// exp(-jkd)/d, the distance d and the vector from the moving end to the antenna, metres.
pub(crate) struct Wave {
    pub(crate) by: [f64; 3],
    pub(crate) d: f64,
    pub(crate) e: [f64; 2],
}
