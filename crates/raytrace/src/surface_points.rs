//! Point sampling on surfaces, and output as PLY.

#[cfg(test)]
mod tests;

use glam::DVec3;
use pwrfgs_core::rng;
use std::io::{self, Write};

/// Levels of subdivision: a side of 10 m is halved down to 0.6 µm.
const LEVELS: u32 = 24;

/// Points on surfaces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfacePoints {
    /// Positions `[P,3]`, metres, world frame.
    pub points: Vec<DVec3>,
    /// Surface normals at the points, `[P,3]`.
    pub normals: Vec<DVec3>,
}

/// Samples `count` points on `triangles`, uniform by area, with the normal of each triangle (one per triangle in
/// `normals`).
///
/// Each triangle gets its share of points, rounded so that the shares of consecutive triangles add up. Points in a
/// triangle follow the low-discrepancy sequence of Basu and Owen (SIAM J. Numer. Anal. 53, 2015, section 3): the base-4
/// digits of the point number select one of the four triangles between the midpoints, level by level. 4^k points form a
/// lattice; the seed sets the positions of further points.
///
/// Without any area the result is empty.
pub fn sample_surfaces(triangles: &[[DVec3; 3]], normals: &[DVec3], count: usize, seed: u64) -> SurfacePoints {
    let mut cumulated = 0.0;
    // Twice the area up to and including each triangle.
    let area_sums: Vec<f64> = triangles
        .iter()
        .map(|[a, b, c]| {
            cumulated += (b - a).cross(c - a).length();
            cumulated
        })
        .collect();
    let mut cloud = SurfacePoints::default();
    if !(cumulated > 0.0 && cumulated.is_finite()) {
        return cloud;
    }
    cloud.points.reserve_exact(count);
    cloud.normals.reserve_exact(count);
    let mut random = rng::stream(seed, "surface", 0);
    let comb = rng::uniform_f64(&mut random);
    for ((triangle, normal), area_sum) in triangles.iter().zip(normals).zip(area_sums) {
        // Tooth k of the comb is at k + comb of `count` equal parts of the area; the last part ends at exactly 1.
        let end = (area_sum / cumulated * count as f64 - comb).ceil().max(0.0) as usize;
        let share = end.saturating_sub(cloud.points.len());
        // Offsets apply to digits of the lattice only; further digits would move points from cell centres to corners.
        let lattice = 1 << (2 * (share.max(1).ilog2() / 2));
        let offsets = rng::below(&mut random, lattice);
        cloud.points.extend((0..share).map(|k| point_in_triangle(triangle, k, offsets)));
        cloud.normals.resize(cloud.points.len(), *normal);
    }
    cloud
}

/// Returns the point `number` of the sequence in a triangle: the centre of the smallest triangle that its base-4 digits
/// select. `offsets` has a base-4 digit per level, which is added to that of `number`.
fn point_in_triangle(corners: &[DVec3; 3], number: usize, offsets: usize) -> DVec3 {
    let [mut a, mut b, mut c] = *corners;
    for level in 0..LEVELS {
        let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
        [a, b, c] = match ((number >> (2 * level)) + (offsets >> (2 * level))) % 4 {
            0 => [bc, ca, ab],
            1 => [a, ab, ca],
            2 => [ab, b, bc],
            _ => [ca, bc, c],
        };
    }
    (a + b + c) / 3.0
}

/// Writes a PLY file of the points: binary, little-endian, `x y z nx ny nz`, metres. All are float32; x, y and z are
/// float64 if a coordinate exceeds 1,000 m, since float32 would round.
///
/// The header marks the points as simulated; each line of `comment` is added to it, in ASCII.
///
/// # Errors
/// Errors of `file`.
pub fn write_ply(points: &SurfacePoints, comment: &str, file: &mut impl Write) -> io::Result<()> {
    let to_ascii = |c: char| if c == ' ' || c.is_ascii_graphic() { c } else { '?' };
    let mut lines = "comment simulated by pwrfgs: points on the surfaces of a scene, metres\n".to_owned();
    for line in comment.lines().filter(|line| !line.trim().is_empty()) {
        lines.extend("comment ".chars().chain(line.chars().map(to_ascii)).chain(['\n']));
    }
    let is_far = points.points.iter().any(|p| p.abs().max_element() > 1e3);
    let kind = if is_far { "double" } else { "float" };
    let properties = ["x", "y", "z"].map(|name| format!("property {kind} {name}\n")).concat()
        + &["nx", "ny", "nz"].map(|name| format!("property float {name}\n")).concat();
    let count = points.points.len();
    write!(file, "ply\nformat binary_little_endian 1.0\n{lines}element vertex {count}\n{properties}end_header\n")?;
    for (point, normal) in points.points.iter().zip(&points.normals) {
        let single = |vector: &DVec3| vector.to_array().map(|value| (value as f32).to_le_bytes());
        if is_far {
            file.write_all(point.to_array().map(f64::to_le_bytes).as_flattened())?;
        } else {
            file.write_all(single(point).as_flattened())?;
        }
        file.write_all(single(normal).as_flattened())?;
    }
    Ok(())
}
