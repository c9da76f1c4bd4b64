//! Initialisers of the Gaussian cloud: on surfaces of the scene, at random, on a grid of directions, or around receivers.
//!
//! An initialiser chooses centres and isotropic scales; opacity, rotation and signals are initialised alike by all of
//! them (module `start`). The trainer adds the columns that pruners request.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod grid;
mod point_cloud;
mod random;
mod start;

pub use grid::Grid;
pub use point_cloud::PointCloud;
pub use random::{AroundReceivers, Random};

use pwrfgs_core::{GaussianCloud, ImagePlane, Initializer, JsonSchema, Result, Scene, rng::Rng};
use serde::{Deserialize, Serialize};

/// No Gaussians, for methods without Gaussians such as `Nerf2`. Such a pipeline uses it if `initializer` is not set.
///
/// ```
/// # use pwrfgs_init as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("NoGaussians()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NoGaussians {}

#[typetag::serde]
impl Initializer for NoGaussians {
    fn initialize(&self, _: &Scene, _: &ImagePlane, _: &mut Rng) -> Result<GaussianCloud> {
        Ok(GaussianCloud::zeros(0))
    }

    fn count(&self) -> Option<usize> {
        Some(0)
    }
}

#[cfg(test)]
mod tests {
    use pwrfgs_core::{AngleAxis, End, ImagePlane, Initializer, Origin, Plugin, Pose, Receiver, Scene};

    /// Scene with the measured receiver and three points.
    pub(crate) fn scene() -> Scene {
        let orientation = [0.512_916_02, -0.486_741_36, -0.486_741_36, 0.512_916_02];
        Scene {
            origin: Origin::ZERO,
            geodetic: None,
            floors: std::collections::BTreeMap::new(),
            moving: End::Transmitter,
            transmitter: None,
            receivers: vec![Receiver::new("gateway1", Pose { position: [5.0, 0.26, 0.0], orientation })],
            bounds: ([-1.0, -1.0, 0.0], [5.0, 1.0, 2.0]),
            points: vec![[0.0; 3], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 4.5, 0.0]],
        }
    }

    /// Creates an image plane with angles (true pose) or without (released projection).
    pub(crate) fn plane(angles: bool) -> ImagePlane {
        let axis = AngleAxis { first: 0.0, step: 1.0 };
        ImagePlane { wraps: angles, angles: angles.then_some((axis, axis)), ..ImagePlane::plain(360, 90) }
    }

    #[test]
    fn rejects_values_out_of_range() {
        for (text, field) in [
            ("Random(count: 0)", "count"),
            ("Random(count: 99000000)", "count"),
            ("Random(std: 0.0)", "std"),
            ("Random(std: NaN)", "std"),
            ("Random(nearest: 0)", "nearest"),
            ("Random(opacity: 1.0)", "opacity"),
            ("Random(opacity: NaN)", "opacity"),
            ("PointCloud(nearest: 0)", "nearest"),
            ("PointCloud(max_points: 0)", "max_points"),
            ("PointCloud(opacity: 0.0)", "opacity"),
            ("Grid(count: 0)", "count"),
            ("Grid(distance_m: -1.0)", "distance_m"),
            ("Grid(overlap: 0.0)", "overlap"),
            ("Grid(opacity: 2.0)", "opacity"),
        ] {
            let why = Plugin::<dyn Initializer>::parse(text).unwrap_err();
            assert!(why.contains(&format!("`{field}`")), "{text}: {why}");
        }
    }
}
