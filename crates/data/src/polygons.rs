//! Polygons and their triangulation.

use glam::DVec3;
use pwrfgs_core::{Error, Result};
use std::path::Path;

/// Vertices `[V,3]` as read, in double precision, and triangle indices `[F,3]`, counted from 0.
pub type Triangles = (Vec<[f64; 3]>, Vec<[u32; 3]>);

/// Limit of side tests per corner of a polygon; most polygons need two.
const TESTS: usize = 64;

/// Faces of three or more corners with valid indices.
#[derive(Debug, Default)]
pub(crate) struct Polygons {
    corners: Vec<u32>,
    /// End index of each face in `corners`.
    ends: Vec<usize>,
}

impl Polygons {
    /// Adds a face with corner indices from 0 to below `vertices`. Returns the problem with fewer than three corners or an
    /// index out of range.
    pub(crate) fn push(&mut self, corners: &[i64], vertices: usize) -> Result<(), String> {
        if corners.len() < 3 {
            return Err(format!("a face has {} corners; give at least three, or remove it", corners.len()));
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

    /// Splits every face into a fan of triangles with the same orientation. Returns an error for a face without such a fan.
    pub(crate) fn triangulate(self, path: &Path, vertices: Vec<[f64; 3]>) -> Result<Triangles> {
        let mut triangles = Vec::with_capacity(self.corners.len().saturating_sub(2 * self.ends.len()));
        let mut start = 0;
        for (face, end) in self.ends.into_iter().enumerate() {
            let corners = &self.corners[start..end];
            start = end;
            let apex = find_fan_apex(&vertices, corners, TESTS * corners.len()).map_err(|fault| {
                let advice = "triangulate the mesh where it was made";
                Error::input(path, format!("face {} of {} corners {fault}; {advice}", face + 1, corners.len()))
            })?;
            let corner = |k: usize| corners[(apex + k) % corners.len()];
            triangles.extend((1..corners.len() - 1).map(|k| [corner(0), corner(k), corner(k + 1)]));
        }
        Ok((vertices, triangles))
    }
}

/// Returns the first corner whose triangle fan has the orientation of the whole polygon.
///
/// The fan then covers a simple polygon once, convex or not: an L has such a corner, a U has none. The side that
/// excluded the last corner is tested first, since it excludes most of its neighbours: about two tests per corner.
/// Returns the problem if there is no such corner, or none within `most` tests.
fn find_fan_apex(vertices: &[[f64; 3]], corners: &[u32], most: usize) -> Result<usize, &'static str> {
    let n = corners.len();
    if n == 3 {
        return Ok(0);
    }
    let corner = |k: usize| vertices[corners[k % n] as usize];
    let normal = (1..n - 1).fold(DVec3::ZERO, |sum, k| sum + double_area(corner(0), corner(k), corner(k + 1)));
    // Sides at the apex make no triangle.
    let rules_out = |side: usize, apex: usize| {
        side != apex
            && (side + 1) % n != apex
            && normal.dot(double_area(corner(apex), corner(side), corner(side + 1))) <= 0.0
    };
    let (mut last, mut tests) = (0, 0);
    for apex in 0..n {
        let mut sides = std::iter::once(last).chain((1..n - 1).map(|k| (apex + k) % n));
        match sides.find(|&side| {
            tests += 1;
            rules_out(side, apex)
        }) {
            Some(side) => last = side,
            None => return Ok(apex),
        }
        if tests > most {
            return Err("is too intricate to be filled by a fan of triangles");
        }
    }
    Err("is not filled by any fan of triangles")
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
            let apex = find_fan_apex(&vertices, &corners, 4 * n).unwrap();
            let corner = |k: usize| vertices[(apex + k) % n];
            assert!((1..n - 1).all(|k| double_area(corner(0), corner(k), corner(k + 1))[2] > 0.0), "{n} corners");
        }
        let (vertices, corners) = (dented(500), (0..500).collect::<Vec<u32>>());
        let error = find_fan_apex(&vertices, &corners, 100).unwrap_err();
        assert_eq!(error, "is too intricate to be filled by a fan of triangles");
    }

    #[test]
    fn reports_polygons_that_cannot_be_filled() {
        let u = [[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [2.0, 3.0], [2.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]];
        let advice = "is not filled by any fan of triangles; triangulate the mesh where it was made";
        assert_eq!(triangles(&u).unwrap_err(), format!("a.obj: face 1 of 8 corners {advice}"));
        let flat = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]];
        assert_eq!(triangles(&flat).unwrap_err(), format!("a.obj: face 1 of 4 corners {advice}"));
        let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(triangles(&bow).unwrap_err(), format!("a.obj: face 1 of 4 corners {advice}"));
        assert_eq!(triangles(&u[..2]).unwrap_err(), "a face has 2 corners; give at least three, or remove it");
        for (corner, name) in [(3, "3"), (-1, "-1"), (1 << 40, "1099511627776")] {
            let message = Polygons::default().push(&[0, 1, corner], 3).unwrap_err();
            assert_eq!(message, format!("a face names vertex {name}, counted from 0, of 3; correct the index"));
        }
    }
}
