//! Random Gaussians: from a normal distribution (released initialisation), or near all receivers and over the site.

use crate::start;
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{GaussianCloud, ImagePlane, Initializer, JsonSchema, Real, Result, Scene, Vec3};
use serde::{Deserialize, Serialize};

/// Gaussians drawn from a normal distribution about the receiver.
///
/// If pixels are angles of the true pose (`Mercator`), centres are normal about the receiver. Centres behind it are
/// mirrored to its front (local z > 0), so that none is out of view, unless the spectrum includes directions behind it.
/// With images of a camera (`Pinhole`), centres are normal about the middle of the bounding box of camera positions and points.
/// With the released projection (`WrfgsCompat`), centres are normal about the origin of the world, as released: count
/// 20,000 and 10 m for WRF-GS, 200,000 and 20 m for WRF-GS+. The scale is the root mean squared distance to the
/// `nearest` neighbours. Use it without a point cloud; the paper finds it slightly inferior to
/// [`crate::PointCloud`].
///
/// ```
/// # use pwrfgs_init as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("Random(count: 2000, std: 5.0)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Random {
    /// Number of Gaussians.
    pub count: usize,
    /// Standard deviation along each axis, metres.
    pub std: Real,
    /// Number of neighbours whose root mean squared distance is the scale: 3 as released, 1 as in the paper with
    /// points.
    pub nearest: usize,
    /// Opacity of every Gaussian, above 0 and below 1.
    pub opacity: Real,
}

impl Default for Random {
    fn default() -> Self {
        Self { count: 20_000, std: 10.0, nearest: 3, opacity: 0.1 }
    }
}

#[typetag::serde]
impl Initializer for Random {
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let (world_from_receiver, origin) = (scene.pose().world_from_receiver(), scene.pose().position_vec());
        let draw = |rng: &mut Rng| [(); 3].map(|()| self.std * rng::normal(rng));
        let ahead = |z: Real| if plane.has_directions_behind() { z } else { z.abs() };
        let in_front = |[x, y, z]: [Real; 3]| (origin + world_from_receiver * Vec3::new(x, y, ahead(z))).to_array();
        let (low, high) = scene.bounds;
        let about_middle = |p: [Real; 3]| [0, 1, 2].map(|k| p[k] + 0.5 * (low[k] + high[k]));
        let to_world = |p: [Real; 3]| match (plane.angles, plane.camera) {
            (Some(_), _) => in_front(p),
            (None, Some(_)) => about_middle(p),
            (None, None) => p,
        };
        let means: Vec<[Real; 3]> = (0..self.count).map(|_| to_world(draw(rng))).collect();
        let scales = start::scales_from_neighbours(&means, self.nearest);
        Ok(start::isotropic_cloud(means, &scales, self.opacity, rng))
    }

    fn count(&self) -> Option<usize> {
        Some(self.count)
    }

    fn check(&self) -> Result<(), String> {
        start::check_count("count", self.count)?;
        start::check_positive("std", self.std, "metres along each axis")?;
        start::check_nearest(self.nearest)?;
        start::check_opacity(self.opacity)
    }
}

/// Random Gaussians near each receiver and over the bounding box of receivers, transmitters and points.
///
/// Use it if several receivers share one cloud and no point cloud is available. The surroundings of a receiver affect
/// its received signal most, so every receiver gets an equal share of the near Gaussians. If the receivers move, these
/// are near the transmitter. For one receiver and spectra, [`crate::Random`] is the released initialisation.
///
/// ```
/// # use pwrfgs_init as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("AroundReceivers(count: 900, near: 0.5, spread_m: 2.5, scale_m: 0.8)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AroundReceivers {
    /// Number of Gaussians.
    pub count: usize,
    /// Share of the Gaussians near the receivers, 0 to 1.
    pub near: Real,
    /// Standard deviation about a receiver along each axis, metres.
    pub spread_m: Real,
    /// Scale of every Gaussian, metres.
    pub scale_m: Real,
    /// Opacity of every Gaussian, above 0 and below 1.
    pub opacity: Real,
}

impl Default for AroundReceivers {
    fn default() -> Self {
        Self { count: 900, near: 0.5, spread_m: 2.5, scale_m: 0.8, opacity: 0.3 }
    }
}

#[typetag::serde]
impl Initializer for AroundReceivers {
    fn initialize(&self, scene: &Scene, _: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let near_count = (self.near * self.count as Real).round() as usize;
        let (low, high) = scene.bounds;
        let fixed_ends = scene.fixed_ends();
        let mean = |i: usize| {
            if i < near_count {
                let centre = fixed_ends[i % fixed_ends.len()].position_vec().to_array();
                return centre.map(|x| x + self.spread_m * rng::normal(rng));
            }
            std::array::from_fn(|k| low[k] + (high[k] - low[k]) * rng::uniform(rng))
        };
        let means: Vec<[Real; 3]> = (0..self.count).map(mean).collect();
        let scales = vec![self.scale_m; self.count];
        Ok(start::isotropic_cloud(means, &scales, self.opacity, rng))
    }

    fn count(&self) -> Option<usize> {
        Some(self.count)
    }

    fn check(&self) -> Result<(), String> {
        start::check_count("count", self.count)?;
        if !(0.0..=1.0).contains(&self.near) {
            return Err(format!("`near` is {}; give a share from 0 to 1", self.near));
        }
        start::check_positive("spread_m", self.spread_m, "metres about a receiver")?;
        start::check_positive("scale_m", self.scale_m, "metres")?;
        start::check_opacity(self.opacity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{plane, scene};
    use pwrfgs_core::rng::stream;
    use pwrfgs_core::{Pose, Receiver};

    fn means(angles: bool) -> Vec<Vec3> {
        let cloud = Random { count: 4000, std: 2.0, ..Random::default() };
        let cloud = cloud.initialize(&scene(), &plane(angles), &mut rng::stream(1, "init", 0)).unwrap();
        cloud.means.into_iter().map(Vec3::from_array).collect()
    }

    fn assert_spread(means: &[Vec3], about: Vec3) {
        let square = means.iter().map(|m| (*m - about).length_squared()).sum::<Real>() / means.len() as Real;
        assert!((square / 12.0 - 1.0).abs() < 0.05, "{square} is not near three times the variance");
    }

    #[test]
    fn random_start_with_angles_is_in_front_of_receiver() {
        let (means, receiver) = (means(true), scene().pose());
        let boresight = receiver.world_from_receiver().z_axis;
        assert!(means.iter().all(|m| (*m - receiver.position_vec()).dot(boresight) > -1e-4));
        assert_spread(&means, receiver.position_vec());
    }

    #[test]
    fn without_angles_gaussians_surround_origin() {
        let means = means(false);
        let mean = means.iter().sum::<Vec3>() / means.len() as Real;
        assert!(mean.length() < 0.2, "{mean} is not the origin");
        assert_spread(&means, Vec3::ZERO);
    }

    #[test]
    fn initial_scales_match_released_code() {
        let cloud = Random::default().initialize(&scene(), &plane(false), &mut rng::stream(1, "init", 0)).unwrap();
        let mut scales: Vec<Real> = cloud.log_scales.iter().map(|l| l[0].exp()).collect();
        scales.sort_by(Real::total_cmp);
        // Measured on the released initialisation: the 1 % and 50 % quantiles are 0.46 and 1.02 m.
        assert!((scales[200] - 0.46).abs() < 0.03, "{}", scales[200]);
        assert!((scales[10_000] - 1.02).abs() < 0.03, "{}", scales[10_000]);
    }

    #[test]
    fn receivers_share_gaussians_and_rest_fill_box() {
        let mut site = scene();
        site.receivers.push(Receiver::new("second", Pose { position: [40.0, 0.0, 2.0], ..Pose::IDENTITY }));
        let settings = AroundReceivers { count: 400, ..AroundReceivers::default() };
        let cloud = settings.initialize(&site, &plane(false), &mut stream(0, "init", 0)).unwrap();
        assert_eq!((cloud.len(), settings.count()), (400, Some(400)));
        for receiver in &site.receivers {
            let close =
                cloud.means.iter().filter(|m| (Vec3::from_array(**m) - receiver.pose.position_vec()).length() < 8.0);
            assert!(close.count() >= 95, "{}", receiver.name);
        }
        let (low, high) = site.bounds;
        assert!(cloud.means[200..].iter().all(|m| (0..3).all(|k| (low[k]..=high[k]).contains(&m[k]))));
    }
}
