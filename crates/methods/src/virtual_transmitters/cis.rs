//! exp(j2πx) over lanes.
//!
//! Phases are counted in cycles: whole cycles are dropped exactly before the multiplication by 2π. In single precision
//! the phase error is then 1e-7 of the path length in wavelengths, some 1e-4 radians at 200 wavelengths.

/// Sines and cosines of cycles, branch-free, so that loops over lanes vectorise.
pub(crate) trait Cis: Copy {
    /// Returns (cos 2πx, sin 2πx) of x cycles.
    fn cis(x: Self) -> (Self, Self);
}

/// Taylor series at πt, |t| ≤ ½ cycle, then the double-angle formula. The first omitted term is below the rounding
/// error.
macro_rules! cis {
    ($real:ty, $sin:expr, $cos:expr) => {
        impl Cis for $real {
            #[inline(always)]
            fn cis(x: Self) -> (Self, Self) {
                // Computed once, also without optimisation.
                const SIN: &[$real] = &$sin;
                const COS: &[$real] = &$cos;
                let y = (x - x.round_ties_even()) * std::f64::consts::PI as Self;
                let z = y * y;
                let (mut s, mut c) = (0.0 as Self, 0.0 as Self);
                let mut i = 0;
                while i < SIN.len() {
                    s = s.mul_add(z, SIN[i]);
                    i += 1;
                }
                i = 0;
                while i < COS.len() {
                    c = c.mul_add(z, COS[i]);
                    i += 1;
                }
                s *= y;
                (1.0 - 2.0 * s * s, 2.0 * s * c)
            }
        }
    };
}
cis!(f32, taylor_coefficients_f32::<6>(1), taylor_coefficients_f32::<7>(0));
cis!(f64, taylor_coefficients::<11>(1), taylor_coefficients::<12>(0));

/// Returns the Taylor coefficients of sin(y)/y (`first` 1) or cos y (`first` 0) in y², highest power first.
const fn taylor_coefficients<const N: usize>(first: usize) -> [f64; N] {
    let mut out = [0.0; N];
    let (mut k, mut c) = (0, 1.0);
    while k < N {
        out[N - 1 - k] = c;
        let n = 2 * k + first;
        c /= -(((n + 1) * (n + 2)) as f64);
        k += 1;
    }
    out
}

/// Returns [`taylor_coefficients`] in single precision.
const fn taylor_coefficients_f32<const N: usize>(first: usize) -> [f32; N] {
    let (wide, mut out) = (taylor_coefficients::<N>(first), [0.0; N]);
    let mut k = 0;
    while k < N {
        out[k] = wide[k] as f32;
        k += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cis_is_accurate_to_rounding() {
        for i in -40_000..40_000 {
            let x = f64::from(i) * 1.234_5e-3;
            let (sin, cos) = (x.fract() * std::f64::consts::TAU).sin_cos();
            let (c, s) = f64::cis(x);
            assert!((c - cos).abs() < 2e-14 && (s - sin).abs() < 2e-14, "{x}: {c} {s}");
            let narrow = x as f32;
            let (sin, cos) = (f64::from(narrow.fract()) * std::f64::consts::TAU).sin_cos();
            let (c, s) = f32::cis(narrow);
            assert!((f64::from(c) - cos).abs() < 8e-7 && (f64::from(s) - sin).abs() < 8e-7, "{narrow}: {c} {s}");
        }
    }
}
