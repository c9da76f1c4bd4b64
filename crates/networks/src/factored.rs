//! `Factored`: signals as products of transmitter features and Gaussian factors.

use crate::check_carrier;
use crate::encoding::{Encoder, Encoding, Pseudo};
use crate::factored_network::{FactoredLayers, WAVE_MEAN};
use crate::linear::{LayoutBuilder, lay_out, lay_out_for};
use crate::near::Near;
use crate::trunk::check_stack;
use crate::wave_mixture::{Basis, WaveMixture};
use pwrfgs_core::{
    Cache, Cholesky, Conditions, Deformation, DeformationInputs, DeformationTraits, DeformationVjp, Deltas, JsonSchema,
    Layout, LinearPart, Pose, Real, cached,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A network that runs once per transmitter instead of once per Gaussian: `Δsᵢ(p) = G(μᵢ)·T(p) + G₀(μᵢ)`.
///
/// A stack of ReLU layers computes `width` features T from the encoded position γ(p) of the transmitter. One linear
/// layer on the encoding φ(μ) of the centre gives the factors G of each Gaussian: two rows (real and imaginary part) of
/// `width` + 1 numbers. A signal is then a scalar product. Waves that are short compared with the distance between
/// Gaussians make their factors independent; long waves make neighbours similar. A prediction costs one pass through
/// the stack, whatever N is. Sixteen Gaussians on a 4 x 4 array can represent every function of the transmitter that
/// the network can learn, so it suits `ArrayResponse`. Geometry does not depend on the transmitter. The architecture is
/// also known as branch and trunk (`DeepONet`).
///
/// Centres receive gradients through the network.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_networks as _;
/// let small = "Factored(depth: 3, width: 128, tx_encoding: Waves(count: 64, reach: 24.0))";
/// let small = Plugin::<dyn Deformation>::parse(small).unwrap();
/// assert!(!small.traits().varies_geometry);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Factored {
    /// Number of ReLU layers of the transmitter stack, 1 or more.
    pub depth: usize,
    /// Units per layer, and number of features.
    pub width: usize,
    /// Encoding of the transmitter position.
    pub tx_encoding: Encoding,
    /// Encoding of the centre, without the bare coordinates, which would dominate the waves.
    pub position_encoding: Encoding,
    /// Correlations with the training positions as further features, to which the factors are linear. They help if
    /// training positions are dense. `None` for none.
    pub near: Option<Near>,
    /// Factor on the carrier, an input for data with several carriers: the logarithm of its frequency, from -1 to 1. Higher
    /// factors let signals vary faster from one carrier to the next. 0 ignores the carrier.
    pub carrier: f64,
}

/// Encoded centres, and the coefficients of their waves for each transmitter.
type Kept = (Basis, Vec<WaveMixture>);

const WAVES: Encoding = Encoding::Waves { count: 32, reach: 4.0, seed: 0 };

impl Default for Factored {
    fn default() -> Self {
        Self {
            depth: 4,
            width: 256,
            tx_encoding: Encoding::default(),
            position_encoding: WAVES,
            near: None,
            carrier: 0.0,
        }
    }
}

impl Factored {
    /// Plans the layers in the order of the weight vector.
    fn plan_layers(&self, plan: &mut LayoutBuilder) -> FactoredLayers {
        let width = self.width;
        let tx_encoding = self.tx_encoding.encoder();
        let tx_width = self.tx_encoding.width();
        let carrier = (self.carrier != 0.0).then_some(self.carrier as Real);
        let inputs = |l| if l == 0 { tx_width + usize::from(carrier.is_some()) } else { width };
        let pseudo = match self.tx_encoding {
            Encoding::PseudoPosition { width, gain, octaves } => {
                Some(Pseudo { layer: plan.linear("tx.pseudo", width, 3), gain: gain as Real, octaves })
            }
            _ => None,
        };
        // Uniform within ±√(3/n): the variance of the inputs is kept, if `start` computes no whitening.
        let white = matches!(tx_encoding, Encoder::Features(..))
            .then(|| plan.linear_within("tx.white", tx_width, tx_width, (3.0 / tx_width as f64).sqrt()));
        let stack = (0..self.depth).map(|l| plan.linear_before_relu(&format!("tx.{l}"), inputs(l), width)).collect();
        let waves = self.position_encoding.width() - 3; // without the coordinates
        // Factors have the variance 1/width, so that initial signals have the magnitude of one feature.
        let bound = WAVE_MEAN * (6.0 * waves as f64 / width as f64).sqrt();
        let direct = if white.is_some() { tx_width } else { 0 };
        let features = width + direct;
        let branch = plan.linear_within("branch", waves, 2 * (features + 1), bound);
        let position_encoding = self.position_encoding.encoder();
        let near = self.near.as_ref().map(|near| near.plan_layer(plan, waves));
        FactoredLayers { tx_encoding, position_encoding, carrier, pseudo, white, stack, branch, features, direct, near }
    }
}

#[typetag::serde]
impl Deformation for Factored {
    fn traits(&self) -> DeformationTraits {
        DeformationTraits {
            inputs: self.tx_encoding.input_count(),
            reads_carrier: self.carrier != 0.0,
            kept_per_gaussian: 2 * (self.position_encoding.width() - 3), // waves and their derivatives
            differentiates_positions: !self.tx_encoding.requires_features(),
            ..DeformationTraits::default()
        }
    }

    fn layout(&self) -> Layout {
        let encodings = [("tx_encoding", &self.tx_encoding), ("position_encoding", &self.position_encoding)];
        let constants = encodings.into_iter().filter_map(|(field, encoding)| encoding.constants(field)).collect();
        Layout { constants, ..lay_out(|plan| self.plan_layers(plan)).1.layout() }
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, prepared: &Cache) -> Deltas {
        let fresh = || self.prepare(inputs.weights, inputs.means, inputs.pose);
        let prepared = prepared.clone().or_else(fresh);
        let (network, basis): &(FactoredLayers, Basis) = cached(&prepared);
        network.forward(basis, &network.wave_mixtures(inputs.weights, inputs.txs))
    }

    fn forward_for_vjp(&self, inputs: &DeformationInputs<'_>) -> (Deltas, Cache) {
        let network = lay_out_for(inputs.weights, |plan| self.plan_layers(plan));
        let kept: Kept = (network.basis(inputs.means), network.wave_mixtures(inputs.weights, inputs.txs));
        (network.forward(&kept.0, &kept.1), Some(Arc::new(kept)))
    }

    fn prepare(&self, weights: &[Real], means: &[[Real; 3]], _: &Pose) -> Cache {
        let network = lay_out_for(weights, |plan| self.plan_layers(plan));
        let basis = network.basis(means);
        Some(Arc::new((network, basis)))
    }

    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        let kept = inputs.kept.clone().or_else(|| self.forward_for_vjp(inputs).1);
        lay_out_for(inputs.weights, |plan| self.plan_layers(plan)).vjp(inputs, cached::<Kept>(&kept), d, sums);
    }

    fn linear_part(&self, weights: &[Real], means: &[[Real; 3]], training: Conditions<'_>) -> Option<LinearPart> {
        lay_out_for(weights, |plan| self.plan_layers(plan)).linear_part(weights, means, training)
    }

    fn start(&self, training: Conditions<'_>, weights: &mut [Real]) {
        let (network, _) = lay_out(|plan| self.plan_layers(plan));
        if let Some(near) = network.near {
            near.set_positions(training.positions(), weights);
        }
        let (Some(white), Encoding::Features { gain, .. }) = (network.white, &self.tx_encoding) else { return };
        if let Some((matrix, bias)) = whitening(training, *gain) {
            weights[white.weight..][..matrix.len()].copy_from_slice(&matrix);
            white.bias_mut(weights).copy_from_slice(&bias);
        }
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, None)?;
        check_carrier(self.carrier)?;
        let reads_features = self.tx_encoding.requires_features();
        if self.carrier != 0.0 && reads_features {
            return Err("carrier: it needs transmitter positions, but tx_encoding reads features; remove it".into());
        }
        self.tx_encoding.check("tx_encoding")?;
        self.position_encoding.check("position_encoding")?;
        if self.position_encoding.requires_features() {
            return Err("position_encoding: Gaussians have no features; give Waves(..) or Octaves(4)".into());
        }
        if let Some(near) = &self.near {
            near.check()?;
            if reads_features {
                return Err("near: it needs transmitter positions, but tx_encoding reads features; remove it".into());
            }
        }
        if self.position_encoding.width() == 3 {
            return Err("position_encoding has no waves; give Waves(count: 32, reach: 4.0) or Octaves(4)".into());
        }
        Ok(())
    }
}

/// Share of the mean variance that is added to every variance: weaker directions are noise and are not amplified.
const FAINTEST: f64 = 1e-3;
/// Maximum number of vectors from which the covariance is computed; more are thinned evenly.
const MOST: usize = 4_000;

/// Returns the whitening of `vectors`: W `[D,D]` and b `[D]` such that W·(gain·x) + b has zero mean and nearly unit
/// covariance. W = L⁻¹ of the Cholesky factor L of the covariance. `None` if there are no vectors, if all are equal, or if
/// a number is not finite.
pub(super) fn whitening(vectors: Conditions<'_>, gain: f64) -> Option<(Vec<Real>, Vec<Real>)> {
    let d = vectors.width();
    let stride = vectors.len().div_ceil(MOST).max(1);
    let rows: Vec<Vec<f64>> = vectors
        .values()
        .chunks_exact(d)
        .step_by(stride)
        .map(|row| row.iter().map(|v| gain * f64::from(*v as f32)).collect()) // equal in both precisions of `Real`
        .collect();
    let n = rows.len() as f64;
    if rows.is_empty() {
        return None;
    }
    let mean: Vec<f64> = (0..d).map(|k| rows.iter().map(|row| row[k]).sum::<f64>() / n).collect();
    let mut covariance = vec![0.0; d * d];
    for row in &rows {
        for i in 0..d {
            let x = (row[i] - mean[i]) / n;
            (0..=i).for_each(|j| covariance[i * d + j] += x * (row[j] - mean[j]));
        }
    }
    let variance = (0..d).map(|k| covariance[k * d + k]).sum::<f64>() / d as f64;
    if variance.is_nan() || variance <= 0.0 {
        return None; // equal vectors have no variance to normalise
    }
    (0..d).for_each(|k| covariance[k * d + k] += FAINTEST * variance);
    let inverse = Cholesky::new(covariance, d)?.inverse_of_factor();
    let bias = (0..d).map(|i| -(0..=i).map(|j| inverse[i * d + j] * mean[j]).sum::<f64>() as Real).collect();
    Some((inverse.into_iter().map(|v| v as Real).collect(), bias))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;

    #[test]
    fn whitening_decorrelates_inputs() {
        let random = &mut rng::stream(0, "whiten", 0);
        let mut values: Vec<Real> = Vec::new();
        for _ in 0..2000 {
            let [a, b] = [rng::normal(random), rng::normal(random)];
            values.extend([3.0 + 10.0 * a, 0.5 * a + 4.0 * b]);
        }
        let (w, bias) = whitening(Conditions::new(2, &values), 2.0).unwrap();
        let white = |row: &[Real]| [0, 1].map(|i| (w[2 * i] * row[0] + w[2 * i + 1] * row[1]) * 2.0 + bias[i]);
        let mut sums = [0.0; 5];
        for row in values.chunks(2) {
            let [x, y] = white(row).map(|v| v as f64);
            [x, y, x * x, x * y, y * y].iter().zip(&mut sums).for_each(|(v, sum)| *sum += v / 2000.0);
        }
        let expected = [0.0, 0.0, 1.0, 0.0, 1.0];
        assert!(sums.iter().zip(expected).all(|(sum, e)| (sum - e).abs() < 0.01), "{sums:?}");
        assert!(whitening(Conditions::new(2, &[]), 1.0).is_none());
        assert!(
            whitening(Conditions::new(2, &[1.0, 2.0, 1.0, 2.0]), 1.0).is_none(),
            "constants have no direction at all"
        );
    }
}
