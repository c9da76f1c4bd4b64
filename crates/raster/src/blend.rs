//! Blending kernel: one tile, front to back, sixteen pixels at a time; and its derivative.
//!
//! Eq. (7) with γ = min(0.99, o·G), G = exp(-½ dᵀ conic d): pixel = Σᵢ sᵢ γᵢ Tᵢ, Tᵢ = Πⱼ﹤ᵢ (1-γⱼ). A splat is drawn in
//! a pixel if γ ≥ 1/255; a pixel ends before the splat that would bring T below 10⁻⁴. The backward pass also runs front
//! to back. With q = ⟨∂L/∂pixel, sᵢ⟩ and the blended image, the sum behind i is total − Σ up to i, so ∂L/∂γᵢ = Tᵢ q −
//! (total − prefix)/(1−γᵢ). It needs neither a back-to-front pass with divisions nor stored weights.

use pwrfgs_core::{ImagePlane, Lanes, Real, Splats};

/// Pixels along the side of a tile, and lanes of the kernel.
pub(crate) const TILE: usize = 16;
/// Number of pixels per tile.
pub(crate) const PIXELS: usize = TILE * TILE;
/// Largest γ of one splat.
pub(crate) const ALPHA_MAX: Real = 0.99;
/// Smallest drawn γ: the step of an 8-bit image.
pub(crate) const ALPHA_MIN: Real = 1.0 / 255.0;
/// A pixel is opaque before T falls below this value.
pub(crate) const T_MIN: Real = 1e-4;
/// Index of the cotangents of a splat in one tile: of its mean (2), conic (3), opacity, and existence; its summed weight.
pub(crate) const MEAN: usize = 0;
pub(crate) const CONIC: usize = 2;
pub(crate) const OPACITY: usize = 5;
pub(crate) const WEIGHT: usize = 6;
pub(crate) const EXISTENCE: usize = 7;
/// Number of these values; one per channel follows.
pub(crate) const GEOMETRY: usize = 8;

pub(crate) type PixelRow = [Real; TILE];

/// Inputs of the kernel for one tile.
pub(crate) struct Tile<'a> {
    /// All splats of the image.
    pub(crate) splats: &'a Splats,
    /// Signals `[N, channels]`.
    pub(crate) signals: &'a [Real],
    /// Number of channels per splat.
    pub(crate) channels: usize,
    /// Image plane of the whole image.
    pub(crate) plane: &'a ImagePlane,
    /// Splats of this tile, nearest first.
    pub(crate) list: &'a [u32],
    /// Rows of this tile that each of them may cover.
    pub(crate) rows: &'a [[u8; 2]],
    /// First column and row of the tile.
    pub(crate) corner: (usize, usize),
}

/// Transmittance of the pixels of a tile, negative once it is final (the pixel is opaque or outside the image).
pub(crate) struct Transmittance {
    signed: [PixelRow; TILE],
    /// Rows with a pixel that is not final.
    is_live: [bool; TILE],
}

/// Values of one splat along the lanes of a row.
pub(crate) struct SplatRow {
    /// Column offsets mean − pixel, nearest image.
    dx: PixelRow,
    /// −½ A dx².
    across: PixelRow,
    a: Real,
    b: Real,
    c: Real,
    y: Real,
    pub(crate) opacity: Real,
    /// Factor on γ.
    pub(crate) existence: Real,
}

impl Tile<'_> {
    /// Returns a transmittance of 1 in the pixels inside the image; those outside are final.
    #[inline(always)]
    pub(crate) fn initial_transmittance(&self) -> Transmittance {
        let mut t = Transmittance { signed: [[-1.0; TILE]; TILE], is_live: [false; TILE] };
        let columns = (self.plane.width - self.corner.0).min(TILE);
        for row in 0..(self.plane.height - self.corner.1).min(TILE) {
            t.signed[row][..columns].fill(1.0);
            t.is_live[row] = true;
        }
        t
    }

    /// Computes the values of splat `i` that all rows of the tile share.
    #[inline(always)]
    pub(crate) fn splat_row(&self, i: usize) -> SplatRow {
        let [x, y] = self.splats.means2d[i];
        let [a, b, c] = self.splats.conics[i];
        let width = self.plane.width as Real;
        let dx = lanes(|lane| {
            let d = x - (self.corner.0 + lane) as Real;
            if self.plane.wraps { nearest_image(d, width) } else { d }
        });
        let across = lanes(|lane| -0.5 * a * dx[lane] * dx[lane]);
        let existence = self.splats.existence.get(i).copied().unwrap_or(1.0);
        SplatRow { dx, across, a, b, c, y, opacity: self.splats.opacities[i], existence }
    }

    /// Blends the signals of the splats into `out` `[channels][PIXELS]` (zeroed here), and returns the remaining transmittance.
    #[inline(always)]
    fn forward<S: pulp::Simd>(&self, simd: S, out: &mut [Real]) -> Transmittance {
        out.fill(0.0);
        let out = out.as_chunks_mut::<TILE>().0; // row `row` of channel c is out[c · TILE + row]
        let mut t = self.initial_transmittance();
        for (&i, &[first, end]) in self.list.iter().zip(self.rows) {
            let i = i as usize;
            let splat = self.splat_row(i);
            let signal = &self.signals[i * self.channels..(i + 1) * self.channels];
            for row in first as usize..end as usize {
                if !t.is_live[row] {
                    continue;
                }
                let (_, raw) = splat.gauss_and_alpha((self.corner.1 + row) as Real);
                let weight = t.blend(row, &splat.with_existence(raw));
                for (c, s) in signal.iter().enumerate() {
                    Real::add_scaled(simd, &mut out[c * TILE + row], *s, &weight);
                }
            }
        }
        t
    }

    /// Computes the cotangents of each splat of the list in this tile: `GEOMETRY` numbers, then one per channel.
    /// `pixels` and `d_pixels` are `[channels][PIXELS]`; `d_signal` is a work buffer, `[channels]`.
    #[inline(always)]
    fn backward<S: pulp::Simd>(
        &self,
        simd: S,
        pixels: &[Real],
        d_pixels: &[Real],
        d_signal: &mut [PixelRow],
        out: &mut [Real],
    ) {
        let (pixels, d_pixels) = (pixels.as_chunks::<TILE>().0, d_pixels.as_chunks::<TILE>().0);
        let mut q_behind = [[0.0; TILE]; TILE]; // ⟨∂L/∂pixel, signal of the splats behind⟩
        for k in 0..pixels.len() {
            Real::add_product(simd, &mut q_behind[k % TILE], &pixels[k], &d_pixels[k]);
        }
        let mut t = self.initial_transmittance();
        let stride = GEOMETRY + self.channels;
        for ((&i, &[first, end]), out) in self.list.iter().zip(self.rows).zip(out.chunks_exact_mut(stride)) {
            let i = i as usize;
            let splat = self.splat_row(i);
            let signal = &self.signals[i * self.channels..(i + 1) * self.channels];
            let mut d = [[0.0; TILE]; GEOMETRY];
            d_signal.fill([0.0; TILE]);
            for row in first as usize..end as usize {
                if !t.is_live[row] {
                    continue;
                }
                let y = (self.corner.1 + row) as Real;
                let (gauss, raw) = splat.gauss_and_alpha(y);
                let alpha = splat.with_existence(raw);
                let before = t.signed[row];
                let weight = t.blend(row, &alpha);
                let drawn = if splat.existence == 1.0 { weight } else { t.live_alpha(row, &raw) };
                let mut q = [0.0; TILE];
                for (c, s) in signal.iter().enumerate() {
                    let g = &d_pixels[c * TILE + row];
                    Real::add_scaled(simd, &mut q, *s, g);
                    Real::add_product(simd, &mut d_signal[c], &weight, g);
                }
                let (mut d_alpha, mut d_power) = ([0.0; TILE], [0.0; TILE]);
                for lane in 0..TILE {
                    q_behind[row][lane] -= weight[lane] * q[lane];
                    let through = before[lane] * q[lane] - q_behind[row][lane] / (1.0 - alpha[lane]);
                    d_alpha[lane] = if drawn[lane] > 0.0 { through } else { 0.0 };
                    d_power[lane] = d_alpha[lane] * splat.opacity * gauss[lane];
                }
                if self.splats.existence.len() > i {
                    Real::add_product(simd, &mut d[EXISTENCE], &d_alpha, &raw);
                }
                if splat.existence != 1.0 {
                    d_alpha = lanes(|lane| d_alpha[lane] * splat.existence);
                    d_power = lanes(|lane| d_power[lane] * splat.existence);
                }
                splat.add_power_vjp(simd, splat.y - y, &d_power, &mut d);
                Real::add_product(simd, &mut d[OPACITY], &d_alpha, &gauss);
                Real::add_scaled(simd, &mut d[WEIGHT], 1.0, &weight);
            }
            for (k, out) in out.iter_mut().enumerate() {
                let row = if k < GEOMETRY { &d[k] } else { &d_signal[k - GEOMETRY] };
                *out = row.iter().sum();
            }
        }
    }
}

/// [`Tile::forward`], compiled for the widest vectors.
pub(crate) struct Forward<'a, 'b> {
    pub(crate) tile: &'b Tile<'a>,
    pub(crate) out: &'b mut [Real],
}

impl pulp::WithSimd for Forward<'_, '_> {
    type Output = Transmittance;
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> Transmittance {
        self.tile.forward(simd, self.out)
    }
}

/// [`Tile::backward`], compiled for the widest vectors.
pub(crate) struct Backward<'a, 'b> {
    pub(crate) tile: &'b Tile<'a>,
    pub(crate) pixels: &'b [Real],
    pub(crate) d_pixels: &'b [Real],
    /// Work buffer for the signal cotangents of one splat, `[channels]` by lane.
    pub(crate) d_signal: &'b mut [PixelRow],
    pub(crate) out: &'b mut [Real],
}

impl pulp::WithSimd for Backward<'_, '_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        self.tile.backward(simd, self.pixels, self.d_pixels, self.d_signal, self.out);
    }
}

impl SplatRow {
    /// Returns γ with the existence factor.
    #[inline(always)]
    pub(crate) fn with_existence(&self, alpha: PixelRow) -> PixelRow {
        if self.existence == 1.0 { alpha } else { lanes(|lane| alpha[lane] * self.existence) }
    }

    /// Adds the cotangents of mean and conic in a row to `d`, given those of the exponent; `dy` is the row offset mean −
    /// pixel.
    #[inline(always)]
    fn add_power_vjp<S: pulp::Simd>(&self, simd: S, dy: Real, d_power: &PixelRow, d: &mut [PixelRow; GEOMETRY]) {
        let Self { dx, a, b, c, .. } = self;
        Real::add_product(simd, &mut d[MEAN], d_power, &lanes(|lane| -(a * dx[lane] + b * dy)));
        Real::add_product(simd, &mut d[MEAN + 1], d_power, &lanes(|lane| -(c * dy + b * dx[lane])));
        Real::add_product(simd, &mut d[CONIC], d_power, &lanes(|lane| -0.5 * dx[lane] * dx[lane]));
        Real::add_product(simd, &mut d[CONIC + 1], d_power, &lanes(|lane| -dx[lane] * dy));
        Real::add_scaled(simd, &mut d[CONIC + 2], -0.5 * dy * dy, d_power);
    }

    /// Returns the derivatives of the exponent by mean (2) and conic (3), in the pixel at `lane` of row `y`.
    #[inline(always)]
    pub(crate) fn exponent_slopes(&self, lane: usize, y: Real) -> [Real; 5] {
        let (dx, dy) = (self.dx[lane], self.y - y);
        let along = [-(self.a * dx + self.b * dy), -(self.c * dy + self.b * dx)];
        [along[0], along[1], -0.5 * dx * dx, -dx * dy, -0.5 * dy * dy]
    }

    /// Returns G and γ, without the existence factor, in the pixels of row `y`; γ is 0 if the splat is not drawn.
    #[inline(always)]
    pub(crate) fn gauss_and_alpha(&self, y: Real) -> (PixelRow, PixelRow) {
        let dy = self.y - y;
        let (along, cross) = (-0.5 * self.c * dy * dy, self.b * dy);
        let (mut gauss, mut alpha) = ([0.0; TILE], [0.0; TILE]);
        for lane in 0..TILE {
            let power = (-cross).mul_add(self.dx[lane], self.across[lane] + along);
            gauss[lane] = exp_nonpositive(power);
            let a = (self.opacity * gauss[lane]).min(ALPHA_MAX);
            // One comparison covers both rules of the released kernel: power ≤ 0 and alpha ≥ 1/255.
            alpha[lane] = if power <= 0.0 && a >= ALPHA_MIN { a } else { 0.0 };
        }
        (gauss, alpha)
    }
}

impl Transmittance {
    /// Blends a splat into a row: returns its blending weights γ·T and updates the transmittance.
    ///
    /// Uses one loop per quantity, on a copy: conditional stores to the tile itself would be compiled lane by lane.
    #[inline(always)]
    pub(crate) fn blend(&mut self, row: usize, alpha: &PixelRow) -> PixelRow {
        let before = self.signed[row];
        let taken = lanes(|lane| alpha[lane] * before[lane]);
        let next = lanes(|lane| before[lane] * (1.0 - alpha[lane]));
        let signed = lanes(|lane| if next[lane] >= T_MIN { next[lane] } else { -before[lane].abs() });
        self.is_live[row] = signed.iter().fold(0, |any, &t| any | u8::from(t > 0.0)) != 0;
        self.signed[row] = signed;
        lanes(|lane| if next[lane] >= T_MIN { taken[lane] } else { 0.0 })
    }

    /// Returns `alpha`, γ of the splat just blended without its existence factor; 0 in pixels that are now final.
    #[inline(always)]
    fn live_alpha(&self, row: usize, alpha: &PixelRow) -> PixelRow {
        lanes(|lane| if self.signed[row][lane] > 0.0 { alpha[lane] } else { 0.0 })
    }

    /// Returns whether a row has a pixel that is not final.
    #[inline(always)]
    pub(crate) fn is_live(&self, row: usize) -> bool {
        self.is_live[row]
    }

    /// Returns the transmittance of a row, negative in final pixels.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> PixelRow {
        self.signed[row]
    }

    /// Returns the final transmittance.
    pub(crate) fn remaining(mut self) -> [PixelRow; TILE] {
        self.signed.as_flattened_mut().iter_mut().for_each(|t| *t = t.abs());
        self.signed
    }
}

/// Returns a row with `value(lane)` in each lane.
#[inline(always)]
fn lanes(value: impl Fn(usize) -> Real) -> PixelRow {
    let mut row = [0.0; TILE];
    for lane in 0..TILE {
        row[lane] = value(lane);
    }
    row
}

/// Wraps the column offset `d` into [-width/2, width/2): to the nearest copy of a splat on an image that wraps.
#[inline(always)]
pub(crate) fn nearest_image(d: Real, width: Real) -> Real {
    d - width * (d / width + 0.5).floor()
}

/// Computes eˣ for x ≤ 0. In single precision, the relative error is below 2.5e-7 for x ≥ −87, and smaller x give e⁻⁸⁷; it is
/// branch-free, so that loops over lanes vectorise.
#[inline(always)]
pub(crate) fn exp_nonpositive(x: Real) -> Real {
    if size_of::<Real>() == 8 { x.exp() } else { exp_single(x as f32) as Real }
}

/// Computes eˣ as 2ⁿ · e^r with |r| ≤ ln2/2: n by the rounding trick, r in two steps (Cody and Waite), e^r by its Taylor
/// polynomial of degree 6, whose last coefficients are adjusted for the interval.
#[inline(always)]
fn exp_single(x: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0; // 1.5 · 2²³
    let x = x.max(-87.0);
    let shifted = x.mul_add(std::f32::consts::LOG2_E, ROUND);
    let n = shifted - ROUND;
    let r = n.mul_add(2.121_944_4e-4, n.mul_add(-0.693_359_4, x));
    let p = r
        .mul_add(0.001_388_9, 0.008_363_38)
        .mul_add(r, 0.041_665_73)
        .mul_add(r, 0.166_666_55)
        .mul_add(r, 0.5)
        .mul_add(r, 1.0)
        .mul_add(r, 1.0);
    let power = (shifted.to_bits().wrapping_sub(ROUND.to_bits()).wrapping_add(127)) << 23;
    f32::from_bits(power) * p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_exact_to_single_precision() {
        let worst = (0..20_000)
            .map(|i| -(i as Real) * 0.001)
            .map(|x| ((exp_nonpositive(x) - x.exp()) / x.exp()).abs())
            .fold(0.0, Real::max);
        assert!(worst < 2.5e-7, "relative error {worst}");
    }
}
