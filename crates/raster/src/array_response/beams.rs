//! Steering of the array to every pixel: aᴴh/K for a whole image.
//!
//! In a grid, every antenna k at p has an opposite antenna -k at -p. So aᴴh = Σ cos φₖ·(hₖ + h₋ₖ) + sin φₖ·(-j)(hₖ - h₋ₖ)
//! over half of the antennas, φₖ = 2π pₖ·u. These are K real functions of the direction, equal for real and imaginary
//! part. An antenna without an opposite one (h₋ₖ = 0) has both functions for itself. At the opposite azimuth a flat array
//! has the projected direction -u: the sum of the cosines is equal and that of the sines changes its sign. On an image of
//! the full circle, two pixels of a grid together therefore cost K multiply-adds per channel, and the table covers half of
//! the image.

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

/// Table of F real functions, cosines first, at the pixels of one half of the image, or of all of it.
#[derive(Debug)]
pub(super) struct Beams {
    /// Number of antennas K.
    elements: usize,
    /// Antenna of each cosine, and the opposite one. The first of them have sines too.
    pairs: Vec<(usize, Option<usize>)>,
    /// Number of functions F.
    functions: usize,
    /// Number of columns of the image.
    width: usize,
    /// Number of columns in the table.
    columns: usize,
    /// Number of pixels of the image.
    pixels: usize,
    /// Values, `[rows of the image, blocks per row, F]`.
    table: Vec<Block>,
}

impl Beams {
    /// Computes the table of an array at the pixels of `plane`.
    pub(super) fn new(antennas: &Antennas, plane: &ImagePlane) -> Self {
        let width = plane.width;
        let columns = if antennas.has_opposite_pixels(width) { width / 2 } else { width };
        let blocks = columns.div_ceil(LANES);
        let (pairs, sines) = opposite_antennas(&antennas.positions);
        let functions = pairs.len() + sines;
        let mut table = vec![[0.0; LANES]; plane.height * blocks * functions];
        table.par_chunks_exact_mut(functions).enumerate().for_each(|(block, table)| {
            let (y, first) = (block / blocks, block % blocks * LANES);
            for lane in 0..LANES.min(columns - first) {
                let u = plane.direction((first + lane) as Real, y as Real).expect("the plane was checked");
                for (i, (k, _)) in pairs.iter().enumerate() {
                    let p = antennas.positions[*k];
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(p.dot(Vec3::from_array(u)))).sin_cos();
                    table[i][lane] = cos as Real;
                    if i < sines {
                        table[pairs.len() + i][lane] = sin as Real;
                    }
                }
            }
        });
        let (elements, pixels) = (antennas.len(), width * plane.height);
        Self { elements, pairs, functions, width, columns, pixels, table }
    }

    /// Returns the number of blocks in the table, which measures its memory.
    pub(super) fn block_count(&self) -> usize {
        self.table.len()
    }

    /// Computes the images `out` `[2B, H·W]`, real and imaginary part in turn, of the fields `[B, K]`.
    pub(super) fn draw(&self, field: &[[Real; 2]], out: &mut [Real]) {
        let coefficients: Vec<Real> =
            field.chunks_exact(self.elements).flat_map(|h| self.function_coefficients(h)).collect();
        let groups = out.par_chunks_mut(GROUP * self.pixels).zip(coefficients.par_chunks(GROUP * self.functions));
        groups.for_each(|(out, coefficients)| widest(Draw { beams: self, coefficients, out }));
    }

    /// Returns the cotangents of the fields `[B, K]`, given those of the images.
    pub(super) fn draw_vjp(&self, d_out: &[Real]) -> Vec<[Real; 2]> {
        let mut d_coefficients = vec![0.0; d_out.len() / self.pixels * self.functions];
        let groups = d_out.par_chunks(GROUP * self.pixels).zip(d_coefficients.par_chunks_mut(GROUP * self.functions));
        groups.for_each(|(d_out, d_coefficients)| widest(Back { beams: self, d_out, d_coefficients }));
        d_coefficients.chunks_exact(2 * self.functions).flat_map(|d| self.function_coefficients_vjp(d)).collect()
    }

    /// Iterates over blocks of the table, each with its pixels and, if the table covers half, those at the opposite
    /// azimuth.
    fn blocks(&self) -> impl Iterator<Item = (&[Block], Range<usize>, Option<Range<usize>>)> {
        let blocks = self.columns.div_ceil(LANES);
        self.table.chunks_exact(self.functions).enumerate().map(move |(block, table)| {
            let first = block % blocks * LANES;
            let start = block / blocks * self.width + first;
            let first_half = start..start + LANES.min(self.columns - first);
            let opposite = first_half.start + self.columns..first_half.end + self.columns;
            (table, first_half, (self.columns < self.width).then_some(opposite))
        })
    }

    /// Returns the coefficients of the F functions for the real part of the image of a field `h` `[K]`, then for the
    /// imaginary part, `[2, F]`.
    fn function_coefficients(&self, h: &[[Real; 2]]) -> Vec<Real> {
        let (f, cosines) = (self.functions, self.pairs.len());
        let scale = 1.0 / self.elements as Real;
        let mut out = vec![0.0; 2 * f];
        for (i, (k, opposite)) in self.pairs.iter().enumerate() {
            let ([re, im], [re2, im2]) = (h[*k], opposite.map_or([0.0; 2], |k| h[k]));
            (out[i], out[f + i]) = (scale * (re + re2), scale * (im + im2));
            if cosines + i < f {
                (out[cosines + i], out[f + cosines + i]) = (scale * (im - im2), scale * (re2 - re));
            }
        }
        out
    }

    /// Returns the cotangent of h, given that of [`Self::function_coefficients`].
    fn function_coefficients_vjp(&self, d: &[Real]) -> Vec<[Real; 2]> {
        let (f, cosines) = (self.functions, self.pairs.len());
        let scale = 1.0 / self.elements as Real;
        let mut out = vec![[0.0; 2]; self.elements];
        for (i, (k, opposite)) in self.pairs.iter().enumerate() {
            let (even_re, even_im) = (scale * d[i], scale * d[f + i]);
            let (mut odd_re, mut odd_im) = (0.0, 0.0);
            if cosines + i < f {
                (odd_re, odd_im) = (scale * d[cosines + i], scale * d[f + cosines + i]);
            }
            out[*k] = [even_re - odd_im, even_im + odd_re];
            if let Some(opposite) = opposite {
                out[*opposite] = [even_re + odd_im, even_im - odd_re];
            }
        }
        out
    }
}

/// Returns pairs of an antenna and the opposite one, if there is one, with each antenna once, and the number of pairs that
/// have a sine: an antenna at the receiver position has none and comes last.
fn opposite_antennas(positions: &[Vec3]) -> (Vec<(usize, Option<usize>)>, usize) {
    let mut pairs = Vec::new();
    let mut is_paired = vec![false; positions.len()];
    for (k, p) in positions.iter().enumerate().filter(|(_, p)| **p != Vec3::ZERO) {
        if !is_paired[k] {
            let opposite = (k + 1..positions.len()).find(|other| positions[*other] == -*p);
            opposite.into_iter().for_each(|other| is_paired[other] = true);
            pairs.push((k, opposite));
        }
    }
    let sines = pairs.len();
    pairs.extend((0..positions.len()).filter(|k| positions[*k] == Vec3::ZERO).map(|k| (k, None)));
    (pairs, sines)
}

/// Forward pass for some pairs of channels of the image.
struct Draw<'a> {
    beams: &'a Beams,
    /// Coefficients `[channels, F]`.
    coefficients: &'a [Real],
    /// Image `[channels, H·W]`.
    out: &'a mut [Real],
}

impl pulp::WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Beams { functions, pixels, .. } = *self.beams;
        let cosines = self.beams.pairs.len();
        for (table, first_half, opposite) in self.beams.blocks() {
            for (pair, coefficients) in self.coefficients.chunks_exact(2 * functions).enumerate() {
                let (re, im) = coefficients.split_at(functions);
                let (mut even, mut odd) = ([[0.0; LANES]; 2], [[0.0; LANES]; 2]);
                Real::two_sums(simd, &mut even, [&re[..cosines], &im[..cosines]], &table[..cosines]);
                Real::two_sums(simd, &mut odd, [&re[cosines..], &im[cosines..]], &table[cosines..]);
                for c in 0..2 {
                    let out = &mut self.out[(2 * pair + c) * pixels..][..pixels];
                    let write_half = |out: &mut [Real], sign: Real| {
                        let (even, odd) = (&even[c][..out.len()], &odd[c][..out.len()]);
                        for i in 0..out.len() {
                            out[i] = even[i] + sign * odd[i];
                        }
                    };
                    write_half(&mut out[first_half.clone()], 1.0);
                    if let Some(opposite) = &opposite {
                        write_half(&mut out[opposite.clone()], -1.0);
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
    /// Cotangents of the coefficients `[channels, F]`.
    d_coefficients: &'a mut [Real],
}

impl pulp::WithSimd for Back<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Beams { functions, pixels, .. } = *self.beams;
        let cosines = self.beams.pairs.len();
        // The four quarters of a block add to the same lanes.
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
                for (k, sum) in sums[channel * functions..][..functions].iter_mut().enumerate() {
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
