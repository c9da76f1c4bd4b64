//! Gaussians on the surfaces of the scene: the initialisation of the paper.

use crate::start;
use pwrfgs_core::{
    Error, GaussianCloud, ImagePlane, Initializer, JsonSchema, Real, Result, Scene,
    rng::{self, Rng},
};
use serde::{Deserialize, Serialize};

/// One Gaussian per point of the scene's point cloud.
///
/// Mean = point, covariance = d²·I with d the distance to the nearest neighbour (section III-C and eq. (14) of the
/// paper). d has a lower limit of sqrt(1e-7) m for duplicate points; a single point has 1 m. Reflection and scattering
/// occur on surfaces, so use it if a scan of the scene is available. The number of Gaussians equals the number of
/// points. `max_points` selects a random subset without replacement; distances are those within the subset.
///
/// ```
/// # use pwrfgs_init as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("PointCloud(max_points: 5000, nearest: 3)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PointCloud {
    /// Maximum number of initial Gaussians; `None` for all points.
    pub max_points: Option<usize>,
    /// Number of neighbours whose root mean squared distance is the scale: 1 as in the paper, 3 as in the released
    /// WRF-GS.
    pub nearest: usize,
    /// Opacity of every Gaussian, above 0 and below 1.
    pub opacity: Real,
}

impl Default for PointCloud {
    fn default() -> Self {
        Self { max_points: None, nearest: 1, opacity: 0.1 }
    }
}

#[typetag::serde]
impl Initializer for PointCloud {
    fn initialize(&self, scene: &Scene, _: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        if scene.points.is_empty() {
            return Err(Error::Config(
                "no point cloud in this scene; use `Random(..)`, or set `points` of the data source".to_owned(),
            ));
        }
        let means = match self.max_points {
            Some(most) if most < scene.points.len() => {
                random_subset(rng, scene.points.len(), most).into_iter().map(|i| scene.points[i]).collect()
            }
            _ => scene.points.clone(),
        };
        let scales = start::scales_from_neighbours(&means, self.nearest);
        Ok(start::isotropic_cloud(means, &scales, self.opacity, rng))
    }

    fn check(&self) -> Result<(), String> {
        if self.max_points == Some(0) {
            return Err("`max_points` is 0; give at least 1, or omit it to use every point".to_owned());
        }
        start::check_nearest(self.nearest)?;
        start::check_opacity(self.opacity)
    }
}

/// Draws `k` distinct indices of 0..n, ascending, by a partial Fisher-Yates shuffle.
fn random_subset(rng: &mut Rng, n: usize, k: usize) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..n).collect();
    for i in 0..k {
        indices.swap(i, i + rng::below(rng, n - i));
    }
    indices.truncate(k);
    indices.sort_unstable();
    indices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{plane, scene};

    fn start(plugin: &PointCloud, points: Vec<[Real; 3]>) -> GaussianCloud {
        let scene = Scene { points, ..scene() };
        plugin.initialize(&scene, &plane(true), &mut rng::stream(1, "init", 0)).unwrap()
    }

    #[test]
    fn scales_equal_distance_to_nearest_neighbour() {
        let points = scene().points;
        let cloud = start(&PointCloud::default(), points.clone());
        assert_eq!(cloud.means, points);
        for (found, expected) in cloud.log_scales.iter().zip([3.0, 3.0, 0.5, 0.5]) {
            assert!(found.iter().all(|l| (l.exp() - expected).abs() < 1e-5));
        }
        let released = start(&PointCloud { nearest: 3, ..PointCloud::default() }, points);
        let rms = ((9.0 + 16.0 + 4.5 * 4.5) / 3.0 as Real).sqrt();
        assert!((released.log_scales[0][0].exp() - rms).abs() < 1e-5);
    }

    #[test]
    fn subset_of_points_has_no_repetition() {
        let points: Vec<[Real; 3]> = (0..100).map(|i| [i as Real, 0.0, 0.0]).collect();
        let some = PointCloud { max_points: Some(30), ..PointCloud::default() };
        let cloud = start(&some, points.clone());
        assert_eq!(cloud.len(), 30);
        assert!(cloud.means.windows(2).all(|w| w[0][0] < w[1][0]));
        assert_eq!(start(&PointCloud { max_points: Some(1), ..some.clone() }, points.clone()).len(), 1);
        assert_eq!(start(&PointCloud { max_points: Some(100), ..some }, points.clone()).means, points);
    }

    #[test]
    fn accepts_duplicate_points_and_single_point() {
        for points in [vec![[1.0; 3]; 50], vec![[1.0; 3]]] {
            let cloud = start(&PointCloud::default(), points);
            assert!(cloud.log_scales.iter().flatten().all(|l| l.is_finite()));
        }
    }

    #[test]
    fn missing_points_give_advice() {
        let scene = Scene { points: vec![], ..scene() };
        let made = PointCloud::default().initialize(&scene, &plane(true), &mut rng::stream(1, "init", 0));
        let message = made.unwrap_err().to_string();
        assert!(message.contains("Random(..)") && message.contains("`points`"), "{message}");
    }
}
