//! Random scenes shared by the tests of this crate.

pub(crate) mod reference;

use pwrfgs_core::{ImagePlane, Pose, Primitives, Projector, Real, Splats, Vec3, rng};
use pwrfgs_raster::Mercator;

/// Pose of a tilted receiver away from the origin.
pub(crate) const POSE: Pose =
    Pose { position: [1.0, -2.0, 0.5], orientation: [0.1, -0.2, 0.3, 0.927_361_849_549_570_4] };

/// Creates `n` Gaussians in front of [`POSE`], of all shapes, some across the seam, some near the zenith.
pub(crate) fn primitives(n: usize, seed: u64) -> Primitives {
    let mut random = rng::stream(seed, "scene", n as u64);
    let r = POSE.world_from_receiver();
    let mut p = Primitives::zeros(n);
    for i in 0..n {
        let az = 360.0 * rng::uniform(&mut random);
        let el = 2.0 + 86.5 * rng::uniform(&mut random);
        let d = Mercator::default().plane(360, 90).direction(az, el).unwrap();
        let distance = 1.5 + 4.0 * rng::uniform(&mut random);
        p.means[i] = (r * (Vec3::from_array(d) * distance) + POSE.position_vec()).to_array();
        p.scales[i] = std::array::from_fn(|_| 0.02 + 0.35 * rng::uniform(&mut random).powi(2));
        let q: [Real; 4] = std::array::from_fn(|_| rng::normal(&mut random));
        let norm = q.iter().map(|v| v * v).sum::<Real>().sqrt();
        p.quats[i] = q.map(|v| v / norm);
        p.opacities[i] = 0.05 + 0.9 * rng::uniform(&mut random);
    }
    p
}

/// Creates signals `[n, channels]`.
pub(crate) fn signals(n: usize, channels: usize, seed: u64) -> Vec<Real> {
    let mut random = rng::stream(seed, "signals", n as u64);
    (0..n * channels).map(|_| rng::normal(&mut random)).collect()
}

/// Creates the splats of such a scene on a full image.
pub(crate) fn splats(n: usize, seed: u64, width: usize, height: usize) -> (Splats, ImagePlane) {
    let projector = Mercator::default();
    let plane = projector.plane(width, height);
    (projector.project(&primitives(n, seed), &POSE, &plane), plane)
}

/// Returns the largest difference, relative to the largest value of `a`.
pub(crate) fn relative(a: &[Real], b: &[Real]) -> Real {
    assert_eq!(a.len(), b.len());
    let largest = a.iter().fold(1e-12, |m: Real, x| m.max(x.abs()));
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, Real::max) / largest
}
