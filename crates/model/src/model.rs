//! `Model`: what is saved and predicts.

use crate::{Activation, Calibration, Stages};
use pwrfgs_core::{DeformationInputs, Deltas, GaussianCloud, Origin, Primitives, Real};

/// A trained model: predicts, and needs nothing else to do so.
#[derive(Clone, Debug)]
pub struct Model {
    /// The path from cloud to picture.
    pub stages: Stages,
    /// The Gaussians; no extra columns but the method's.
    pub cloud: GaussianCloud,
    /// Θ, as long as the method's layout says.
    pub weights: Vec<Real>,
}

impl Model {
    /// What is drawn for a transmitter at `tx`, or of the base parameters alone: the Gaussians in space, and their
    /// signals `[N, channels]`.
    pub fn gaussians(&self, tx: Option<[f64; 3]>) -> (Primitives, Vec<Real>) {
        let Some(splatting) = self.stages.splatting() else {
            let activation = Activation { calibration: Calibration::Physical, replaces_signals: false, channels: 2 };
            let none = Deltas::default();
            return (activation.geometry(&self.cloud, &none, 0, None), activation.signals(&self.cloud, &none, 0..1));
        };
        let network = &self.weights[..splatting.deformation.layout().numbers()];
        let deform = |tx: [Real; 3]| {
            let (means, pose) = (&self.cloud.means, self.stages.pose());
            splatting.deformation.forward(&DeformationInputs::new(network, means, &[tx], &pose), &None)
        };
        let deltas = tx.map(|tx| self.stages.origin.local(tx)).map_or_else(Deltas::default, deform);
        let activation = splatting.activation();
        (activation.geometry(&self.cloud, &deltas, 0, None), activation.signals(&self.cloud, &deltas, 0..1))
    }

    /// The centres `[N,3]`, metres from `origin`.
    pub fn means_from(&self, origin: Origin) -> Vec<[Real; 3]> {
        let own = self.stages.origin;
        let moved = |mean: &[Real; 3]| if own == origin { *mean } else { origin.local(own.world(*mean)) };
        self.cloud.means.iter().map(moved).collect()
    }

    /// Bytes of the Gaussians in the model file: 13 numbers each, and those that the method adds.
    pub fn gaussian_bytes(&self) -> usize {
        self.cloud.columns().map(|(_, _, values)| size_of_val(values)).sum()
    }

    /// Bytes of the network in the model file.
    pub fn network_bytes(&self) -> usize {
        size_of_val(self.weights.as_slice())
    }
}
