//! Patches of rough faces; each patch scatters as a unit.

use crate::world::{Face, Triangle, World};
use glam::DVec3;
use pwrfgs_core::rng;
use pwrfgs_core::statistics::bounds;
use std::f64::consts::TAU;

/// Patch of a rough face.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Patch {
    /// Index of the face.
    pub(crate) face: u32,
    /// Centre, metres.
    pub(crate) point: DVec3,
    /// Area, m².
    pub(crate) area: f64,
    /// Random phase of the rough surface, radians: fixed, so that the field is a smooth function of the transmitter.
    pub(crate) phase: f64,
}

/// Returns the scattering patches of all rough faces: rectangles with sides of about `side` metres. Phases are drawn per
/// index of a face, so that faces added at the end change no others.
pub(crate) fn scattering_patches(world: &World, side: f64, seed: u64) -> Vec<Patch> {
    let mut patches = Vec::new();
    for (index, face) in world.faces.iter().enumerate() {
        if world.surface_of(index as u32).roughness == 0.0 {
            continue;
        }
        let mut random = rng::stream(seed, "scattering", index as u64);
        let start = patches.len();
        let lattice = Lattice::new(&face.hull, face.normal, side);
        for point in lattice.iter().flat_map(Lattice::cell_centres) {
            let phase = rng::uniform(&mut random) as f64 * TAU;
            if world.is_on_face(index as u32, point) {
                patches.push(Patch { face: index as u32, point, area: 0.0, phase });
            }
        }
        // On slanted borders patch areas are rescaled to sum to the area of the face. If another face covers this one
        // from both sides, only that one scatters.
        let area: f64 = world.triangles[face.triangles.clone()].iter().map(Triangle::area).sum();
        let share = area / (patches.len() - start).max(1) as f64;
        let mut fresh = patches.split_off(start);
        fresh.retain(|patch| {
            [1.0, -1.0]
                .into_iter()
                .any(|sign| world.front_face(patch.face, patch.point, patch.point + sign * face.normal) == patch.face)
        });
        fresh.iter_mut().for_each(|patch| patch.area = share);
        patches.append(&mut fresh);
    }
    patches
}

/// Returns the number of cells of about `side` metres in the bounding rectangle of a face, which [`scattering_patches`]
/// tests: a whole number, 0 without extent.
pub(crate) fn cell_count(face: &Face, side: f64) -> f64 {
    Lattice::new(&face.hull, face.normal, side).map_or(0.0, |l| l.columns * l.rows)
}

/// Grid of cells in the bounding rectangle of a convex polygon, along its longest side.
struct Lattice {
    /// Axes in the plane, unit vectors.
    u: DVec3,
    v: DVec3,
    /// Point of the plane nearest to the origin, metres.
    level: DVec3,
    /// Range along each axis, metres.
    extent: [(f64, f64); 2],
    /// Number of cells along each axis, whole numbers.
    columns: f64,
    rows: f64,
}

impl Lattice {
    /// Creates the grid of cells of about `side` metres over a polygon; `None` if all its corners coincide.
    fn new(hull: &[DVec3], normal: DVec3, side: f64) -> Option<Self> {
        let sides = (0..hull.len()).map(|i| hull[(i + 1) % hull.len()] - hull[i]);
        let u = sides.max_by(|a, b| a.length().total_cmp(&b.length())).and_then(DVec3::try_normalize)?;
        let v = normal.cross(u);
        let extent = [u, v].map(|axis| bounds(hull.iter().map(|p| p.dot(axis))));
        let [columns, rows] = extent.map(|(low, high)| ((high - low) / side).round().max(1.0));
        Some(Self { u, v, level: normal * normal.dot(hull[0]), extent, columns, rows })
    }

    /// Returns the centres of the cells, metres, row by row.
    fn cell_centres(&self) -> impl Iterator<Item = DVec3> {
        let (columns, rows) = (self.columns as usize, self.rows as usize);
        let middle = |(low, high): (f64, f64), i: usize, n: usize| low + (high - low) * (i as f64 + 0.5) / n as f64;
        let [across, up] = self.extent;
        (0..rows * columns).map(move |i| {
            self.level + self.u * middle(across, i % columns, columns) + self.v * middle(up, i / columns, rows)
        })
    }
}
