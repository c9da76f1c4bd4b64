//! Gaussians in evenly spaced directions, all of them visible.

use crate::start;
use pwrfgs_core::{GaussianCloud, ImagePlane, Initializer, JsonSchema, Real, Result, Scene, Vec3, consts, rng::Rng};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Regular grid of directions on a sphere about the receiver.
///
/// The grid has rings of equal elevation, each with a number of azimuths in proportion to its solid angle, so that
/// directions are nearly uniform. Every Gaussian covers about the same part of the spectrum, and none is hidden. It is
/// the best start for few Gaussians without a point cloud; it is not part of the paper. If pixels are angles of the
/// true pose, the grid covers the hemisphere in front of the receiver, or the sphere if the spectrum includes
/// directions behind it. With images of a camera it covers the sphere about the transmitter. With the released projection
/// it covers the whole sphere about the actual centre of that projection, −R·r with R and r the orientation and position
/// of the receiver.
///
/// ```
/// # use pwrfgs_init as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("Grid(count: 800, distance_m: 4.0)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Grid {
    /// Number of Gaussians.
    pub count: usize,
    /// Distance from the centre of the grid, metres.
    pub distance_m: Real,
    /// Scale (one standard deviation) relative to the grid spacing: 1 leaves no gap, 0.5 gives little overlap.
    pub overlap: Real,
    /// Opacity of every Gaussian, above 0 and below 1.
    pub opacity: Real,
}

impl Default for Grid {
    fn default() -> Self {
        Self { count: 500, distance_m: 5.0, overlap: 1.0, opacity: 0.1 }
    }
}

#[typetag::serde]
impl Initializer for Grid {
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let world_from_receiver = scene.pose().world_from_receiver();
        let (lowest, centre) = match plane.angles {
            Some(_) => (if plane.has_directions_behind() { -FRAC_PI_2 } else { 0.0 }, scene.pose().position_vec()),
            None if plane.camera.is_some() => (-FRAC_PI_2, scene.pose().position_vec()),
            None => (-FRAC_PI_2, -(world_from_receiver * scene.pose().position_vec())),
        };
        let centre_along = |direction: [f64; 3]| {
            let direction = Vec3::from_array(direction.map(|v| v as Real));
            (centre + world_from_receiver * direction * self.distance_m).to_array()
        };
        let means: Vec<[Real; 3]> = directions(self.count, lowest).into_iter().map(centre_along).collect();
        // Side of the patch of solid angle per Gaussian at unit distance, as in [`directions`].
        let spacing = (consts::TAU * (1.0 - lowest.sin() as Real) / self.count as Real).sqrt();
        let scales = vec![self.overlap * spacing * self.distance_m; means.len()];
        Ok(start::isotropic_cloud(means, &scales, self.opacity, rng))
    }

    fn count(&self) -> Option<usize> {
        Some(self.count)
    }

    fn check(&self) -> Result<(), String> {
        start::check_count("count", self.count)?;
        start::check_positive("distance_m", self.distance_m, "metres from the centre of the grid")?;
        start::check_positive("overlap", self.overlap, "scale over spacing, about 1")?;
        start::check_opacity(self.opacity)
    }
}

/// Returns `count` unit vectors, nearly uniform above the elevation `lowest` (radians): rings of equal elevation, each with
/// directions in proportion to its solid angle.
fn directions(count: usize, lowest: f64) -> Vec<[f64; 3]> {
    let area_below = |elevation: f64| (elevation.sin() - lowest.sin()) / (1.0 - lowest.sin());
    let patch = (TAU * (1.0 - lowest.sin()) / count as f64).sqrt();
    let rings = ((FRAC_PI_2 - lowest) / patch).round().max(1.0) as usize;
    let step = (FRAC_PI_2 - lowest) / rings as f64;
    let mut directions = Vec::with_capacity(count);
    for ring in 0..rings {
        // Rounding the cumulative share instead of each ring makes the total exact.
        let until = (count as f64 * area_below(lowest + (ring + 1) as f64 * step)).round() as usize;
        let (elevation, n) = (lowest + (ring as f64 + 0.5) * step, until.min(count) - directions.len());
        // Rotates every second ring by half a step, so that no meridian collects directions.
        let turn = 0.25 + 0.5 * (ring % 2) as f64;
        directions.extend((0..n).map(|k| {
            let azimuth = TAU * (k as f64 + turn) / n as f64;
            [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()]
        }));
    }
    directions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{plane, scene};
    use pwrfgs_core::{neighbours, rng};

    fn make(count: usize, angles: bool) -> GaussianCloud {
        let grid = Grid { count, ..Grid::default() };
        grid.initialize(&scene(), &plane(angles), &mut rng::stream(1, "init", 0)).unwrap()
    }

    #[test]
    fn grid_has_exact_count_and_minimum_distance() {
        for count in [1, 2, 3, 7, 10, 157, 500, 2613] {
            for (angles, centre) in [(true, Vec3::new(5.0, 0.26, 0.0)), (false, Vec3::new(-0.261_66, 4.993_15, -0.26))]
            {
                let cloud = make(count, angles);
                assert_eq!(cloud.len(), count);
                for mean in &cloud.means {
                    let distance = (Vec3::from_array(*mean) - centre).length();
                    assert!((distance - 5.0).abs() < 1e-4, "{distance}");
                }
            }
        }
    }

    #[test]
    fn grid_with_angles_is_in_front_of_receiver() {
        let receiver = scene().pose();
        let boresight = receiver.world_from_receiver().z_axis;
        let lowest = make(500, true)
            .means
            .iter()
            .fold(Real::MAX, |low, m| low.min((Vec3::from_array(*m) - receiver.position_vec()).dot(boresight)));
        assert!(lowest > 0.05, "{lowest}");
    }

    #[test]
    fn grid_neighbours_are_one_spacing_apart_and_overlap() {
        for angles in [true, false] {
            let cloud = make(2000, angles);
            let scale = cloud.log_scales[0][0].exp();
            for squared in neighbours::nearest_other_squared(&cloud.means) {
                let ratio = squared.sqrt() / scale;
                assert!((0.6..1.4).contains(&ratio), "nearest neighbour at {ratio} scales");
            }
        }
    }
}
