//! Central differences through projection and blending together, in double precision.

#![allow(clippy::unwrap_used)] // a scene that cannot be unpacked is a broken test

mod common;

use common::{POSE, primitives, signals};
use pwrfgs_core::testing::check_vjp;
use pwrfgs_core::{Primitives, Projector, Rasterizer, Real};
use pwrfgs_raster::{AlphaBlending, Mercator, Support, WrfgsCompat};

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

fn check(projector: &dyn Projector, raster: &AlphaBlending, seed: u64) {
    let plane = projector.plane(120, 40);
    let scene = primitives(N, seed, &plane);
    let x = pack(&scene, &signals(N, CHANNELS, seed));
    check_vjp(
        "render",
        &x,
        |x| {
            let (p, s) = unpack(x);
            raster.forward(&projector.project(&p, &POSE, &plane), &s, CHANNELS, &plane).pixels
        },
        |x, d| {
            let (p, s) = unpack(x);
            let splats = projector.project(&p, &POSE, &plane);
            let render = raster.forward(&splats, &s, CHANNELS, &plane);
            let g = raster.backward(&splats, &s, CHANNELS, &plane, &render, d);
            pack(&projector.project_vjp(&p, &POSE, &plane, &splats, &g.splats), &g.signals)
        },
        1e-7,
        2e-4,
    );
}

#[test]
fn mercator_and_blending_differentiate() {
    if size_of::<Real>() == 8 {
        for seed in 0..4 {
            check(&Mercator::default(), &AlphaBlending::default(), seed);
        }
    }
}

#[test]
fn compat_projection_and_blending_differentiate() {
    if size_of::<Real>() == 8 {
        for seed in 0..4 {
            check(&WrfgsCompat::default(), &AlphaBlending { support: Support::TileSquares }, seed);
        }
    }
}
