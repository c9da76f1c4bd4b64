//! Where images must be if those found already are: mirrored in the planes that pairs of them share.
//!
//! If v' is the image of v behind a wall, that wall is the plane half-way between them, and every other source has an
//! image behind it too. So few places need so little proof that weak images of a second mirroring are told from noise.

use crate::virtual_transmitters::sweep::Peak;

/// Share of the moving positions that may lie behind a wall, as over the edge of a table.
const BEHIND: f64 = 0.02;

/// The mirror images of all `places` in all planes half-way between two of them, those of `hear` on one side alone;
/// without those that `holds` does not hold and those nearer than `apart` to a place or to each other.
pub(crate) fn images(
    places: &[[f64; 3]],
    hear: &[[f64; 3]],
    holds: impl Fn([f64; 3]) -> bool,
    apart: f64,
) -> Vec<[f64; 3]> {
    let near = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>() < apart * apart;
    let mut found: Vec<[f64; 3]> = Vec::new();
    for (i, a) in places.iter().enumerate() {
        for b in &places[..i] {
            let Some(plane) = Plane::between(*a, *b).filter(|p| p.clear_of(hear)) else { continue };
            for v in places {
                let image = plane.mirrored(*v);
                if holds(image) && !places.iter().chain(&found).any(|p| near(p, &image)) {
                    found.push(image);
                }
            }
        }
    }
    found
}

/// n·x = at, with n of length 1.
struct Plane {
    n: [f64; 3],
    at: f64,
}

impl Plane {
    fn between(a: [f64; 3], b: [f64; 3]) -> Option<Self> {
        let by = [0, 1, 2].map(|k| b[k] - a[k]);
        let length = by.iter().map(|x| x * x).sum::<f64>().sqrt();
        if length < 1e-3 {
            return None;
        }
        let n = by.map(|x| x / length);
        Some(Self { n, at: (0..3).map(|k| n[k] * (a[k] + b[k]) / 2.0).sum() })
    }

    fn above(&self, x: &[f64; 3]) -> f64 {
        (0..3).map(|k| self.n[k] * x[k]).sum::<f64>() - self.at
    }

    fn clear_of(&self, hear: &[[f64; 3]]) -> bool {
        let above = hear.iter().filter(|p| self.above(p) > 0.0).count() as f64 / hear.len().max(1) as f64;
        above.min(1.0 - above) <= BEHIND
    }

    fn mirrored(&self, v: [f64; 3]) -> [f64; 3] {
        let above = self.above(&v);
        [0, 1, 2].map(|k| v[k] - 2.0 * above * self.n[k])
    }
}

/// Candidates without a score, each with every rotation.
pub(crate) fn as_peaks(places: &[[f64; 3]], quats: &[[f64; 4]]) -> Vec<Peak> {
    let all = |quat: &[f64; 4]| {
        let quat = *quat;
        places.iter().map(move |place| Peak { place: *place, quat, explains: 0.0 })
    };
    quats.iter().flat_map(all).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_of_two_walls_follows_from_two_images() {
        let (node, wall, floor) = ([1.0, 0.5, 1.5], [-3.0, 0.5, 1.5], [1.0, 0.5, -1.5]);
        let hear = [[0.0, 0.0, 1.0], [1.0, 1.0, 2.0]];
        let found = images(&[node, wall, floor], &hear, |_| true, 0.05);
        assert!(found.iter().any(|p| (0..3).all(|k| (p[k] - [-3.0, 0.5, -1.5][k]).abs() < 1e-12)), "{found:?}");
        let across = images(&[node, wall], &[[-2.0, 0.0, 1.0], [1.0, 1.0, 2.0]], |_| true, 0.05);
        assert!(across.is_empty(), "no wall goes through where the moving end was: {across:?}");
    }
}
