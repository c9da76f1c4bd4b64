//! Openings: holes in faces, and their rims.

use super::build::WorldBuilder;
use super::contact::{TOUCHING, is_near};
use super::{Edge, Face, SurfaceLayer, Triangle};
use crate::images::{LEAST_AREA, area, clip};
use glam::DVec3;

/// Number of points along each side of an opening that must lie on a face.
const PLACES: usize = 16;

/// Plane that bounds the opening: normal and offset, positive inside.
type Plane = (DVec3, f64);

impl WorldBuilder {
    /// Cuts a convex polygon, `hole`, out of every face in its plane. Its rims diffract; edges inside it are removed.
    ///
    /// # Errors
    /// A part of the hole lies on no face, or a face is solid.
    pub fn cut(&mut self, hole: &[DVec3; 4]) -> Result<(), String> {
        let is_coplanar = |face: &Face| hole.iter().all(|p| face.height(*p).abs() < TOUCHING);
        let mut hosts: Vec<usize> = (0..self.faces.len()).filter(|f| is_coplanar(&self.faces[*f])).collect();
        let is_held = |p: DVec3| hosts.iter().any(|f| is_near(&self.faces[*f], p, self.triangles_of(*f)));
        let middle = |i: usize| (i as f64 + 0.5) / PLACES as f64;
        let mut places = (0..PLACES * PLACES).map(|i| {
            let (u, v) = (middle(i % PLACES), middle(i / PLACES));
            hole[0].lerp(hole[1], u).lerp(hole[3].lerp(hole[2], u), v)
        });
        if !places.all(is_held) {
            return Err(
                "does not lie wholly on a wall, a panel or the side of a box; move it there, and list it after \
                        the thing that it opens"
                    .into(),
            );
        }
        let surface = |face: &Face| &self.surfaces[face.surface as usize];
        let is_solid = |face: &&Face| face.layer == SurfaceLayer::SolidBody && surface(face).thickness.is_none();
        if let Some(face) = hosts.iter().map(|f| &self.faces[*f]).find(is_solid) {
            let name = &surface(face).object;
            return Err(format!(
                "opens `{name}`, which is solid; give its finish a `thickness_m`, so that it is hollow"
            ));
        }
        // Among overlapping faces, the frontmost one has the rim.
        hosts.sort_by_key(|f| (std::cmp::Reverse(self.faces[*f].layer), *f));
        for (i, &host) in hosts.iter().enumerate() {
            let flat = hole.map(|p| p - self.faces[host].height(p) * self.faces[host].normal);
            let sides = sides(&flat, self.faces[host].normal);
            self.cut_edges(host as u32, &sides);
            let rims = self.rims(host, &flat, &hosts[..i]);
            self.owners.resize(self.owners.len() + rims.len(), self.parts[host]);
            self.edges.extend(rims);
        }
        let triangles = std::mem::take(&mut self.triangles);
        for (index, face) in self.faces.iter_mut().enumerate() {
            let start = self.triangles.len();
            let old = &triangles[face.triangles.clone()];
            if hosts.contains(&index) {
                let sides = sides(hole, face.normal);
                self.triangles.extend(old.iter().flat_map(|triangle| outside(triangle, &sides)));
            } else {
                self.triangles.extend(old);
            }
            face.triangles = start..self.triangles.len();
        }
        Ok(())
    }

    fn triangles_of(&self, face: usize) -> &[Triangle] {
        &self.triangles[self.faces[face].triangles.clone()]
    }

    /// Cuts the opening out of the edges of a face. If only one of the two faces of an edge is removed, the other gets
    /// a rim.
    fn cut_edges(&mut self, host: u32, sides: &[Plane; 4]) {
        let (edges, owners) = (std::mem::take(&mut self.edges), std::mem::take(&mut self.owners));
        for (edge, owner) in edges.into_iter().zip(owners) {
            let [a, b] = edge.ends;
            let tolerance = TOUCHING / a.distance(b);
            let inside = if edge.faces.contains(&host) { within(edge.ends, sides, -TOUCHING) } else { None };
            let Some((start, end)) = inside.filter(|(start, end)| end - start > 3.0 * tolerance) else {
                self.edges.push(edge);
                self.owners.push(owner);
                continue;
            };
            let piece = |from: f64, to: f64| Edge { ends: [a.lerp(b, from), a.lerp(b, to)], ..edge.clone() };
            let mut pieces = Vec::new();
            pieces.extend((start > 2.0 * tolerance).then(|| piece(0.0, start)));
            pieces.extend((1.0 - end > 2.0 * tolerance).then(|| piece(end, 1.0)));
            if let Some(k) = edge.faces.iter().position(|f| *f != host) {
                let (face, along) = (edge.faces[k], edge.inwards()[k]);
                let normal = self.faces[face as usize].normal;
                pieces.push(Edge { faces: [face; 2], along, normal, outer_angle: 2.0, ..piece(start, end) });
            }
            self.owners.resize(self.owners.len() + pieces.len(), owner);
            self.edges.extend(pieces);
        }
    }

    /// Rims of an opening in a face: the parts of its sides beyond which the face continues and no face of `others`
    /// does.
    fn rims(&self, host: usize, hole: &[DVec3; 4], others: &[usize]) -> Vec<Edge> {
        let face = &self.faces[host];
        let mut rims = Vec::new();
        for (i, (normal, _)) in sides(hole, face.normal).into_iter().enumerate() {
            let ends = [hole[i], hole[(i + 1) % 4]];
            let beyond = ends.map(|p| p - 10.0 * TOUCHING * normal);
            let mut held: Vec<(f64, f64)> = self
                .triangles_of(host)
                .iter()
                .filter_map(|t| within(beyond, &sides(&t.corners(), face.normal), 0.0))
                .collect();
            held.sort_by(|a, b| a.0.total_cmp(&b.0));
            held.dedup_by(|next, last| {
                let joined = next.0 <= last.1 + 1e-9;
                if joined {
                    last.1 = last.1.max(next.1);
                }
                joined
            });
            let at = |t: f64| ends[0].lerp(ends[1], t);
            let is_long = |(start, end): &(f64, f64)| (end - start) * ends[0].distance(ends[1]) > 1e-3;
            let is_bare = |(start, end): &(f64, f64)| {
                let point = beyond[0].lerp(beyond[1], 0.5 * (start + end));
                !others.iter().any(|f| is_near(&self.faces[*f], point, self.triangles_of(*f)))
            };
            rims.extend(held.into_iter().filter(is_long).filter(is_bare).map(|(start, end)| Edge {
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

/// Planes through the sides of a convex polygon, perpendicular to its plane.
fn sides<const N: usize>(corners: &[DVec3; N], normal: DVec3) -> [Plane; N] {
    let middle = corners.iter().sum::<DVec3>() / N as f64;
    std::array::from_fn(|i| {
        let across = normal.cross(corners[(i + 1) % N] - corners[i]).normalize();
        let inwards = if across.dot(middle - corners[i]) < 0.0 { -across } else { across };
        (inwards, inwards.dot(corners[i]))
    })
}

/// Interval, from 0 to 1, in which a segment is more than `least` metres inside.
fn within([a, b]: [DVec3; 2], sides: &[Plane], least: f64) -> Option<(f64, f64)> {
    let (mut start, mut end) = (0.0_f64, 1.0_f64);
    for (normal, offset) in sides {
        let (at_a, at_b) = (normal.dot(a) - offset - least, normal.dot(b) - offset - least);
        match (at_a >= 0.0, at_b >= 0.0) {
            (true, true) => {}
            (false, false) => return None,
            (false, true) => start = start.max(at_a / (at_a - at_b)),
            (true, false) => end = end.min(at_a / (at_a - at_b)),
        }
    }
    (start < end).then_some((start, end))
}

/// Part of a triangle outside the opening, as triangles.
fn outside(triangle: &Triangle, sides: &[Plane; 4]) -> Vec<Triangle> {
    let mut rest = triangle.corners().to_vec();
    let mut pieces = Vec::new();
    for &(normal, offset) in sides {
        pieces.push(clip(&rest, (-normal, -offset)));
        rest = clip(&rest, (normal, offset));
        if area(&rest) <= LEAST_AREA {
            return vec![*triangle]; // nothing of it lies inside
        }
    }
    let fan = |piece: Vec<DVec3>| {
        let (first, rest) = piece.split_first().map_or((DVec3::ZERO, &[][..]), |(first, rest)| (*first, rest));
        let of = |w: &[DVec3]| Triangle { corner: first, sides: [w[0] - first, w[1] - first], face: triangle.face };
        rest.windows(2).map(of).filter(|t| t.area() > LEAST_AREA).collect::<Vec<_>>()
    };
    pieces.into_iter().flat_map(fan).collect()
}
