//! Coincident faces of one sheet, such as the two sides of a wall: only the first face is kept.

use super::build::WorldBuilder;
use super::contact::{BEYOND, COVERED_PROBES, PROBES, bounding_box, is_near_face};
use super::{Edge, Triangle};
use crate::hierarchy::Hierarchy;
use crate::polygon::{side_planes, triangles_outside};
use glam::DVec3;
use std::ops::Range;

/// Margin of the boxes in which coincident faces are searched, metres.
const MARGIN: f64 = 2.0 * BEYOND;

/// Finds the triangles in a box that describe the same sheet as a face.
type Coincident<'a> = &'a dyn Fn(u32, [DVec3; 2]) -> Vec<Triangle>;

impl WorldBuilder {
    /// Cuts out of each face what earlier faces of the same sheet cover, and removes edges inside a sheet. Needs the twins of
    /// faces.
    pub(super) fn join_sheets(&mut self) {
        let same_sheet = |face: u32| {
            let twins = self.faces[face as usize].twins.iter().copied();
            twins.filter(|twin| self.is_same_sheet(*twin, face)).collect()
        };
        let sheets: Vec<Vec<u32>> = (0..self.faces.len() as u32).map(same_sheet).collect();
        if sheets.iter().all(Vec::is_empty) {
            return;
        }
        let hierarchy = Hierarchy::new(&self.triangles);
        let coincident = |face: u32, bounds: [DVec3; 2]| -> Vec<Triangle> {
            let sheet = &sheets[face as usize];
            if sheet.is_empty() {
                return Vec::new();
            }
            let touching = hierarchy.in_box(bounds).map(|i| self.triangles[i]);
            touching.filter(|triangle| sheet.binary_search(&triangle.face).is_ok()).collect()
        };
        let (mut edges, mut owners) = (Vec::new(), Vec::new());
        for (edge, owner) in self.edges.iter().zip(&self.owners) {
            edges.extend(self.outer_edges(edge, &coincident));
            owners.resize(edges.len(), *owner);
        }
        let (triangles, ranges) = self.uncovered_triangles(&coincident);
        (self.edges, self.owners, self.triangles) = (edges, owners, triangles);
        for (face, range) in self.faces.iter_mut().zip(ranges) {
            if range.is_empty() {
                face.hull.clear(); // nothing reflects there
            }
            face.triangles = range;
        }
    }

    /// Returns the parts of all triangles that no earlier face of their sheet covers, and the range of each face in them.
    fn uncovered_triangles(&self, coincident: Coincident<'_>) -> (Vec<Triangle>, Vec<Range<usize>>) {
        let mut triangles = Vec::with_capacity(self.triangles.len());
        let mut ranges = Vec::with_capacity(self.faces.len());
        for (index, face) in (0..).zip(&self.faces) {
            let start = triangles.len();
            for triangle in &self.triangles[face.triangles.clone()] {
                let mut earlier = coincident(index, bounding_box(&triangle.corners(), MARGIN));
                earlier.retain(|other| other.face < index);
                triangles.extend(uncovered_pieces(triangle, &earlier));
            }
            ranges.push(start..triangles.len());
        }
        (triangles, ranges)
    }

    /// Returns whether coplanar faces describe one sheet where they coincide: faces of one mesh, and faces of different
    /// parts with equal material. Bodies that touch keep their shells.
    fn is_same_sheet(&self, one: u32, other: u32) -> bool {
        let [one, other] = [one as usize, other as usize];
        let [a, b] = [&self.faces[one], &self.faces[other]];
        let [surface_a, surface_b] = [a, b].map(|face| &self.surfaces[face.surface as usize]);
        let touch = self.shells[one] && self.shells[other] && a.normal.dot(b.normal) < 0.0;
        let is_alike = surface_a.thickness.is_some() && surface_a.is_like(surface_b) && !touch;
        a.layer == b.layer && (self.parts[one] == self.parts[other] || is_alike)
    }

    /// Returns the pieces of an edge that no earlier face covers and beyond which the sheet ends. If an earlier face covers
    /// one side of a fold, it replaces the face of this side.
    fn outer_edges(&self, edge: &Edge, coincident: Coincident<'_>) -> Vec<Edge> {
        let [first, second] = edge.faces;
        let (bounds, inwards) = (bounding_box(&edge.ends, MARGIN), edge.inward_directions());
        if first == second {
            return self.outer_rims(edge, &coincident(first, bounds));
        }
        let cover = [0, 1].map(|k| {
            let mut others = coincident(edge.faces[k], bounds);
            others.retain(|other| other.face < edge.faces[k]);
            self.covering_face(edge, inwards[k], &others)
        });
        match cover {
            [None, None] => vec![edge.clone()],
            [Some(_), Some(_)] => Vec::new(),
            [a, b] => vec![Edge { faces: [a.unwrap_or(first), b.unwrap_or(second)], ..edge.clone() }],
        }
    }

    /// Returns the face of one of `triangles` that covers the side `inwards` of an edge; `None` unless they cover most of its
    /// length.
    fn covering_face(&self, edge: &Edge, inwards: DVec3, triangles: &[Triangle]) -> Option<u32> {
        let face_at = |t: f64| {
            let point = edge.ends[0].lerp(edge.ends[1], t) + BEYOND * inwards;
            let is_near = |triangle: &&Triangle| {
                is_near_face(&self.faces[triangle.face as usize], point, std::slice::from_ref(*triangle))
            };
            triangles.iter().find(is_near).map(|triangle| triangle.face)
        };
        PROBES.into_iter().filter_map(face_at).nth(COVERED_PROBES - 1)
    }

    /// Returns the pieces of the rim of a face that neither are inside earlier faces of its sheet nor border on its other faces;
    /// `others` are the triangles of the sheet near it.
    fn outer_rims(&self, edge: &Edge, others: &[Triangle]) -> Vec<Edge> {
        let face = edge.faces[0];
        let inside = others.iter().filter(|other| other.face < face).map(|other| (BEYOND, *other));
        let beyond = others.iter().map(|other| (-BEYOND, *other));
        let mut pieces = vec![edge.clone()];
        for (step, other) in inside.chain(beyond) {
            let sides = side_planes(&other.corners(), other.normal());
            let cut = |piece: Edge| {
                let probe = piece.ends.map(|end| end + step * edge.along);
                self.cut_edge(piece, face, probe, &sides)
            };
            pieces = pieces.into_iter().flat_map(cut).collect();
            if pieces.is_empty() {
                break;
            }
        }
        // At a corner of angle a, probes at the distance BEYOND beside the edge miss its last BEYOND / tan(a): such remnants are no
        // rims. The factor 4 covers angles from 14 degrees.
        pieces.retain(|piece| piece.ends == edge.ends || piece.ends[0].distance(piece.ends[1]) > 4.0 * BEYOND);
        pieces
    }
}

/// Returns the pieces of a triangle outside other triangles in its plane.
fn uncovered_pieces(triangle: &Triangle, others: &[Triangle]) -> Vec<Triangle> {
    let mut pieces = vec![*triangle];
    for other in others {
        let sides = side_planes(&other.corners(), other.normal());
        pieces = pieces.iter().flat_map(|piece| triangles_outside(piece, &sides)).collect();
        if pieces.is_empty() {
            break;
        }
    }
    pieces
}
