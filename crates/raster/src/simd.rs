//! The exponential of the blending kernel, and the dispatch to the widest vectors the processor has.

use pwrfgs_core::Real;

/// eˣ for x ≤ 0; relative error below 2e-7 in single precision. Branch-free, so that loops over lanes vectorise.
#[inline(always)]
pub(crate) fn exp_nonpositive(x: Real) -> Real {
    if size_of::<Real>() == 8 { x.exp() } else { fast(x as f32) as Real }
}

/// 2ⁿ · e^r with |r| ≤ ln2/2: n by the rounding trick, r in two steps (Cody and Waite), e^r by its Taylor polynomial of
/// degree 6, whose last coefficients are adjusted for the interval.
#[inline(always)]
fn fast(x: f32) -> f32 {
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

/// Multiply and add over the lanes of a row, with explicit vectors: left to itself the compiler vectorises across
/// channels instead, by gathering.
pub(crate) trait Lanes: Sized {
    /// sum += scale · x.
    fn add_scaled<S: pulp::Simd, const N: usize>(simd: S, sum: &mut [Self; N], scale: Self, x: &[Self; N]);
    /// sum += x · y.
    fn add_product<S: pulp::Simd, const N: usize>(simd: S, sum: &mut [Self; N], x: &[Self; N], y: &[Self; N]);
    /// Two weighted sums of the same rows, each row loaded once: `sums[c] = Σ scales[c][k] · rows[k]`. N is a multiple of
    /// 64, so that every vector width makes whole groups of four, which stay in registers.
    fn two_sums<S: pulp::Simd, const N: usize>(
        simd: S,
        sums: &mut [[Self; N]; 2],
        scales: [&[Self]; 2],
        rows: &[[Self; N]],
    );
}

macro_rules! lanes {
    ($real:ty, $vectors:ident, $vectors_mut:ident, $splat:ident, $mul_add:ident) => {
        impl Lanes for $real {
            #[inline(always)]
            fn add_scaled<S: pulp::Simd, const N: usize>(simd: S, sum: &mut [Self; N], scale: Self, x: &[Self; N]) {
                let (sum, sum_rest) = S::$vectors_mut(sum);
                let (x, x_rest) = S::$vectors(x);
                let many = simd.$splat(scale);
                for i in 0..sum.len() {
                    sum[i] = simd.$mul_add(many, x[i], sum[i]);
                }
                for i in 0..sum_rest.len() {
                    sum_rest[i] = scale.mul_add(x_rest[i], sum_rest[i]);
                }
            }
            #[inline(always)]
            fn add_product<S: pulp::Simd, const N: usize>(simd: S, sum: &mut [Self; N], x: &[Self; N], y: &[Self; N]) {
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
            fn two_sums<S: pulp::Simd, const N: usize>(
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
        }
    };
}
lanes!(f32, as_simd_f32s, as_mut_simd_f32s, splat_f32s, mul_add_f32s);
lanes!(f64, as_simd_f64s, as_mut_simd_f64s, splat_f64s, mul_add_f64s);

/// Runs `work` at the widest vectors of this processor. `with_simd` must be `#[inline(always)]`, and so must all it
/// calls: what is not inlined into the dispatch is compiled for the narrowest. (A closure is not, hence the structs.)
/// The standard library does not promise it of `zip`, `array::map` and `array::from_fn`, which become calls where a
/// crate's parts are not optimised together: kernels count their lanes.
#[inline(always)]
pub(crate) fn widest<W: pulp::WithSimd>(work: W) -> W::Output {
    pulp::Arch::new().dispatch(work)
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
