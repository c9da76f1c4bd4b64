//! Convex polygons: clipping, area, and the difference of coplanar ones.

use crate::hierarchy::Triangle;
use glam::DVec3;

/// Distance below which corners lie in a plane, metres.
pub(crate) const THIN: f64 = 1e-9;
/// Minimum area of a clipped polygon, m²: smaller ones are rounding errors.
pub(crate) const LEAST_AREA: f64 = 1e-12;

/// Normal and offset, positive inside.
pub(crate) type Plane = (DVec3, f64);

/// Returns the part of a convex polygon with `normal`·x > `offset` (Sutherland and Hodgman, 1974); empty if there is none.
pub(crate) fn clip_polygon(polygon: &[DVec3], (normal, offset): Plane) -> Vec<DVec3> {
    let height = |p: DVec3| {
        let h = normal.dot(p) - offset;
        if h.abs() < THIN { 0.0 } else { h }
    };
    if polygon.iter().all(|p| height(*p) <= 0.0) {
        return Vec::new(); // such as the last mirror itself, and other faces in its plane
    }
    let mut clipped = Vec::with_capacity(polygon.len() + 1);
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (ha, hb) = (height(a), height(b));
        if ha >= 0.0 {
            clipped.push(a);
        }
        if ha * hb < 0.0 {
            clipped.push(a + (b - a) * (ha / (ha - hb)));
        }
    }
    clipped
}

/// Returns the area of a convex polygon, m².
pub(crate) fn polygon_area(polygon: &[DVec3]) -> f64 {
    let Some((first, rest)) = polygon.split_first() else { return 0.0 };
    0.5 * rest.windows(2).map(|w| (w[0] - first).cross(w[1] - first)).sum::<DVec3>().length()
}

/// Returns the planes through the sides of a convex polygon, perpendicular to its plane, positive inside.
pub(crate) fn side_planes<const N: usize>(corners: &[DVec3; N], normal: DVec3) -> [Plane; N] {
    let middle = corners.iter().sum::<DVec3>() / N as f64;
    std::array::from_fn(|i| {
        let across = normal.cross(corners[(i + 1) % N] - corners[i]).normalize();
        let inwards = if across.dot(middle - corners[i]) < 0.0 { -across } else { across };
        (inwards, inwards.dot(corners[i]))
    })
}

/// Returns the interval, within 0 to 1, in which the segment from `a` to `b` is more than `least` metres inside all
/// planes; `None` if there is none.
pub(crate) fn interval_inside([a, b]: [DVec3; 2], sides: &[Plane], least: f64) -> Option<(f64, f64)> {
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

/// Returns the part of a triangle outside a convex polygon in its plane, as triangles. `sides` are the planes of the
/// polygon, as of [`side_planes`].
pub(crate) fn triangles_outside(triangle: &Triangle, sides: &[Plane]) -> Vec<Triangle> {
    let mut inside = triangle.corners().to_vec();
    let mut pieces = Vec::new();
    for &(normal, offset) in sides {
        pieces.push(clip_polygon(&inside, (-normal, -offset)));
        inside = clip_polygon(&inside, (normal, offset));
        if polygon_area(&inside) <= LEAST_AREA {
            return vec![*triangle]; // nothing of it lies inside
        }
    }
    let fan = |piece: Vec<DVec3>| {
        let (first, rest) = piece.split_first().map_or((DVec3::ZERO, &[][..]), |(first, rest)| (*first, rest));
        let triangle_of =
            |w: &[DVec3]| Triangle { corner: first, sides: [w[0] - first, w[1] - first], face: triangle.face };
        rest.windows(2).map(triangle_of).filter(|t| t.area() > LEAST_AREA).collect::<Vec<_>>()
    };
    pieces.into_iter().flat_map(fan).collect()
}
