//! Contacts: coplanar faces, and edges that lie on other parts.

use super::{Edge, Face, Triangle};
use crate::hierarchy::Hierarchy;
use glam::DVec3;
use std::cell::Cell;
use std::collections::BTreeMap;

/// Distance below which parts touch, metres.
pub(crate) const TOUCHING: f64 = 1e-4;
/// Distance beyond an edge at which a continuing surface is probed, metres.
pub(super) const BEYOND: f64 = 1e-3;
/// Positions on an edge at which its surroundings are probed, from 0 to 1.
pub(super) const PROBES: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];
/// Least number of covered probes of an edge that counts as covered: most of its length.
pub(super) const COVERED_PROBES: usize = 3;
/// Largest number of overlapping face pairs, to limit memory.
const MOST_PAIRS: usize = 5_000_000;

/// Largest number of contact tests and compared corners, to limit time to minutes.
const MOST_TRIALS: usize = 500_000_000;
const TOO_MANY_TRIALS: &str = "its meshes touch in too many places; simplify them, or move them apart";

/// Faces and triangles of all parts.
pub(super) struct Contacts<'a> {
    faces: &'a [Face],
    triangles: &'a [Triangle],
    hierarchy: &'a Hierarchy,
    /// Part of each box in the hierarchy if all its triangles belong to one part.
    owners: Vec<Option<usize>>,
    trials: Cell<usize>,
}

impl<'a> Contacts<'a> {
    /// Creates the contact tests; `parts` has the part of each face.
    pub(super) fn new(faces: &'a [Face], triangles: &'a [Triangle], hierarchy: &'a Hierarchy, parts: &[usize]) -> Self {
        let owners = hierarchy.box_owners(|triangle| parts[triangles[triangle].face as usize]);
        Self { faces, triangles, hierarchy, owners, trials: Cell::new(0) }
    }

    /// Returns whether an edge of `part` lies on another part for most of its length, like the edge of a board on a
    /// wall: it then does not diffract. Parts on the faces of the edge count only if they continue beyond the edge.
    ///
    /// # Errors
    /// Too many tests for all edges so far.
    pub(super) fn is_covered(&self, edge: &Edge, part: usize) -> Result<bool, String> {
        let points = PROBES.map(|t| edge.ends[0].lerp(edge.ends[1], t));
        let is_covered = points.into_iter().filter(|p| self.is_covered_at(*p, edge, part)).count() >= COVERED_PROBES;
        if self.trials.get() > MOST_TRIALS { Err(TOO_MANY_TRIALS.into()) } else { Ok(is_covered) }
    }

    /// Returns whether another part than `part` touches `point` of the edge, or covers a face of the edge and continues
    /// beyond `point`.
    fn is_covered_at(&self, point: DVec3, edge: &Edge, part: usize) -> bool {
        let is_apart =
            |face: u32| !edge.faces.contains(&face) && !edge.faces.iter().any(|host| self.is_covering(face, *host));
        let continues = |(host, inwards): (u32, DVec3)| {
            self.is_near_other_part(point - BEYOND * inwards, part, &|face| self.is_covering(face, host))
        };
        self.is_near_other_part(point, part, &is_apart)
            || edge.faces.into_iter().zip(edge.inward_directions()).any(continues)
    }

    /// Returns whether `face` is in the plane of `host` and in a later layer, in front of it.
    fn is_covering(&self, face: u32, host: u32) -> bool {
        let [face, host] = [face, host].map(|f| &self.faces[f as usize]);
        face.layer > host.layer && is_coplanar(face, host)
    }

    /// Returns whether a face of another part than `part` touches the point and is eligible. Boxes of only that part
    /// are skipped: near the tip of a fan there are as many as triangles.
    fn is_near_other_part(&self, point: DVec3, part: usize, is_eligible: &dyn Fn(u32) -> bool) -> bool {
        let is_other = |number: usize| {
            self.trials.set(self.trials.get() + 1);
            self.owners[number] != Some(part)
        };
        self.hierarchy.near_point(point, TOUCHING, is_other).map(|i| &self.triangles[i]).any(|triangle| {
            let face = &self.faces[triangle.face as usize];
            is_near_face(face, point, std::slice::from_ref(triangle)) && is_eligible(triangle.face)
        })
    }
}

/// Returns whether a point touches one of these triangles of a face.
pub(super) fn is_near_face(face: &Face, point: DVec3, triangles: &[Triangle]) -> bool {
    let height = face.height(point);
    height.abs() < TOUCHING && triangles.iter().any(|t| t.contains(point - height * face.normal))
}

/// Returns whether `one` lies in the plane of `other`.
pub(super) fn is_coplanar(one: &Face, other: &Face) -> bool {
    one.hull.iter().all(|p| other.height(*p).abs() < TOUCHING)
}

/// Sets the `twins` of each face: coplanar faces that may overlap with it, in order.
///
/// # Errors
/// Too many pairs or tests.
pub(super) fn find_twins(faces: &mut [Face]) -> Result<(), String> {
    // Coplanar faces are in the same cell: its side of 1e-3 (normals; offsets in metres) is wide against `TOUCHING`. The
    // second of two shifted grids joins those that a cell border of the first separates.
    let key = |face: &Face, nudge: f64| {
        let n = face.normal;
        // Opposite normals have one key; with these weights, no common normal gives a sum near 0.
        let sign = if n.x + 1.1 * n.y + 1.3 * n.z < 0.0 { -1.0 } else { 1.0 };
        let grid = |v: f64| (sign * v * 1e3 + nudge).floor() as i64;
        [grid(n.x), grid(n.y), grid(n.z), grid(face.offset)]
    };
    let (mut pairs, mut trials) = (Vec::new(), 0);
    for nudge in [0.25, 0.75] {
        let mut planes: BTreeMap<[i64; 4], Vec<(u32, [DVec3; 2])>> = BTreeMap::new();
        for (index, face) in (0..).zip(&*faces) {
            planes.entry(key(face, nudge)).or_default().push((index, bounding_box(&face.hull, TOUCHING)));
        }
        planes.into_values().try_for_each(|plane| collect_pairs(plane, faces, &mut pairs, &mut trials))?;
    }
    pairs.sort_unstable();
    pairs.dedup();
    for [one, other] in pairs {
        faces[one as usize].twins.push(other);
        faces[other as usize].twins.push(one);
    }
    faces.iter_mut().for_each(|face| face.twins.sort_unstable());
    Ok(())
}

/// Returns the lowest and highest corner of the bounding box of points, larger by `margin` on each side, metres; around
/// zero without points.
pub(super) fn bounding_box(points: &[DVec3], margin: f64) -> [DVec3; 2] {
    let points = || points.iter().copied();
    let (low, high) = (points().reduce(DVec3::min), points().reduce(DVec3::max));
    [low.unwrap_or_default() - margin, high.unwrap_or_default() + margin]
}

/// Adds the pairs of overlapping coplanar faces to `pairs`, the earlier face first, and counts the tests in `trials`. `plane` has
/// nearly coplanar faces with their bounding boxes. Sweeps along the longest axis, so that only faces that overlap on it are
/// compared.
///
/// # Errors
/// Too many pairs or tests so far.
fn collect_pairs(
    mut plane: Vec<(u32, [DVec3; 2])>,
    faces: &[Face],
    pairs: &mut Vec<[u32; 2]>,
    trials: &mut usize,
) -> Result<(), String> {
    let corners: Vec<DVec3> = plane.iter().flat_map(|(_, bounds)| *bounds).collect();
    let [low, high] = bounding_box(&corners, 0.0);
    let axis = (high - low).max_position();
    plane.sort_by(|(_, [a, _]), (_, [b, _])| a[axis].total_cmp(&b[axis]));
    for (i, &(a, [low, high])) in plane.iter().enumerate() {
        for &(b, bounds) in plane[i + 1..].iter().take_while(|(_, bounds)| bounds[0][axis] <= high[axis]) {
            let overlap = low.cmple(bounds[1]).all() && bounds[0].cmple(high).all();
            let (first, second) = (a.min(b), a.max(b));
            *trials += if overlap { faces[second as usize].hull.len() } else { 1 };
            if *trials > MOST_TRIALS {
                return Err(TOO_MANY_TRIALS.into());
            }
            if overlap && is_coplanar(&faces[second as usize], &faces[first as usize]) {
                pairs.push([first, second]);
            }
        }
        if pairs.len() > MOST_PAIRS {
            return Err("millions of its faces lie on each other; remove double faces from its meshes".into());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Complex;
    use crate::mesh::Mesh;
    use crate::scattering::Lobe;
    use crate::world::{Surface, WorldBuilder, WorldPart};

    /// Returns a zigzag fan of `count` triangles about one vertex.
    fn fan(count: usize) -> Mesh {
        let rim = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / (count + 1) as f64).sin_cos();
            DVec3::new(cos, sin, if k.is_multiple_of(2) { 0.0 } else { 0.3 })
        };
        let vertices = std::iter::once(DVec3::ZERO).chain((0..=count).map(rim)).collect();
        Mesh { vertices, triangles: (1..=count as u32).map(|k| [0, k, k + 1]).collect() }
    }

    #[test]
    fn fan_edges_visit_bounded_number_of_boxes() {
        let mut builder = WorldBuilder::default();
        let (eta, lobe) = (Complex::new(4.0, 0.0), Lobe::Lambertian);
        builder.add_surface(Surface { object: "a".into(), eta, thickness: Some(0.01), roughness: 0.0, lobe });
        let describe = |_: DVec3, _: usize| ("a".to_owned(), 0);
        let room = Mesh {
            vertices: [(-2.0, -2.0), (2.0, -2.0), (0.0, 2.0)].map(|(x, y)| DVec3::new(x, y, -1.0)).into(),
            triangles: vec![[0, 1, 2]],
        };
        for mesh in [room, fan(1_000)] {
            builder.add_part(&WorldPart { name: "a", mesh: &mesh, closed: false, describe: &describe });
        }
        let hierarchy = Hierarchy::new(&builder.triangles);
        let contacts = Contacts::new(&builder.faces, &builder.triangles, &hierarchy, &builder.parts);
        for (edge, part) in builder.edges.iter().zip(&builder.owners) {
            assert!(!contacts.is_covered(edge, *part).unwrap());
        }
        let edges = builder.edges.len();
        assert!(edges > 1_900 && contacts.trials.get() < 100 * edges, "{} boxes", contacts.trials.get());
    }
}
