//! `Stepper`: gradients, statistics and Adam, the part of a step between the batch and the edit of the cloud.

use crate::adam::{Adam, Rates};
use crate::graph::{Batch, loss_and_gradients};
use crate::loss::Objective;
use crate::settings::Training;
use pwrfgs_core::{
    CloudStats, ColumnSpec, Error, GaussianCloud, Plugin, Pruner, Real, Result, StepContext, WeightGroup, device,
};
use pwrfgs_model::Stages;
use std::sync::Arc;

/// Parameters of a trainer with their moments and statistics, and what a step needs to change them.
pub(crate) struct Stepper<'t> {
    pub(crate) training: &'t Training,
    pub(crate) stages: &'t Arc<Stages>,
    pub(crate) objective: &'t dyn Objective,
    pub(crate) specs: &'t [ColumnSpec],
    pub(crate) groups: &'t [WeightGroup],
    pub(crate) cloud: &'t mut GaussianCloud,
    pub(crate) weights: &'t mut Arc<Vec<Real>>,
    pub(crate) adam: &'t mut Adam,
    pub(crate) stats: &'t mut CloudStats,
}

impl Stepper<'_> {
    /// Runs a step on a batch, with `dropout` factors on the weights if given; returns loss and penalty before the update.
    ///
    /// # Errors
    /// [`Error::NonFinite`] with step and tensor, [`Error::Device`] of the GPU.
    pub(crate) fn step(
        self,
        batch: &Batch,
        pruners: &[Plugin<dyn Pruner>],
        dropout: Option<&[Real]>,
        context: &StepContext,
    ) -> Result<(Real, Real)> {
        let dropped = match dropout {
            Some(factors) => Arc::new(multiply(factors, self.weights)),
            None => Arc::clone(self.weights),
        };
        let mut gradients =
            loss_and_gradients(self.stages, self.cloud, &dropped, batch, self.objective, pruners, context)?;
        device::check()?;
        drop(dropped); // the optimiser then updates them in place
        if let Some(factors) = dropout {
            gradients.d_weights = multiply(factors, &gradients.d_weights);
        }
        self.stats.merge(&gradients.stats);
        let rates = Rates { training: self.training, step: context.step };
        let weights = Arc::make_mut(self.weights);
        (self.adam.step_cloud(rates, self.specs, self.cloud, &gradients.d_cloud))
            .and_then(|()| self.adam.step_weights(rates, self.groups, weights, &gradients.d_weights))
            .map_err(|column| Error::NonFinite { tensor: column, step: context.step })?;
        Ok((gradients.loss, gradients.penalty))
    }
}

/// Multiplies weights, or their derivatives, by the dropout factors.
fn multiply(factors: &[Real], weights: &[Real]) -> Vec<Real> {
    weights.iter().zip(factors).map(|(w, factor)| w * factor).collect()
}
