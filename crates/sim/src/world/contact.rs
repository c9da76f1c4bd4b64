//! What touches what: faces in one plane, and edges that lie on something else.

use super::hierarchy::Hierarchy;
use super::{Edge, Face, Triangle};
use glam::DVec3;
use std::collections::BTreeMap;

/// What lies closer than this to a face of something else touches it, metres.
pub(crate) const TOUCHING: f64 = 1e-4;
/// How far beyond an edge is looked whether something goes on there, metres.
const BEYOND: f64 = 1e-3;
/// Most pairs of faces that lie on each other: more would exhaust the memory.
const MOST_PAIRS: usize = 5_000_000;

/// Faces and triangles of all parts.
pub(super) struct Contacts<'a> {
    pub(super) faces: &'a [Face],
    pub(super) triangles: &'a [Triangle],
    pub(super) hierarchy: &'a Hierarchy,
}

impl Contacts<'_> {
    /// Whether an edge lies on something else for most of its length, as that of a board on a wall does: it is no edge.
    /// What lies on the edge's own faces ends there with them, unless it goes on beyond. `is_other` says whether a face
    /// belongs to another part.
    pub(super) fn ends(&self, edge: &Edge, is_other: &dyn Fn(u32) -> bool) -> bool {
        let lies_on = |face: u32, host: u32| {
            let [face, host] = [face, host].map(|f| &self.faces[f as usize]);
            face.layer > host.layer && is_coplanar(face, host)
        };
        let is_near = |t: f64| {
            let point = edge.ends[0].lerp(edge.ends[1], t);
            let is_apart = |face: u32| !edge.faces.iter().any(|host| lies_on(face, *host));
            let goes_on = |(host, inwards): (u32, DVec3)| {
                self.is_near_any(point - BEYOND * inwards, &|face| is_other(face) && lies_on(face, host))
            };
            self.is_near_any(point, &|face| is_other(face) && is_apart(face))
                || edge.faces.into_iter().zip(edge.inwards()).any(goes_on)
        };
        [0.1, 0.3, 0.5, 0.7, 0.9].into_iter().filter(|t| is_near(*t)).count() >= 3
    }

    fn is_near_any(&self, point: DVec3, counts: &dyn Fn(u32) -> bool) -> bool {
        self.hierarchy.around(point, TOUCHING).map(|i| &self.triangles[i]).any(|triangle| {
            let face = &self.faces[triangle.face as usize];
            is_near(face, point, std::slice::from_ref(triangle)) && counts(triangle.face)
        })
    }
}

/// Whether a point touches a face, of which these are triangles.
pub(super) fn is_near(face: &Face, point: DVec3, triangles: &[Triangle]) -> bool {
    let height = face.height(point);
    height.abs() < TOUCHING && triangles.iter().any(|t| t.contains(point - height * face.normal))
}

/// Whether `one` lies in the plane of `other`.
pub(super) fn is_coplanar(one: &Face, other: &Face) -> bool {
    one.hull.iter().all(|p| other.height(*p).abs() < TOUCHING)
}

/// Finds the faces that share a plane and may overlap.
///
/// # Errors
/// There are too many.
pub(super) fn find_twins(faces: &mut [Face]) -> Result<(), String> {
    // Faces in one plane have the same rounded key but for those at its borders, whose neighbours are looked at too.
    let key = |face: &Face, nudge: f64| {
        let n = face.normal;
        let sign = if n.x + 1.1 * n.y + 1.3 * n.z < 0.0 { -1.0 } else { 1.0 };
        let grid = |v: f64| (sign * v * 1e3 + nudge).floor() as i64;
        [grid(n.x), grid(n.y), grid(n.z), grid(face.offset)]
    };
    let bounds: Vec<[DVec3; 2]> = faces.iter().map(bounds).collect();
    let mut pairs = Vec::new();
    for nudge in [0.25, 0.75] {
        let mut planes: BTreeMap<[i64; 4], Vec<u32>> = BTreeMap::new();
        for (index, face) in faces.iter().enumerate() {
            planes.entry(key(face, nudge)).or_default().push(index as u32);
        }
        planes.into_values().try_for_each(|plane| pairs_of(plane, faces, &bounds, &mut pairs))?;
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

fn bounds(face: &Face) -> [DVec3; 2] {
    let corners = || face.hull.iter().copied();
    let (low, high) = (corners().reduce(DVec3::min), corners().reduce(DVec3::max));
    [low.unwrap_or_default() - TOUCHING, high.unwrap_or_default() + TOUCHING]
}

/// Pairs among the faces of about one plane, the earlier face first: a sweep along its longest axis.
fn pairs_of(
    mut plane: Vec<u32>,
    faces: &[Face],
    bounds: &[[DVec3; 2]],
    pairs: &mut Vec<[u32; 2]>,
) -> Result<(), String> {
    let of = |face: u32| bounds[face as usize];
    let low = plane.iter().map(|f| of(*f)[0]).reduce(DVec3::min).unwrap_or_default();
    let high = plane.iter().map(|f| of(*f)[1]).reduce(DVec3::max).unwrap_or_default();
    let axis = (high - low).max_position();
    plane.sort_by(|a, b| of(*a)[0][axis].total_cmp(&of(*b)[0][axis]));
    for (i, &a) in plane.iter().enumerate() {
        for &b in plane[i + 1..].iter().take_while(|b| of(**b)[0][axis] <= of(a)[1][axis]) {
            let overlap = of(a)[0].cmple(of(b)[1]).all() && of(b)[0].cmple(of(a)[1]).all();
            let (first, second) = (a.min(b), a.max(b));
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
