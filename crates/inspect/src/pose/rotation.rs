//! The rotation that fits pairs of directions best, not misled by some that are wrong.
//!
//! Wahba's problem, max over R of Σ w bᵀRa, is the largest eigenvector of a symmetric 4 x 4 matrix (Davenport's
//! q-method). Weights 1/angle, found anew in turn, make it the least sum of angles: reflections that are stronger than
//! the direct path then count little.

use crate::eigen::symmetric;
use glam::{DMat3, DQuat, DVec3};

/// Angles below this count alike, radians: about a pixel.
const LEAST: f64 = 0.01;
/// Rounds of reweighting.
const ROUNDS: usize = 40;

/// Two directions that should be one.
pub(crate) type Pair = (DVec3, DVec3);

/// Angle between two unit vectors, radians; exact for small ones, as the arc cosine is not.
pub(crate) fn angle(a: DVec3, b: DVec3) -> f64 {
    a.cross(b).length().atan2(a.dot(b))
}

/// The rotation R with the least Σ w·angle(R a, b).
pub(crate) fn best(pairs: &[Pair], weights: &[f64]) -> DQuat {
    let cost = |r: &DQuat| pairs.iter().zip(weights).map(|((a, b), w)| w * angle(*r * *a, *b)).sum::<f64>();
    // Two starts: no rotation, and the one with the least squares.
    let starts = [DQuat::IDENTITY, wahba(pairs, weights)].map(|start| refined(start, pairs, weights));
    let [a, b] = starts;
    if cost(&b) < cost(&a) { b } else { a }
}

fn refined(start: DQuat, pairs: &[Pair], weights: &[f64]) -> DQuat {
    let mut rotation = start;
    let mut own = vec![0.0; pairs.len()];
    for _ in 0..ROUNDS {
        for (own, ((a, b), w)) in own.iter_mut().zip(pairs.iter().zip(weights)) {
            *own = w / angle(rotation * *a, *b).max(LEAST);
        }
        let next = wahba(pairs, &own);
        let change = next.angle_between(rotation);
        rotation = next;
        if change < 1e-6 {
            break;
        }
    }
    rotation
}

/// The rotation with the largest Σ w bᵀRa.
fn wahba(pairs: &[Pair], weights: &[f64]) -> DQuat {
    let (mut m, mut z) = (DMat3::ZERO, DVec3::ZERO);
    for ((a, b), w) in pairs.iter().zip(weights) {
        m += DMat3::from_cols(*b * a.x, *b * a.y, *b * a.z) * *w;
        z += a.cross(*b) * *w;
    }
    let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
    let s = m + m.transpose();
    let mut k = vec![0.0; 16];
    for i in 0..3 {
        for j in 0..3 {
            k[4 * i + j] = s.col(j)[i] - if i == j { trace } else { 0.0 };
        }
        (k[4 * i + 3], k[12 + i]) = (z[i], z[i]);
    }
    k[15] = trace;
    let (_, vectors) = symmetric(k, 4);
    let [x, y, z, w] = [0, 1, 2, 3].map(|i| vectors[0][i]);
    DQuat::from_xyzw(x, y, z, w).normalize()
}

/// The direction with the least sum of angles to all (the spherical median).
pub(crate) fn middle(directions: &[DVec3]) -> DVec3 {
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
    fn any_rotation_is_found_in_spite_of_wrong_pairs() {
        let mut random = rng::stream(1, "rotation", 0);
        for k in 0..20 {
            let truth = DQuat::from_axis_angle(direction(&mut random), 0.15 * f64::from(k));
            let pair = |i: usize, random: &mut rng::Rng| {
                let a = direction(random);
                // A third of the pairs are anything.
                (a, if i.is_multiple_of(3) { direction(random) } else { truth * a })
            };
            let pairs: Vec<Pair> = (0..300).map(|i| pair(i, &mut random)).collect();
            let found = best(&pairs, &vec![1.0; pairs.len()]);
            assert!(found.angle_between(truth).to_degrees() < 0.1, "{k}: {found} is not {truth}");
        }
    }

    #[test]
    fn without_wrong_pairs_the_least_squares_are_exact() {
        let truth = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.2, 2.5);
        let pairs: Vec<Pair> = [DVec3::X, DVec3::Y].map(|a| (a, truth * a)).into();
        assert!(wahba(&pairs, &[1.0, 1.0]).angle_between(truth) < 1e-9);
    }

    #[test]
    fn the_middle_of_directions_ignores_a_few_far_off() {
        let mut directions = vec![DVec3::Z; 7];
        directions.extend([DVec3::X; 3]);
        assert!(angle(middle(&directions), DVec3::Z).to_degrees() < 0.5);
    }
}
