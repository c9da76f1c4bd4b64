//! Whether pictures are those of a planar antenna array, and of which.
//!
//! What an array of R x C antennas hears from the direction with cosines u and v is |aᴴh|, and its square is a sum of the
//! (2R−1)(2C−1) lags cos and sin of 2πd(m u + n v), |m| < C and |n| < R, with d the spacing in wavelengths. A picture p is this
//! power, its root, or the root stretched: (p + a)² b = |aᴴh|². The last says that p² + κp lies in the span of the lags,
//! of which 1 is one, with one κ = 2a a picture; κ = 0 without an offset. So every candidate is linear least squares, and
//! what is left is held against what rounding e of p does to it: (2p + κ)e.

use super::components::dot;
use super::scattered;
use pwrfgs_core::{Dataset, Image, Real, evenly};
use pwrfgs_experiment::scores::quantile;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Pictures and pixels that are fitted.
const PICTURES: usize = 12;
const PIXELS: usize = 800;
/// Square arrays that are tried.
const LARGEST: usize = 8;
/// Spacings that are tried, wavelengths; between the best and its neighbours it is refined.
const SPACINGS: (f64, f64, f64) = (0.2, 1.0, 0.04);
const REFINEMENTS: usize = 14;
/// A residual so many times that of rounding counts as rounding.
const SLACK: f64 = 1.3;
/// A lag that others make up to this part of it says nothing new.
const DEPENDENT: f64 = 1e-6;

/// What a pixel is of the array's |aᴴh|.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Amplitude, stretched from its smallest to its largest value.
    Stretched,
    /// Amplitude, from zero.
    Amplitude,
    /// Its square.
    Power,
}

impl Kind {
    /// What is tried of pictures that each run from 0 to 1, or do not.
    fn tried(each_stretched: bool) -> &'static [Self] {
        if each_stretched { &[Self::Power, Self::Stretched] } else { &[Self::Power, Self::Amplitude, Self::Stretched] }
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Stretched => "amplitude, each picture shifted and stretched (`readout: MinMax`)",
            Self::Amplitude => "amplitude from zero (`readout: Magnitude`)",
            Self::Power => "power (`readout: Power`)",
        }
    }
}

/// An array that explains the pictures, or comes nearest to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Array {
    /// Antennas along y of the receiver.
    pub rows: usize,
    /// Antennas along x.
    pub columns: usize,
    /// Distance of neighbours, wavelengths.
    pub spacing: f64,
    /// What a pixel is.
    pub kind: Kind,
    /// RMS of what is left, in units of rounding; about 1 where the array explains everything. Median over pictures.
    pub residual: f64,
}

impl Array {
    /// Whether rounding alone is left.
    pub fn explains(&self) -> bool {
        self.residual <= SLACK
    }

    /// Real numbers in the squared picture.
    pub fn lags(&self) -> usize {
        (2 * self.rows - 1) * (2 * self.columns - 1)
    }

    /// Real numbers in the antennas' signals, whose common phase does not show.
    pub fn signals(&self) -> usize {
        2 * self.rows * self.columns - 1
    }
}

/// The smallest array that explains the pictures `lively`, whose rounding has the RMS `rounding`; the one that comes
/// nearest where none does, and nothing of fewer than four pictures or a few pixels.
pub(super) fn array(data: &Dataset, lively: &[usize], rounding: f64) -> Option<Array> {
    let problem = Problem::of(data, lively, rounding);
    if problem.pictures.len() < 4 {
        return None;
    }
    let mut nearest: Option<Array> = None;
    for n in 2..=LARGEST {
        let found = problem.best_spacing(n);
        if found.explains() {
            return Some(problem.smallest_within(found));
        }
        if found.residual.is_finite() && nearest.is_none_or(|before| found.residual < 0.7 * before.residual) {
            nearest = Some(found);
        }
    }
    nearest
}

/// Pictures on some pixels.
struct Problem {
    /// Direction cosines along x and y of each pixel.
    cosines: Vec<[f64; 2]>,
    pictures: Vec<Vec<f64>>,
    rounding: f64,
    kinds: &'static [Kind],
}

impl Problem {
    fn of(data: &Dataset, lively: &[usize], rounding: f64) -> Self {
        let (pixels, plane) = (scattered(PIXELS, (data.width, data.height)), data.plane());
        let cosine = |&p: &usize| {
            let direction = plane.direction((p % data.width) as Real, (p / data.width) as Real).unwrap_or_default();
            [direction[0] as f64, direction[1] as f64]
        };
        let images: Vec<Image> = evenly(lively, PICTURES).into_iter().map(|i| data.image(i)).collect();
        let read = |image: &Image| pixels.iter().map(|&p| image.pixels[p] as f64).collect();
        let stretched = |image: &Image| [0.0, 1.0].iter().all(|end| image.pixels.contains(end));
        let kinds = Kind::tried(images.iter().all(stretched));
        let pictures = images.iter().map(read).collect();
        Self { cosines: pixels.iter().map(cosine).collect(), pictures, rounding, kinds }
    }

    /// The spacing at which an array of `n` x `n` leaves least.
    fn best_spacing(&self, n: usize) -> Array {
        let (first, last, step) = SPACINGS;
        let count = ((last - first) / step).round() as usize;
        let tried = (0..=count).into_par_iter().map(|k| self.fit(n, n, first + step * k as f64));
        let all: Vec<Array> = tried.collect();
        let best = all.into_iter().reduce(|a, b| if b.residual < a.residual { b } else { a });
        let mut best = best.unwrap_or_else(|| self.fit(n, n, first));
        let mut reach = step;
        for _ in 0..REFINEMENTS {
            let around = [-0.5, 0.5].map(|part| best.spacing + part * reach);
            let (a, b) = rayon::join(|| self.fit(n, n, around[0]), || self.fit(n, n, around[1]));
            best = [best, a, b].into_iter().reduce(|a, b| if b.residual < a.residual { b } else { a }).unwrap_or(best);
            reach *= 0.6;
        }
        best
    }

    /// Fewer rows or columns at the same spacing, where they do.
    fn smallest_within(&self, found: Array) -> Array {
        let n = found.rows;
        let fewest = |fit: &dyn Fn(usize) -> Array| (1..=n).find(|k| fit(*k).explains()).unwrap_or(n);
        let rows = fewest(&|rows| self.fit(rows, n, found.spacing));
        let columns = fewest(&|columns| self.fit(n, columns, found.spacing));
        let smaller = self.fit(rows, columns, found.spacing);
        if smaller.explains() { smaller } else { found }
    }

    /// What is left with this array, as the kind that leaves least. A kind with a freedom more must leave much less.
    fn fit(&self, rows: usize, columns: usize, spacing: f64) -> Array {
        let basis = self.basis(rows, columns, spacing);
        let of = |kind: Kind| {
            let mut left: Vec<f64> = self.pictures.iter().map(|p| self.left(&basis, p, kind)).collect();
            left.sort_by(f64::total_cmp);
            Array { rows, columns, spacing, kind, residual: quantile(&left, 0.5) }
        };
        let better = |a: Array, b: Array| if b.residual < 0.8 * a.residual { b } else { a };
        self.kinds.iter().copied().map(of).reduce(better).expect("there are kinds")
    }

    /// Orthonormal columns that span the lags.
    fn basis(&self, rows: usize, columns: usize, spacing: f64) -> Vec<Vec<f64>> {
        let (m, n) = (columns as i32 - 1, rows as i32 - 1);
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for (k, l) in (0..=m).flat_map(|k| (-n..=n).map(move |l| (k, l))).filter(|&(k, l)| k > 0 || l >= 0) {
            let phase = |[x, y]: &[f64; 2]| TAU * spacing * (f64::from(k) * x + f64::from(l) * y);
            for wave in [f64::cos, f64::sin] {
                let mut column: Vec<f64> = self.cosines.iter().map(|u| wave(phase(u))).collect();
                let size = dot(&column, &column);
                for q in &basis {
                    let part = dot(&column, q);
                    subtract(&mut column, q, part);
                }
                let rest = dot(&column, &column);
                if rest > DEPENDENT.powi(2) * size.max(1e-9) {
                    column.iter_mut().for_each(|c| *c /= rest.sqrt());
                    basis.push(column);
                }
            }
        }
        basis
    }

    /// RMS of what the lags leave of a picture, over that of its rounding. A fit takes from rounding what it has numbers
    /// for; one with more than a third of the pixels would explain anything.
    fn left(&self, basis: &[Vec<f64>], p: &[f64], kind: Kind) -> f64 {
        if 3 * basis.len() > p.len() {
            return f64::INFINITY;
        }
        let free = (p.len() as f64 / (p.len() - basis.len() - 1) as f64).sqrt();
        let outside = |mut y: Vec<f64>| {
            basis.iter().for_each(|q| {
                let part = dot(&y, q);
                subtract(&mut y, q, part);
            });
            y
        };
        let linear = outside(p.to_vec());
        if kind == Kind::Power {
            return free * rms(&linear) / self.rounding;
        }
        let mut square = outside(p.iter().map(|p| p * p).collect());
        let kappa = match kind {
            Kind::Stretched => (-dot(&square, &linear) / dot(&linear, &linear).max(f64::MIN_POSITIVE)).max(0.0),
            _ => 0.0,
        };
        subtract(&mut square, &linear, -kappa);
        let gain: Vec<f64> = p.iter().map(|p| 2.0 * p + kappa).collect();
        free * rms(&square) / (self.rounding * rms(&gain))
    }
}

/// y − part·x.
fn subtract(y: &mut [f64], x: &[f64], part: f64) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y -= part * x);
}

fn rms(x: &[f64]) -> f64 {
    (dot(x, x) / x.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests;
