//! Room geometry: faces, edges, and intersection tests of straight segments.

mod build;
mod contact;
mod from_scene;
mod opening;
mod sheets;

use crate::hierarchy::Hierarchy;
pub use crate::hierarchy::Triangle;
use crate::waves::Surface;
pub use build::{WorldBuilder, WorldPart};
pub(crate) use contact::TOUCHING;
use glam::DVec3;
use std::cmp::Ordering;
use std::f64::consts::PI;
use std::ops::Range;

/// Margin at the ends of a segment without intersections, metres: reflection points lie on faces.
pub(crate) const MARGIN: f64 = 1e-6;

/// Planar piece of surface: connected triangles in one plane.
#[derive(Clone, Debug)]
pub struct Face {
    /// Name, such as `floor` or `desk 2/top`.
    pub name: String,
    /// Unit normal n; inwards for the room, outwards for objects.
    pub normal: DVec3,
    /// Offset n·x of its points, metres.
    pub offset: f64,
    /// Index into [`World::surfaces`].
    pub surface: u32,
    /// Range of its triangles in [`World::triangles`].
    pub triangles: Range<usize>,
    /// Faces in the same plane that may overlap with it, in order.
    pub twins: Vec<u32>,
    /// Convex hull, corners in order.
    pub hull: Vec<DVec3>,
    /// Type of the part it belongs to.
    pub layer: SurfaceLayer,
}

/// Order of overlapping faces in one plane: a later layer lies in front of an earlier one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SurfaceLayer {
    /// Walls, floor and ceiling.
    Room,
    /// Boxes and closed meshes.
    SolidBody,
    /// Panels and open meshes.
    Sheet,
}

impl Face {
    /// Returns whether it belongs to the room rather than to an object.
    pub fn is_room(&self) -> bool {
        self.layer == SurfaceLayer::Room
    }

    /// Returns the signed distance of a point from the plane, metres, positive on the side of the normal.
    pub fn height(&self, point: DVec3) -> f64 {
        self.normal.dot(point) - self.offset
    }

    /// Returns the mirror image of a point at the plane.
    pub fn mirror(&self, point: DVec3) -> DVec3 {
        point - 2.0 * self.height(point) * self.normal
    }
}

/// Straight edge that diffracts waves.
#[derive(Clone, Debug, PartialEq)]
pub struct Edge {
    /// End points, metres.
    pub ends: [DVec3; 2],
    /// Indices of the two faces; equal for the rim of a sheet.
    pub faces: [u32; 2],
    /// Unit vector in face 0, perpendicular to the edge and away from it: angles start here.
    pub along: DVec3,
    /// Unit normal of face 0 on the outer side.
    pub normal: DVec3,
    /// Outer angle between the faces, in units of π; 2 for a rim.
    pub outer_angle: f64,
}

impl Edge {
    /// Returns a unit vector in each of the two faces, perpendicular to the edge and away from it.
    pub fn inward_directions(&self) -> [DVec3; 2] {
        let (sin, cos) = (self.outer_angle * PI).sin_cos();
        let is_rim = self.faces[0] == self.faces[1];
        [self.along, if is_rim { self.along } else { cos * self.along + sin * self.normal }]
    }
}

/// Closed surface of the room or of an object.
#[derive(Debug)]
struct SolidBody {
    name: String,
    bounds: [DVec3; 2],
    triangles: Vec<Triangle>,
}

impl SolidBody {
    /// Returns whether the point lies inside: a ray from it crosses the surface an odd number of times. The ray direction
    /// is oblique to typical faces.
    fn contains(&self, point: DVec3) -> bool {
        let [low, high] = self.bounds;
        let reach = DVec3::new(0.311, 0.577, 0.813) * 4.0 * (high - low).length();
        let in_box = point.cmpge(low).all() && point.cmple(high).all();
        in_box && self.triangles.iter().filter(|t| t.crossing(point, reach).is_some()).count() % 2 == 1
    }
}

/// Geometry that waves interact with.
#[derive(Debug)]
pub struct World {
    /// Surface properties, indexed by [`Face::surface`].
    pub surfaces: Vec<Surface>,
    /// All faces; the faces of the room come first.
    pub faces: Vec<Face>,
    /// All edges that diffract.
    pub edges: Vec<Edge>,
    /// All triangles, in the order of their faces.
    pub triangles: Vec<Triangle>,
    /// Closed bodies; the room, if any, is the first.
    bodies: Vec<SolidBody>,
    hierarchy: Hierarchy,
}

impl World {
    /// Returns the surface properties of a face.
    pub fn surface_of(&self, face: u32) -> &Surface {
        &self.surfaces[self.faces[face as usize].surface as usize]
    }

    /// Returns whether a point in the plane of a face lies on it.
    pub fn is_on_face(&self, face: u32, point: DVec3) -> bool {
        self.triangles[self.faces[face as usize].triangles.clone()].iter().any(|t| t.contains(point))
    }

    /// Returns the frontmost face at a point of `face`, for a wave that comes from `from`: `face` itself unless another face
    /// in its plane covers it there.
    pub fn front_face(&self, face: u32, point: DVec3, from: DVec3) -> u32 {
        let lies_on = |best: u32, twin: u32| self.is_in_front(twin, best, from) && self.is_on_face(twin, point);
        self.faces[face as usize].twins.iter().fold(face, |best, &twin| if lies_on(best, twin) { twin } else { best })
    }

    /// Returns whether `one` covers `other` in a common plane, as seen from `from`: the later layer in front, the
    /// earlier behind; within a layer the first.
    fn is_in_front(&self, one: u32, other: u32, from: DVec3) -> bool {
        let [a, b] = [one, other].map(|face| &self.faces[face as usize]);
        match a.layer.cmp(&b.layer) {
            Ordering::Equal => one < other,
            Ordering::Greater => b.height(from) >= 0.0,
            Ordering::Less => a.height(from) < 0.0,
        }
    }

    /// Collects the sheets between `from` and `to` in `sheets` (cleared first): position on the segment, from 0 to 1, and
    /// face, nearest first. Returns whether no solid face blocks the segment; otherwise `sheets` is undefined. `ends` are
    /// the faces of the two end points: faces in their planes do not count as obstacles.
    pub fn collect_sheets(&self, from: DVec3, to: DVec3, ends: [&[u32]; 2], sheets: &mut Vec<(f64, u32)>) -> bool {
        sheets.clear();
        let span = to - from;
        let margin = MARGIN / span.length().max(MARGIN);
        let is_at_end = |face: u32| ends.into_iter().flatten().any(|f| self.faces[*f as usize].twins.contains(&face));
        for triangle in self.hierarchy.near_segment(from, span).map(|i| &self.triangles[i]) {
            let Some(position) = triangle.crossing(from, span) else { continue };
            if position <= margin || position >= 1.0 - margin || is_at_end(triangle.face) {
                continue;
            }
            if self.surface_of(triangle.face).thickness.is_none() {
                return false;
            }
            sheets.push((position, triangle.face));
        }
        sheets.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // On the seam of two triangles of a face both are hit.
        sheets.dedup_by(|b, a| a.1 == b.1 && b.0 - a.0 < margin);
        true
    }

    /// Returns an error for a point where no antenna can be: outside the room or inside an object. The error is the
    /// obstacle, such as «inside `desk 2`».
    pub fn check_free(&self, point: DVec3) -> Result<(), String> {
        let has_room = self.faces.first().is_some_and(Face::is_room);
        let (room, objects) = self.bodies.split_at(usize::from(has_room));
        if room.iter().any(|room| !room.contains(point)) {
            return Err("outside the room".into());
        }
        match objects.iter().find(|body| body.contains(point)) {
            Some(body) => Err(format!("inside `{}`", body.name)),
            None => Ok(()),
        }
    }
}
