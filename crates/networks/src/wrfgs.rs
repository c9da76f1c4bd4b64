//! `Wrfgs`: the network of WRF-GS (Wen et al., IEEE INFOCOM 2025) as in the released code.

use crate::encoding::{self, check_frequencies};
use crate::linear::{LayoutBuilder, lay_out, lay_out_for};
use crate::trunk::{Trunk, TrunkShape, check_stack};
use crate::wrfgs_branch::Branch;
use crate::wrfgs_network::{TrunkOutput, WrfgsLayers};
use pwrfgs_core::{
    Cache, Deformation, DeformationInputs, DeformationTraits, DeformationVjp, Deltas, JsonSchema, Layout, Pose, Real,
    cached,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The released network of WRF-GS: it replaces the signals and does not change the geometry.
///
/// A stack of ReLU layers computes an attenuation A and a feature from γ(X) of the centre of the Gaussian. Two more
/// layers compute an amplitude S from the feature, γ(p) of the transmitter and γ(X - p). The signal is g·S·A ≥ 0 in the
/// first channel and 0 in the second. In the released code, g = 40·F with F = √Σᵢ|Xᵢ - r|² and r the position of the
/// receiver. This single number for the whole cloud grows with √N and saturates most initial models. Set a fixed `gain`
/// for a usable model.
///
/// The default values are those of the released network, 189,636 weights. Its two phases per Gaussian are not used;
/// their weights are kept, so that the layout is that of the released network.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_networks as _;
/// let released = Plugin::<dyn Deformation>::parse("Wrfgs()").unwrap();
/// assert!(released.traits().replaces_signals);
/// let usable = Plugin::<dyn Deformation>::parse("Wrfgs(width: 64, gain: 100)").unwrap();
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Wrfgs {
    /// Number of ReLU layers before attenuation and feature, 1 or more.
    pub depth: usize,
    /// Units per layer, 2 or more; the last hidden layer has half of them.
    pub width: usize,
    /// Number of frequencies 2⁰…2^(L-1) rad/m of all three encodings; 0 for the bare coordinates.
    pub frequencies: usize,
    /// Index of the layer (from 0) after which γ(X) enters again; `None` for a plain stack.
    pub skip: Option<usize>,
    /// Factor g on every signal; `None` for 40·F as released.
    pub gain: Option<f64>,
}

impl Default for Wrfgs {
    fn default() -> Self {
        Self { depth: 8, width: 128, frequencies: 10, skip: Some(4), gain: None }
    }
}

/// Reciprocal of 0.025 in the released code.
const RELEASED_GAIN: f64 = 40.0;

impl Wrfgs {
    /// Returns F, the norm of all centres relative to the receiver, metres.
    fn cloud_norm(means: &[[Real; 3]], pose: &Pose) -> f64 {
        means.iter().flat_map(|x| (0..3).map(|k| (f64::from(x[k]) - pose.position[k]).powi(2))).sum::<f64>().sqrt()
    }

    /// Returns the factor g on every signal.
    fn gain(&self, means: &[[Real; 3]], pose: &Pose) -> f64 {
        self.gain.unwrap_or_else(|| RELEASED_GAIN * Self::cloud_norm(means, pose))
    }

    /// Returns the terms with the signals g·S·A in the first channel, given the products S·A, `[B, N]`.
    fn signals(gain: Real, products: Vec<Real>) -> Deltas {
        Deltas { signals: products.into_iter().map(|sa| [gain * sa, 0.0]).collect(), ..Deltas::default() }
    }

    /// Plans the layers in the order of the weight vector.
    pub(super) fn plan_layers(&self, plan: &mut LayoutBuilder) -> WrfgsLayers {
        let &Self { depth, width, frequencies, skip, .. } = self;
        let gamma = encoding::encoded_width(frequencies);
        let trunk = Trunk::new(plan, TrunkShape { depth, width, skip, gamma, side: 0 });
        // Two outputs, as released: a magnitude, and a phase that is not used.
        let attenuation = plan.linear("attn", width, 2);
        let feature = plan.linear("feat", width, width);
        let signal = [plan.linear("sig.0", width + 2 * gamma, width), plan.linear("sig.1", width, width / 2)];
        let branch = Branch { frequencies, signal, out: plan.linear("out", width / 2, 2) };
        WrfgsLayers { trunk, attenuation, feature, branch }
    }

    /// Returns the layers for these weights.
    fn planned_layers(&self, weights: &[Real]) -> WrfgsLayers {
        lay_out_for(weights, |plan| self.plan_layers(plan))
    }
}

#[typetag::serde]
impl Deformation for Wrfgs {
    fn traits(&self) -> DeformationTraits {
        let couples_gaussians = self.gain.is_none();
        DeformationTraits {
            replaces_signals: true,
            couples_gaussians,
            differentiates_positions: true,
            runs_on_gpu: true,
            ..DeformationTraits::default()
        }
    }

    fn layout(&self) -> Layout {
        lay_out(|plan| self.plan_layers(plan)).1.layout()
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, prepared: &Cache) -> Deltas {
        let &DeformationInputs { weights, means, txs, pose, .. } = inputs;
        let gain = self.gain(means, pose) as Real;
        #[cfg(feature = "gpu")]
        if let Some(gpu) = pwrfgs_gpu::current() {
            let trunk_output = prepared.as_ref().and_then(|cache| cache.downcast_ref());
            let products = self.planned_layers(weights).gpu_forward(gpu, inputs, trunk_output);
            return Self::signals(
                gain,
                products.unwrap_or_else(|error| {
                    pwrfgs_core::device::fail(error);
                    vec![0.0; means.len() * txs.len()]
                }),
            );
        }
        let txs = txs.positions();
        let products = if prepared.is_some() {
            let (network, trunk_output): &(WrfgsLayers, Vec<TrunkOutput>) = cached(prepared);
            network.forward(weights, means, txs, Some(trunk_output.as_slice()))
        } else {
            self.planned_layers(weights).forward(weights, means, txs, None)
        };
        Self::signals(gain, products)
    }

    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], _: &Pose) -> Cache {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = pwrfgs_gpu::current() {
            return match self.planned_layers(weights).gpu_prepare(gpu, weights, means) {
                Ok(trunk_output) => trunk_output.map(|output| Arc::new(output) as Arc<_>),
                Err(error) => {
                    pwrfgs_core::device::fail(error);
                    None
                }
            };
        }
        let network = self.planned_layers(weights);
        let trunk_output = network.trunk_outputs(weights, means);
        Some(Arc::new((network, trunk_output)))
    }

    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, mut sums: DeformationVjp<'_>) {
        if d.signals.is_empty() {
            return;
        }
        let network = self.planned_layers(inputs.weights);
        assert_eq!(sums.weights.len(), inputs.weights.len(), "a derivative for each weight");
        let gain = self.gain(inputs.means, inputs.pose);
        let d_products: Vec<Real> = d.signals.iter().map(|d| gain as Real * d[0]).collect();
        #[cfg(feature = "gpu")]
        let along_gain = match pwrfgs_gpu::current() {
            Some(gpu) => network.gpu_vjp(gpu, inputs, &d_products, &mut sums).unwrap_or_else(|error| {
                pwrfgs_core::device::fail(error);
                0.0
            }),
            None => network.vjp(inputs, &d_products, &mut sums),
        };
        #[cfg(not(feature = "gpu"))]
        let along_gain = network.vjp(inputs, &d_products, &mut sums);
        let norm = Self::cloud_norm(inputs.means, inputs.pose);
        if let Some(d_means) = sums.means.filter(|_| self.gain.is_none() && norm > 0.0) {
            // g·∂L/∂g is available; with g = 40·F, ∂g/∂X = g·(X - r)/F².
            let scale = along_gain / (norm * norm);
            for (d, x) in d_means.iter_mut().zip(inputs.means) {
                for k in 0..3 {
                    d[k] += (scale * (f64::from(x[k]) - inputs.pose.position[k])) as Real;
                }
            }
        }
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, self.skip)?;
        if self.width < 2 {
            return Err("width is 1; give at least 2, because the last hidden layer has half the width".to_owned());
        }
        check_frequencies("frequencies", self.frequencies)?;
        match self.gain {
            Some(gain) if !(gain.is_finite() && gain > 0.0) => {
                Err(format!("gain is {gain}; give a positive number, or `None` for the released 40·F"))
            }
            _ => Ok(()),
        }
    }
}
