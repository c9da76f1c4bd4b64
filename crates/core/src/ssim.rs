//! Structural similarity of two spectra: the evaluation form and the training form.
//!
//! Both are the mean over windows of (2μ₁μ₂+C₁)(2σ₁₂+C₂) / ((μ₁²+μ₂²+C₁)(σ₁²+σ₂²+C₂)) with C₁ = 0.01², C₂ = 0.03²
//! (values in [0, 1]). They differ in the window, and strongly in value (0.447 and 0.564 for one pair of spectra), so
//! always state the form:
//!
//! * [`evaluation`]: uniform 7x7 windows inside the image, sample covariance (49/48); equal to scikit-image's
//!   `structural_similarity(a, b, data_range=1)`.
//! * [`training_form`], the `SSIM` of eq. (9), with its derivative: 11 Gaussian taps of σ = 1.5 px about every pixel,
//!   zeros beyond the border, covariance `E[xy] − E[x]·E[y]`; as in the released training.
//!
//! Neither wraps in azimuth. Images are row-major `[height, width]`.
//!
//! The training form is computed once per spectrum and step: a performance-critical path.
//! With f the blur, μ₁ = f(P), μ₂ = f(G), σ₁² = f(P²) − μ₁² and so on, A = μ₁²+μ₂²+C₁, B = σ₁²+σ₂²+C₂, C = 2μ₁μ₂+C₁, D
//! = 2σ₁₂+C₂, the map is m = CD/(AB). Since f is self-adjoint, ∂/∂P Σm = f(∂m/∂μ₁) + 2P·f(∂m/∂σ₁²) + G·f(∂m/∂σ₁₂),
//! where ∂m/∂μ₁ includes the μ₁ in the variances. Only the sum of the two variances is needed, so f(P² + G²) is blurred
//! once for both.
//!
//! f is separable: rows first, then columns, both through `blur`, which adds eleven slices. All loops run over blocks
//! of `LANES` numbers and are compiled once per instruction set (pulp). Every pixel is computed by the same
//! operations in the same order on all of them, so that results are bit-identical for all machines and numbers of
//! threads. Innermost loops use indices: `zip`, `array::map` and `array::from_fn` are calls if the parts of a crate are
//! not optimised together.

use crate::{Image, Real};
use std::cell::RefCell;

/// Returns the SSIM of scikit-image for two images of the same size; computed in double precision.
///
/// scikit-image rejects images with a side below 7 px; here the window shrinks to the largest odd square that fits. Two
/// images without pixels have SSIM 1.
///
/// # Panics
/// If the images differ in size, or their pixels do not fill it.
pub fn evaluation(a: &Image, b: &Image) -> f64 {
    assert_eq!((a.width, a.height), (b.width, b.height), "SSIM compares images of one size");
    assert_eq!((a.pixels.len(), b.pixels.len()), (a.width * a.height, a.width * a.height), "pixels fill the image");
    let (width, height) = (a.width, a.height);
    let Some(window) = [7, 5, 3, 1].into_iter().find(|w| *w <= width.min(height)) else { return 1.0 };
    // Sums over `window` rows, column by column, of x, y, x², y², xy.
    let mut columns = [(); 5].map(|()| vec![0.0f64; width]);
    let mut total = 0.0;
    for y in 0..height {
        let rows = |y: usize| (&a.pixels[y * width..][..width], &b.pixels[y * width..][..width]);
        add_products(&mut columns, rows(y), 1.0);
        if y >= window {
            add_products(&mut columns, rows(y - window), -1.0);
        }
        if y + 1 >= window {
            total += sum_window_ssim(&columns, window);
        }
    }
    total / ((width - window + 1) * (height - window + 1)) as f64
}

/// Adds `sign` times x, y, x², y², xy of one row to the column sums.
fn add_products(columns: &mut [Vec<f64>; 5], (a, b): (&[Real], &[Real]), sign: f64) {
    let [x1, x2, x11, x22, x12] = columns;
    for (i, (a, b)) in a.iter().zip(b).enumerate() {
        let (a, b) = (*a as f64, *b as f64);
        x1[i] += sign * a;
        x2[i] += sign * b;
        x11[i] += sign * (a * a);
        x22[i] += sign * (b * b);
        x12[i] += sign * (a * b);
    }
}

/// Returns the sum of the SSIM of all windows of one row, given the column sums of x, y, x², y², xy.
fn sum_window_ssim(columns: &[Vec<f64>; 5], window: usize) -> f64 {
    let n = (window * window) as f64;
    let sample = if window > 1 { n / (n - 1.0) } else { 1.0 };
    let mut sums = [0.0; 5];
    let mut total = 0.0;
    for right in 0..columns[0].len() {
        for k in 0..5 {
            sums[k] += columns[k][right];
            if right >= window {
                sums[k] -= columns[k][right - window];
            }
        }
        if right + 1 >= window {
            let [m1, m2, e11, e22, e12] = [sums[0] / n, sums[1] / n, sums[2] / n, sums[3] / n, sums[4] / n];
            let variances = sample * ((e11 - m1 * m1) + (e22 - m2 * m2));
            let covariance = sample * (e12 - m1 * m2);
            total += (2.0 * m1 * m2 + C1) * (2.0 * covariance + C2) / ((m1 * m1 + m2 * m2 + C1) * (variances + C2));
        }
    }
    total
}

/// C₁ = (0.01 · data range)².
const C1: f64 = 1e-4;
/// C₂ = (0.03 · data range)².
const C2: f64 = 9e-4;
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

    /// Returns the taps.
    pub fn taps(&self) -> &[Real; TAPS] {
        &self.0
    }
}

impl Default for Window {
    /// Returns the window of σ = 1.5 px, the usual value in training. Written out, so that results do not depend on the
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

/// Returns the training SSIM, the mean over all pixels, and its derivative by every pixel of `prediction`, with zeros
/// beyond the border. All arrays are row-major `[height, width]`, `size` is (width, height). The SSIM of images without pixels
/// is 1.
///
/// # Panics
/// If the pixels do not fill `size`.
pub fn training_form(prediction: &[Real], truth: &[Real], size: (usize, usize), window: &Window) -> (Real, Vec<Real>) {
    let (width, height) = size;
    assert_eq!((prediction.len(), truth.len()), (width * height, width * height), "pixels fill the image");
    if prediction.is_empty() {
        return (1.0, Vec::new());
    }
    thread_local! {
        static SCRATCH: RefCell<Scratch> = RefCell::default();
    }
    let mut d = vec![0.0; width * height];
    let value = SCRATCH.with_borrow_mut(|scratch| {
        scratch.resize(width, height);
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
    /// Allocates the buffers for images of another size.
    fn resize(&mut self, width: usize, height: usize) {
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

/// Arguments of [`training_form`], for the dispatch to an instruction set.
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
        // Pass 1: P, G, P² + G² and PG, blurred along the rows.
        for y in 0..height {
            let row = y * width..(y + 1) * width;
            write_products(padded, &prediction[row.clone()], &truth[row]);
            for (padded, plane) in padded.iter().zip(&mut *moments) {
                blur(&mut plane[y * stride..][..stride], row_taps(padded, stride), weights);
            }
        }
        // Pass 2: the same along the columns, which gives the map; its derivatives, blurred along the rows.
        let mut total = [0.0; LANES];
        for y in 0..height {
            for (row, plane) in blurred.iter_mut().zip(&*moments) {
                blur(row, column_taps(plane, y, stride, zeros), weights);
            }
            add_similarity(blurred, width, &mut total, padded);
            for (padded, plane) in padded.iter().zip(&mut *slopes) {
                blur(&mut plane[y * stride..][..stride], row_taps(padded, stride), weights);
            }
        }
        // Pass 3: the derivatives along the columns, which gives the derivative by P.
        let pixels = (width * height) as f64;
        for (y, d) in d.chunks_exact_mut(width).enumerate() {
            for (row, plane) in blurred.iter_mut().zip(&*slopes) {
                blur(row, column_taps(plane, y, stride, zeros), weights);
            }
            let row = y * width..(y + 1) * width;
            write_derivative(d, &prediction[row.clone()], &truth[row], blurred, (1.0 / pixels) as Real);
        }
        (total.iter().sum::<f64>() / pixels) as Real
    }
}

/// Returns eleven shifted views of one padded row.
#[inline(always)]
fn row_taps(padded: &[Real], stride: usize) -> [&[Real]; TAPS] {
    let mut taps = [padded; TAPS];
    for k in 0..TAPS {
        taps[k] = &padded[k..k + stride];
    }
    taps
}

/// Returns eleven rows of a plane about row `y`, zeros beyond the border.
#[inline(always)]
fn column_taps<'a>(plane: &'a [Real], y: usize, stride: usize, zeros: &'a [Real]) -> [&'a [Real]; TAPS] {
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
fn write_products(padded: &mut [Vec<Real>; 4], p: &[Real], g: &[Real]) {
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
fn add_similarity(moments: &[Vec<Real>; 4], width: usize, total: &mut [f64; LANES], slopes: &mut [Vec<Real>; 4]) {
    for i in 0..width.div_ceil(LANES) {
        let (start, valid) = (i * LANES, LANES.min(width - i * LANES));
        let block = |k: usize| &moments[k].as_chunks::<LANES>().0[i];
        let (map, d) = similarity_map([block(0), block(1), block(2), block(3)]);
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
fn similarity_map([mu1, mu2, squares, e12]: [&Block; 4]) -> (Block, [Block; 3]) {
    let (mut map, mut d) = ([0.0; LANES], [[0.0; LANES]; 3]);
    let [d_mu, d_variance, d_covariance] = &mut d;
    // A, B, C and D (`s`) of the module documentation.
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

/// Computes d = scale · (f(∂m/∂μ₁) + 2P·f(∂m/∂σ₁²) + G·f(∂m/∂σ₁₂)) for one row; `scale` is 1 / number of pixels.
#[inline(always)]
fn write_derivative(d: &mut [Real], p: &[Real], g: &[Real], blurred: &[Vec<Real>; 4], scale: Real) {
    let (n, [mu, variance, covariance, ..]) = (d.len(), blurred);
    let (mu, variance, covariance, p, g) = (&mu[..n], &variance[..n], &covariance[..n], &p[..n], &g[..n]);
    for i in 0..n {
        d[i] = scale * (mu[i] + 2.0 * p[i] * variance[i] + g[i] * covariance[i]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Real;
    use crate::{rng, testing::check_vjp};

    fn trained(a: &Image, b: &Image) -> f64 {
        training_form(&a.pixels, &b.pixels, (a.width, a.height), &Window::default()).0 as f64
    }

    /// Creates an image that Python can reproduce: bytes of a hash of the position, averaged with a ramp if `ramp`.
    fn picture(width: usize, height: usize, seed: u64, ramp: bool) -> Image {
        let pixel = |i: usize| {
            let (x, y) = ((i % width) as u64, (i / width) as u64);
            let hash = ((x * 7919 + y * 104_729 + seed * 1_299_709).wrapping_mul(2_654_435_761) % (1 << 32)) >> 24;
            let noise = hash as f64 / 255.0;
            (if ramp { 0.5 * noise + 0.5 * (x as f64 / width as f64) } else { noise }) as Real
        };
        Image { width, height, pixels: (0..width * height).map(pixel).collect() }
    }

    #[test]
    fn ssim_matches_scikit_image_and_scipy() {
        // width, height, ramp, skimage.metrics.structural_similarity(data_range=1), scipy convolve1d (zero padding)
        let cases = [
            (7, 7, false, -0.311_215_119_881, 0.247_837_366_820),
            (7, 7, true, 0.280_773_196_175, 0.626_314_718_809),
            (9, 16, false, -0.319_688_485_290, 0.071_910_652_571),
            (9, 16, true, 0.169_158_601_237, 0.439_479_811_098),
            (40, 23, false, -0.322_458_835_732, -0.154_219_487_589),
            (40, 23, true, -0.265_594_330_924, 0.007_293_166_073),
            (360, 90, false, -0.325_195_483_948, -0.290_892_582_326),
            (360, 90, true, -0.305_138_487_355, -0.240_999_383_803),
        ];
        for (width, height, ramp, expected_evaluation, expected_training) in cases {
            let (a, b) = (picture(width, height, 1, ramp), picture(width, height, 2, ramp));
            let actual = evaluation(&a, &b);
            assert!((actual - expected_evaluation).abs() < 1e-6, "{width}x{height}: {actual}");
            let actual = trained(&a, &b);
            assert!((actual - expected_training).abs() < 2e-6, "{width}x{height}: {actual}");
        }
    }

    #[test]
    fn ssim_of_measured_spectra_matches_known_values() {
        let Some(folder) = crate::testing::shared("data/s23/spectrum") else { return };
        let read = |id: &str| {
            let picture = image::open(folder.join(format!("{id}.png"))).unwrap().into_luma8();
            Image::from_bytes(picture.width() as usize, picture.height() as usize, picture.as_raw())
        };
        let (a, b) = (read("00001"), read("00002"));
        assert!((evaluation(&a, &b) - 0.447_368).abs() < 1e-6);
        assert!((trained(&a, &b) - 0.564_120).abs() < 1e-6);
    }

    #[test]
    fn ssim_of_equal_images_is_one_at_any_size() {
        for (width, height) in [(0, 0), (1, 1), (2, 9), (6, 6), (7, 7), (30, 11)] {
            let a = picture(width, height, 3, true);
            assert_eq!(evaluation(&a, &a), 1.0, "{width}x{height}");
            assert!((trained(&a, &a) - 1.0).abs() < 1e-5, "{width}x{height}");
        }
    }

    #[test]
    fn small_image_uses_one_ssim_window() {
        let (a, b) = (picture(3, 3, 1, false), picture(3, 3, 2, false));
        let mean = |f: &dyn Fn(usize) -> f64| (0..9).map(f).sum::<f64>() / 9.0;
        let (x, y) = (|i: usize| a.pixels[i] as f64, |i: usize| b.pixels[i] as f64);
        let (m1, m2) = (mean(&x), mean(&y));
        let covariance = |f: &dyn Fn(usize) -> f64| 9.0 / 8.0 * mean(f);
        let v1 = covariance(&|i| (x(i) - m1).powi(2));
        let v2 = covariance(&|i| (y(i) - m2).powi(2));
        let v12 = covariance(&|i| (x(i) - m1) * (y(i) - m2));
        let expected = (2.0 * m1 * m2 + C1) * (2.0 * v12 + C2) / ((m1 * m1 + m2 * m2 + C1) * (v1 + v2 + C2));
        assert!((evaluation(&a, &b) - expected).abs() < 1e-12);
    }

    fn noise(n: usize, name: &str) -> Vec<Real> {
        let mut random = rng::stream(2, name, 0);
        (0..n).map(|_| rng::uniform(&mut random)).collect()
    }

    fn differentiated(p: &[Real], g: &[Real], width: usize, height: usize) -> (Real, Vec<Real>) {
        training_form(p, g, (width, height), &Window::default())
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
