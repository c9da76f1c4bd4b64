//! Which triangles a segment crosses, through a bounding-volume hierarchy.

use super::Triangle;
use bvh::aabb::{Aabb, Bounded};
use bvh::bounding_hierarchy::BHShape;
use bvh::bvh::Bvh;
use glam::DVec3;

/// Boxes are made wider by this, metres: axis-aligned faces would have none.
const PADDING: f64 = 1e-6;

/// A crossing: at `from + at·span`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Share of the segment, in [0, 1].
    pub(super) at: f64,
    /// Index of the triangle.
    pub(super) triangle: usize,
}

/// The flattened tree: nodes in depth-first order, each with the index behind its subtree.
#[derive(Debug)]
pub(super) struct Hierarchy {
    nodes: Vec<Node>,
}

/// A box with what lies in it: the node after it, or a triangle.
#[derive(Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// The first node inside; `u32::MAX` where it holds a triangle.
    entry: u32,
    /// The node after all that is inside.
    exit: u32,
    triangle: u32,
}

impl Node {
    fn new(bounds: &Aabb<f64, 3>, entry: u32, exit: u32, triangle: u32) -> Self {
        let corner = |p: [f64; 3]| DVec3::from(p);
        Self { low: corner(bounds.min.into()), high: corner(bounds.max.into()), entry, exit, triangle }
    }
}

struct Shape {
    bounds: Aabb<f64, 3>,
    node: usize,
}

impl Bounded<f64, 3> for Shape {
    fn aabb(&self) -> Aabb<f64, 3> {
        self.bounds
    }
}

impl BHShape<f64, 3> for Shape {
    fn set_bh_node_index(&mut self, index: usize) {
        self.node = index;
    }
    fn bh_node_index(&self) -> usize {
        self.node
    }
}

impl Hierarchy {
    pub(super) fn new(triangles: &[Triangle]) -> Self {
        let shape = |t: &Triangle| {
            let corners = t.corners();
            let low = corners.into_iter().reduce(DVec3::min).expect("three corners") - PADDING;
            let high = corners.into_iter().reduce(DVec3::max).expect("three corners") + PADDING;
            Shape { bounds: Aabb::with_bounds(low.to_array().into(), high.to_array().into()), node: 0 }
        };
        let mut shapes: Vec<Shape> = triangles.iter().map(shape).collect();
        Self { nodes: Bvh::build(&mut shapes).flatten_custom(&Node::new) }
    }

    /// Shows every crossing of the segment to `see`, in no order, until it returns false. Returns whether it never did.
    pub(super) fn all(
        &self,
        triangles: &[Triangle],
        from: DVec3,
        span: DVec3,
        mut see: impl FnMut(Hit) -> bool,
    ) -> bool {
        let inverse = 1.0 / span;
        let mut i = 0;
        while let Some(node) = self.nodes.get(i) {
            if node.entry == u32::MAX {
                let triangle = node.triangle as usize;
                if let Some(at) = crossing(&triangles[triangle], from, span)
                    && !see(Hit { at, triangle })
                {
                    return false;
                }
                i = node.exit as usize;
            } else {
                i = if meets_box(node, from, inverse) { node.entry } else { node.exit } as usize;
            }
        }
        true
    }
}

/// The slab test. Along an axis that the segment does not move on, `inverse` is infinite: a start on the padded border
/// gives NaN there, which `f64::min` and `f64::max` pass over.
fn meets_box(node: &Node, from: DVec3, inverse: DVec3) -> bool {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for k in 0..3 {
        let one = (node.low[k] - from[k]) * inverse[k];
        let other = (node.high[k] - from[k]) * inverse[k];
        enter = enter.max(one.min(other));
        leave = leave.min(one.max(other));
    }
    enter <= leave
}

/// Where a segment crosses a triangle (Möller and Trumbore, 1997), borders included; a segment in its plane does not.
pub(super) fn crossing(triangle: &Triangle, from: DVec3, span: DVec3) -> Option<f64> {
    const BORDER: f64 = 1e-12;
    let [a, b] = triangle.sides;
    let p = span.cross(b);
    let volume = a.dot(p);
    if volume.abs() < 1e-14 * span.length() * a.length() * b.length() {
        return None;
    }
    let t = from - triangle.corner;
    let u = t.dot(p) / volume;
    if !(-BORDER..=1.0 + BORDER).contains(&u) {
        return None;
    }
    let q = t.cross(a);
    let v = span.dot(q) / volume;
    if v < -BORDER || u + v > 1.0 + BORDER {
        return None;
    }
    let at = b.dot(q) / volume;
    (0.0..=1.0).contains(&at).then_some(at)
}
