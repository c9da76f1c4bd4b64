//! `Initializer`: where the Gaussians start.

use crate::{Dataset, GaussianCloud, ImagePlane, Method, Progress, Real, Result, Scene, Task, plugin_kind, rng::Rng};
use std::sync::atomic::AtomicBool;

/// What an initialiser may look at that reads observations.
pub struct Seen<'a> {
    /// All data.
    pub data: &'a Dataset,
    /// The links to learn from, and no others.
    pub train: &'a [usize],
    /// What an observation is.
    pub plane: &'a ImagePlane,
    /// What the Gaussians are for: it may want more columns than every cloud has.
    pub method: &'a dyn Method,
    /// Told how far it is.
    pub progress: Progress<'a>,
    /// Set where somebody wants it to end.
    pub stop: &'a AtomicBool,
}

impl std::fmt::Debug for Seen<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Seen").field("data", &self.data.title).field("train", &self.train.len()).finish_non_exhaustive()
    }
}

/// Makes the first cloud.
///
/// Worked example: `pwrfgs_init::Random` in `crates/init/src/random.rs`; the page on writing one is `docs/plugins.md`.
#[typetag::serde]
pub trait Initializer:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// The cloud to start from, with at least one Gaussian. `plane` tells whether pixels are angles of the true
    /// receiver pose (`plane.angles`), for initialisers that place Gaussians where they can be seen.
    ///
    /// # Errors
    /// Where the scene lacks what is needed, saying what to do instead.
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud>;

    /// The cloud to start from, found in what was observed of the links `train`: [`Self::initialize`] where the scene alone
    /// decides. Where it takes long it tells `progress`, and ends with [`Error::Stopped`](crate::Error::Stopped) once
    /// `stop` is set; a run that is resumed does not come here again.
    ///
    /// # Errors
    /// As [`Self::initialize`].
    fn search(&self, seen: &Seen<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        self.initialize(&seen.data.scene, seen.plane, rng)
    }

    /// Weights to start from, where it has them; fresh ones where not.
    ///
    /// # Errors
    /// Where they do not fit the method.
    fn weights(&self, seen: &Seen<'_>) -> Result<Option<Vec<Real>>> {
        let _ = seen;
        Ok(None)
    }

    /// How many Gaussians it makes, where its settings alone say so.
    fn count(&self) -> Option<usize> {
        None
    }

    /// Whether it searches observations of `task`. An initializer that reads no observations supports every task.
    fn supports(&self, task: Task) -> bool {
        let _ = task;
        true
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Initializer);
