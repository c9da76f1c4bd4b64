//! Training SSIM and its derivative, computed once per spectrum and step: a performance-critical path.
//!
//! With f the blur, μ₁ = f(P), μ₂ = f(G), σ₁² = f(P²) − μ₁² and so on, A = μ₁²+μ₂²+C₁, B = σ₁²+σ₂²+C₂, C = 2μ₁μ₂+C₁, D
//! = 2σ₁₂+C₂, the map is m = CD/(AB). Since f is self-adjoint, ∂/∂P Σm = f(∂m/∂μ₁) + 2P·f(∂m/∂σ₁²) + G·f(∂m/∂σ₁₂),
//! where ∂m/∂μ₁ includes the μ₁ in the variances. Only the sum of the two variances is needed, so f(P² + G²) is blurred
//! once for both.
//!
//! f is separable: rows first, then columns, both through [`blur`], which adds eleven slices. All loops run over blocks
//! of [`LANES`] numbers and are compiled once per instruction set (pulp). Every pixel is computed by the same
//! operations in the same order on all of them, so that results are bit-identical for all machines and numbers of
//! threads. Innermost loops use indices: `zip`, `array::map` and `array::from_fn` are calls if the parts of a crate are
//! not optimised together.

use crate::Real;
use std::cell::RefCell;

/// C₁ = (0.01 · data range)².
pub(super) const C1: f64 = 1e-4;
/// C₂ = (0.03 · data range)².
pub(super) const C2: f64 = 9e-4;
/// Number of taps of the blur.
const TAPS: usize = 11;
/// Reach of the blur, px.
const REACH: usize = TAPS / 2;

/// Gaussian window of the training SSIM: 11 taps along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window([Real; TAPS]);

impl Window {
    /// Computes exp(−x²/(2σ²)) at x = −5 … 5, divided by the sum; σ in pixels, above 0 and small enough for 11 taps.
    /// Weights below the precision of the largest one are 0: their products would be denormal numbers, which are slow.
    pub fn new(sigma: f64) -> Self {
        let weight = |k: usize| (-0.5 * ((k as f64 - REACH as f64) / sigma).powi(2)).exp();
        let raw: [f64; TAPS] = std::array::from_fn(weight).map(|w| if w < 1e-8 { 0.0 } else { w });
        let sum: f64 = raw.iter().sum();
        Self(raw.map(|w| (w / sum) as Real))
    }
}

impl Default for Window {
    /// Window of σ = 1.5 px, the usual value in training. Written out, so that results do not depend on the
    /// exponential of a library.
    fn default() -> Self {
        Self(WEIGHTS)
    }
}

/// Values of exp(−x²/(2·1.5²)) at x = −5 … 5, divided by the sum.
const WEIGHTS: [Real; TAPS] = [
    0.001_028_380_084_479_109_2,
    0.007_598_758_135_239_185,
    0.036_000_772_128_430_83,
    0.109_360_689_509_700_02,
    0.213_005_537_711_253_7,
    0.266_011_724_861_794_36,
    0.213_005_537_711_253_7,
    0.109_360_689_509_700_02,
    0.036_000_772_128_430_83,
    0.007_598_758_135_239_185,
    0.001_028_380_084_479_109_2,
];
/// Number of values processed together.
const LANES: usize = 16;
type Block = [Real; LANES];

/// Returns the training SSIM and its derivative with respect to every pixel of `prediction`. The window is Gaussian
/// with zeros beyond the border; the mean is over all pixels. All arrays are row-major `[height, width]`; the SSIM of
/// images without pixels is 1.
pub fn training(
    prediction: &[Real],
    truth: &[Real],
    (width, height): (usize, usize),
    window: &Window,
) -> (Real, Vec<Real>) {
    assert_eq!((prediction.len(), truth.len()), (width * height, width * height), "pixels fill the picture");
    if prediction.is_empty() {
        return (1.0, Vec::new());
    }
    thread_local! {
        static SCRATCH: RefCell<Scratch> = RefCell::default();
    }
    let mut d = vec![0.0; width * height];
    let value = SCRATCH.with_borrow_mut(|scratch| {
        scratch.fit(width, height);
        pulp::Arch::new().dispatch(Job { prediction, truth, width, height, window, d: &mut d, scratch })
    });
    (value, d)
}

/// Buffers that each thread reuses. Rows have a length of `stride`, a multiple of [`LANES`] not below the width; values
/// beyond the width are never read as pixels.
#[derive(Default)]
struct Scratch {
    width: usize,
    stride: usize,
    /// Row with [`REACH`] zeros before it and zeros behind it, for each blurred quantity.
    padded: [Vec<Real>; 4],
    /// Rows blurred along themselves: of P, G, P² + G², PG, then of the three derivatives.
    planes: [Vec<Real>; 7],
    /// One row blurred in both directions, for each quantity.
    blurred: [Vec<Real>; 4],
    /// Row beyond the border.
    zeros: Vec<Real>,
}

impl Scratch {
    fn fit(&mut self, width: usize, height: usize) {
        let stride = width.next_multiple_of(LANES);
        if (self.width, self.stride * height) != (width, self.planes[0].len()) {
            (self.width, self.stride) = (width, stride);
            self.padded = [(); 4].map(|()| vec![0.0; stride + 2 * REACH]);
            self.planes = [(); 7].map(|()| vec![0.0; stride * height]);
            self.blurred = [(); 4].map(|()| vec![0.0; stride]);
            self.zeros = vec![0.0; stride];
        }
    }
}

struct Job<'a> {
    prediction: &'a [Real],
    truth: &'a [Real],
    width: usize,
    height: usize,
    window: &'a Window,
    d: &'a mut [Real],
    scratch: &'a mut Scratch,
}

impl pulp::WithSimd for Job<'_> {
    type Output = Real;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Real {
        let Job { prediction, truth, width, height, window: Window(weights), d, scratch } = self;
        let Scratch { stride, padded, planes, blurred, zeros, .. } = scratch;
        let (stride, (moments, slopes)) = (*stride, planes.split_at_mut(4));
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            products(padded, &prediction[row.clone()], &truth[row]);
            for (padded, plane) in padded.iter().zip(&mut *moments) {
                blur(&mut plane[y * stride..][..stride], along(padded, stride), weights);
            }
        }
        let mut total = [0.0; LANES];
        for y in 0..height {
            for (row, plane) in blurred.iter_mut().zip(&*moments) {
                blur(row, across(plane, y, stride, zeros), weights);
            }
            similarity(blurred, width, &mut total, padded);
            for (padded, plane) in padded.iter().zip(&mut *slopes) {
                blur(&mut plane[y * stride..][..stride], along(padded, stride), weights);
            }
        }
        let pixels = (width * height) as f64;
        for (y, d) in d.chunks_exact_mut(width).enumerate() {
            for (row, plane) in blurred.iter_mut().zip(&*slopes) {
                blur(row, across(plane, y, stride, zeros), weights);
            }
            let row = y * width..(y + 1) * width;
            gather(d, &prediction[row.clone()], &truth[row], blurred, (1.0 / pixels) as Real);
        }
        (total.iter().sum::<f64>() / pixels) as Real
    }
}

/// Returns eleven shifted views of one padded row.
#[inline(always)]
fn along(padded: &[Real], stride: usize) -> [&[Real]; TAPS] {
    let mut taps = [padded; TAPS];
    for k in 0..TAPS {
        taps[k] = &padded[k..k + stride];
    }
    taps
}

/// Returns eleven rows of a plane about row `y`, zeros beyond the border.
#[inline(always)]
fn across<'a>(plane: &'a [Real], y: usize, stride: usize, zeros: &'a [Real]) -> [&'a [Real]; TAPS] {
    let mut taps = [zeros; TAPS];
    for k in 0..TAPS {
        match (y + k).checked_sub(REACH) {
            Some(row) if (row + 1) * stride <= plane.len() => taps[k] = &plane[row * stride..][..stride],
            _ => {}
        }
    }
    taps
}

/// Computes `out` = Σ weight · tap, all of one length, a multiple of [`LANES`].
#[inline(always)]
fn blur(out: &mut [Real], taps: [&[Real]; TAPS], weights: &[Real; TAPS]) {
    for (i, out) in out.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let mut sum: Block = [0.0; LANES];
        for k in 0..TAPS {
            let tap = &taps[k].as_chunks::<LANES>().0[i];
            for lane in 0..LANES {
                sum[lane] += weights[k] * tap[lane];
            }
        }
        *out = sum;
    }
}

/// Writes P, G, P² + G², PG of one row into the padded rows.
#[inline(always)]
fn products(padded: &mut [Vec<Real>; 4], p: &[Real], g: &[Real]) {
    let (n, [p1, g1, squares, pg]) = (p.len(), padded);
    p1[REACH..][..n].copy_from_slice(p);
    g1[REACH..][..n].copy_from_slice(g);
    let (squares, pg, g) = (&mut squares[REACH..][..n], &mut pg[REACH..][..n], &g[..n]);
    for i in 0..n {
        squares[i] = p[i] * p[i] + g[i] * g[i];
    }
    for i in 0..n {
        pg[i] = p[i] * g[i];
    }
}

/// Adds the map of one row to `total` and writes ∂m/∂μ₁, ∂m/∂σ₁², ∂m/∂σ₁₂ into the first three padded rows.
#[inline(always)]
fn similarity(moments: &[Vec<Real>; 4], width: usize, total: &mut [f64; LANES], slopes: &mut [Vec<Real>; 4]) {
    for i in 0..width.div_ceil(LANES) {
        let (start, valid) = (i * LANES, LANES.min(width - i * LANES));
        let block = |k: usize| &moments[k].as_chunks::<LANES>().0[i];
        let (map, d) = map_block([block(0), block(1), block(2), block(3)]);
        for lane in 0..valid {
            total[lane] += map[lane] as f64;
        }
        for k in 0..d.len() {
            slopes[k][REACH + start..][..valid].copy_from_slice(&d[k][..valid]);
        }
    }
}

/// Returns the map m and ∂m/∂μ₁, ∂m/∂σ₁², ∂m/∂σ₁₂ of [`LANES`] pixels, given the four blurred quantities.
#[inline(always)]
fn map_block([mu1, mu2, squares, e12]: [&Block; 4]) -> (Block, [Block; 3]) {
    let (mut map, mut d) = ([0.0; LANES], [[0.0; LANES]; 3]);
    let [d_mu, d_variance, d_covariance] = &mut d;
    for i in 0..LANES {
        let (m1, m2) = (mu1[i], mu2[i]);
        let a = m1 * m1 + m2 * m2 + C1 as Real;
        let b = (squares[i] - (m1 * m1 + m2 * m2)) + C2 as Real;
        let c = 2.0 * m1 * m2 + C1 as Real;
        let s = 2.0 * (e12[i] - m1 * m2) + C2 as Real;
        let inverse = 1.0 / (a * b);
        let m = c * s * inverse;
        map[i] = m;
        d_mu[i] = 2.0 * (m2 * (s - c) + m1 * m * (a - b)) * inverse;
        d_variance[i] = -m * a * inverse;
        d_covariance[i] = 2.0 * c * inverse;
    }
    (map, d)
}

/// Computes d = (f(∂m/∂μ₁) + 2P·f(∂m/∂σ₁²) + G·f(∂m/∂σ₁₂)) / pixels for one row.
#[inline(always)]
fn gather(d: &mut [Real], p: &[Real], g: &[Real], blurred: &[Vec<Real>; 4], scale: Real) {
    let (n, [mu, variance, covariance, ..]) = (d.len(), blurred);
    let (mu, variance, covariance, p, g) = (&mu[..n], &variance[..n], &covariance[..n], &p[..n], &g[..n]);
    for i in 0..n {
        d[i] = scale * (mu[i] + 2.0 * p[i] * variance[i] + g[i] * covariance[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{rng, testing::check_vjp};

    fn noise(n: usize, name: &str) -> Vec<Real> {
        let mut random = rng::stream(2, name, 0);
        (0..n).map(|_| rng::uniform(&mut random)).collect()
    }

    fn differentiated(p: &[Real], g: &[Real], width: usize, height: usize) -> (Real, Vec<Real>) {
        training(p, g, (width, height), &Window::default())
    }

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn ssim_derivative_matches_central_differences() {
        for (width, height) in [(1, 1), (3, 14), (17, 12), (33, 4)] {
            let (p, g) = (noise(width * height, "p"), noise(width * height, "g"));
            check_vjp(
                "training SSIM",
                &p,
                |p| vec![differentiated(p, &g, width, height).0],
                |p, d| differentiated(p, &g, width, height).1.iter().map(|v| v * d[0]).collect(),
                1e-5,
                1e-6,
            );
        }
    }

    #[test]
    fn result_is_independent_of_scratch_buffer() {
        let (p, g) = (noise(90 * 40, "p"), noise(90 * 40, "g"));
        let before = differentiated(&p, &g, 90, 40);
        for (width, height) in [(40, 90), (7, 7), (1, 3600), (45, 80)] {
            let _ = differentiated(&p[..width * height], &g[..width * height], width, height);
        }
        assert_eq!(differentiated(&p, &g, 90, 40), before);
    }

    #[test]
    fn ssim_weights_are_gaussian_with_unit_sum() {
        let raw = |k: usize| (-0.5 * ((k as f64 - 5.0) / 1.5).powi(2)).exp();
        let sum: f64 = (0..TAPS).map(raw).sum();
        for (k, weight) in WEIGHTS.iter().enumerate() {
            assert!((*weight as f64 - raw(k) / sum).abs() < 1e-8);
            assert!((Window::new(1.5).0[k] - weight).abs() < 1e-7);
        }
        assert!((Window::new(0.5).0[REACH] - 0.786_57).abs() < 1e-4);
    }
}
