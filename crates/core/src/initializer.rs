//! `Initializer`: initial Gaussians.

use crate::{
    Dataset, Demand, GaussianCloud, ImagePlane, Method, Progress, Real, Requirement, Result, Scene, Task, plugin_kind,
    rng::Rng,
};
use std::sync::atomic::AtomicBool;

/// Inputs of an initialiser that reads observations.
pub struct InitializerInput<'a> {
    /// All data.
    pub data: &'a Dataset,
    /// Training links; an initialiser may use only these.
    pub train: &'a [usize],
    /// Image plane of an observation.
    pub plane: &'a ImagePlane,
    /// Method of the model, which may request further columns.
    pub method: &'a dyn Method,
    /// Progress callback.
    pub progress: Progress<'a>,
    /// Set to request an early end.
    pub stop: &'a AtomicBool,
}

impl std::fmt::Debug for InitializerInput<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InitializerInput")
            .field("data", &self.data.title)
            .field("train", &self.train.len())
            .finish_non_exhaustive()
    }
}

/// Creates the initial cloud.
///
/// Worked example: `pwrfgs_init::Random` in `crates/init/src/random.rs`; guide: `docs/plugins.md`.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Initializer: crate::plugin::PluginObject {
    /// Returns the initial cloud, with at least one Gaussian if the method has any. `plane.angles` or `plane.camera` gives the
    /// directions of pixels in the receiver frame, for initialisers that place Gaussians in view; without both, as for the
    /// released projection, pixels do not follow the receiver pose.
    ///
    /// # Errors
    /// The scene lacks a required input, and the message names the alternative; or a file of the plugin cannot be read.
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud>;

    /// Returns the initial cloud from the observations of the links `train`; by default [`Self::initialize`], which
    /// uses the scene only. Long searches report to `progress` and end with [`Error::Stopped`](crate::Error::Stopped)
    /// once `stop` is set. A resumed run does not repeat the search.
    ///
    /// # Errors
    /// As [`Self::initialize`]; observations that do not suit the search.
    fn search(&self, input: &InitializerInput<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        self.initialize(&input.data.scene, input.plane, rng)
    }

    /// Returns the shortest and longest expected time of [`Self::search`], seconds, from a few timed parts of it. By
    /// default `[0.0, 0.0]`: no noticeable time.
    ///
    /// # Errors
    /// As [`Self::search`].
    fn search_seconds(&self, input: &InitializerInput<'_>) -> Result<[f64; 2]> {
        Ok([0.0; 2])
    }

    /// Returns initial weights; `None` for the standard initialisation.
    ///
    /// # Errors
    /// The weights do not fit the method, or cannot be read.
    fn weights(&self, input: &InitializerInput<'_>) -> Result<Option<Vec<Real>>> {
        Ok(None)
    }

    /// Returns the number of Gaussians; `None` unless it follows from the settings.
    fn count(&self) -> Option<usize> {
        None
    }

    /// Returns the measurement types that it supports: all, if it reads no observations.
    fn tasks(&self) -> &'static [Task] {
        &Task::ALL
    }

    /// Returns its requirements of data and method beside the task.
    fn requires(&self) -> &'static [Requirement] {
        &[]
    }

    /// Returns its demands, for [`check_compatible`](crate::check_compatible).
    fn demand(&self) -> Demand {
        Demand { field: "initializer", plugin: self.typetag_name(), tasks: self.tasks(), requires: self.requires() }
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Initializer);
