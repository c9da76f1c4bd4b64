//! Bounding volume hierarchy of triangles for segment queries.

use glam::DVec3;

/// Padding of boxes, metres: axis-aligned faces have zero thickness.
const PADDING: f64 = 1e-6;
/// Depth from which groups are halved, which bounds the depth of the tree.
const DEEP: u32 = 64;

/// Width of the border that counts as inside a triangle, in parts of its sides: rounding.
const BORDER: f64 = 1e-12;

/// A triangle with its face.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// First corner, metres.
    pub corner: DVec3,
    /// Vectors from the first corner to the other two.
    pub sides: [DVec3; 2],
    /// Index into [`World::faces`](crate::world::World::faces).
    pub face: u32,
}

impl Triangle {
    /// Creates a triangle from its corners, metres; it belongs to no face: `face` is `u32::MAX`.
    pub(crate) fn new([a, b, c]: [DVec3; 3]) -> Self {
        Self { corner: a, sides: [b - a, c - a], face: u32::MAX }
    }

    /// Returns the unit normal; seen from its side, the corners are in counter-clockwise order.
    pub(crate) fn normal(&self) -> DVec3 {
        self.sides[0].cross(self.sides[1]).normalize()
    }

    /// Returns the corner positions, metres.
    pub fn corners(&self) -> [DVec3; 3] {
        [self.corner, self.corner + self.sides[0], self.corner + self.sides[1]]
    }

    /// Returns the area, m².
    pub fn area(&self) -> f64 {
        0.5 * self.sides[0].cross(self.sides[1]).length()
    }

    /// Returns whether a point in the plane of the triangle lies inside, border included.
    pub(crate) fn contains(&self, point: DVec3) -> bool {
        let n = self.sides[0].cross(self.sides[1]);
        let p = point - self.corner;
        let scale = 1.0 / n.length_squared();
        let u = p.cross(self.sides[1]).dot(n) * scale;
        let v = self.sides[0].cross(p).dot(n) * scale;
        u >= -BORDER && v >= -BORDER && u + v <= 1.0 + BORDER
    }

    /// Returns the position of the intersection on the segment from `from` to `from + span`, from 0 to 1, borders of the
    /// triangle included (Möller and Trumbore, 1997); `None` without intersection and for coplanar segments.
    pub(crate) fn crossing(&self, from: DVec3, span: DVec3) -> Option<f64> {
        let [a, b] = self.sides;
        let p = span.cross(b);
        let volume = a.dot(p);
        let t = from - self.corner;
        let u = t.dot(p) / volume;
        if !(-BORDER..=1.0 + BORDER).contains(&u) {
            return None;
        }
        let q = t.cross(a);
        let v = span.dot(q) / volume;
        if v < -BORDER || u + v > 1.0 + BORDER {
            return None;
        }
        let position = b.dot(q) / volume;
        // A smaller volume is a rounding error of a coplanar segment.
        let least = 1e-28 * span.length_squared() * a.length_squared() * b.length_squared();
        ((0.0..=1.0).contains(&position) && volume * volume >= least).then_some(position)
    }
}

/// Tree in depth-first order.
#[derive(Debug)]
pub(crate) struct Hierarchy {
    nodes: Vec<Node>,
}

/// Box with one triangle, or with the nodes that follow it.
#[derive(Clone, Copy, Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// Triangle index; `u32::MAX` for an inner node.
    triangle: u32,
    /// Index of the node after the subtree.
    exit: u32,
}

impl Node {
    /// Creates the leaf of triangle `index`: its padded bounding box. `exit` is not set yet.
    fn leaf(index: usize, triangle: &Triangle) -> Self {
        let [a, b, c] = triangle.corners();
        let (low, high) = (a.min(b).min(c) - PADDING, a.max(b).max(c) + PADDING);
        Self { low, high, triangle: index as u32, exit: 0 }
    }

    /// Returns the inner node whose box bounds the boxes of both nodes. `exit` is not set yet.
    fn join(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high), triangle: u32::MAX, exit: 0 }
    }

    /// Returns half the surface area of the box, m².
    fn half_area(&self) -> f64 {
        let size = self.high - self.low;
        size.x * size.y + size.y * size.z + size.z * size.x
    }

    /// Returns whether the segment from `from` meets the box (slab test); `inverse` is 1 over its span. Along an axis
    /// without motion, `inverse` is infinite: a start on the padded border gives NaN, for which either result is correct,
    /// since no triangle reaches the padding. Comparisons take one instruction each, `f64::min` and `f64::max` three.
    fn is_crossed(&self, from: DVec3, inverse: DVec3) -> bool {
        let (mut enter, mut leave) = (0.0, 1.0);
        for k in 0..3 {
            let one = (self.low[k] - from[k]) * inverse[k];
            let other = (self.high[k] - from[k]) * inverse[k];
            let (near, far) = if one < other { (one, other) } else { (other, one) };
            enter = if near > enter { near } else { enter };
            leave = if far < leave { far } else { leave };
        }
        enter <= leave
    }
}

impl Hierarchy {
    /// Builds the tree over `triangles`.
    pub(crate) fn new(triangles: &[Triangle]) -> Self {
        let mut leaves: Vec<Node> = triangles.iter().enumerate().map(|(i, t)| Node::leaf(i, t)).collect();
        let mut nodes = Vec::with_capacity(2 * leaves.len());
        append_subtree(&mut nodes, &mut leaves, 0);
        Self { nodes }
    }

    /// Returns the indices of the triangles whose box meets the segment from `from` to `from + span`, in no particular
    /// order: all triangles that the segment crosses are among them.
    pub(super) fn near_segment(&self, from: DVec3, span: DVec3) -> impl Iterator<Item = usize> {
        let inverse = 1.0 / span;
        self.matching_leaves(move |_, node| node.is_crossed(from, inverse))
    }

    /// Returns the indices of the triangles whose box is at most `reach` metres from the point along each axis, in no
    /// particular order: all closer triangles are among them. Subtrees whose box index `is_wanted` rejects are skipped.
    pub(crate) fn near_point(
        &self,
        point: DVec3,
        reach: f64,
        is_wanted: impl Fn(usize) -> bool,
    ) -> impl Iterator<Item = usize> {
        let is_near = move |node: &Node| point.cmpge(node.low - reach).all() && point.cmple(node.high + reach).all();
        self.matching_leaves(move |number, node| is_near(node) && is_wanted(number))
    }

    /// Returns the indices of the triangles whose box touches the box between two corners, in no particular order: all
    /// triangles that touch it are among them.
    pub(super) fn in_box(&self, [low, high]: [DVec3; 2]) -> impl Iterator<Item = usize> {
        self.matching_leaves(move |_, node| node.low.cmple(high).all() && node.high.cmpge(low).all())
    }

    /// Returns the owner of each box: that of its triangles, `None` if they have several. `owner_of` maps the index of a
    /// triangle to its owner.
    pub(super) fn box_owners(&self, owner_of: impl Fn(usize) -> usize) -> Vec<Option<usize>> {
        let mut owners = vec![None; self.nodes.len()];
        for (i, node) in self.nodes.iter().enumerate().rev() {
            owners[i] = if node.triangle == u32::MAX {
                // The subtrees of an inner node follow it, one after the other.
                let second = self.nodes[i + 1].exit as usize;
                owners[i + 1].filter(|owner| owners[second] == Some(*owner))
            } else {
                Some(owner_of(node.triangle as usize))
            };
        }
        owners
    }

    /// Returns the indices of the triangles for which all boxes from the root (exclusive) to the leaf satisfy `is_hit`, a
    /// function of the index and the box; skips subtrees of other boxes.
    #[inline(always)]
    fn matching_leaves(&self, is_hit: impl Fn(usize, &Node) -> bool) -> impl Iterator<Item = usize> {
        let mut next = usize::from(self.nodes.len() > 1); // the first box holds all; a single box is tested
        std::iter::from_fn(move || {
            while let Some(node) = self.nodes.get(next) {
                if is_hit(next, node) {
                    next += 1;
                    if node.triangle != u32::MAX {
                        return Some(node.triangle as usize);
                    }
                } else {
                    next = node.exit as usize;
                }
            }
            None
        })
    }
}

/// Appends the subtree over `leaves` in depth-first order and sets its exits; reorders `leaves`.
fn append_subtree(nodes: &mut Vec<Node>, leaves: &mut [Node], depth: u32) {
    let Some(root) = leaves.iter().copied().reduce(Node::join) else { return };
    let index = nodes.len();
    nodes.push(root);
    if leaves.len() > 1 {
        let middle = if depth < DEEP { cheapest_split(leaves) } else { leaves.len() / 2 };
        let (one, other) = leaves.split_at_mut(middle);
        append_subtree(nodes, one, depth + 1);
        append_subtree(nodes, other, depth + 1);
    }
    nodes[index].exit = nodes.len() as u32;
}

/// Sorts `leaves` along the best axis and returns the index that splits them into two groups with the least sum of
/// surface area times number (surface area heuristic, Goldsmith and Salmon, 1987).
fn cheapest_split(leaves: &mut [Node]) -> usize {
    let count = leaves.len();
    let sort = |leaves: &mut [Node], axis: usize| {
        leaves.sort_unstable_by(|a, b| (a.low[axis] + a.high[axis]).total_cmp(&(b.low[axis] + b.high[axis])));
    };
    let mut cost_after = vec![0.0; count];
    let (mut least_cost, mut best_axis, mut split) = (f64::INFINITY, 0, count / 2);
    for axis in 0..3 {
        sort(leaves, axis);
        let mut part = leaves[count - 1];
        for i in (1..count).rev() {
            part = part.join(leaves[i]);
            cost_after[i] = part.half_area() * (count - i) as f64;
        }
        part = leaves[0];
        for i in 1..count {
            part = part.join(leaves[i - 1]);
            let cost = part.half_area() * i as f64 + cost_after[i];
            if cost < least_cost {
                (least_cost, best_axis, split) = (cost, axis, i);
            }
        }
    }
    sort(leaves, best_axis);
    split
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the points of a coarse grid: faces along the axes, triangles twice, segments in their planes and along
    /// the axes.
    fn point() -> impl Strategy<Value = DVec3> {
        prop_oneof![
            prop::array::uniform3(-2..=2_i8).prop_map(|p| DVec3::from(p.map(f64::from))),
            prop::array::uniform3(-2.0..2.0).prop_map(DVec3::from),
        ]
    }

    proptest! {
        #[test]
        fn hierarchy_finds_every_crossing(
            corners in prop::collection::vec([point(), point(), point()], 0..150),
            segments in prop::collection::vec([point(), point()], 30),
        ) {
            let triangle = |[a, b, c]: &[DVec3; 3]| Triangle { corner: *a, sides: [*b - *a, *c - *a], face: 0 };
            let triangles: Vec<Triangle> = corners.iter().map(triangle).collect();
            let hierarchy = Hierarchy::new(&triangles);
            for [from, to] in segments {
                let is_crossed = |i: &usize| triangles[*i].crossing(from, to - from).is_some();
                let mut crossed: Vec<usize> = hierarchy.near_segment(from, to - from).filter(is_crossed).collect();
                crossed.sort_unstable();
                let all: Vec<usize> = (0..triangles.len()).filter(is_crossed).collect();
                prop_assert_eq!(crossed, all);
            }
        }
    }

    #[test]
    fn duplicate_triangles_do_not_deepen_hierarchy() {
        let triangle = Triangle { corner: DVec3::ZERO, sides: [DVec3::X, DVec3::Y], face: 0 };
        let hierarchy = Hierarchy::new(&vec![triangle; 20_000]);
        let from = DVec3::new(0.2, 0.2, 1.0);
        assert_eq!(hierarchy.near_segment(from, -2.0 * DVec3::Z).count(), 20_000);
        assert_eq!(hierarchy.near_segment(from, DVec3::X).count(), 0);
    }
}
