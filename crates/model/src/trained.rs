//! `Trained`: a model as the initial state of another training.

use crate::{Model, file};
use pwrfgs_core::{
    Error, GaussianCloud, ImagePlane, Initializer, InitializerInput, JsonSchema, MeasurementSetup, Parts, Real, Result,
    Scene, check_compatible, rng::Rng,
};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Gaussians and weights of a trained model.
///
/// Use it to prune or continue a trained model. One dense model can be pruned in several ways with equal training
/// length (`experiments/pareto.ron`). Method and receivers must be those of the model, and the state of the optimiser
/// is reset. To resume an interrupted run, repeat its command instead; it uses the checkpoint.
///
/// ```
/// # use pwrfgs_model as _;
/// # use pwrfgs_core::{Initializer, Plugin};
/// Plugin::<dyn Initializer>::parse("Trained(model: \"runs/dense/model.safetensors\")")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Trained {
    /// Path of the `model.safetensors` of a finished run, relative to the pipeline.
    #[schemars(extend("format" = "path"))]
    pub model: PathBuf,
}

impl Default for Trained {
    fn default() -> Self {
        Self { model: "model.safetensors".into() }
    }
}

#[typetag::serde]
impl Initializer for Trained {
    fn initialize(&self, _: &Scene, _: &ImagePlane, _: &mut Rng) -> Result<GaussianCloud> {
        Ok(file::read(&self.model)?.cloud)
    }

    fn weights(&self, input: &InitializerInput<'_>) -> Result<Option<Vec<Real>>> {
        let Model { stages, weights, .. } = file::read(&self.model)?;
        let setup = MeasurementSetup::of(input.data, input.plane.clone());
        let (method, start) = (Some(input.method), Some((stages.method.get(), &stages.setup)));
        check_compatible(&Parts { setup: Some(&setup), method, start, ..Parts::default() })
            .map_err(|why| Error::input(&self.model, why))?;
        Ok(Some(weights))
    }
}
