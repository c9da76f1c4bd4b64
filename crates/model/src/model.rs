//! `Model`: what is saved and predicts.

use crate::Stages;
use pwrfgs_core::{Activated, GaussianCloud, Origin, Parameters, Real};

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
    /// What is drawn for a transmitter at `tx` (metres, world frame), or of the base parameters alone.
    pub fn gaussians(&self, tx: Option<[f64; 3]>) -> Activated {
        let Stages { method, frame } = &self.stages;
        let parameters = Parameters { cloud: &self.cloud, gate: None, presence: None, weights: &self.weights };
        let local = tx.map(|tx| frame.origin.local(tx));
        method.gaussians(frame, &parameters, local)
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
