//! Steering of the array to every pixel: aᴴh/K for a whole image.
//!
//! The array is centred: every antenna k at p has an opposite antenna K-1-k at -p. So aᴴh = Σ cos φₖ·(hₖ + h₋ₖ) + sin
//! φₖ·(-j)(hₖ - h₋ₖ) over half of the antennas, φₖ = 2π pₖ·u. These are K real functions of the direction, equal for
//! real and imaginary part. At the opposite azimuth the flat array has the direction -u: the sum of the cosines is
//! equal and that of the sines changes its sign. On an image of the full circle, two pixels together therefore cost K
//! multiply-adds per channel, and the table covers half of the image.

use super::wave::Antennas;
use pwrfgs_core::{ImagePlane, Lanes, Real, Vec3, widest};
use rayon::prelude::*;
use std::ops::Range;

/// Number of pixels per kernel call: with both channels enough to fill the pipelines, and few enough to stay in
/// registers.
const LANES: usize = 64;
/// Number of channels per thread: each block of the table is loaded once for all of them.
const GROUP: usize = 8;

/// Values of some pixels of a row, with zeros beyond its end.
type Block = [Real; LANES];

/// Table of K real functions, cosines first, at the pixels of one half of the image, or of all of it.
#[derive(Debug)]
pub(super) struct Beams {
    elements: usize,
    width: usize,
    /// Number of columns in the table.
    columns: usize,
    pixels: usize,
    /// Values, `[rows of the image, blocks per row, K]`.
    table: Vec<Block>,
}

impl Beams {
    /// Computes the table of an array at the pixels of `plane`.
    pub(super) fn new(antennas: &Antennas, plane: &ImagePlane) -> Self {
        let (elements, width) = (antennas.len(), plane.width);
        let columns = if antennas.is_full_circle(width) { width / 2 } else { width };
        let blocks = columns.div_ceil(LANES);
        let half = elements.div_ceil(2);
        let mut table = vec![[0.0; LANES]; plane.height * blocks * elements];
        table.par_chunks_exact_mut(elements).enumerate().for_each(|(block, table)| {
            let (y, first) = (block / blocks, block % blocks * LANES);
            for lane in 0..LANES.min(columns - first) {
                let u = plane.direction((first + lane) as Real, y as Real).expect("the plane was checked");
                for (k, p) in antennas.positions[..half].iter().enumerate() {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(p.dot(Vec3::from_array(u)))).sin_cos();
                    table[k][lane] = cos as Real;
                    if half + k < elements {
                        table[half + k][lane] = sin as Real;
                    }
                }
            }
        });
        Self { elements, width, columns, pixels: width * plane.height, table }
    }

    /// Computes the images `out` `[2B, H·W]`, real and imaginary part in turn, of the fields `[B, K]`.
    pub(super) fn draw(&self, field: &[[Real; 2]], out: &mut [Real]) {
        let coefficients: Vec<Real> =
            field.chunks_exact(self.elements).flat_map(|h| self.function_coefficients(h)).collect();
        let groups = out.par_chunks_mut(GROUP * self.pixels).zip(coefficients.par_chunks(GROUP * self.elements));
        groups.for_each(|(out, coefficients)| widest(Draw { beams: self, coefficients, out }));
    }

    /// Returns the cotangents of the fields `[B, K]`, given those of the images.
    pub(super) fn draw_vjp(&self, d_out: &[Real]) -> Vec<[Real; 2]> {
        let mut d_coefficients = vec![0.0; d_out.len() / self.pixels * self.elements];
        let groups = d_out.par_chunks(GROUP * self.pixels).zip(d_coefficients.par_chunks_mut(GROUP * self.elements));
        groups.for_each(|(d_out, d_coefficients)| widest(Back { beams: self, d_out, d_coefficients }));
        d_coefficients.chunks_exact(2 * self.elements).flat_map(|d| self.function_coefficients_vjp(d)).collect()
    }

    /// Iterates over blocks of the table, each with its pixels and, if the table covers half, those at the opposite
    /// azimuth.
    fn blocks(&self) -> impl Iterator<Item = (&[Block], Range<usize>, Option<Range<usize>>)> {
        let blocks = self.columns.div_ceil(LANES);
        self.table.chunks_exact(self.elements).enumerate().map(move |(block, table)| {
            let first = block % blocks * LANES;
            let start = block / blocks * self.width + first;
            let first_half = start..start + LANES.min(self.columns - first);
            let opposite = first_half.start + self.columns..first_half.end + self.columns;
            (table, first_half, (self.columns < self.width).then_some(opposite))
        })
    }

    /// Returns the coefficients of the K functions for the real part of the image of a field `h` `[K]`, then for the
    /// imaginary part, `[2, K]`.
    fn function_coefficients(&self, h: &[[Real; 2]]) -> Vec<Real> {
        let (k, half) = (self.elements, self.elements.div_ceil(2));
        let scale = 1.0 / k as Real;
        let mut out = vec![0.0; 2 * k];
        for i in 0..half {
            let ([re, im], [re2, im2]) = (h[i], h[k - 1 - i]);
            if half + i < k {
                (out[i], out[k + i]) = (scale * (re + re2), scale * (im + im2));
                (out[half + i], out[k + half + i]) = (scale * (im - im2), scale * (re2 - re));
            } else {
                (out[i], out[k + i]) = (scale * re, scale * im);
            }
        }
        out
    }

    /// Returns the cotangent of h, given that of [`Self::function_coefficients`].
    fn function_coefficients_vjp(&self, d: &[Real]) -> Vec<[Real; 2]> {
        let (k, half) = (self.elements, self.elements.div_ceil(2));
        let scale = 1.0 / k as Real;
        let mut out = vec![[0.0; 2]; k];
        for i in 0..half {
            let (even_re, even_im) = (scale * d[i], scale * d[k + i]);
            out[i] = [even_re, even_im];
            if half + i < k {
                let (odd_re, odd_im) = (scale * d[half + i], scale * d[k + half + i]);
                out[i] = [even_re - odd_im, even_im + odd_re];
                out[k - 1 - i] = [even_re + odd_im, even_im - odd_re];
            }
        }
        out
    }
}

/// Forward pass for some pairs of channels of the image.
struct Draw<'a> {
    beams: &'a Beams,
    /// Coefficients `[channels, K]`.
    coefficients: &'a [Real],
    /// Image `[channels, H·W]`.
    out: &'a mut [Real],
}

impl pulp::WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Beams { elements, pixels, .. } = *self.beams;
        let cosines = elements.div_ceil(2);
        for (table, first_half, opposite) in self.beams.blocks() {
            for (pair, coefficients) in self.coefficients.chunks_exact(2 * elements).enumerate() {
                let (re, im) = coefficients.split_at(elements);
                let (mut even, mut odd) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
                Real::two_sums(simd, &mut even, [&re[..cosines], &im[..cosines]], &table[..cosines]);
                Real::two_sums(simd, &mut odd, [&re[cosines..], &im[cosines..]], &table[cosines..]);
                for c in 0..2 {
                    let out = &mut self.out[(2 * pair + c) * pixels..][..pixels];
                    let both = |out: &mut [Real], sign: Real| {
                        let (even, odd) = (&even[c][..out.len()], &odd[c][..out.len()]);
                        for i in 0..out.len() {
                            out[i] = even[i] + sign * odd[i];
                        }
                    };
                    both(&mut out[first_half.clone()], 1.0);
                    if let Some(opposite) = &opposite {
                        both(&mut out[opposite.clone()], -1.0);
                    }
                }
            }
        }
    }
}

/// Backward pass of [`Draw`].
struct Back<'a> {
    beams: &'a Beams,
    /// Cotangents of the image `[channels, H·W]`.
    d_out: &'a [Real],
    /// Cotangents of the coefficients `[channels, K]`.
    d_coefficients: &'a mut [Real],
}

impl pulp::WithSimd for Back<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Beams { elements, pixels, .. } = *self.beams;
        let cosines = elements.div_ceil(2);
        let mut sums = vec![[0.0; LANES / 4]; self.d_coefficients.len()];
        for (table, first_half, opposite) in self.beams.blocks() {
            for (channel, d_out) in self.d_out.chunks_exact(pixels).enumerate() {
                let mut even = [0.0; LANES];
                even[..first_half.len()].copy_from_slice(&d_out[first_half.clone()]);
                let mut odd = even;
                if let Some(opposite) = &opposite {
                    let d = &d_out[opposite.clone()];
                    let (even, odd) = (&mut even[..d.len()], &mut odd[..d.len()]);
                    for i in 0..d.len() {
                        even[i] += d[i];
                        odd[i] -= d[i];
                    }
                }
                for (k, sum) in sums[channel * elements..][..elements].iter_mut().enumerate() {
                    let d = if k < cosines { &even } else { &odd };
                    let (d, beam) = (d.as_chunks::<{ LANES / 4 }>().0, table[k].as_chunks::<{ LANES / 4 }>().0);
                    for quarter in 0..4 {
                        Real::add_product(simd, sum, &d[quarter], &beam[quarter]);
                    }
                }
            }
        }
        for (d, sum) in self.d_coefficients.iter_mut().zip(&sums) {
            *d = sum.iter().sum();
        }
    }
}
