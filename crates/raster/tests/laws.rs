//! Symmetries of the image, and errors of the image plane near the zenith.

use crate::common::{POSE, primitives, relative, signals};
use pwrfgs_core::{Mat3, Pose, Primitives, Projector, Rasterizer, Real, Vec3, consts::DEG};
use pwrfgs_raster::{AlphaBlending, Mercator};

/// Draws `p` with `channels` signals on 360 × 90.
fn draw(p: &Primitives, pose: &Pose, signals: &[Real], channels: usize) -> Vec<Real> {
    let projector = Mercator::default();
    let plane = projector.plane(360, 90);
    AlphaBlending::default().forward(projector.project(p, pose, &plane).with_signals(signals, channels, &plane)).pixels
}

#[test]
fn rotated_scene_gives_rotated_image_across_seam() {
    let n = 40;
    let p = primitives(n, 11);
    let s = signals(n, 1, 11);
    let still = draw(&p, &POSE, &s, 1);
    for k in [1usize, 90, 173, 355] {
        // Rotates everything about the boresight by k degrees.
        let r = POSE.world_from_receiver();
        let about = r * Mat3::from_rotation_z(k as Real / DEG) * r.transpose();
        let mut turned = p.clone();
        let q = glam_quat(&about);
        for i in 0..n {
            let v = about * (Vec3::from_array(p.means[i]) - POSE.position_vec()) + POSE.position_vec();
            turned.means[i] = v.to_array();
            turned.quats[i] = multiply(q, p.quats[i]);
        }
        let moved = draw(&turned, &POSE, &s, 1);
        let shifted: Vec<Real> = (0..moved.len()).map(|at| moved[at / 360 * 360 + (at % 360 + k) % 360]).collect();
        // Rounding occasionally moves a pixel across 1/255: most pixels must agree closely, all roughly.
        let bound = if size_of::<Real>() == 8 { 1e-6 } else { 0.02 };
        assert!(relative(&still, &shifted) < bound, "turn by {k}: {}", relative(&still, &shifted));
        let far = still.iter().zip(&shifted).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
        assert!(far < 40, "turn by {k}: {far} pixels differ");
    }
}

/// Returns the quaternion w, x, y, z of a rotation about any axis by less than about 180°.
fn glam_quat(m: &Mat3) -> [Real; 4] {
    let c = m.to_cols_array().map(|v| v as f64);
    let (m00, m10, m20, m01, m11, m21, m02, m12, m22) = (c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]);
    let root = |x: f64| 0.5 * x.max(0.0).sqrt();
    let (w, x, y, z) = (
        root(1.0 + m00 + m11 + m22),
        root(1.0 + m00 - m11 - m22),
        root(1.0 - m00 + m11 - m22),
        root(1.0 - m00 - m11 + m22),
    );
    [w, x.copysign(m21 - m12), y.copysign(m02 - m20), z.copysign(m10 - m01)].map(|v| v as Real)
}

fn multiply(a: [Real; 4], b: [Real; 4]) -> [Real; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

#[test]
fn image_ignores_order_of_gaussians() {
    let n = 50;
    let p = primitives(n, 2);
    let s = signals(n, 2, 2);
    let rows: Vec<usize> = (0..n).map(|i| i * 17 % n).collect();
    let q = Primitives {
        means: rows.iter().map(|&i| p.means[i]).collect(),
        scales: rows.iter().map(|&i| p.scales[i]).collect(),
        quats: rows.iter().map(|&i| p.quats[i]).collect(),
        opacities: rows.iter().map(|&i| p.opacities[i]).collect(),
    };
    let t: Vec<Real> = rows.iter().flat_map(|&i| [s[2 * i], s[2 * i + 1]]).collect();
    assert_eq!(draw(&p, &POSE, &s, 2), draw(&q, &POSE, &t, 2));
}

#[test]
fn gaussian_without_opacity_equals_absent_gaussian() {
    let p = primitives(20, 4);
    let s = signals(20, 1, 4);
    let mut closed = p.clone();
    closed.opacities[7] = 0.0;
    closed.scales[7] = [0.0; 3];
    let keep: Vec<usize> = (0..20).filter(|&i| i != 7).collect();
    let without = Primitives {
        means: keep.iter().map(|&i| p.means[i]).collect(),
        scales: keep.iter().map(|&i| p.scales[i]).collect(),
        quats: keep.iter().map(|&i| p.quats[i]).collect(),
        opacities: keep.iter().map(|&i| p.opacities[i]).collect(),
    };
    let t: Vec<Real> = keep.iter().map(|&i| s[i]).collect();
    assert_eq!(draw(&closed, &POSE, &s, 1), draw(&without, &POSE, &t, 1));
}

#[test]
fn splat_wider_than_image_covers_every_column_once() {
    // A ball that fills a quarter of the view, 2° off the zenith.
    let p = Primitives {
        means: vec![[0.1, 0.0, 3.0]],
        scales: vec![[0.8; 3]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        opacities: vec![0.5],
    };
    let picture = draw(&p, &Pose::IDENTITY, &[1.0], 1);
    let row = &picture[88 * 360..89 * 360];
    assert!(row.iter().all(|v| (0.2..=0.5).contains(v)), "{row:?}");
}

#[test]
fn relative_error_near_zenith_matches_documented_table() {
    let sigma_deg: Real = 5.0;
    // Values of the table in the documentation of `Mercator`.
    for (elevation, relative_error, largest) in [(45.0, 0.041, 0.022), (75.0, 0.134, 0.090), (88.0, 0.292, 0.384)] {
        let plane = Mercator::default().plane(360, 90);
        let centre = Vec3::from_array(plane.direction(120.0, elevation).unwrap());
        let distance = 4.0;
        let p = Primitives {
            means: vec![(centre * distance).to_array()],
            scales: vec![[distance * (sigma_deg / DEG).tan(); 3]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            opacities: vec![0.99],
        };
        let picture = draw(&p, &Pose::IDENTITY, &[1.0], 1);
        let (mut error, mut total, mut worst) = (0.0, 0.0, 0.0 as Real);
        for at in 0..picture.len() {
            let (x, y) = ((at % 360) as Real, (at / 360) as Real);
            let u = Vec3::from_array(plane.direction(x, y).unwrap());
            let angle = u.dot(centre).clamp(-1.0, 1.0).acos() * DEG;
            let exact = 0.99 * (-0.5 * (angle / sigma_deg).powi(2)).exp();
            let weight = (y / DEG).cos();
            error += weight * (picture[at] - exact).abs();
            total += weight * exact;
            worst = worst.max((picture[at] - exact).abs());
        }
        println!("elevation {elevation}: relative error {:.3}, largest {worst:.3}", error / total);
        assert!((error / total - relative_error as Real).abs() < 0.003, "elevation {elevation}");
        assert!((worst - largest as Real).abs() < 0.003, "elevation {elevation}");
    }
}
