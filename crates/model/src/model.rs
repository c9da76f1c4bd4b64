//! `Model`: what is saved and predicts.

use crate::{Activation, Calibration, Prepared, Readout};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{
    Deformation, Deltas, GaussianCloud, Image, ImagePlane, Pose, Predict, Primitives, Projector, Rasterizer, Real,
    Splats, sigmoid,
};

/// Everything between a cloud and a picture.
#[derive(Clone, Debug)]
pub struct Stages {
    /// What the transmitter changes.
    pub deformation: Plugin<dyn Deformation>,
    /// From space to the picture.
    pub projector: Plugin<dyn Projector>,
    /// From splats to pixels.
    pub rasterizer: Plugin<dyn Rasterizer>,
    /// How calibration terms meet the base parameters.
    pub calibration: Calibration,
    /// From blended signals to grey values.
    pub readout: Readout,
    /// The receiver.
    pub pose: Pose,
    /// The picture.
    pub plane: ImagePlane,
}

impl Stages {
    /// How a cloud is activated here.
    pub fn activation(&self) -> Activation {
        Activation {
            calibration: self.calibration,
            replaces_signals: self.deformation.replaces_signals(),
            channels: self.readout.channels(),
        }
    }

    /// The rows of `cloud` that can show in a picture, whatever the network says: gate open, not too faint for the
    /// rasterizer, seen by the projector. Only they need to pass the network; all, where it couples them.
    pub fn drawable(&self, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        if self.deformation.couples_gaussians() {
            return (0..cloud.len()).collect();
        }
        let seen = self.projector.sees(&cloud.means, &self.pose, &self.plane);
        let faintest = self.rasterizer.faintest();
        let drawn = |i: &usize| {
            let gate = gate.map_or(1.0, |g| g[*i]);
            gate != 0.0 && seen[*i] && gate * sigmoid(cloud.opacity_logits[*i]) >= faintest
        };
        (0..cloud.len()).filter(drawn).collect()
    }

    /// The splats of transmitter `b` of the batch in `deltas`.
    pub(crate) fn splats(&self, cloud: &GaussianCloud, deltas: &Deltas, b: usize) -> Splats {
        self.projector.project(&self.activation().geometry(cloud, deltas, b, None), &self.pose, &self.plane)
    }
}

/// A trained model: predicts, and needs nothing else to do so.
#[derive(Clone, Debug)]
pub struct Model {
    /// The path from cloud to picture.
    pub stages: Stages,
    /// The Gaussians; no extra columns.
    pub cloud: GaussianCloud,
    /// Θ, as long as the deformation's layout says.
    pub weights: Vec<Real>,
}

impl Model {
    /// The spectrum for a transmitter at `tx` (metres, world frame), not clamped. For more than one, [`Self::prepare`].
    pub fn predict(&self, tx: [Real; 3]) -> Image {
        self.prepare().predict(tx)
    }

    /// The model with everything worked out that no transmitter changes.
    pub fn prepare(&self) -> Prepared<'_> {
        Prepared::new(std::slice::from_ref(self))
    }

    /// What is drawn for a transmitter at `tx`, or of the base parameters alone: the Gaussians in space, and their
    /// signals `[N, channels]`.
    pub fn gaussians(&self, tx: Option<[Real; 3]>) -> (Primitives, Vec<Real>) {
        let deform = |tx| self.stages.deformation.forward(&self.weights, &self.cloud.means, &[tx], &self.stages.pose);
        let deltas = tx.map_or_else(Deltas::default, deform);
        let activation = self.stages.activation();
        (activation.geometry(&self.cloud, &deltas, 0, None), activation.signals(&self.cloud, &deltas, 0..1))
    }

    /// Bytes of the Gaussians in the model file: 13 numbers each.
    pub fn gaussian_bytes(&self) -> usize {
        self.cloud.columns().map(|(_, _, values)| size_of_val(values)).sum()
    }

    /// Bytes of the network in the model file.
    pub fn network_bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }
}

impl Predict for Model {
    fn predict(&self, tx: [Real; 3]) -> Image {
        Self::predict(self, tx)
    }
}
