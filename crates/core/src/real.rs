//! Floating-point type of all kernels, kernels over vector lanes, and dispatch to the widest vectors of the processor.
//!
//! `f32` by default; the crate feature `f64` selects double precision to check hand-written derivatives against central
//! differences. A feature instead of generics keeps kernels readable as formulas.

use pulp::Simd;

/// Single precision, or double with the feature `f64`.
#[cfg(not(feature = "f64"))]
pub type Real = f32;
/// Single precision, or double with the feature `f64`.
#[cfg(feature = "f64")]
pub type Real = f64;

/// Position or direction, in metres unless stated otherwise.
#[cfg(not(feature = "f64"))]
pub type Vec3 = glam::Vec3;
/// Position or direction, in metres unless stated otherwise.
#[cfg(feature = "f64")]
pub type Vec3 = glam::DVec3;

/// A 3x3 matrix, stored by columns.
#[cfg(not(feature = "f64"))]
pub type Mat3 = glam::Mat3;
/// A 3x3 matrix, stored by columns.
#[cfg(feature = "f64")]
pub type Mat3 = glam::DMat3;

/// Mathematical constants at the precision of [`Real`].
pub mod consts {
    use super::Real;
    /// π.
    pub const PI: Real = std::f64::consts::PI as Real;
    /// 2π.
    pub const TAU: Real = std::f64::consts::TAU as Real;
    /// Degrees per radian.
    pub const DEG: Real = 180.0 / PI;
    /// ln 10.
    pub const LN_10: Real = std::f64::consts::LN_10 as Real;
}

/// Returns the logistic function σ(x) = 1/(1 + e⁻ˣ).
#[inline]
pub fn sigmoid(x: Real) -> Real {
    if x >= 0.0 {
        1.0 / (1.0 + (-x).exp())
    } else {
        let e = x.exp(); // e⁻ˣ could overflow
        e / (1.0 + e)
    }
}

/// Returns the inverse of [`sigmoid`]: ln(p/(1-p)) for p in (0, 1).
#[inline]
pub fn logit(p: Real) -> Real {
    (p / (1.0 - p)).ln()
}

/// Multiply-add over the lanes of a row, with explicit vectors: automatic vectorisation would use slow gather
/// instructions across channels.
pub trait Lanes: Sized {
    /// Computes sum += scale · x.
    fn add_scaled<S: Simd, const N: usize>(simd: S, sum: &mut [Self; N], scale: Self, x: &[Self; N]);
    /// Computes sum += x · y.
    fn add_product<S: Simd, const N: usize>(simd: S, sum: &mut [Self; N], x: &[Self; N], y: &[Self; N]);
    /// Computes two weighted sums of the same rows, each row loaded once: `sums[c] = Σ scales[c][k] · rows[k]`. N is a
    /// multiple of 64, so that every vector width forms whole groups of four, which stay in registers.
    fn two_sums<S: Simd, const N: usize>(simd: S, sums: &mut [[Self; N]; 2], scales: [&[Self]; 2], rows: &[[Self; N]]);
    /// Computes the scalar products `[M, N]` of each vector of `a` with each of `b`, all of one length. The order of the
    /// additions depends only on that length and the width of `simd`.
    fn dots<S: Simd, const M: usize, const N: usize>(simd: S, a: [&[Self]; M], b: [&[Self]; N]) -> [[Self; N]; M];
}

/// Implements [`Lanes`] for a type with the operations that [`Simd`] names after it.
macro_rules! lanes {
    ($real:ty, $vectors:ident, $vectors_mut:ident, $splat:ident, $mul_add:ident, $load:ident, $sum:ident) => {
        impl Lanes for $real {
            #[inline(always)]
            fn add_scaled<S: Simd, const N: usize>(simd: S, sum: &mut [Self; N], scale: Self, x: &[Self; N]) {
                let (sum, sum_rest) = S::$vectors_mut(sum);
                let (x, x_rest) = S::$vectors(x);
                let factor = simd.$splat(scale);
                for i in 0..sum.len() {
                    sum[i] = simd.$mul_add(factor, x[i], sum[i]);
                }
                for i in 0..sum_rest.len() {
                    sum_rest[i] = scale.mul_add(x_rest[i], sum_rest[i]);
                }
            }
            #[inline(always)]
            fn add_product<S: Simd, const N: usize>(simd: S, sum: &mut [Self; N], x: &[Self; N], y: &[Self; N]) {
                let (sum, sum_rest) = S::$vectors_mut(sum);
                let ((x, x_rest), (y, y_rest)) = (S::$vectors(x), S::$vectors(y));
                for i in 0..sum.len() {
                    sum[i] = simd.$mul_add(x[i], y[i], sum[i]);
                }
                for i in 0..sum_rest.len() {
                    sum_rest[i] = x_rest[i].mul_add(y_rest[i], sum_rest[i]);
                }
            }
            #[inline(always)]
            fn two_sums<S: Simd, const N: usize>(
                simd: S,
                sums: &mut [[Self; N]; 2],
                scales: [&[Self]; 2],
                rows: &[[Self; N]],
            ) {
                const { assert!(N.is_multiple_of(64), "whole groups of four vectors") };
                let [first, second] = sums;
                let first = S::$vectors_mut(first).0.as_chunks_mut::<4>().0;
                let second = S::$vectors_mut(second).0.as_chunks_mut::<4>().0;
                let (xs, ys) = (&scales[0][..rows.len()], &scales[1][..rows.len()]);
                for g in 0..first.len() {
                    let (mut a, mut b) = ([simd.$splat(0.0); 4], [simd.$splat(0.0); 4]);
                    for k in 0..rows.len() {
                        let (x, y) = (simd.$splat(xs[k]), simd.$splat(ys[k]));
                        let row = &S::$vectors(&rows[k]).0.as_chunks::<4>().0[g];
                        for v in 0..4 {
                            a[v] = simd.$mul_add(row[v], x, a[v]);
                            b[v] = simd.$mul_add(row[v], y, b[v]);
                        }
                    }
                    (first[g], second[g]) = (a, b);
                }
            }
            #[inline(always)]
            fn dots<S: Simd, const M: usize, const N: usize>(
                simd: S,
                a: [&[Self]; M],
                b: [&[Self]; N],
            ) -> [[Self; N]; M] {
                let mut sums = [[simd.$splat(0.0); N]; M];
                let mut results = [[0.0; N]; M];
                let (mut xs, mut ys) = ([S::$vectors(&[]); M], [S::$vectors(&[]); N]);
                for i in 0..M {
                    xs[i] = S::$vectors(a[i]);
                }
                for j in 0..N {
                    ys[j] = S::$vectors(&b[j][..a[0].len()]);
                }
                for k in 0..xs[0].0.len() {
                    for i in 0..M {
                        for j in 0..N {
                            sums[i][j] = simd.$mul_add(xs[i].0[k], ys[j].0[k], sums[i][j]);
                        }
                    }
                }
                for i in 0..M {
                    let x = simd.$load(xs[i].1);
                    for j in 0..N {
                        sums[i][j] = simd.$mul_add(x, simd.$load(ys[j].1), sums[i][j]);
                    }
                }
                for i in 0..M {
                    for j in 0..N {
                        results[i][j] = simd.$sum(sums[i][j]);
                    }
                }
                results
            }
        }
    };
}
lanes!(f32, as_simd_f32s, as_mut_simd_f32s, splat_f32s, mul_add_f32s, partial_load_f32s, reduce_sum_f32s);
lanes!(f64, as_simd_f64s, as_mut_simd_f64s, splat_f64s, mul_add_f64s, partial_load_f64s, reduce_sum_f64s);

/// Runs `work` with the widest vectors of this processor. `with_simd` and all functions that it calls must be
/// `#[inline(always)]`: functions that are not inlined are compiled for the narrowest vectors. (Closures are not
/// inlined, hence the structs.) The standard library does not guarantee inlining of `zip`, `array::map` and
/// `array::from_fn`, which become calls if the parts of a crate are not optimised together; kernels therefore use
/// indices.
#[inline(always)]
pub fn widest<W: pulp::WithSimd>(work: W) -> W::Output {
    pulp::Arch::new().dispatch(work)
}
