//! `TrainingPlan`: what a training follows from, besides the data.

use crate::budgets::contradiction;
use crate::settings::Training;
use pwrfgs_core::plugin::{Checked, Plugin};
use pwrfgs_core::{Initializer, Method, Pruner};

/// What a training follows from, besides the data. `pwrfgs_pipeline::Pipeline::plan` makes it of a pipeline.
#[derive(Clone, Debug)]
pub struct TrainingPlan {
    /// Name of the training in messages.
    pub name: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// From Gaussians and weights to observations.
    pub method: Plugin<dyn Method>,
    /// Where the Gaussians start.
    pub initializer: Plugin<dyn Initializer>,
    /// Who decides which Gaussians stay; all must agree.
    pub pruners: Vec<Plugin<dyn Pruner>>,
    /// Algorithm 1.
    pub training: Checked<Training>,
}

impl TrainingPlan {
    /// Checks whether the pruners go together, with the method and with the number of Gaussians at the start.
    ///
    /// # Errors
    /// What is wrong with the list of pruners.
    pub fn check(&self) -> Result<(), String> {
        contradiction(self).map_or(Ok(()), Err)
    }
}
