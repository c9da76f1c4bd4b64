//! Builds faces and edges from triangle meshes.

use super::contact::{self, bounding_box, is_near_face};
use super::{Edge, Face, SolidBody, Surface, SurfaceLayer, Triangle, World};
use crate::hierarchy::Hierarchy;
use crate::mesh::Mesh;
use glam::DVec3;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Difference of unit normals below which triangles are coplanar.
const COPLANAR: f64 = 1e-7;
/// Angle below which faces do not form an edge: facets of round objects.
const FLATTEST_EDGE: f64 = 5.0 * PI / 180.0;

/// Collects parts and builds a world.
#[derive(Debug, Default)]
pub struct WorldBuilder {
    pub(super) surfaces: Vec<Surface>,
    pub(super) faces: Vec<Face>,
    pub(super) edges: Vec<Edge>,
    pub(super) triangles: Vec<Triangle>,
    bodies: Vec<SolidBody>,
    /// Part index of each face.
    pub(super) parts: Vec<usize>,
    /// Whether the part of each face is closed.
    pub(super) shells: Vec<bool>,
    /// Part index of each edge.
    pub(super) owners: Vec<usize>,
    /// Number of parts so far.
    count: usize,
}

/// Part to add: the room first.
pub struct WorldPart<'a> {
    /// Its name.
    pub name: &'a str,
    /// Triangles with shared vertices; normals point to the side of the waves.
    pub mesh: &'a Mesh,
    /// Whether the mesh is closed, so that antennas cannot be inside (for the room: outside).
    pub closed: bool,
    /// Function from the normal of a face and its number in the part to its name and surface index.
    pub describe: &'a dyn Fn(DVec3, usize) -> (String, u32),
}

impl WorldBuilder {
    /// Adds surface properties and returns their index.
    pub fn add_surface(&mut self, surface: Surface) -> u32 {
        self.surfaces.push(surface);
        self.surfaces.len() as u32 - 1
    }

    /// Begins a scene without a room: the first part is an object.
    pub fn begin_open_scene(&mut self) {
        self.count = 1;
    }

    /// Returns the number of triangles so far.
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Adds the room, or an object after it: its faces except hidden ones, its edges, and its body if it is closed.
    pub fn add_part(&mut self, part: &WorldPart<'_>) {
        let layer = match (self.count, part.closed) {
            (0, _) => SurfaceLayer::Room,
            (_, true) => SurfaceLayer::SolidBody,
            (_, false) => SurfaceLayer::Sheet,
        };
        let corners = part.mesh.triangles.iter().map(|t| part.mesh.corners(*t));
        let mut triangles: Vec<Triangle> = corners.map(Triangle::new).collect(); // hidden ones keep the face u32::MAX
        let owners = side_owners(part.mesh);
        for (number, group) in coplanar_groups(&triangles, &owners).iter().enumerate() {
            let start = self.triangles.len();
            let members: Vec<Triangle> = group.iter().map(|&t| triangles[t]).collect();
            let face = create_face(&members, layer, number, part);
            if layer == SurfaceLayer::SolidBody && self.is_hidden(&face) {
                continue;
            }
            for &t in group {
                triangles[t].face = self.faces.len() as u32;
                self.triangles.push(triangles[t]);
            }
            self.faces.push(Face { triangles: start..self.triangles.len(), ..face });
        }
        self.edges.extend(owners.iter().filter_map(|side| face_edge(part, side, &triangles)));
        self.parts.resize(self.faces.len(), self.count);
        self.shells.resize(self.faces.len(), part.mesh.is_closed());
        self.owners.resize(self.edges.len(), self.count);
        self.count += 1;
        if part.closed {
            let bounds = bounding_box(&part.mesh.vertices, 0.0);
            self.bodies.push(SolidBody { name: part.name.into(), bounds, triangles });
        }
    }

    /// Builds the world: finds coplanar faces, joins sheets and leaves out edges that lie on other parts.
    ///
    /// # Errors
    /// Too many overlapping faces or contacts.
    pub fn build(mut self) -> Result<World, String> {
        contact::find_twins(&mut self.faces)?;
        self.join_sheets();
        let hierarchy = Hierarchy::new(&self.triangles);
        let contacts = contact::Contacts::new(&self.faces, &self.triangles, &hierarchy, &self.parts);
        let mut edges = Vec::new();
        for (edge, part) in self.edges.iter().zip(&self.owners) {
            if !contacts.is_covered(edge, *part)? {
                edges.push(edge.clone());
            }
        }
        let Self { surfaces, faces, triangles, bodies, .. } = self;
        Ok(World { surfaces, faces, edges, triangles, bodies, hierarchy })
    }

    /// Returns whether a face lies back to back on a face of the room, like the underside of a cupboard: no wave
    /// reaches it.
    fn is_hidden(&self, face: &Face) -> bool {
        let middle = face.hull.iter().sum::<DVec3>() / face.hull.len() as f64;
        let is_covered_by = |wall: &Face| {
            let near = |p: &DVec3| is_near_face(wall, *p, &self.triangles[wall.triangles.clone()]);
            face.normal.dot(wall.normal) < 0.0 && face.hull.iter().chain([&middle]).all(near)
        };
        self.faces.iter().take_while(|f| f.is_room()).any(is_covered_by)
    }
}

/// Creates face `number` of `part` from its coplanar triangles; its plane is that of the largest. The range of its triangles
/// is not set yet.
fn create_face(triangles: &[Triangle], layer: SurfaceLayer, number: usize, part: &WorldPart<'_>) -> Face {
    let largest = triangles.iter().max_by(|a, b| a.area().total_cmp(&b.area())).expect("a face has a triangle");
    let (normal, offset) = (largest.normal(), largest.normal().dot(largest.corner));
    let (name, surface) = (part.describe)(normal, number);
    let hull = convex_hull(triangles.iter().flat_map(Triangle::corners).collect(), normal);
    Face { name, normal, offset, surface, triangles: 0..0, twins: Vec::new(), hull, layer }
}

/// Returns the indices of the triangles at each side of a triangle; sides are pairs of vertices, the lower first.
fn side_owners(mesh: &Mesh) -> BTreeMap<[u32; 2], Vec<usize>> {
    let mut edges: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
    for (t, &[a, b, c]) in mesh.triangles.iter().enumerate() {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            edges.entry([p.min(q), p.max(q)]).or_default().push(t);
        }
    }
    edges
}

/// Returns the groups of connected coplanar triangles, in the order of their first; each group ascends. `owners` has the
/// triangles at each side.
fn coplanar_groups(triangles: &[Triangle], owners: &BTreeMap<[u32; 2], Vec<usize>>) -> Vec<Vec<usize>> {
    let mut neighbours = vec![Vec::new(); triangles.len()];
    for owners in owners.values() {
        for &a in owners {
            neighbours[a].extend(owners.iter().copied().filter(|&b| b != a));
        }
    }
    let mut seen = vec![false; triangles.len()];
    let mut groups = Vec::new();
    for start in 0..triangles.len() {
        if std::mem::replace(&mut seen[start], true) {
            continue;
        }
        // Compared with the first triangle of the group, not the neighbour: a gently curved surface stays in pieces.
        let normal = triangles[start].normal();
        let mut group = vec![start];
        let mut next = 0;
        while next < group.len() {
            for &other in &neighbours[group[next]] {
                if !seen[other] && (triangles[other].normal() - normal).length() < COPLANAR {
                    seen[other] = true;
                    group.push(other);
                }
            }
            next += 1;
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

/// Returns the edge between the faces of the triangles `owners` at a side with these `ends`, or the rim of a sheet; `None`
/// inside a face, at an angle below [`FLATTEST_EDGE`], in a concave corner of a closed part, beside a hidden face, or
/// between more than two triangles.
fn face_edge(part: &WorldPart<'_>, (ends, owners): (&[u32; 2], &Vec<usize>), triangles: &[Triangle]) -> Option<Edge> {
    let mesh = part.mesh;
    let [p, q] = ends.map(|i| mesh.vertices[i as usize]);
    let direction = (q - p).normalize();
    let third = |t: usize| {
        let index = mesh.triangles[t].into_iter().find(|i| !ends.contains(i)).expect("a triangle has three corners");
        mesh.vertices[index as usize]
    };
    let face_of = |t: usize| triangles[t].face;
    // `sign` is that of the normal of the first face on the outer side.
    let (faces, outer_angle, sign) = match **owners {
        [only] => ([face_of(only); 2], 2.0, 1.0),
        [one, other] if face_of(one) != face_of(other) => {
            let (n0, n1) = (triangles[one].normal(), triangles[other].normal());
            let turn = n0.cross(n1).length().atan2(n0.dot(n1));
            let is_convex = n0.dot(third(other) - p) < 0.0;
            // A sheet has two sides: its folds are convex on one of them.
            if turn < FLATTEST_EDGE || part.closed && !is_convex {
                return None;
            }
            ([face_of(one), face_of(other)], 1.0 + turn / PI, if is_convex { 1.0 } else { -1.0 })
        }
        _ => return None,
    };
    if faces.contains(&u32::MAX) {
        return None;
    }
    let inwards = third(owners[0]) - p;
    let along = (inwards - inwards.dot(direction) * direction).normalize();
    Some(Edge { ends: [p, q], faces, along, normal: sign * triangles[owners[0]].normal(), outer_angle })
}

/// Returns the convex hull of points in a plane, counter-clockwise about its normal (Andrew's monotone chain).
fn convex_hull(mut points: Vec<DVec3>, normal: DVec3) -> Vec<DVec3> {
    let u = normal.any_orthonormal_vector();
    let v = normal.cross(u);
    let flat = |p: DVec3| (p.dot(u), p.dot(v));
    points.sort_by(|a, b| {
        let (a, b) = (flat(*a), flat(*b));
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    // Below 1e-12 m² the corner is straight, up to rounding.
    let turns_left = |a: DVec3, b: DVec3, c: DVec3| (b - a).cross(c - b).dot(normal) > 1e-12;
    let half = |points: &mut dyn Iterator<Item = DVec3>| {
        let mut chain: Vec<DVec3> = Vec::new();
        for p in points {
            while chain.len() >= 2 && !turns_left(chain[chain.len() - 2], chain[chain.len() - 1], p) {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter().copied());
    hull.extend(half(&mut points.iter().rev().copied()));
    hull
}
