//! Gaussians about every receiver and all over the site.

use crate::start;
use pwrfgs_core::{GaussianCloud, ImagePlane, Initializer, JsonSchema, Real, Result, Scene, rng, rng::Rng};
use serde::{Deserialize, Serialize};

/// Some Gaussians about each receiver, the others all over the box that holds receivers, transmitters and points.
///
/// For one cloud that many receivers look at, where no point cloud is known: what happens near a receiver decides most of
/// what it hears, so each has its share. Of one receiver and spectra, [`crate::Random`] is the released start.
///
/// ```
/// # use pwrfgs_init as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("Site(count: 900, near: 0.5, spread_m: 2.5, scale_m: 0.8)")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Site {
    /// Number of Gaussians.
    pub count: usize,
    /// Share of them that stand about the receivers, 0 to 1.
    pub near: Real,
    /// Standard deviation about a receiver along each axis, metres.
    pub spread_m: Real,
    /// Scale of every Gaussian, metres.
    pub scale_m: Real,
    /// Opacity of every Gaussian, above 0 and below 1.
    pub opacity: Real,
    /// Width of the interval about 0 in which each channel of a signal is drawn uniformly.
    pub signal_scale: Real,
}

impl Default for Site {
    fn default() -> Self {
        Self { count: 900, near: 0.5, spread_m: 2.5, scale_m: 0.8, opacity: 0.3, signal_scale: 1.0 }
    }
}

#[typetag::serde]
impl Initializer for Site {
    fn initialize(&self, scene: &Scene, _: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let near = (self.near * self.count as Real).round() as usize;
        let (low, high) = scene.bounds;
        let mean = |i: usize| {
            let about = scene.receivers.get(i % scene.receivers.len().max(1)).filter(|_| i < near);
            match about {
                Some(receiver) => {
                    let place = receiver.pose.origin().to_array();
                    place.map(|x| x + self.spread_m * rng::normal(rng))
                }
                None => std::array::from_fn(|k| low[k] + (high[k] - low[k]) * rng::uniform(rng)),
            }
        };
        let means: Vec<[Real; 3]> = (0..self.count).map(mean).collect();
        let scales = vec![self.scale_m; self.count];
        Ok(start::cloud(means, &scales, self.opacity, self.signal_scale, rng))
    }

    fn check(&self) -> Result<(), String> {
        start::check_count("count", self.count)?;
        if !(0.0..=1.0).contains(&self.near) {
            return Err(format!("`near` is {}; give a share from 0 to 1", self.near));
        }
        start::positive("spread_m", self.spread_m, "metres about a receiver")?;
        start::positive("scale_m", self.scale_m, "metres")?;
        start::check(self.opacity, self.signal_scale)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{plane, scene};
    use pwrfgs_core::{Pose, Receiver, Vec3, rng::stream};

    #[test]
    fn every_receiver_has_its_share_and_the_rest_stays_inside() {
        let mut site = scene();
        site.receivers.push(Receiver::new("second", Pose { position: [40.0, 0.0, 2.0], ..Pose::IDENTITY }));
        let settings = Site { count: 400, ..Site::default() };
        let cloud = settings.initialize(&site, &plane(false), &mut stream(0, "init", 0)).unwrap();
        for receiver in &site.receivers {
            let close = cloud.means.iter().filter(|m| (Vec3::from_array(**m) - receiver.pose.origin()).length() < 8.0);
            assert!(close.count() >= 95, "{}", receiver.name);
        }
        let (low, high) = site.bounds;
        assert!(cloud.means[200..].iter().all(|m| (0..3).all(|k| (low[k]..=high[k]).contains(&m[k]))));
    }
}
