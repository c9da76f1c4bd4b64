//! `Factored`: signals as products of what depends on the transmitter and what depends on the Gaussian.

use super::factored_network::{Basis, Network};
use super::mlp::check_stack;
use super::waves::Encoding;
use super::whiten::whitening;
use crate::layers::plan::{laid_out, planned};
use pwrfgs_core::{
    Cache, Conditions, Deformation, DeformationInputs, DeformationTraits, Deltas, JsonSchema, Layout, LinearPart, Pose,
    Real, cached,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A network that runs once per transmitter instead of once per Gaussian: `Δsᵢ(p) = G(μᵢ)·T(p) + G₀(μᵢ)`.
///
/// A stack of ReLU layers makes `width` features T of the transmitter's encoded position γ(p); one linear layer on the
/// waves φ(μ) of the encoded centre makes each Gaussian's factors G, two rows (real and imaginary part) of `width` + 1
/// numbers. A signal is then a scalar product. Waves short against the distances of Gaussians make their factors
/// independent, long ones let neighbours agree. The cost of a prediction is that of one pass through the stack, whatever N is, and
/// sixteen Gaussians on a 4 x 4 array can follow all that the network knows of the transmitter: the shape for
/// `ArrayResponse`. Geometry does not depend on the transmitter. Known elsewhere as branch and trunk (`DeepONet`).
///
/// Centres are differentiated through the network.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_model as _;
/// let small = Plugin::<dyn Deformation>::parse("Factored(depth: 3, width: 128, tx_encoding: Waves(count: 64, reach: 24.0))").unwrap();
/// assert!(!small.traits().varies_geometry);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Factored {
    /// ReLU layers of the transmitter's stack, 1 or more.
    pub depth: usize,
    /// Units per layer, and number of features.
    pub width: usize,
    /// How the transmitter's position is encoded.
    pub tx_encoding: Encoding,
    /// How the centre is encoded; without the coordinates, which would drown the waves.
    pub position_encoding: Encoding,
}

const WAVES: Encoding = Encoding::Waves { count: 32, reach: 4.0, seed: 0 };

impl Default for Factored {
    fn default() -> Self {
        Self { depth: 4, width: 256, tx_encoding: Encoding::default(), position_encoding: WAVES }
    }
}

#[typetag::serde]
impl Deformation for Factored {
    fn traits(&self) -> DeformationTraits {
        DeformationTraits {
            inputs: self.tx_encoding.inputs(),
            kept_per_gaussian: 2 * (self.position_encoding.width() - 3), // its waves and their derivative
            ..DeformationTraits::default()
        }
    }

    fn layout(&self) -> Layout {
        let encodings = [("tx_encoding", &self.tx_encoding), ("position_encoding", &self.position_encoding)];
        let constants = encodings.into_iter().filter_map(|(field, encoding)| encoding.constants(field)).collect();
        Layout { constants, ..planned(|plan| Network::new(self, plan)).1.layout() }
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, prepared: &Cache) -> Deltas {
        let fresh = || self.prepare(inputs.weights, inputs.means, inputs.pose);
        let prepared = prepared.clone().or_else(fresh);
        let (network, basis): &(Network, Basis) = cached(&prepared);
        network.forward(inputs.weights, basis, inputs.txs)
    }

    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], _: &Pose) -> Cache {
        let network = laid_out(weights, |plan| Network::new(self, plan));
        let basis = network.basis(means);
        Some(Arc::new((network, basis)))
    }

    fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        d: &Deltas,
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    ) {
        laid_out(inputs.weights, |plan| Network::new(self, plan)).vjp(inputs, d, d_weights, d_means);
    }

    fn linear_part(&self, weights: &[Real], means: &[[Real; 3]], training: Conditions<'_>) -> Option<LinearPart> {
        laid_out(weights, |plan| Network::new(self, plan)).linear_part(weights, means, training)
    }

    fn start(&self, training: Conditions<'_>, weights: &mut [Real]) {
        let (network, _) = planned(|plan| Network::new(self, plan));
        let (Some(white), Encoding::Features { gain, .. }) = (network.white, &self.tx_encoding) else { return };
        if let Some((matrix, bias)) = whitening(training, *gain) {
            weights[white.weight..][..matrix.len()].copy_from_slice(&matrix);
            white.bias_mut(weights).copy_from_slice(&bias);
        }
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, None)?;
        self.tx_encoding.check("tx_encoding")?;
        self.position_encoding.check("position_encoding")?;
        if matches!(self.position_encoding, Encoding::Features { .. } | Encoding::PseudoPosition { .. }) {
            return Err(
                "position_encoding: a Gaussian has a position and no features; give Waves(..) or Octaves(4)".into()
            );
        }
        if self.position_encoding.width() == 3 {
            return Err("position_encoding needs a wave: give Waves(count: 32, reach: 4.0) or Octaves(4)".into());
        }
        Ok(())
    }
}
