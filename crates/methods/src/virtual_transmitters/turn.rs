//! Rotations as quaternions w, x, y, z: matrix, derivative, and small rotations, in double precision.

/// Matrix by rows.
pub(crate) type MatrixRows = [[f64; 3]; 3];

/// Identity rotation.
pub(crate) const IDENTITY: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Returns q/|q|; the identity if |q| is close to zero or not finite.
pub(crate) fn unit_quat(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 1e-30 && length.is_finite() { q.map(|x| x / length) } else { IDENTITY }
}

/// Returns the matrix R of a unit quaternion.
pub(crate) fn rotation_matrix([w, x, y, z]: [f64; 4]) -> MatrixRows {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Returns the rotated vector R v.
#[inline(always)]
pub(crate) fn rotate_vector(r: &MatrixRows, v: [f64; 3]) -> [f64; 3] {
    [
        r[0][0] * v[0] + r[0][1] * v[1] + r[0][2] * v[2],
        r[1][0] * v[0] + r[1][1] * v[1] + r[1][2] * v[2],
        r[2][0] * v[0] + r[2][1] * v[1] + r[2][2] * v[2],
    ]
}

/// Computes the derivative of [`rotation_matrix`] of [`unit_quat`]: the cotangent of a quaternion of any length, given that
/// of R; zero if [`unit_quat`] returns the identity instead.
pub(crate) fn rotation_matrix_vjp(q: [f64; 4], d: &MatrixRows) -> [f64; 4] {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !(length > 1e-30 && length.is_finite()) {
        return [0.0; 4];
    }
    let u = q.map(|x| x / length);
    let [w, x, y, z] = u;
    let du = [
        2.0 * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1])),
        2.0 * (y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[2][1] - d[1][2])
            - 2.0 * x * (d[1][1] + d[2][2])),
        2.0 * (x * (d[0][1] + d[1][0]) + z * (d[1][2] + d[2][1]) + w * (d[0][2] - d[2][0])
            - 2.0 * y * (d[0][0] + d[2][2])),
        2.0 * (x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]) + w * (d[1][0] - d[0][1])
            - 2.0 * z * (d[0][0] + d[1][1])),
    ];
    let along: f64 = (0..4).map(|k| u[k] * du[k]).sum();
    std::array::from_fn(|k| (du[k] - u[k] * along) / length)
}

/// Returns the quaternion of a rotation by the vector `by` (radians, world axes) after `q`.
pub(crate) fn rotate_quat(q: [f64; 4], by: [f64; 3]) -> [f64; 4] {
    let angle = by.iter().map(|x| x * x).sum::<f64>().sqrt();
    if angle < 1e-30 {
        return q;
    }
    let (s, c) = (angle / 2.0).sin_cos();
    let [x, y, z] = by.map(|x| x / angle * s);
    unit_quat(quat_product([c, x, y, z], q))
}

/// Returns Hamilton's product a·b: first b, then a.
pub(crate) fn quat_product(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// Returns the normal of the plane that fits the antennas best; exact for antennas in a plane or on a line. The z axis for
/// antennas at one position.
///
/// It is the eigenvector of the smallest eigenvalue of their covariance, by power iteration on trace·I − covariance.
pub(crate) fn array_normal(antennas: &[[f64; 3]]) -> [f64; 3] {
    let n = antennas.len().max(1) as f64;
    let mean: [f64; 3] = std::array::from_fn(|k| antennas.iter().map(|a| a[k]).sum::<f64>() / n);
    let mut c = [[0.0; 3]; 3];
    for a in antennas {
        for (i, row) in c.iter_mut().enumerate() {
            (0..3).for_each(|j| row[j] += (a[i] - mean[i]) * (a[j] - mean[j]) / n);
        }
    }
    let trace = c[0][0] + c[1][1] + c[2][2];
    let mut v = [0.36, 0.48, 0.8]; // not along an axis
    // 200 steps suffice for a square array; 64 x 2 antennas take about 30,000.
    for step in 1..=100_000 {
        let cv = rotate_vector(&c, v);
        let w: [f64; 3] = std::array::from_fn(|k| trace * v[k] - cv[k]);
        let length = w.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length < 1e-30 {
            return [0.0, 0.0, 1.0];
        }
        let before = std::mem::replace(&mut v, w.map(|x| x / length));
        if step >= 200 && (0..3).all(|k| (v[k] - before[k]).abs() < 1e-12) {
            break;
        }
    }
    v
}

/// Returns the quaternions that act on a planar array of `antennas` as the eight reflections diag(±1, ±1, ±1) do, identity
/// first, without duplicates.
///
/// With an odd number of negative signs, the reflection combined with that in the plane of the array is a rotation, and
/// the latter does not change the array.
pub(crate) fn mirror_rotations(antennas: &[[f64; 3]]) -> Vec<[f64; 4]> {
    let m = array_normal(antennas);
    let mut quats: Vec<[f64; 4]> = Vec::new();
    for signs in 0..8_u32 {
        let sign = |k: usize| if signs >> k & 1 == 1 { -1.0 } else { 1.0 };
        let odd = signs.count_ones() % 2 == 1;
        let entry = |i: usize, j: usize| {
            let identity = if i == j { 1.0 } else { 0.0 };
            sign(i) * (identity - if odd { 2.0 * m[i] * m[j] } else { 0.0 })
        };
        let q = quat_from_matrix(&std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j))));
        let positions = |q: [f64; 4]| -> Vec<[f64; 3]> {
            antennas.iter().map(|a| rotate_vector(&rotation_matrix(q), *a)).collect()
        };
        let antennas_of_q = positions(q);
        // Rounding moves antennas by far less than a millionth of the array; a lone antenna at the centre has no extent.
        let reach = antennas.as_flattened().iter().fold(1e-9_f64, |r, x| r.max(x.abs()));
        let same = |other: &[f64; 4]| {
            let others = positions(*other);
            antennas_of_q.as_flattened().iter().zip(others.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6 * reach)
        };
        if !quats.iter().any(same) {
            quats.push(q);
        }
    }
    quats
}

/// Returns the unit quaternion of a rotation matrix, computed from its largest component, which is far from 0.
pub(crate) fn quat_from_matrix(r: &MatrixRows) -> [f64; 4] {
    let squares = [
        1.0 + r[0][0] + r[1][1] + r[2][2],
        1.0 + r[0][0] - r[1][1] - r[2][2],
        1.0 - r[0][0] + r[1][1] - r[2][2],
        1.0 - r[0][0] - r[1][1] + r[2][2],
    ];
    let largest = (0..4).fold(0, |best, k| if squares[k] > squares[best] { k } else { best });
    let (a, b, c) = (r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]);
    let (d, e, f) = (r[0][1] + r[1][0], r[0][2] + r[2][0], r[1][2] + r[2][1]);
    unit_quat(match largest {
        0 => [squares[0], a, b, c],
        1 => [a, squares[1], d, e],
        2 => [b, d, squares[2], f],
        _ => [c, e, f, squares[3]],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_matrix_round_trips_through_quaternion() {
        for q in [IDENTITY, [0.5, 0.5, -0.5, 0.5], [0.1, -0.7, 0.2, 0.3], [0.0, 0.0, 1.0, 0.0], [0.0, 0.6, 0.0, -0.8]] {
            let q = unit_quat(q);
            let back = quat_from_matrix(&rotation_matrix(q));
            let dot: f64 = (0..4).map(|k| q[k] * back[k]).sum();
            assert!((dot.abs() - 1.0).abs() < 1e-12, "{q:?} {back:?}");
        }
    }

    #[test]
    fn mirrored_planar_array_equals_rotated_array() {
        // Array in the plane x = 0, as on a wall.
        let antennas: Vec<[f64; 3]> = (0..16).map(|k| [0.0, f64::from(k % 4), f64::from(k / 4) + 0.1]).collect();
        let rotations = mirror_rotations(&antennas);
        assert_eq!(rotations.len(), 4, "x does not matter, y and z do");
        for signs in [[1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, -1.0]] {
            let hit = rotations.iter().any(|q| {
                antennas.iter().all(|a| {
                    let t = rotate_vector(&rotation_matrix(*q), *a);
                    (0..3).all(|k| (t[k] - signs[k] * a[k]).abs() < 1e-9)
                })
            });
            assert!(hit, "{signs:?}");
        }
        assert_eq!(mirror_rotations(&[[0.0; 3]]).len(), 1, "nothing to turn");
    }

    #[test]
    fn normal_of_long_array_is_exact() {
        let antenna = |k: i32| [0.06 * f64::from(k / 2), 0.0, 0.06 * f64::from(k % 2)];
        let normal = array_normal(&(0..128).map(antenna).collect::<Vec<_>>());
        assert!(normal[0].abs() < 1e-6 && normal[2].abs() < 1e-6, "{normal:?}");
    }

    #[test]
    fn small_rotation_turns_about_its_axis() {
        let q = rotate_quat([0.5, 0.5, 0.5, 0.5], [0.0, 0.0, 1e-3]);
        let (a, b) = (
            rotate_vector(&rotation_matrix([0.5; 4]), [1.0, 2.0, 3.0]),
            rotate_vector(&rotation_matrix(q), [1.0, 2.0, 3.0]),
        );
        assert!((b[0] - (a[0] - 1e-3 * a[1])).abs() < 1e-5 && (b[1] - (a[1] + 1e-3 * a[0])).abs() < 1e-5);
    }
}
