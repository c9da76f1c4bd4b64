//! The positional encoding γ(x) = [x, sin 2⁰x, cos 2⁰x, …, sin 2^(L-1)x, cos 2^(L-1)x], each block three wide.
//!
//! No factor π, no scaling: x is in metres and 2^k x in radians (spec of WRF-GS, 3.1). The result is feature-major,
//! `[3 + 6L, R]`, as the layers take it (see `dense`).
//!
//! Only the sine and cosine of x itself are computed by the library, in double precision; each next frequency follows
//! by sin 2a = 2 sin a cos a, cos 2a = 1 - 2 sin² a. Each doubling multiplies the error by two to four, which in single
//! precision would cost more than 3e-5 after nine of them. From the 1e-16 of double precision, for coordinates up to
//! 40 m, the largest error found is 1.2e-12 at L = 10 and 2e-10 at L = 16: below the rounding of the result to `f32`.

use pwrfgs_core::Real;

/// The most that angle doubling carries to full single precision; 2¹⁵ rad/m is a period of 0.2 mm.
pub const MOST_FREQUENCIES: usize = 16;

/// How many numbers γ has for one point.
pub fn width(frequencies: usize) -> usize {
    3 + 6 * frequencies
}

/// γ of R points into `out` `[3 + 6L, R]`.
pub fn encode(points: impl ExactSizeIterator<Item = [Real; 3]>, frequencies: usize, out: &mut [Real]) {
    let rows = points.len();
    assert_eq!(out.len(), rows * width(frequencies), "one column a point");
    let (plain, mut waves) = out.split_at_mut(3 * rows);
    for (r, x) in points.enumerate() {
        (0..3).for_each(|k| plain[k * rows + r] = x[k]);
    }
    if frequencies == 0 {
        return;
    }
    let (mut sines, mut cosines): (Vec<f64>, Vec<f64>) = plain.iter().map(|&x| f64::from(x).sin_cos()).unzip();
    loop {
        let (block, rest) = waves.split_at_mut(6 * rows);
        let (s_out, c_out) = block.split_at_mut(3 * rows);
        let last = rest.is_empty();
        double(s_out, c_out, &mut sines, &mut cosines);
        if last {
            return;
        }
        waves = rest;
    }
}

/// Stores sine and cosine, then doubles their angle.
fn double(s_out: &mut [Real], c_out: &mut [Real], sines: &mut [f64], cosines: &mut [f64]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (((s_out, c_out), s), c) in s_out.iter_mut().zip(c_out).zip(sines).zip(cosines) {
                (*s_out, *c_out) = (*s as Real, *c as Real);
                (*s, *c) = (2.0 * *s * *c, 1.0 - 2.0 * *s * *s);
            }
        },
    );
}

/// Adds to `d_points` the derivative through γ: `encoded` is what [`encode`] gave, `d` its cotangent.
pub fn encode_vjp(encoded: &[Real], d: &[Real], frequencies: usize, d_points: &mut [[Real; 3]]) {
    let rows = d_points.len();
    assert!(encoded.len() == rows * width(frequencies) && d.len() == encoded.len(), "one column a point");
    for (r, d_point) in d_points.iter_mut().enumerate() {
        for (k, d_x) in d_point.iter_mut().enumerate() {
            let mut sum = d[k * rows + r];
            let mut scale = 1.0;
            for f in 0..frequencies {
                let (s, c) = ((3 + 6 * f + k) * rows + r, (6 + 6 * f + k) * rows + r);
                sum += scale * (encoded[c] * d[s] - encoded[s] * d[c]);
                scale *= 2.0;
            }
            *d_x += sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{rng, testing::check_vjp};

    fn points(n: usize, size: Real) -> Vec<[Real; 3]> {
        let mut random = rng::stream(3, "encoding", 0);
        (0..n).map(|_| std::array::from_fn(|_| size * (2.0 * rng::uniform(&mut random) - 1.0))).collect()
    }

    /// The largest error over points in a cube of ±40 m.
    fn worst_error(frequencies: usize) -> f64 {
        let points = points(2000, 40.0);
        let mut out = vec![0.0; points.len() * width(frequencies)];
        encode(points.iter().copied(), frequencies, &mut out);
        let mut worst: f64 = 0.0;
        for (r, x) in points.iter().enumerate() {
            for k in 0..3 {
                let at = |feature: usize| f64::from(out[(feature + k) * points.len() + r]);
                assert_eq!(at(0), f64::from(x[k]));
                for f in 0..frequencies {
                    let (sin, cos) = (f64::from(x[k]) * f64::from(1 << f)).sin_cos();
                    worst = worst.max((at(3 + 6 * f) - sin).abs()).max((at(6 + 6 * f) - cos).abs());
                }
            }
        }
        worst
    }

    #[test]
    fn angle_doubling_is_as_exact_as_the_library_at_forty_metres() {
        let (ten, most) = (worst_error(10), worst_error(MOST_FREQUENCIES));
        let (ten_allowed, most_allowed) = if size_of::<Real>() == 8 { (2e-12, 2e-8) } else { (4e-8, 1e-7) };
        assert!(ten < ten_allowed && most < most_allowed, "largest errors {ten}, {most}");
    }

    #[test]
    fn no_frequency_leaves_the_point_alone() {
        let mut out = vec![0.0; 6];
        encode([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]].into_iter(), 0, &mut out);
        assert_eq!(out, [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
    }

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn derivative_agrees_with_central_differences() {
        let x = points(3, 1.0);
        let encoded = |x: &[Real]| {
            let mut out = vec![0.0; x.len() / 3 * width(4)];
            encode(x.as_chunks::<3>().0.iter().copied(), 4, &mut out);
            out
        };
        let vjp = |x: &[Real], d: &[Real]| {
            let mut d_x = vec![[0.0; 3]; x.len() / 3];
            encode_vjp(&encoded(x), d, 4, &mut d_x);
            d_x.into_flattened()
        };
        check_vjp("encoding", x.as_flattened(), encoded, vjp, 1e-6, 1e-7);
    }
}
