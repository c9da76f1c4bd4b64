//! Central differences through projection and blending together, in double precision.

use crate::common::{POSE, primitives, signals};
use pwrfgs_core::testing::check_vjp;
use pwrfgs_core::{ImagePlane, Primitives, Projector, Rasterizer, Real, Splats, Vec3};
use pwrfgs_raster::{
    AlphaBlending, CameraModel, Mercator, Pinhole, Support, WrfgsCompat, project, project_vjp, visible_centres,
};

const N: usize = 12;
const CHANNELS: usize = 2;

fn pack(p: &Primitives, signals: &[Real]) -> Vec<Real> {
    [p.means.as_flattened(), p.scales.as_flattened(), p.quats.as_flattened(), &p.opacities, signals].concat()
}

fn unpack(x: &[Real]) -> (Primitives, Vec<Real>) {
    let mut x = x.iter().copied();
    let mut p = Primitives::zeros(N);
    let mut fill = |v: &mut [Real]| v.iter_mut().for_each(|v| *v = x.next().unwrap());
    fill(p.means.as_flattened_mut());
    fill(p.scales.as_flattened_mut());
    fill(p.quats.as_flattened_mut());
    fill(&mut p.opacities);
    (p, x.collect())
}

/// Compares the derivative of projection and blending with central differences.
fn check(
    plane: &ImagePlane,
    project: impl Fn(&Primitives) -> Splats,
    project_vjp: impl Fn(&Primitives, &Splats, &Splats) -> Primitives,
    raster: &AlphaBlending,
    seed: u64,
) {
    let x = pack(&primitives(N, seed), &signals(N, CHANNELS, seed));
    check_vjp(
        "render",
        &x,
        |x| {
            let (p, s) = unpack(x);
            raster.forward(project(&p).with_signals(&s, CHANNELS, plane)).pixels
        },
        |x, d| {
            let (p, s) = unpack(x);
            let splats = project(&p);
            let render = raster.forward(splats.with_signals(&s, CHANNELS, plane));
            let g = raster.backward(splats.with_signals(&s, CHANNELS, plane), &render, d);
            pack(&project_vjp(&p, &splats, &g.splats), &g.signals)
        },
        1e-7,
        2e-4,
    );
}

fn check_plugin(projector: &dyn Projector, raster: &AlphaBlending) {
    let plane = &projector.plane(120, 40);
    for seed in 0..4 {
        let project = |p: &Primitives| projector.project(p, &POSE, plane);
        check(plane, project, |p, splats, d| projector.project_vjp(p, &POSE, plane, splats, d), raster, seed);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn mercator_and_blending_differentiate() {
    check_plugin(&Mercator::default(), &AlphaBlending::default());
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn pinhole_and_blending_differentiate() {
    check_plugin(&Pinhole::default(), &AlphaBlending::default());
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn compat_projection_and_blending_differentiate() {
    check_plugin(&WrfgsCompat::default(), &AlphaBlending { support: Support::TileSquares });
}

/// Minimal projection with three functions: a pixel is linear in the direction cosines x/r and y/r.
struct Disc {
    half: [Real; 2],
}

const DISC: Disc = Disc { half: [30.0, 20.0] };
const PLANE: ImagePlane = ImagePlane::plain(60, 40);

impl CameraModel for Disc {
    fn pixel(&self, v: Vec3) -> [Real; 2] {
        let r = v.length();
        [self.half[0] * (1.0 + v.x / r), self.half[1] * (1.0 + v.y / r)]
    }

    fn jacobian(&self, v: Vec3) -> [Vec3; 2] {
        let r = v.length();
        let row = |axis: Vec3| axis / r - v * (axis.dot(v) / (r * r * r));
        [row(Vec3::X) * self.half[0], row(Vec3::Y) * self.half[1]]
    }

    fn jacobian_vjp(&self, v: Vec3, d: [Vec3; 2]) -> Vec3 {
        let (r2, r3) = (v.length_squared(), v.length().powi(3));
        let row = |axis: Vec3, d: Vec3| {
            let (a, along) = (axis.dot(v), d.dot(v));
            v * (3.0 * a * along / (r2 * r3)) - (v * axis.dot(d) + axis * along + d * a) / r3
        };
        row(Vec3::X, d[0]) * self.half[0] + row(Vec3::Y, d[1]) * self.half[1]
    }
}

#[test]
fn custom_camera_model_projects() {
    let (disc, plane) = (&DISC, &PLANE);
    let mut scene = primitives(N, 0);
    let shown = project(disc, &scene, &POSE, plane);
    assert!(shown.radii.iter().all(|r| *r > 0.0), "all are in front of the receiver");
    assert!(shown.depths.iter().all(|d| (1.5..5.6).contains(d)), "distances from the receiver, by its pose");
    scene.means[3] = POSE.position_vec().to_array();
    let without = project(disc, &scene, &POSE, plane);
    assert_eq!(visible_centres(disc, &scene.means, &POSE).iter().filter(|s| **s).count(), N - 1, "no pixel, not seen");
    assert_eq!((without.radii[3], without.means2d[4]), (0.0, shown.means2d[4]));
    // Gaussians centred outside the image are drawn if they are wide enough to reach it.
    let tall = project(&Disc { half: [30.0, 200.0] }, &primitives(N, 0), &POSE, plane);
    for i in 0..N {
        let first = tall.means2d[i][1] - 3.329_042_1 * tall.sigmas2d[i][1];
        assert_eq!(tall.radii[i] > 0.0, first <= 39.0, "{i}");
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn custom_camera_model_differentiates() {
    for seed in 0..4 {
        let vjp = |p: &Primitives, splats: &Splats, d: &Splats| project_vjp(&DISC, p, &POSE, splats, d);
        check(&PLANE, |p| project(&DISC, p, &POSE, &PLANE), vjp, &AlphaBlending::default(), seed);
    }
}
