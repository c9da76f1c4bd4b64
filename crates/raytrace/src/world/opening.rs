//! Openings: holes in faces, and their rims.

use super::build::WorldBuilder;
use super::contact::{BEYOND, TOUCHING, is_near_face};
use super::{Edge, Face, SurfaceLayer, Triangle};
use crate::polygon::{Plane, interval_inside, side_planes, triangles_outside};
use glam::DVec3;

/// Number of points along each side of an opening that must lie on a face.
const SAMPLES: usize = 16;
/// Shorter rims are left out, metres.
const SHORTEST_RIM: f64 = 1e-3;

impl WorldBuilder {
    /// Cuts a convex polygon, `hole`, out of every face in its plane. Its rims diffract; edges inside it are removed.
    ///
    /// # Errors
    /// A part of the hole lies on no face, or a face is solid.
    pub fn cut_opening(&mut self, hole: &[DVec3; 4]) -> Result<(), String> {
        let is_coplanar = |face: &Face| hole.iter().all(|p| face.height(*p).abs() < TOUCHING);
        let mut hosts: Vec<usize> = (0..self.faces.len()).filter(|f| is_coplanar(&self.faces[*f])).collect();
        self.check_opening(hole, &hosts)?;
        // Among overlapping faces, the frontmost one has the rim.
        hosts.sort_by_key(|f| (std::cmp::Reverse(self.faces[*f].layer), *f));
        for (i, &host) in hosts.iter().enumerate() {
            let flat = hole.map(|p| p - self.faces[host].height(p) * self.faces[host].normal);
            let sides = side_planes(&flat, self.faces[host].normal);
            self.cut_edges(host as u32, &sides);
            let rims = self.opening_rims(host, &flat, &hosts[..i]);
            self.owners.resize(self.owners.len() + rims.len(), self.parts[host]);
            self.edges.extend(rims);
        }
        let triangles = std::mem::take(&mut self.triangles);
        for (index, face) in self.faces.iter_mut().enumerate() {
            let start = self.triangles.len();
            let old = &triangles[face.triangles.clone()];
            if hosts.contains(&index) {
                let sides = side_planes(hole, face.normal);
                self.triangles.extend(old.iter().flat_map(|triangle| triangles_outside(triangle, &sides)));
            } else {
                self.triangles.extend(old);
            }
            face.triangles = start..self.triangles.len();
        }
        Ok(())
    }

    /// Returns an error unless every part of `hole` lies on one of the faces `hosts`, and none of them is solid.
    fn check_opening(&self, hole: &[DVec3; 4], hosts: &[usize]) -> Result<(), String> {
        let is_on_face = |p: DVec3| hosts.iter().any(|f| is_near_face(&self.faces[*f], p, self.face_triangles(*f)));
        let middle = |i: usize| (i as f64 + 0.5) / SAMPLES as f64;
        let mut points = (0..SAMPLES * SAMPLES).map(|i| {
            let (u, v) = (middle(i % SAMPLES), middle(i / SAMPLES));
            hole[0].lerp(hole[1], u).lerp(hole[3].lerp(hole[2], u), v)
        });
        if !points.all(is_on_face) {
            return Err(
                "does not lie wholly on a wall, a panel or the side of a box; move it there, and list it after \
                        the thing that it opens"
                    .into(),
            );
        }
        let surface = |face: &Face| &self.surfaces[face.surface as usize];
        let is_solid = |face: &&Face| face.layer == SurfaceLayer::SolidBody && surface(face).thickness.is_none();
        match hosts.iter().map(|f| &self.faces[*f]).find(is_solid) {
            None => Ok(()),
            Some(face) => Err(format!(
                "opens `{}`, which is solid; give its finish a `thickness_m`, so that it is hollow",
                surface(face).object
            )),
        }
    }

    /// Returns the triangles of the face with this index.
    fn face_triangles(&self, face: usize) -> &[Triangle] {
        &self.triangles[self.faces[face].triangles.clone()]
    }

    /// Cuts an opening with these `sides` out of the edges of the face `host`.
    fn cut_edges(&mut self, host: u32, sides: &[Plane; 4]) {
        let (edges, owners) = (std::mem::take(&mut self.edges), std::mem::take(&mut self.owners));
        for (edge, owner) in edges.into_iter().zip(owners) {
            let ends = edge.ends;
            let pieces = if edge.faces.contains(&host) { self.cut_edge(edge, host, ends, sides) } else { vec![edge] };
            self.owners.resize(self.owners.len() + pieces.len(), owner);
            self.edges.extend(pieces);
        }
    }

    /// Returns the pieces of an edge of `host` where the line `probe`, which runs beside it, is outside the convex polygon
    /// with these `sides`. Where the polygon removes only one of two faces, the edge becomes a rim of the other.
    pub(super) fn cut_edge(&self, edge: Edge, host: u32, probe: [DVec3; 2], sides: &[Plane]) -> Vec<Edge> {
        let [a, b] = edge.ends;
        let tolerance = TOUCHING / a.distance(b);
        let inside = interval_inside(probe, sides, -TOUCHING);
        // The interval exceeds the polygon by the tolerance at both ends; shorter pieces are rounding errors.
        let Some((start, end)) = inside.filter(|(start, end)| end - start > 3.0 * tolerance) else { return vec![edge] };
        let piece = |from: f64, to: f64| Edge { ends: [a.lerp(b, from), a.lerp(b, to)], ..edge.clone() };
        let mut pieces = Vec::new();
        pieces.extend((start > 2.0 * tolerance).then(|| piece(0.0, start)));
        pieces.extend((1.0 - end > 2.0 * tolerance).then(|| piece(end, 1.0)));
        if let Some(k) = edge.faces.iter().position(|f| *f != host) {
            let (face, along) = (edge.faces[k], edge.inward_directions()[k]);
            let normal = self.faces[face as usize].normal;
            pieces.push(Edge { faces: [face; 2], along, normal, outer_angle: 2.0, ..piece(start, end) });
        }
        pieces
    }

    /// Returns the rims of an opening in a face: the parts of its sides beyond which the face continues and no face of
    /// `others` does.
    fn opening_rims(&self, host: usize, hole: &[DVec3; 4], others: &[usize]) -> Vec<Edge> {
        let face = &self.faces[host];
        let mut rims = Vec::new();
        for (i, (normal, _)) in side_planes(hole, face.normal).into_iter().enumerate() {
            let ends = [hole[i], hole[(i + 1) % 4]];
            let beyond = ends.map(|p| p - BEYOND * normal);
            let mut intervals: Vec<(f64, f64)> = self
                .face_triangles(host)
                .iter()
                .filter_map(|t| interval_inside(beyond, &side_planes(&t.corners(), face.normal), 0.0))
                .collect();
            intervals.sort_by(|a, b| a.0.total_cmp(&b.0));
            intervals.dedup_by(|next, last| {
                // Triangles with a common side meet up to rounding.
                let joined = next.0 <= last.1 + 1e-9;
                if joined {
                    last.1 = last.1.max(next.1);
                }
                joined
            });
            let at = |t: f64| ends[0].lerp(ends[1], t);
            let is_long = |(start, end): &(f64, f64)| (end - start) * ends[0].distance(ends[1]) > SHORTEST_RIM;
            let is_bare = |(start, end): &(f64, f64)| {
                let point = beyond[0].lerp(beyond[1], 0.5 * (start + end));
                !others.iter().any(|f| is_near_face(&self.faces[*f], point, self.face_triangles(*f)))
            };
            rims.extend(intervals.into_iter().filter(is_long).filter(is_bare).map(|(start, end)| Edge {
                ends: [at(start), at(end)],
                faces: [host as u32; 2],
                along: -normal,
                normal: face.normal,
                outer_angle: 2.0,
            }));
        }
        rims
    }
}
