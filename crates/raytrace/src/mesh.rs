//! Triangle meshes: reading from OBJ or PLY, validation and placement.

#[cfg(test)]
mod tests;

use crate::hierarchy::{Hierarchy, Triangle};
use crate::polygon::{side_planes, triangles_outside};
use glam::{DMat3, DMat4, DVec3};
use pwrfgs_core::{Error, Result};
pub(crate) use pwrfgs_data::MOST_TRIANGLES;
use pwrfgs_data::warn_once;
use std::{cell::Cell, collections::HashMap, path::Path};

/// Ratio of height to longest side below which a triangle is degenerate.
const FLAT: f64 = 1e-9;

/// Largest number of triangles that share an edge.
const MOST_SHARED: usize = 64;
/// Ratio of distance to size below which triangles coincide, and of areas below which nothing remains.
const EQUAL: f64 = 1e-6;
/// Largest number of pieces of a triangle between others, to limit time.
const MOST_PIECES: usize = 1_000;
/// Largest number of tested boxes of a mesh, to limit time.
const MOST_TRIALS: usize = 200_000_000;

/// Triangle mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, metres.
    pub vertices: Vec<DVec3>,
    /// Three vertex indices per triangle, from 0, counterclockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Returns the mesh called `cube`, from -1 to 1 on each axis, or `rectangle`, from -1 to 1 in x and y, as in Mitsuba; `None`
/// for other names.
pub(crate) fn named_mesh(name: &Path) -> Option<Mesh> {
    // Bit k of the index of a corner is its side on axis k.
    const SIDES: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let (corners, sides, z) = match name.to_str()? {
        "cube" => (8, &SIDES[..], 1.0),
        "rectangle" => (4, &[[0, 1, 3, 2]][..], 0.0),
        _ => return None,
    };
    let corner =
        |i: u32| DVec3::from([0, 1, 2].map(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 })) * DVec3::new(1.0, 1.0, z);
    let triangles = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    Some(Mesh { vertices: (0..corners).map(corner).collect(), triangles })
}

/// Reads a mesh with extension `.obj` or `.ply`, or one called `cube` or `rectangle`; vertices are welded and the mesh is
/// validated.
///
/// # Errors
/// Errors of [`pwrfgs_data::read_mesh`] and of [`Mesh::check`].
pub fn read_mesh(path: &Path) -> Result<Mesh> {
    if let Some(mesh) = named_mesh(path) {
        return Ok(mesh);
    }
    let (vertices, triangles) = pwrfgs_data::read_mesh(path)?;
    let mesh = Mesh { vertices: vertices.into_iter().map(DVec3::from_array).collect(), triangles }.welded();
    mesh.check(path)?;
    Ok(mesh)
}

/// Reads the mesh of the object `name`, maps its vertices by `matrix` and leaves out second sides of sheets; normals of a
/// closed surface then point outwards. `solid`: the surface must be closed. Warns if y seems to point up.
///
/// # Errors
/// Errors of [`read_mesh`]; too many overlapping triangles; a solid that is not closed, or whose triangles run in different
/// directions.
pub(crate) fn read_object_mesh(file: &Path, matrix: DMat4, solid: bool, name: &str) -> Result<Mesh> {
    let mut mesh = read_mesh(file)?;
    mesh.vertices.iter_mut().for_each(|vertex| *vertex = matrix.transform_point3(*vertex));
    mesh.warn_of_y_up(file);
    let Some(mut mesh) = mesh.one_sided() else {
        return Err(Error::input(file, "its triangles overlap in too many places; simplify the mesh"));
    };
    if solid && mesh.is_closed() && !is_consistently_oriented(&mesh) {
        return Err(Error::input(
            file,
            format!(
                "the triangles of `{name}` run in different directions, so that inside and outside are unclear; let the \
                 modelling program recalculate its normals"
            ),
        ));
    }
    if mesh.is_closed() && signed_volume(&mesh) < 0.0 {
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2)); // normals must point outwards
    }
    if solid && !mesh.is_closed() {
        let edges = mesh.boundary_edge_count();
        return Err(Error::input(
            file,
            format!(
                "the surface of `{name}` is open ({edges} sides of triangles have no neighbour), and a solid needs a closed \
                 one; close it, or give its finish a `thickness_m` to make it a thin sheet"
            ),
        ));
    }
    Ok(mesh)
}

/// Returns whether neighbouring triangles traverse their common edge in opposite directions; `false` for open meshes.
fn is_consistently_oriented(mesh: &Mesh) -> bool {
    let mut edges: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]).collect();
    edges.sort_unstable();
    let mut reversed: Vec<[u32; 2]> = edges.iter().map(|[a, b]| [*b, *a]).collect();
    reversed.sort_unstable();
    edges == reversed
}

/// Returns whether a part of a triangle remains outside the triangles that hide it. `hiding` returns a triangle that
/// covers the centre of a piece. Also returns `true` if the parts become too many.
fn has_visible_part(triangle: &Triangle, hiding: impl Fn(&Triangle) -> Option<Triangle>) -> bool {
    let mut remaining = vec![*triangle];
    for _ in 0..MOST_PIECES {
        let Some(piece) = remaining.pop() else { return false };
        let Some(other) = hiding(&piece) else { return true };
        let pieces = triangles_outside(&piece, &side_planes(&other.corners(), other.normal()));
        remaining.extend(pieces.into_iter().filter(|piece| piece.area() > EQUAL * triangle.area()));
    }
    true
}

/// Returns whether `other` lies in the plane of `triangle` and covers `point` of it, up to rounding.
fn is_hidden_at(triangle: &Triangle, point: DVec3, other: &Triangle) -> bool {
    let normal = other.normal();
    let height = |p: DVec3| normal.dot(p - other.corner);
    let flat = EQUAL * (other.sides[0].length() + other.sides[1].length());
    triangle.corners().iter().all(|p| height(*p).abs() <= flat) && other.contains(point - height(point) * normal)
}

/// Returns the volume of a closed surface, m³; negative if the normals point inwards.
fn signed_volume(mesh: &Mesh) -> f64 {
    let origin = mesh.vertices.first().copied().unwrap_or_default();
    let corner = |i: u32| mesh.vertices[i as usize] - origin;
    mesh.triangles.iter().map(|&[a, b, c]| corner(a).dot(corner(b).cross(corner(c))) / 6.0).sum()
}

impl Mesh {
    /// Returns the mesh without triangles that earlier ones in their plane cover, in either corner order: the second side
    /// of a sheet. Bodies that touch keep their common sides, without which they would be open. `None` if that takes too
    /// long.
    fn one_sided(self) -> Option<Self> {
        let triangles: Vec<Triangle> = self.triangles.iter().map(|t| Triangle::new(self.corners(*t))).collect();
        let (hierarchy, trials) = (Hierarchy::new(&triangles), Cell::new(0));
        let mut is_kept = vec![true; triangles.len()];
        for i in 0..triangles.len() {
            // Counts each tested box, and ends the search at the limit.
            let count_trial = |_| trials.replace(trials.get() + 1) < MOST_TRIALS;
            let hiding = |piece: &Triangle| {
                let middle = piece.corners().iter().sum::<DVec3>() / 3.0;
                let reach = EQUAL * (piece.sides[0].length() + piece.sides[1].length());
                let hides = |k: &usize| *k < i && is_kept[*k] && is_hidden_at(&triangles[i], middle, &triangles[*k]);
                hierarchy.near_point(middle, reach, count_trial).find(hides).map(|k| triangles[k])
            };
            is_kept[i] = has_visible_part(&triangles[i], hiding);
        }
        if trials.get() >= MOST_TRIALS {
            return None;
        }
        if is_kept.iter().all(|kept| *kept) {
            return Some(self);
        }
        let mut flags = is_kept.iter();
        let mut single = self.clone();
        single.triangles.retain(|_| flags.next() == Some(&true));
        let (low, high) = self.bounds();
        let is_body = self.is_closed() && signed_volume(&self).abs() > FLAT * (high - low).length().powi(3);
        Some(if is_body && !single.is_closed() { self } else { single.welded() })
    }

    /// Validates all triangles; `path` is named in errors.
    ///
    /// # Errors
    /// No triangle, a vertex that is not finite, an index out of range, a triangle without area, or an edge of too many
    /// triangles. Triangles are counted from 1, in file order.
    pub fn check(&self, path: &Path) -> Result<()> {
        if self.triangles.is_empty() {
            return Err(Error::input(path, "holds no triangle with an area; export a surface with faces"));
        }
        for (number, triangle) in (1..).zip(&self.triangles) {
            let fault = |problem: String| Err(Error::input(path, format!("triangle {number} {problem}")));
            if let Some(vertex) = triangle.iter().find(|&&v| v as usize >= self.vertices.len()) {
                let advice = "counted from 0; correct the index";
                return fault(format!("names vertex {vertex} of {}, {advice}", self.vertices.len()));
            }
            let [a, b, c] = self.corners(*triangle);
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                return fault("has a vertex that is not finite; give every vertex a finite x, y and z".into());
            }
            let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
            // Twice the area over the squared longest side is the height relative to that side.
            if (b - a).cross(c - a).length() <= FLAT * longest {
                let advice = "remove degenerate faces in the modelling program";
                return fault(format!("at ({}, {}, {}) has no area; {advice}", a.x, a.y, a.z));
            }
        }
        match self.triangles_per_edge().max() {
            Some(shared) if shared > MOST_SHARED => {
                let problem = format!("has an edge that {shared} triangles share; remove double faces");
                Err(Error::input(path, problem))
            }
            _ => Ok(()),
        }
    }

    /// Returns the mesh with equal vertices merged and unused ones dropped: many programs write one vertex per triangle
    /// corner. Vertices keep the order of their first use; indices out of range are kept.
    pub fn welded(self) -> Self {
        let mut merged = HashMap::new();
        let mut vertices = Vec::new();
        let mut index = |old: u32| {
            let Some(vertex) = self.vertices.get(old as usize) else { return old };
            // Zero has two signs.
            *merged.entry(vertex.to_array().map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                vertices.push(*vertex);
                vertices.len() as u32 - 1
            })
        };
        let triangles = self.triangles.iter().map(|triangle| triangle.map(&mut index)).collect();
        Self { vertices, triangles }
    }

    /// Returns the number of edges of only one triangle: the rim of an open surface. Weld the mesh first.
    pub fn boundary_edge_count(&self) -> usize {
        self.triangles_per_edge().filter(|triangles| *triangles == 1).count()
    }

    /// Returns whether the surface is closed: every edge belongs to an even number of triangles. Weld the mesh first.
    pub fn is_closed(&self) -> bool {
        !self.triangles.is_empty() && self.triangles_per_edge().all(|triangles| triangles % 2 == 0)
    }

    /// Returns the mesh scaled, then rotated about +z by `yaw_deg` degrees counterclockwise, then shifted by metres.
    /// Quarter turns are exact. A negative scale mirrors; the corner order is then reversed so that the outside stays
    /// outside.
    pub fn transformed(mut self, scale: f64, yaw_deg: f64, shift: DVec3) -> Self {
        let turn = yaw_rotation(yaw_deg);
        self.vertices.iter_mut().for_each(|vertex| *vertex = turn * (*vertex * scale) + shift);
        if scale < 0.0 {
            self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        }
        self
    }

    /// Returns the corners of a triangle, metres.
    pub(crate) fn corners(&self, triangle: [u32; 3]) -> [DVec3; 3] {
        triangle.map(|v| self.vertices[v as usize])
    }

    /// Returns the smallest and largest coordinates, metres; `(∞, −∞)` without vertices.
    fn bounds(&self) -> (DVec3, DVec3) {
        let ends = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        self.vertices.iter().fold(ends, |(low, high), vertex| (low.min(*vertex), high.max(*vertex)))
    }

    /// Warns if y seems to point up, as in files of many modelling programs: the mesh is smaller along y than along x and z but
    /// no sheet, stands on y = 0 up to 2 % of its height, goes below z = 0 by a quarter of its depth, and more of its area faces
    /// y than z.
    fn warn_of_y_up(&self, file: &Path) {
        let (low, high) = self.bounds();
        let size = high - low;
        let is_low = size.y > 0.02 * size.max_element() && size.y < size.x.min(size.z);
        if !is_low || low.y.abs() > 0.02 * size.y || low.z > -0.25 * size.z {
            return;
        }
        let areas = self.triangles.iter().map(|t| self.corners(*t)).map(|[a, b, c]| (b - a).cross(c - a).abs());
        let area = areas.sum::<DVec3>();
        if area.y > area.z {
            let extent = format!("y from {:.2} to {:.2}, z from {:.2} to {:.2}", low.y, high.y, low.z, high.z);
            let advice = "export the mesh with z up, or turn it: `matrix: ((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0))`, in XML \
                          <rotate x=\"1\" angle=\"90\"/>";
            warn_once(file, format_args!("y seems to point up ({extent}), and z points up in scenes; {advice}"));
        }
    }

    /// Returns the number of triangles at each edge, in no particular order.
    fn triangles_per_edge(&self) -> impl Iterator<Item = usize> {
        let ends = |[a, b, c]: &[u32; 3]| [[*a, *b], [*b, *c], [*c, *a]].map(|[u, v]| (u.min(v), u.max(v)));
        let mut edges: Vec<(u32, u32)> = self.triangles.iter().flat_map(ends).collect();
        edges.sort_unstable();
        let counts: Vec<usize> = edges.chunk_by(|a, b| a == b).map(<[_]>::len).collect();
        counts.into_iter()
    }
}

/// Returns the rotation about +z by `degrees` counterclockwise, exact for quarter turns.
fn yaw_rotation(degrees: f64) -> DMat3 {
    let (quarters, remainder) = ((degrees / 90.0).round(), degrees - 90.0 * (degrees / 90.0).round());
    let (sin, cos) = remainder.to_radians().sin_cos();
    let (sin, cos) = match quarters.rem_euclid(4.0) as u8 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    };
    DMat3::from_cols(DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0), DVec3::Z)
}
