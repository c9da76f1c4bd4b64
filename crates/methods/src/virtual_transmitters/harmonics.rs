//! Real spherical harmonics up to the third order, as polynomials of a direction, and their derivatives.
//!
//! Their mean square over the sphere is 1, and the first harmonic is 1, so that its coefficient is the mean gain.

/// Extra column `[N, 2(K−1)]` of gains beyond the mean: real and imaginary part of each harmonic except the first.
pub const HARMONICS: &str = "harmonics";

/// Smallest distance between a transmitter and a receiver in the model, metres; closer transmitters count as at this
/// distance and are not moved.
pub(crate) const CLOSEST: f64 = 1e-3;
/// Maximum order.
pub(crate) const HIGHEST: usize = 3;
/// Number of harmonics up to [`HIGHEST`].
pub(crate) const MOST: usize = harmonic_count(HIGHEST);

/// Returns the number of harmonics up to `order`.
pub(crate) const fn harmonic_count(order: usize) -> usize {
    (order + 1) * (order + 1)
}

// √3; √15, √15/2, √5/2; √(35/8), √105, √(21/8), √7/2, √105/2.
const S1: f64 = 1.732_050_807_568_877_2;
const S2: [f64; 3] = [3.872_983_346_207_417, 1.936_491_673_103_708_5, 1.118_033_988_749_895];
const S3: [f64; 5] = [
    2.091_650_066_335_189,
    10.246_950_765_959_598,
    1.620_185_174_601_965,
    1.322_875_655_532_295_4,
    5.123_475_382_979_799,
];

/// Returns the real spherical harmonics Y of the direction `[x, y, z]` of length 1, by order.
pub(crate) fn harmonics([x, y, z]: [f64; 3]) -> [f64; MOST] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        1.0,
        S1 * y,
        S1 * z,
        S1 * x,
        S2[0] * x * y,
        S2[0] * y * z,
        S2[2] * (3.0 * zz - 1.0),
        S2[0] * z * x,
        S2[1] * (xx - yy),
        S3[0] * y * (3.0 * xx - yy),
        S3[1] * x * y * z,
        S3[2] * y * (5.0 * zz - 1.0),
        S3[3] * z * (5.0 * zz - 3.0),
        S3[2] * x * (5.0 * zz - 1.0),
        S3[4] * z * (xx - yy),
        S3[0] * x * (xx - 3.0 * yy),
    ]
}

/// Returns the derivatives of [`harmonics`] by x, y and z, as independent variables.
pub(crate) fn harmonic_gradients([x, y, z]: [f64; 3]) -> [[f64; 3]; MOST] {
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let by = |s: f64, v: [f64; 3]| v.map(|v| s * v);
    [
        [0.0; 3],
        [0.0, S1, 0.0],
        [0.0, 0.0, S1],
        [S1, 0.0, 0.0],
        by(S2[0], [y, x, 0.0]),
        by(S2[0], [0.0, z, y]),
        by(S2[2], [0.0, 0.0, 6.0 * z]),
        by(S2[0], [z, 0.0, x]),
        by(S2[1], [2.0 * x, -2.0 * y, 0.0]),
        by(S3[0], [6.0 * x * y, 3.0 * (xx - yy), 0.0]),
        by(S3[1], [y * z, x * z, x * y]),
        by(S3[2], [0.0, 5.0 * zz - 1.0, 10.0 * y * z]),
        by(S3[3], [0.0, 0.0, 15.0 * zz - 3.0]),
        by(S3[2], [5.0 * zz - 1.0, 0.0, 10.0 * x * z]),
        by(S3[4], [2.0 * x * z, -2.0 * y * z, xx - yy]),
        by(S3[0], [3.0 * (xx - yy), -6.0 * x * y, 0.0]),
    ]
}

/// Returns the complex gain Σ c·Y from `v` towards `p`, with the coefficients `gains` `[K,2]`.
pub(crate) fn directional_gain(gains: &[[f64; 2]], v: [f64; 3], p: [f64; 3]) -> [f64; 2] {
    if let [only] = gains {
        return *only;
    }
    let y = harmonics(direction_and_distance(v, p).0);
    gains.iter().zip(y).fold([0.0; 2], |sum, (c, y)| [sum[0] + c[0] * y, sum[1] + c[1] * y])
}

/// Returns the unit vector from `v` to `p`, and the distance of at least [`CLOSEST`], within which the vector is shorter.
pub(crate) fn direction_and_distance(v: [f64; 3], p: [f64; 3]) -> ([f64; 3], f64) {
    let by = [0, 1, 2].map(|k| p[k] - v[k]);
    let d = (by[0] * by[0] + by[1] * by[1] + by[2] * by[2]).sqrt().max(CLOSEST);
    (by.map(|x| x / d), d)
}

/// Returns the derivative by the start `v` of a direction u, given the derivative `d_u` by the direction: (u uᵀ − I)/d ·
/// `d_u`, and zero within [`CLOSEST`], where the distance is constant.
pub(crate) fn direction_vjp(u: [f64; 3], d: f64, d_u: [f64; 3]) -> [f64; 3] {
    if d <= CLOSEST {
        return [0.0; 3];
    }
    let along = u[0] * d_u[0] + u[1] * d_u[1] + u[2] * d_u[2];
    [0, 1, 2].map(|k| (along * u[k] - d_u[k]) / d)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gauss quadrature in z with equal steps in azimuth is exact for polynomials up to order 7.
    fn mean(f: impl Fn([f64; 3]) -> f64) -> f64 {
        let z = [0.339_981_043_584_856_3_f64, 0.861_136_311_594_052_6];
        let w = [0.652_145_154_862_546_1, 0.347_854_845_137_453_85];
        let mut sum = 0.0;
        for k in 0..16 {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 16.0).sin_cos();
            for (z, w) in z.into_iter().zip(w) {
                let r = (1.0 - z * z).sqrt();
                sum += w / 32.0 * (f([r * cos, r * sin, z]) + f([r * cos, r * sin, -z]));
            }
        }
        sum
    }

    #[test]
    fn harmonics_are_orthonormal() {
        for i in 0..MOST {
            for j in 0..=i {
                let product = mean(|u| harmonics(u)[i] * harmonics(u)[j]);
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((product - expected).abs() < 1e-12, "{i} {j}: {product}");
            }
        }
    }

    #[test]
    fn harmonic_slopes_match_central_differences() {
        let (u, h) = ([0.3, -0.5, 0.8], 1e-5);
        for k in 0..3 {
            let at = |by: f64| {
                let mut u = u;
                u[k] += by;
                harmonics(u)
            };
            let (after, before) = (at(h), at(-h));
            for i in 0..MOST {
                let expected = (after[i] - before[i]) / (2.0 * h);
                assert!(
                    (harmonic_gradients(u)[i][k] - expected).abs() < 1e-8,
                    "{i} by {k}: {} is not {expected}",
                    harmonic_gradients(u)[i][k]
                );
            }
        }
    }
}
