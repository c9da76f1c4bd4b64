//! The exponential of the blending kernel.

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
