//! Image sources of a fixed point: the sequences of faces that can reflect a ray to it, found once by beam tracing.
//!
//! The receiver is mirrored at a face, its image at the next face, and so on. Each image has a beam: the cone from the
//! image through the clipped face. Only faces inside the beam create further images, and a transmitter is tested
//! against the beam alone. Blocking walls are not tested here.

use crate::polygon::{LEAST_AREA, Plane, THIN, clip_polygon, polygon_area};
use crate::world::{Face, World};
use glam::DVec3;
use std::ops::Range;

/// Largest number of images of one point, to limit memory.
const MOST_IMAGES: usize = 2_000_000;
/// Largest number of planes of all beams, to limit memory.
const MOST_PLANES: usize = 20 * MOST_IMAGES;
/// Largest number of tested pairs of image and face, to limit time to minutes.
const MOST_TRIALS: usize = 500_000_000;

/// Largest number of tested pairs of beam plane and face corner; faces may have tens of thousands of corners.
const MOST_CORNERS: usize = 50 * MOST_TRIALS;

/// Number of pairs above which a progress message is shown, about ten seconds.
const SLOW_TRIALS: usize = 50_000_000;

/// Largest numbers of reflections of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orders {
    /// Largest number of reflections on any faces.
    pub all: usize,
    /// Largest number of reflections of a path that is reflected at faces of the room only.
    pub room: usize,
}

/// Faces of a path and its reflection points, in order of travel.
#[derive(Default)]
struct UnfoldedPath {
    faces: Vec<u32>,
    points: Vec<DVec3>,
}

/// Image of the receiver, and the faces that made it.
#[derive(Clone, Debug)]
struct Node {
    /// Parent image, one reflection nearer to the receiver; `u32::MAX` for first-order images.
    parent: u32,
    /// Last mirror: the first face that a ray from a transmitter meets.
    face: u32,
    image: DVec3,
    /// Planes through the image that bound the beam, and the plane of the mirror, in [`ImageTree::planes`]: the image
    /// is visible to a transmitter if all are positive.
    planes: Range<u32>,
}

/// All images of a point.
#[derive(Debug)]
pub struct ImageTree {
    origin: DVec3,
    nodes: Vec<Node>,
    /// Normal and offset: positive inside.
    planes: Vec<Plane>,
}

impl ImageTree {
    /// Builds the tree of the point `origin`; `None` if it would exceed the limits of memory (`MOST_IMAGES`,
    /// `MOST_PLANES`) or time (`MOST_TRIALS`, `MOST_CORNERS`).
    pub fn build(world: &World, origin: DVec3, orders: Orders) -> Option<Self> {
        let mut tree = Self { origin, nodes: Vec::new(), planes: Vec::new() };
        // Faces of the room come first, in case their reflection limit is higher.
        let room_faces = world.faces.iter().take_while(|f| f.is_room()).count() as u32;
        // Images of the last order, and whether all their mirrors belong to the room.
        let mut parents = vec![(u32::MAX, true)];
        let (mut trials, mut corners) = (0, 0_usize);
        for order in 1..=orders.all.max(orders.room) {
            let any_face = order <= orders.all;
            let candidates = if any_face { world.faces.len() as u32 } else { room_faces };
            trials += parents.len() * candidates as usize;
            let hull_corners: usize = world.faces[..candidates as usize].iter().map(|face| face.hull.len()).sum();
            corners +=
                parents.iter().map(|(id, _)| tree.beam(*id).1.len() + 1).sum::<usize>().saturating_mul(hull_corners);
            if trials > MOST_TRIALS || corners > MOST_CORNERS {
                return None; // refused before any of them is tested
            }
            if parents.len() * candidates as usize > SLOW_TRIALS {
                tracing::warn!(
                    "testing {} images with {candidates} faces takes a while; lower `order`, or simplify meshes",
                    parents.len()
                );
            }
            let mut images = Vec::new();
            for &(parent, in_room) in &parents {
                for face in 0..candidates {
                    let is_room = in_room && face < room_faces;
                    if any_face || is_room {
                        images.extend(tree.add_image(world, parent, face).map(|id| (id, is_room)));
                    }
                    if tree.nodes.len() > MOST_IMAGES || tree.planes.len() > MOST_PLANES {
                        return None;
                    }
                }
            }
            parents = images;
        }
        Some(tree)
    }

    /// Returns the image `id` and the planes of its beam, positive inside; the origin without planes for `u32::MAX`.
    fn beam(&self, id: u32) -> (DVec3, &[Plane]) {
        match self.nodes.get(id as usize) {
            Some(Node { image, planes, .. }) => (*image, &self.planes[planes.start as usize..planes.end as usize]),
            None => (self.origin, &[]),
        }
    }

    /// Adds the image of the image `parent` in `face`, and returns its index; `None` if no part of the face is inside the
    /// beam of `parent`, or if the parent image lies in the plane of the face.
    fn add_image(&mut self, world: &World, parent: u32, face: u32) -> Option<u32> {
        let (image, beam) = self.beam(parent);
        let mirror = &world.faces[face as usize];
        if mirror.height(image).abs() < THIN {
            return None;
        }
        let mut polygon = mirror.hull.clone();
        for plane in beam {
            polygon = clip_polygon(&polygon, *plane);
            if polygon.len() < 3 {
                return None;
            }
        }
        if polygon_area(&polygon) <= LEAST_AREA {
            return None;
        }
        let image = mirror.mirror(image);
        let planes = self.store_beam(mirror, image, &polygon);
        self.nodes.push(Node { parent, face, image, planes });
        Some(self.nodes.len() as u32 - 1)
    }

    /// Returns the approximate memory use, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.planes.len() * size_of::<Plane>()
    }

    /// Calls `visit` with each geometrically possible sequence of faces and its reflection points, in order of travel
    /// from `tx` (metres, world frame). The caller tests for obstacles. The first sequence is empty (line of sight).
    pub fn visit_candidates(&self, world: &World, tx: DVec3, mut visit: impl FnMut(&[u32], &[DVec3])) {
        visit(&[], &[]);
        let mut path = UnfoldedPath::default();
        for (id, node) in (0..).zip(&self.nodes) {
            if self.beam(id).1.iter().all(|(normal, offset)| normal.dot(tx) > *offset)
                && self.unfold_path(world, node, tx, &mut path)
            {
                visit(&path.faces, &path.points);
            }
        }
    }

    /// Returns the point that all reflected rays lead to, the receiver position: metres, world frame.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Unfolds the path from `tx` towards the image of `node` from mirror to mirror, and collects its faces and reflection
    /// points in `path` (cleared first). Returns whether all points lie on their faces: beams use convex
    /// hulls, so holes and bays of faces are tested here.
    fn unfold_path(&self, world: &World, node: &Node, tx: DVec3, path: &mut UnfoldedPath) -> bool {
        path.faces.clear();
        path.points.clear();
        let (mut from, mut node) = (tx, node);
        loop {
            let face = &world.faces[node.face as usize];
            let (near, far) = (face.height(from), face.height(node.image));
            let point = from + (node.image - from) * (near / (near - far));
            if !world.is_on_face(node.face, point) {
                return false;
            }
            path.faces.push(node.face);
            path.points.push(point);
            if node.parent == u32::MAX {
                return true;
            }
            from = point;
            node = &self.nodes[node.parent as usize];
        }
    }

    /// Stores the beam from `image` through the convex polygon `clipped` on `mirror`, and returns the range of its planes.
    fn store_beam(&mut self, mirror: &Face, image: DVec3, clipped: &[DVec3]) -> Range<u32> {
        let start = self.planes.len() as u32;
        // In front of the mirror, opposite to the image.
        let side = -mirror.height(image).signum();
        self.planes.push((side * mirror.normal, side * mirror.offset));
        let middle = clipped.iter().sum::<DVec3>() / clipped.len() as f64;
        for (i, a) in clipped.iter().enumerate() {
            let b = clipped[(i + 1) % clipped.len()];
            let normal = (*a - image).cross(b - image);
            let normal = if normal.dot(middle - image) < 0.0 { -normal } else { normal };
            let length = normal.length();
            if length > 0.0 {
                let normal = normal / length;
                // A border shared by two beams belongs to both rather than to none.
                self.planes.push((normal, normal.dot(image) - THIN));
            }
        }
        start..self.planes.len() as u32
    }
}
