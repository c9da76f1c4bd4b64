//! stub
#![allow(missing_docs)]
use glam::DVec3;
use pwrfgs_core::rng;
#[derive(Clone, Debug)]
pub struct SurfacePoints {
    pub points: Vec<DVec3>,
    pub normals: Vec<DVec3>,
}
pub fn sample(t: &[[DVec3; 3]], n: &[DVec3], count: usize, seed: u64) -> SurfacePoints {
    let area: Vec<f64> = t.iter().map(|[a, b, c]| 0.5 * (*b - *a).cross(*c - *a).length()).collect();
    let sum: f64 = area.iter().sum();
    let mut r = rng::stream(seed, "surface", 0);
    let mut o = SurfacePoints { points: vec![], normals: vec![] };
    let mut i = 0;
    let mut acc = area[0];
    for k in 0..count {
        let x = (k as f64 + 0.5) / count as f64 * sum;
        while acc < x {
            i += 1;
            acc += area[i];
        }
        let (mut u, mut v) = (rng::uniform(&mut r) as f64, rng::uniform(&mut r) as f64);
        if u + v > 1.0 {
            u = 1.0 - u;
            v = 1.0 - v;
        }
        let [a, b, c] = t[i];
        o.points.push(a + u * (b - a) + v * (c - a));
        o.normals.push(n[i]);
    }
    o
}
pub fn to_ply(p: &SurfacePoints, c: &str) -> Vec<u8> {
    let mut o = format!("ply\nformat ascii 1.0\ncomment {c}\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n", p.points.len()).into_bytes();
    for q in &p.points {
        o.extend(format!("{} {} {}\n", q.x as f32, q.y as f32, q.z as f32).bytes());
    }
    o
}
