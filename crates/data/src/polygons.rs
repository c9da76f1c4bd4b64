//! Polygons and their triangulation.

use crate::text::warn_once;
use earcut::Earcut;
use glam::{DVec2, DVec3};
use pwrfgs_core::{Error, Result};
use std::path::Path;

/// Vertices `[V,3]` as read, in double precision, and triangle indices `[F,3]`, counted from 0.
pub type Triangles = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// Largest number of triangles of a mesh: more take minutes and gigabytes before the first path.
pub const MOST_TRIANGLES: usize = 300_000;
/// Ratio of height to longest side below which a triangle has no area.
const FLAT: f64 = 1e-9;
/// Limit of side tests per corner of a polygon; most polygons need two.
const TESTS: usize = 64;
/// Largest number of corners of a polygon that no fan fills.
const MOST_CORNERS: usize = 5_000;

/// Faces of three or more corners with valid indices.
#[derive(Debug, Default)]
pub(crate) struct Polygons {
    corners: Vec<u32>,
    /// End index of each face in `corners`.
    ends: Vec<usize>,
}

impl Polygons {
    /// Adds a face with corner indices from 0 to below `vertices`. Returns the problem with fewer than three corners, an
    /// index out of range, or more than [`MOST_TRIANGLES`].
    pub(crate) fn push(&mut self, corners: &[i64], vertices: usize) -> Result<(), String> {
        if corners.len() < 3 {
            return Err(format!("a face has {} corners; give at least three, or remove it", corners.len()));
        }
        if self.triangle_count() + corners.len() - 2 > MOST_TRIANGLES {
            return Err(format!("the mesh has more than {MOST_TRIANGLES} triangles; simplify it"));
        }
        for &corner in corners {
            let index = u32::try_from(corner).ok().filter(|&index| (index as usize) < vertices);
            self.corners.push(index.ok_or_else(|| {
                format!("a face names vertex {corner}, counted from 0, of {vertices}; correct the index")
            })?);
        }
        self.ends.push(self.corners.len());
        Ok(())
    }

    /// Adds the triangles of strips, of which every second has its corners exchanged to keep the orientation; a negative index
    /// ends a strip. Returns the problems of [`Self::push`].
    pub(crate) fn push_strips(&mut self, corners: &[i64], vertices: usize) -> Result<(), String> {
        let windows = corners.split(|corner| *corner < 0).flat_map(|strip| strip.windows(3).enumerate());
        windows
            .map(|(k, t)| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] })
            .try_for_each(|triangle| self.push(&triangle, vertices))
    }

    /// Returns the number of triangles of all faces.
    fn triangle_count(&self) -> usize {
        self.corners.len() - 2 * self.ends.len()
    }

    /// Splits every face into triangles with the same orientation. Triangles without area and repeated corners are left
    /// out, with a warning that counts them. Returns an error for a face with a hole, or one that crosses itself.
    pub(crate) fn triangulate(self, path: &Path, vertices: Vec<[f64; 3]>) -> Result<Triangles> {
        let (total, mut start) = (self.triangle_count(), 0);
        let mut triangles = Vec::with_capacity(total);
        for (face, end) in self.ends.into_iter().enumerate() {
            let mut corners = self.corners[start..end].to_vec();
            start = end;
            corners.dedup_by_key(|corner| vertices[*corner as usize]);
            while corners.len() > 1 && vertices[corners[0] as usize] == vertices[corners[corners.len() - 1] as usize] {
                corners.pop();
            }
            let count = corners.len();
            split_polygon(&vertices, &corners, &mut triangles).map_err(|fault| {
                let advice = "triangulate the mesh where it was made";
                Error::input(path, format!("face {} of {count} corners {fault}; {advice}", face + 1))
            })?;
        }
        triangles.retain(|t| has_area(t.map(|corner| vertices[corner as usize])));
        let left_out = total - triangles.len();
        if left_out > 0 {
            warn_once(path, format_args!("{left_out} of {total} triangles have no area and are left out"));
        }
        Ok((vertices, triangles))
    }
}

/// Adds the triangles of a polygon whose neighbouring corners differ; none for fewer than three corners, or corners on a
/// line. Returns the problem with a polygon that touches or crosses itself, or that no fan fills and that has more corners
/// than [`MOST_CORNERS`].
fn split_polygon(vertices: &[[f64; 3]], corners: &[u32], out: &mut Vec<[u32; 3]>) -> Result<(), &'static str> {
    let n = corners.len();
    let corner = |k: usize| corners[k % n];
    let position = |k: usize| vertices[corner(k) as usize];
    let is_line = (2..n).all(|k| !has_area([position(0), position(k - 1), position(k)]));
    if is_line {
        return Ok(());
    }
    let normal = (2..n).fold(DVec3::ZERO, |sum, k| sum + double_area(position(0), position(k - 1), position(k)));
    if let Some(apex) = find_fan_apex(vertices, corners, normal, TESTS * n) {
        out.extend((1..n - 1).map(|k| [corner(apex), corner(apex + k), corner(apex + k + 1)]));
        return Ok(());
    }
    let mut sorted: Vec<[u64; 3]> = (0..n).map(|k| position(k).map(|v| (v + 0.0).to_bits())).collect();
    sorted.sort_unstable();
    if sorted.windows(2).any(|pair| pair[0] == pair[1]) {
        return Err("touches itself, as around a hole");
    }
    if n > MOST_CORNERS {
        return Err("is too intricate");
    }
    // The polygon is projected along the largest component of its normal.
    let axis = if normal.abs().max_element() == 0.0 { 2 } else { normal.abs().max_position() };
    let flat = |p: [f64; 3]| DVec2::new(p[(axis + 1) % 3], p[(axis + 2) % 3]);
    let plan: Vec<[f64; 2]> = (0..n).map(|k| (flat(position(k)) - flat(position(0))).to_array()).collect();
    let (mut ears, mut covered) = (Vec::<u32>::new(), 0.0);
    Earcut::new().earcut_slice(&plan, &[], &mut ears);
    for [a, b, c] in ears.as_chunks().0 {
        let [p, q, r] = [a, b, c].map(|k| DVec2::from(plan[*k as usize]));
        let area = (q - p).perp_dot(r - p) * normal[axis].signum();
        covered += area.abs();
        let [b, c] = if area < 0.0 { [c, b] } else { [b, c] };
        out.push([a, b, c].map(|k| corners[*k as usize]));
    }
    // Up to rounding, ears cover the area of the polygon, unless it crosses itself.
    if covered > 0.0 && (covered - normal[axis].abs()).abs() <= 1e-6 * covered { Ok(()) } else { Err("crosses itself") }
}

/// Returns the first corner whose triangle fan has the orientation of the whole polygon, along `normal`.
///
/// The fan then covers a simple polygon once, convex or not: an L has such a corner, a U has none. The side that
/// excluded the last corner is tested first, since it excludes most of its neighbours: about two tests per corner.
/// `None` if there is no such corner, or none within `most` tests.
fn find_fan_apex(vertices: &[[f64; 3]], corners: &[u32], normal: DVec3, most: usize) -> Option<usize> {
    let n = corners.len();
    if n == 3 {
        return Some(0);
    }
    let corner = |k: usize| vertices[corners[k % n] as usize];
    // Sides at the apex make no triangle.
    let rules_out = |side: usize, apex: usize| {
        side != apex
            && (side + 1) % n != apex
            && normal.dot(double_area(corner(apex), corner(side), corner(side + 1))) <= 0.0
    };
    let (mut last, mut tests) = (0, 0);
    for apex in 0..n {
        let mut sides = std::iter::once(last).chain((1..n - 1).map(|k| (apex + k) % n));
        last = match sides.find(|&side| {
            tests += 1;
            rules_out(side, apex)
        }) {
            Some(side) => side,
            None => return Some(apex),
        };
        if tests > most {
            break;
        }
    }
    None
}

/// Returns whether a triangle has an area: its height exceeds [`FLAT`] of its longest side.
fn has_area([a, b, c]: [[f64; 3]; 3]) -> bool {
    let longest = [[a, b], [b, c], [c, a]].map(|[p, q]| DVec3::from(p).distance_squared(DVec3::from(q)));
    // Twice the area over the squared longest side is the height relative to that side.
    double_area(a, b, c).length() > FLAT * longest.into_iter().fold(0.0, f64::max)
}

/// Returns twice the area of a triangle, as a vector along its normal.
fn double_area(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> DVec3 {
    let [a, b, c] = [a, b, c].map(DVec3::from);
    (b - a).cross(c - a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangles(corners: &[[f64; 2]]) -> Result<Triangles, String> {
        let vertices: Vec<[f64; 3]> = corners.iter().map(|[x, y]| [*x, *y, 2.0]).collect();
        let mut polygons = Polygons::default();
        let indices: Vec<i64> = (0..corners.len() as i64).collect();
        polygons.push(&indices, vertices.len())?;
        polygons.triangulate(Path::new("a.obj"), vertices).map_err(|e| e.to_string())
    }

    fn signed_area((vertices, triangles): &Triangles) -> f64 {
        triangles
            .iter()
            .map(|t| double_area(vertices[t[0] as usize], vertices[t[1] as usize], vertices[t[2] as usize])[2])
            .sum::<f64>()
            / 2.0
    }

    #[test]
    fn triangulated_polygons_keep_area_and_orientation() {
        let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let cut = triangles(&square).unwrap();
        assert_eq!(cut.1, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(signed_area(&cut), 4.0);
        // A fan from the first corner would leave the L shape.
        let l = [[2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0], [0.0, 0.0]];
        let cut = triangles(&l).unwrap();
        assert!(cut.1.iter().all(|t| t[0] == 2));
        assert_eq!(signed_area(&cut), 3.0);
        // A corner in the middle of a side: a triangle of zero area.
        let five = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let (vertices, cut) = triangles(&five).unwrap();
        let area_of =
            |t: &[u32; 3]| double_area(vertices[t[0] as usize], vertices[t[1] as usize], vertices[t[2] as usize])[2];
        assert!(cut.iter().all(|t| area_of(t) > 0.0));
        let mut clockwise = l;
        clockwise.reverse();
        assert_eq!(signed_area(&triangles(&clockwise).unwrap()), -3.0);
    }

    /// Circle of `n` corners with a dent, whose two sides hide most corners from each other.
    fn dented(n: usize) -> Vec<[f64; 3]> {
        let corner = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / n as f64).sin_cos();
            let radius = if k == n / 3 { 0.5 } else { 1.0 };
            [radius * cos, radius * sin, 0.0]
        };
        (0..n).map(corner).collect()
    }

    #[test]
    fn finds_fan_with_few_tests_per_corner() {
        for n in [8, 500, 60_000] {
            let (vertices, corners) = (dented(n), (0..n as u32).collect::<Vec<_>>());
            let apex = find_fan_apex(&vertices, &corners, DVec3::Z, 4 * n).unwrap();
            let corner = |k: usize| vertices[(apex + k) % n];
            assert!((1..n - 1).all(|k| double_area(corner(0), corner(k), corner(k + 1))[2] > 0.0), "{n} corners");
        }
        let (vertices, corners) = (dented(500), (0..500).collect::<Vec<u32>>());
        assert_eq!(find_fan_apex(&vertices, &corners, DVec3::Z, 100), None);
    }

    #[test]
    fn concave_polygons_are_cut_by_ears() {
        let u = [[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [4.0, 5.0], [4.0, 2.0], [2.0, 2.0], [2.0, 5.0], [0.0, 5.0]];
        let (mut reversed, comb) = (u, comb(400));
        reversed.reverse();
        for (polygon, area) in [(&u[..], 24.0), (&reversed, -24.0), (&comb, 600.0)] {
            let cut = triangles(polygon).unwrap();
            assert_eq!(cut.1.len(), polygon.len() - 2);
            assert_eq!(signed_area(&cut), area);
            assert!(cut.1.iter().all(|t| area * signed_area(&(cut.0.clone(), vec![*t])) > 0.0));
        }
    }

    /// Returns a comb of `n` teeth of width 1 and height 1 on a bar of height 1: area 3 `n` / 2.
    fn comb(n: usize) -> Vec<[f64; 2]> {
        let teeth = (0..n).rev().map(|k| k as f64).flat_map(|x| [[x + 1.0, 1.0], [x + 0.5, 2.0]]);
        [[0.0, 0.0], [n as f64, 0.0]].into_iter().chain(teeth).chain([[0.0, 1.0]]).collect()
    }

    #[test]
    fn repeated_corners_and_flat_faces_are_left_out() {
        let twice = [[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]];
        let cut = triangles(&twice).unwrap();
        assert_eq!((cut.1.len(), signed_area(&cut)), (2, 4.0));
        let flat = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]];
        assert_eq!(triangles(&flat).unwrap().1, [[0; 3]; 0]);
    }

    #[test]
    fn reports_polygons_that_cannot_be_filled() {
        let advice = "triangulate the mesh where it was made";
        let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(triangles(&bow).unwrap_err(), format!("a.obj: face 1 of 4 corners crosses itself; {advice}"));
        let (outside, inside) = (
            [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [0.0, 0.0]],
            [[1.0, 1.0], [1.0, 2.0], [2.0, 2.0], [2.0, 1.0], [1.0, 1.0]],
        );
        let hole = [&outside[..], &inside].concat();
        let message = triangles(&hole).unwrap_err();
        assert_eq!(message, format!("a.obj: face 1 of 10 corners touches itself, as around a hole; {advice}"));
        assert_eq!(
            triangles(&comb(3_000)).unwrap_err(),
            format!("a.obj: face 1 of 6003 corners is too intricate; {advice}")
        );
        assert_eq!(triangles(&bow[..2]).unwrap_err(), "a face has 2 corners; give at least three, or remove it");
        for (corner, name) in [(3, "3"), (-1, "-1"), (1 << 40, "1099511627776")] {
            let message = Polygons::default().push(&[0, 1, corner], 3).unwrap_err();
            assert_eq!(message, format!("a face names vertex {name}, counted from 0, of 3; correct the index"));
        }
        let message = Polygons::default().push(&vec![0; MOST_TRIANGLES + 3], 3).unwrap_err();
        assert_eq!(message, "the mesh has more than 300000 triangles; simplify it");
    }
}
