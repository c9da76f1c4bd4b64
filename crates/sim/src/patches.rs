//! Patches of rough faces, each of which scatters as one.

use crate::world::{Triangle, World};
use glam::DVec3;
use pwrfgs_core::rng;
use std::f64::consts::TAU;

/// A piece of a rough face.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Patch {
    /// Index of the face.
    pub(crate) face: u32,
    /// Its middle, metres.
    pub(crate) point: DVec3,
    /// m².
    pub(crate) area: f64,
    /// Phase that its unevenness adds, radians: fixed, so that the field stays a smooth function of the transmitter.
    pub(crate) phase: f64,
}

/// All patches of all rough faces: squares of about `side` metres. Phases are drawn for each patch of each face, so that
/// a face more or less changes no other.
pub(crate) fn patches(world: &World, side: f64, seed: u64) -> Vec<Patch> {
    let mut all = Vec::new();
    for (index, face) in world.faces.iter().enumerate() {
        if world.surface_of(index as u32).roughness == 0.0 {
            continue;
        }
        let mut random = rng::stream(seed, "scattering", index as u64);
        let start = all.len();
        for point in lattice(&face.hull, face.normal, side) {
            let phase = rng::uniform(&mut random) as f64 * TAU;
            if world.is_on(index as u32, point) && !world.is_covered(index as u32, point) {
                all.push(Patch { face: index as u32, point, area: 0.0, phase });
            }
        }
        // Whatever the lattice makes of a slanted border, the patches have the area of the face together.
        let area: f64 = world.triangles[face.triangles.clone()].iter().map(Triangle::area).sum();
        let share = area / (all.len() - start).max(1) as f64;
        all[start..].iter_mut().for_each(|patch| patch.area = share);
    }
    all
}

/// Middles of cells of about `side` metres that fill the rectangle about a convex polygon along its longest side.
fn lattice(hull: &[DVec3], normal: DVec3, side: f64) -> Vec<DVec3> {
    let longest = (0..hull.len()).map(|i| hull[(i + 1) % hull.len()] - hull[i]);
    let Some(u) = longest.max_by(|a, b| a.length().total_cmp(&b.length())).and_then(DVec3::try_normalize) else {
        return Vec::new();
    };
    let v = normal.cross(u);
    let extent = |axis: DVec3| {
        let along = || hull.iter().map(|p| p.dot(axis));
        (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max))
    };
    let ((u0, u1), (v0, v1)) = (extent(u), extent(v));
    let cells = |low: f64, high: f64| (((high - low) / side).round() as usize).max(1);
    let (columns, rows) = (cells(u0, u1), cells(v0, v1));
    let level = normal * normal.dot(hull[0]);
    let middle = |low: f64, high: f64, i: usize, n: usize| low + (high - low) * (i as f64 + 0.5) / n as f64;
    let cell = |i: usize| level + u * middle(u0, u1, i % columns, columns) + v * middle(v0, v1, i / columns, rows);
    (0..rows * columns).map(cell).collect()
}
