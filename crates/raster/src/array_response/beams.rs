//! Steering the array to every pixel: aᴴh/K for a whole picture.
//!
//! The array is centred: with every antenna k at p there is one, K-1-k, at -p. So aᴴh = Σ cos φₖ·(hₖ + h₋ₖ) +
//! sin φₖ·(-j)(hₖ - h₋ₖ) over half of the antennas, φₖ = 2π pₖ·u: K real functions of the direction, the same for real
//! and imaginary part. A pixel costs K multiply-adds a channel, and a channel is a row of `field · table`.

use super::wave::Antennas;
use crate::simd::{Lanes, widest};
use pwrfgs_core::{ImagePlane, Real, Vec3};
use rayon::prelude::*;

/// Pixels that the kernel carries at a time: enough to fill the pipelines, few enough to stay in registers.
const LANES: usize = 64;
/// Channels that one thread draws: each block of the table is loaded once for all of them.
const GROUP: usize = 8;

/// A table of K real functions at every pixel.
#[derive(Debug)]
pub(super) struct Beams {
    elements: usize,
    pixels: usize,
    /// `[blocks of pixels, K]`.
    table: Vec<[Real; LANES]>,
}

impl Beams {
    pub(super) fn new(antennas: &Antennas, plane: &ImagePlane) -> Self {
        let (elements, pixels) = (antennas.len(), plane.width * plane.height);
        let half = elements.div_ceil(2);
        let mut table = vec![[0.0; LANES]; pixels.div_ceil(LANES) * elements];
        table.par_chunks_exact_mut(elements).enumerate().for_each(|(block, table)| {
            for lane in 0..LANES.min(pixels - block * LANES) {
                let pixel = block * LANES + lane;
                let (x, y) = ((pixel % plane.width) as Real, (pixel / plane.width) as Real);
                let u = Vec3::from_array(plane.direction(x, y).expect("the plane was checked"));
                for (k, p) in antennas.positions()[..half].iter().enumerate() {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(p.dot(u))).sin_cos();
                    table[k][lane] = cos as Real;
                    if half + k < elements {
                        table[half + k][lane] = sin as Real;
                    }
                }
            }
        });
        Self { elements, pixels, table }
    }

    /// Pictures `[2B, H·W]`, real and imaginary part in turn, of the fields `[B, K]`.
    pub(super) fn draw(&self, field: &[[Real; 2]], out: &mut [Real]) {
        let coefficients: Vec<Real> = field.chunks_exact(self.elements).flat_map(|h| self.fold(h)).collect();
        let groups = out.par_chunks_mut(GROUP * self.pixels).zip(coefficients.par_chunks(GROUP * self.elements));
        groups.for_each(|(out, coefficients)| widest(Draw { beams: self, coefficients, out }));
    }

    /// Cotangents of the fields `[B, K]`, given those of the pictures.
    pub(super) fn draw_vjp(&self, d_out: &[Real]) -> Vec<[Real; 2]> {
        let mut d_coefficients = vec![0.0; d_out.len() / self.pixels * self.elements];
        let groups = d_out.par_chunks(GROUP * self.pixels).zip(d_coefficients.par_chunks_mut(GROUP * self.elements));
        groups.for_each(|(d_out, d_coefficients)| widest(Back { beams: self, d_out, d_coefficients }));
        d_coefficients.chunks_exact(2 * self.elements).flat_map(|d| self.fold_vjp(d)).collect()
    }

    /// What the K functions are multiplied with for the real part `[K]`, and then for the imaginary part.
    fn fold(&self, h: &[[Real; 2]]) -> Vec<Real> {
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

    /// Cotangent of h, given that of [`Self::fold`].
    fn fold_vjp(&self, d: &[Real]) -> Vec<[Real; 2]> {
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

/// Some channels of the picture.
struct Draw<'a> {
    beams: &'a Beams,
    /// `[channels, K]`.
    coefficients: &'a [Real],
    /// `[channels, H·W]`.
    out: &'a mut [Real],
}

impl pulp::WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Beams { elements, pixels, table } = self.beams;
        for (block, table) in table.chunks_exact(*elements).enumerate() {
            let here = block * LANES..((block + 1) * LANES).min(*pixels);
            for (out, coefficients) in self.out.chunks_exact_mut(*pixels).zip(self.coefficients.chunks_exact(*elements))
            {
                let mut sum = [0.0; LANES];
                for (beam, &c) in table.iter().zip(coefficients) {
                    Real::add_scaled(simd, &mut sum, c, beam);
                }
                out[here.clone()].copy_from_slice(&sum[..here.len()]);
            }
        }
    }
}

/// The way back of [`Draw`].
struct Back<'a> {
    beams: &'a Beams,
    /// `[channels, H·W]`.
    d_out: &'a [Real],
    /// `[channels, K]`.
    d_coefficients: &'a mut [Real],
}

impl pulp::WithSimd for Back<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Beams { elements, pixels, table } = self.beams;
        let mut sums = vec![[0.0; LANES / 4]; self.d_coefficients.len()];
        for (block, table) in table.chunks_exact(*elements).enumerate() {
            let here = block * LANES..((block + 1) * LANES).min(*pixels);
            for (d_out, sums) in self.d_out.chunks_exact(*pixels).zip(sums.chunks_exact_mut(*elements)) {
                let mut d = [0.0; LANES];
                d[..here.len()].copy_from_slice(&d_out[here.clone()]);
                let (quarters, _) = d.as_chunks::<{ LANES / 4 }>();
                for (beam, sum) in table.iter().zip(sums) {
                    for (d, beam) in quarters.iter().zip(beam.as_chunks::<{ LANES / 4 }>().0) {
                        Real::add_product(simd, sum, d, beam);
                    }
                }
            }
        }
        for (d, sum) in self.d_coefficients.iter_mut().zip(&sums) {
            *d = sum.iter().sum();
        }
    }
}
