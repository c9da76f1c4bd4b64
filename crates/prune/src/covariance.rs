//! Covariance of a Gaussian, and conversion back to scales and rotation.

use pwrfgs_core::GaussianCloud;

/// Covariance matrix Σ = R diag(s²) Rᵀ, m².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Covariance(pub(crate) [[f64; 3]; 3]);

/// Maximum number of sweeps of Jacobi rotations; a 3 × 3 matrix needs five or six for full precision.
const SWEEPS: usize = 12;

impl Covariance {
    /// Computes the covariance of Gaussian `i`.
    pub(crate) fn new(cloud: &GaussianCloud, i: usize) -> Self {
        let r = rotation_matrix(cloud.quats[i].map(f64::from));
        let squares = cloud.log_scales[i].map(|s| (2.0 * f64::from(s)).exp());
        let element = |a: usize, b: usize| (0..3).map(|k| r[a][k] * squares[k] * r[b][k]).sum();
        Self(std::array::from_fn(|a| std::array::from_fn(|b| element(a, b))))
    }

    /// Returns the scales along the principal axes, metres, and the rotation to these axes (quaternion w, x, y, z), by
    /// Jacobi's eigenvalue method.
    pub(crate) fn principal_axes(&self) -> ([f64; 3], [f64; 4]) {
        let mut a = self.0;
        let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for _ in 0..SWEEPS {
            for (p, q) in [(0, 1), (0, 2), (1, 2)] {
                apply_jacobi_rotation(&mut a, &mut v, p, q);
            }
        }
        let scales = [0, 1, 2].map(|k: usize| a[k][k].max(0.0).sqrt());
        if determinant(&v) < 0.0 {
            v.iter_mut().for_each(|row| row[2] = -row[2]); // a rotation instead of a reflection
        }
        (scales, quat_from_matrix(&v))
    }
}

/// Applies one Jacobi rotation, which makes the element (p, q) of `a` zero, to `a` and to the eigenvectors `v`.
fn apply_jacobi_rotation(a: &mut [[f64; 3]; 3], v: &mut [[f64; 3]; 3], p: usize, q: usize) {
    if a[p][q] == 0.0 {
        return;
    }
    // Tangent, cosine and sine of the angle: the smaller of the two that make the element zero.
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    for row in a.iter_mut().chain(v.iter_mut()) {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    for k in 0..3 {
        (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
    }
}

/// Returns the determinant of a 3 × 3 matrix.
fn determinant(m: &[[f64; 3]; 3]) -> f64 {
    let minor = |a: usize, b: usize| m[1][a] * m[2][b] - m[1][b] * m[2][a];
    m[0][0] * minor(1, 2) - m[0][1] * minor(0, 2) + m[0][2] * minor(0, 1)
}

/// Returns the rotation matrix of a quaternion w, x, y, z of any length; the identity for a quaternion close to zero.
fn rotation_matrix(q: [f64; 4]) -> [[f64; 3]; 3] {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = if norm > 1e-12 { q.map(|v| v / norm) } else { [1.0, 0.0, 0.0, 0.0] };
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Returns the quaternion w, x, y, z of a rotation matrix, from its largest component (Shepperd's method).
fn quat_from_matrix(r: &[[f64; 3]; 3]) -> [f64; 4] {
    let trace = r[0][0] + r[1][1] + r[2][2];
    let squares = [trace, r[0][0], r[1][1], r[2][2]];
    let first = (1..4).fold(0, |best, k| if squares[k] > squares[best] { k } else { best });
    if first == 0 {
        let w = 0.5 * (1.0 + trace).max(0.0).sqrt();
        let f = 0.25 / w;
        return [w, f * (r[2][1] - r[1][2]), f * (r[0][2] - r[2][0]), f * (r[1][0] - r[0][1])];
    }
    let (i, j, k) = (first - 1, first % 3, (first + 1) % 3);
    let largest = 0.5 * (1.0 + r[i][i] - r[j][j] - r[k][k]).max(0.0).sqrt();
    let f = 0.25 / largest;
    let mut q = [f * (r[k][j] - r[j][k]), 0.0, 0.0, 0.0];
    (q[1 + i], q[1 + j], q[1 + k]) = (largest, f * (r[j][i] + r[i][j]), f * (r[k][i] + r[i][k]));
    q
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Real, rng};

    #[test]
    fn covariance_round_trips_through_axes() {
        let mut random = rng::stream(3, "covariance", 0);
        for _ in 0..200 {
            let mut cloud = GaussianCloud::zeros(1);
            cloud.quats[0] = std::array::from_fn(|_| rng::normal(&mut random));
            cloud.log_scales[0] = std::array::from_fn(|_| rng::normal(&mut random));
            let covariance = Covariance::new(&cloud, 0);
            let (scales, quat) = covariance.principal_axes();
            let mut sorted = [scales, cloud.log_scales[0].map(|s| f64::from(s).exp())];
            sorted.iter_mut().for_each(|s| s.sort_by(f64::total_cmp));
            sorted[0].iter().zip(sorted[1]).for_each(|(a, b)| assert!((a - b).abs() < 1e-4 * b, "{a} is not {b}"));
            cloud.quats[0] = quat.map(|q| q as Real);
            cloud.log_scales[0] = scales.map(|s| s.ln() as Real);
            let again = Covariance::new(&cloud, 0);
            let largest = sorted[1][2] * sorted[1][2];
            for (a, b) in covariance.0.iter().flatten().zip(again.0.iter().flatten()) {
                assert!((a - b).abs() < 1e-4 * largest, "{a} is not {b}");
            }
        }
    }
}
