//! `Initializer`: where the Gaussians start.

use crate::{GaussianCloud, ImagePlane, Result, Scene, plugin_kind, rng::Rng};

/// Makes the first cloud.
///
/// Worked example: `pwrfgs_init::Random` in `crates/init/src/random.rs`; the page on writing one is `docs/plugins.md`.
#[typetag::serde]
pub trait Initializer: erased_serde::Serialize + std::any::Any + std::fmt::Debug + Send + Sync {
    /// The cloud to start from, with at least one Gaussian. `plane` tells whether pixels are angles of the true
    /// receiver pose (`plane.angles`), for initialisers that place Gaussians where they can be seen.
    ///
    /// # Errors
    /// Where the scene lacks what is needed, saying what to do instead.
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud>;

    /// One line for `pwrfgs plugins`.
    fn about(&self) -> &'static str {
        ""
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Initializer);
