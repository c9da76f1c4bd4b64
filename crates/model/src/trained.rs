//! `Trained`: a model as the initial state of another training.

use crate::file;
use pwrfgs_core::{
    Error, GaussianCloud, ImagePlane, Initializer, InitializerInput, JsonSchema, Real, Result, Scene, rng::Rng,
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
    fn initialize(&self, scene: &Scene, _: &ImagePlane, _: &mut Rng) -> Result<GaussianCloud> {
        let model = file::read(&self.model)?;
        if model.stages.setup.origin != scene.origin {
            return Err(Error::input(
                &self.model,
                "the model has another origin than the data; give a model trained on these data",
            ));
        }
        Ok(model.cloud)
    }

    fn weights(&self, input: &InitializerInput<'_>) -> Result<Option<Vec<Real>>> {
        let model = file::read(&self.model)?;
        let (own, expected) = (model.stages.method.get(), input.method);
        let text = |method: &dyn pwrfgs_core::Method| serde_json::to_string(method).unwrap_or_default();
        if text(own) != text(expected)
            || model.stages.setup.receivers != input.data.scene.receivers
            || model.stages.setup.moving != input.data.scene.moving
        {
            let what = "its method or its receivers are others than those of the pipeline; copy projector, rasterizer, \
                        deformation, calibration and readout from the run that made it";
            return Err(Error::input(&self.model, what));
        }
        Ok(Some(model.weights))
    }
}
