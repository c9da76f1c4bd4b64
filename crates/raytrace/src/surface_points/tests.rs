//! Points lie on their triangles, evenly; the PLY file is valid.

use super::*;

/// Returns a rectangle of `width` × `height` metres in the plane x = `x`, cut along its diagonal.
fn wall(x: f64, width: f64, height: f64) -> [[DVec3; 3]; 2] {
    let at = |y, z| DVec3::new(x, y, z);
    let (a, b, c, d) = (at(0.0, 0.0), at(width, 0.0), at(width, height), at(0.0, height));
    [[a, b, c], [a, c, d]]
}

/// Samples points with the normals of the triangles.
fn sample_on(triangles: &[[DVec3; 3]], count: usize, seed: u64) -> SurfacePoints {
    let normals: Vec<DVec3> = triangles.iter().map(|[a, b, c]| (b - a).cross(c - a).normalize_or_zero()).collect();
    sample_surfaces(triangles, &normals, count, seed)
}

/// Returns the number of points in each of `n` × `n` equal cells of the wall.
fn cells(points: &[DVec3], width: f64, height: f64, n: usize) -> Vec<f64> {
    let mut counts = vec![0.0; n * n];
    for p in points {
        let cell = |v: f64, side: f64| ((v / side * n as f64) as usize).min(n - 1);
        counts[cell(p.z, height) * n + cell(p.y, width)] += 1.0;
    }
    counts
}

#[test]
fn points_lie_on_their_triangles_and_count_is_exact() {
    let mut triangles = wall(1.0, 3.0, 2.0).to_vec();
    triangles.push([DVec3::ZERO; 3]);
    triangles.extend(wall(-1.0, 0.01, 0.02));
    triangles.push([DVec3::new(0.0, 0.0, 5.0), DVec3::new(1.0, 2.0, 6.0), DVec3::new(-3.0, 1.0, 7.0)]);
    for count in [0, 1, 2, 7, 1000, 4096] {
        let cloud = sample_on(&triangles, count, 3);
        assert_eq!((cloud.points.len(), cloud.normals.len()), (count, count));
        for (point, normal) in cloud.points.iter().zip(&cloud.normals) {
            let is_inside = |[a, b, c]: &[DVec3; 3]| {
                let n = (b - a).cross(c - a);
                let part = |u: DVec3, v: DVec3| (u - point).cross(v - point).dot(n) / n.length_squared();
                let is_in_plane = ((point - a).dot(n.normalize_or_zero())).abs() < 1e-12;
                n.normalize_or_zero() == *normal
                    && is_in_plane
                    && [part(*b, *c), part(*c, *a), part(*a, *b)].iter().all(|p| *p > 0.0)
            };
            assert!(triangles.iter().any(is_inside), "{point}");
        }
    }
}

#[test]
fn point_count_is_proportional_to_triangle_area() {
    let mut triangles = Vec::new();
    (1..=40).for_each(|i| triangles.extend(wall(i as f64, 1.0, 0.1 * i as f64)));
    let cloud = sample_on(&triangles, 10_000, 5);
    let total: f64 = (1..=40).map(|i| 0.1 * i as f64).sum();
    for i in 1..=40 {
        let count = cloud.points.iter().filter(|p| p.x == i as f64).count() as f64;
        // Two triangles whose shares add up: one more or less.
        assert!((count - 10_000.0 * 0.1 * i as f64 / total).abs() < 1.0 + 1e-9, "wall {i}: {count}");
    }
    assert_eq!(sample_on(&[], 10, 0), SurfacePoints::default());
    assert_eq!(sample_on(&[[DVec3::ONE; 3]], 10, 0), SurfacePoints::default());
}

#[test]
fn points_are_more_even_than_independent_points() {
    // Independent points would have a χ² of 255 ± 23 over the 256 cells.
    for seed in 0..20 {
        let cloud = sample_on(&wall(0.0, 6.0, 3.0), 7600, seed);
        let expected = cloud.points.len() as f64 / 256.0;
        let chi: f64 = cells(&cloud.points, 6.0, 3.0, 16).iter().map(|n| (n - expected).powi(2) / expected).sum();
        assert!(chi < 50.0, "seed {seed}: χ² {chi}");
    }
}

#[test]
fn points_have_no_clusters_or_holes() {
    let cloud = sample_on(&wall(0.0, 1.0, 1.0), 4000, 1);
    // Independent points would be 0.5/√density from their nearest neighbours.
    let nearest = |i: usize| {
        let others = cloud.points.iter().enumerate().filter(|(j, _)| *j != i);
        others.map(|(_, q)| cloud.points[i].distance(*q)).fold(f64::INFINITY, f64::min)
    };
    let mean = (0..500).map(|k| nearest(8 * k)).sum::<f64>() / 500.0;
    assert!(mean * 4000.0f64.sqrt() > 0.65, "{}", mean * 4000.0f64.sqrt());
    let holes = (0..400).map(|k| DVec3::new(0.0, (k % 20) as f64 / 19.0, (k / 20) as f64 / 19.0));
    let largest = holes.map(|h| cloud.points.iter().map(|p| p.distance(h)).fold(f64::INFINITY, f64::min));
    let largest = largest.fold(0.0, f64::max);
    assert!(largest * 4000.0f64.sqrt() < 2.0, "{}", largest * 4000.0f64.sqrt());
}

#[test]
fn surface_points_depend_on_seed() {
    let triangles = wall(0.0, 6.0, 3.0);
    let bytes = |seed| ply(&sample_on(&triangles, 1000, seed), "room");
    assert_eq!(bytes(1), bytes(1));
    assert_ne!(bytes(1), bytes(2));
}

#[test]
fn surface_point_file_round_trips_with_title() {
    let cloud = sample_on(&wall(2.5, 6.0, 3.0), 1000, 0);
    let bytes = ply(&cloud, "scene: büro\r\n\nend_header\n");
    let head = "ply\nformat binary_little_endian 1.0\n\
        comment simulated by pwrfgs: points on the surfaces of a scene, metres\ncomment scene: b?ro\n\
        comment end_header\nelement vertex 1000\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nend_header\n";
    assert!(bytes.starts_with(head.as_bytes()), "{}", String::from_utf8_lossy(&bytes[..400]));
    assert_eq!(bytes.len(), head.len() + 1000 * 24);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cloud.ply");
    std::fs::write(&path, bytes).unwrap();
    let read = pwrfgs_data::read_points(&path).unwrap();
    assert_eq!(read.len(), 1000);
    for (read, point) in read.iter().zip(&cloud.points) {
        assert_eq!(read.map(|v| v as f32), point.to_array().map(|v| v as f32));
    }
}

fn ply(points: &SurfacePoints, comment: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_ply(points, comment, &mut bytes).unwrap();
    bytes
}
