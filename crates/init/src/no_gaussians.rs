//! `NoGaussians`: nothing to start with.

use pwrfgs_core::{GaussianCloud, ImagePlane, Initializer, JsonSchema, Result, Scene, rng::Rng};
use serde::{Deserialize, Serialize};

/// No Gaussians, for a method that has none, such as `Nerf2`; it is what such a pipeline takes that leaves `initializer` out.
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
