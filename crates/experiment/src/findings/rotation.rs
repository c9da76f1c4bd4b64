//! Rotation between pairs of directions, and the median direction.
//!
//! Wahba's problem, max over R of Σ w bᵀRa, is the largest eigenvector of a symmetric 4 x 4 matrix (Davenport's
//! q-method). With weights 1/angle, updated iteratively, the result minimises the sum of angles: reflections that are
//! stronger than the direct path then have little influence.

use glam::{DMat3, DMat4, DQuat, DVec3};

/// Smallest angle in the weights, radians: about a pixel.
const LEAST: f64 = 0.01;
/// Number of reweighting iterations.
const ROUNDS: usize = 40;
/// Number of matrix squarings, which separate eigenvalues with a relative difference of 10⁻⁹.
const SQUARINGS: usize = 36;

/// Two directions that should coincide.
pub(super) type DirectionPair = (DVec3, DVec3);

/// Returns the angle between two unit vectors, radians; accurate for small angles, unlike the arc cosine.
pub(super) fn angle(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// Finds the rotation R with the smallest Σ angle(R a, b) over the pairs (a, b), the better result of two starts.
pub(super) fn best_rotation(pairs: &[DirectionPair]) -> DQuat {
    let cost = |r: &DQuat| pairs.iter().map(|(a, b)| angle(*r * *a, *b)).sum::<f64>();
    // Two starts: no rotation, and the least-squares rotation.
    let [a, b] = [DQuat::IDENTITY, solve_wahba(pairs, &vec![1.0; pairs.len()])].map(|start| refine(start, pairs));
    if cost(&b) < cost(&a) { b } else { a }
}

/// Repeats the least-squares fit with weights 1/angle, from `rotation`, until it changes by less than 10⁻⁶ rad, at most
/// [`ROUNDS`] times.
fn refine(mut rotation: DQuat, pairs: &[DirectionPair]) -> DQuat {
    for _ in 0..ROUNDS {
        let weights: Vec<f64> = pairs.iter().map(|(a, b)| 1.0 / angle(rotation * *a, *b).max(LEAST)).collect();
        let next = solve_wahba(pairs, &weights);
        let change = next.angle_between(rotation);
        rotation = next;
        if change < 1e-6 {
            break;
        }
    }
    rotation
}

/// Solves Wahba's problem, the rotation R with the largest Σ w bᵀRa, by Davenport's q-method.
fn solve_wahba(pairs: &[DirectionPair], weights: &[f64]) -> DQuat {
    let (mut m, mut z) = (DMat3::ZERO, DVec3::ZERO);
    for ((a, b), w) in pairs.iter().zip(weights) {
        m += DMat3::from_cols(*b * a.x, *b * a.y, *b * a.z) * *w;
        z += a.cross(*b) * *w;
    }
    let (trace, s) = (m.x_axis.x + m.y_axis.y + m.z_axis.z, m + m.transpose());
    let mut k = DMat4::from_mat3(s - DMat3::from_diagonal(DVec3::splat(trace)));
    (k.w_axis, k.x_axis.w, k.y_axis.w, k.z_axis.w) = (z.extend(trace), z.x, z.y, z.z);
    // Repeated squaring of the shifted, positive matrix leaves its largest eigenvector.
    let size = |m: &DMat4| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    k += DMat4::IDENTITY * size(&k);
    for _ in 0..SQUARINGS {
        k = k * (1.0 / size(&k));
        k = k * k;
    }
    let columns = [k.x_axis, k.y_axis, k.z_axis, k.w_axis];
    let longest = columns.into_iter().max_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    DQuat::from_vec4(longest.unwrap_or_default().normalize_or(glam::DVec4::W))
}

/// Finds the direction with the smallest sum of angles to all `directions` (spherical median), by Weiszfeld's iteration.
pub(super) fn median_direction(directions: &[DVec3]) -> DVec3 {
    let mut middle = directions.iter().sum::<DVec3>().normalize_or(DVec3::Z);
    for _ in 0..ROUNDS {
        let pull: DVec3 = directions.iter().map(|d| *d / angle(*d, middle).max(LEAST)).sum();
        middle = pull.normalize_or(middle);
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;

    fn direction(random: &mut rng::Rng) -> DVec3 {
        DVec3::from_array([(); 3].map(|()| f64::from(rng::normal(random) as f32))).normalize()
    }

    #[test]
    fn finds_any_rotation_despite_outliers() {
        let mut random = rng::stream(1, "rotation", 0);
        for k in 0..20 {
            let truth = DQuat::from_axis_angle(direction(&mut random), 0.15 * f64::from(k));
            let pair = |i: usize, random: &mut rng::Rng| {
                let a = direction(random);
                // A third of the pairs are random.
                (a, if i.is_multiple_of(3) { direction(random) } else { truth * a })
            };
            let pairs: Vec<DirectionPair> = (0..300).map(|i| pair(i, &mut random)).collect();
            let rotation = best_rotation(&pairs);
            assert!(rotation.angle_between(truth).to_degrees() < 0.1, "{k}: {rotation} is not {truth}");
        }
    }

    #[test]
    fn least_squares_rotation_is_exact_without_outliers() {
        let truth = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.2, 2.5);
        let pairs: Vec<DirectionPair> = [DVec3::X, DVec3::Y].map(|a| (a, truth * a)).into();
        assert!(solve_wahba(&pairs, &[1.0, 1.0]).angle_between(truth) < 1e-7);
    }

    #[test]
    fn median_direction_ignores_outliers() {
        let mut directions = vec![DVec3::Z; 7];
        directions.extend([DVec3::X; 3]);
        assert!(angle(median_direction(&directions), DVec3::Z).to_degrees() < 0.5);
    }
}
