//! `Nerf2Network`: the layers of NeRF2 and the offsets of their weights.

use crate::nerf2::Nerf2;
use pwrfgs_core::{Conditions, Real};
use pwrfgs_networks::dense::{Matrix, MatrixMut, StoreMode, product};
use pwrfgs_networks::encoding::{encode, encode_vjp, encoded_width};
use pwrfgs_networks::linear::LayoutBuilder;
use pwrfgs_networks::linear::{LayerPart, Linear};
use pwrfgs_networks::trunk::{Trunk, TrunkShape};

/// Number of frequencies of every encoding.
pub(crate) const FREQUENCIES: usize = 10;

/// All layers. The trunk maps the position of a sample to a feature, from which follows the attenuation; with view
/// direction and transmitter it gives the emission.
#[derive(Debug)]
pub(crate) struct Nerf2Network {
    pub(crate) trunk: Trunk,
    pub(crate) attenuation: Linear,
    pub(crate) feature: Linear,
    /// Layers [feature, view, transmitter] → width → width / 2.
    pub(crate) signal: [Linear; 2],
    pub(crate) emission: Linear,
    /// Length of a raw output: amplitudes, then phases.
    pub(crate) outputs: usize,
    /// Whether features, which are not encoded, replace the transmitter position.
    reads_features: bool,
    transmitter_width: usize,
}

impl Nerf2Network {
    /// Plans the network of `method`, with `bands` amplitudes and phases per sample.
    pub(crate) fn new(method: &Nerf2, bands: usize, plan: &mut LayoutBuilder) -> Self {
        let (wide, encoded, outputs) = (method.width, encoded_width(FREQUENCIES), 2 * bands);
        let (reads_features, transmitter_width) = match method.features {
            0 => (false, encoded),
            features => (true, features),
        };
        let skip = (method.depth > 5).then_some(4); // as released
        Self {
            trunk: Trunk::new(plan, TrunkShape { depth: method.depth, width: wide, skip, gamma: encoded, side: 0 }),
            attenuation: plan.linear("attenuation", wide, outputs),
            feature: plan.linear("feature", wide, wide),
            signal: [
                plan.linear("signal.0", wide + encoded + transmitter_width, wide),
                plan.linear("signal.1", wide, wide / 2),
            ],
            emission: plan.linear("emission", wide / 2, outputs),
            outputs,
            reads_features,
            transmitter_width,
        }
    }

    /// Returns the number of units of the trunk.
    pub(crate) fn width(&self) -> usize {
        self.trunk.width
    }

    /// Returns the columns of the first layer of the signal network for the feature.
    pub(crate) fn feature_columns(&self) -> LayerPart {
        self.signal[0].part(0..self.width())
    }

    /// Returns the columns of the first layer of the signal network for the view direction.
    pub(crate) fn view_columns(&self) -> LayerPart {
        self.signal[0].part(self.width()..self.width() + encoded_width(FREQUENCIES))
    }

    /// Returns the columns of the first layer of the signal network for the transmitter.
    fn transmitter_columns(&self) -> std::ops::Range<usize> {
        self.signal[0].inputs - self.transmitter_width..self.signal[0].inputs
    }

    /// Returns the network inputs per transmitter, `[B, inputs]`: features, or encoded positions in units of `unit` metres.
    fn transmitter_inputs(&self, conditions: &Conditions<'_>, unit: Real) -> Vec<Real> {
        if self.reads_features {
            return conditions.values().to_vec();
        }
        let mut inputs = vec![0.0; conditions.len() * self.transmitter_width];
        for (tx, inputs) in conditions.positions().iter().zip(inputs.chunks_exact_mut(self.transmitter_width)) {
            encode([tx.map(|x| x / unit)].into_iter(), FREQUENCIES, inputs);
        }
        inputs
    }

    /// Returns the contribution of each transmitter to the first layer of the signal network, `[B, width]`. Runs one
    /// transmitter at a time, so that batches are bit-identical to single calls.
    pub(crate) fn transmitter_terms(&self, weights: &[Real], conditions: &Conditions<'_>, unit: Real) -> Vec<Real> {
        let inputs = self.transmitter_inputs(conditions, unit);
        let mut terms = vec![0.0; conditions.len() * self.width()];
        for (input, out) in inputs.chunks_exact(self.transmitter_width).zip(terms.chunks_exact_mut(self.width())) {
            let w = self.signal[0].weight(weights).columns(self.transmitter_columns());
            let input = Matrix::new(input, self.transmitter_width, 1);
            product(MatrixMut::new(out, self.width(), 1), StoreMode::Set, w, input);
        }
        terms
    }

    /// Returns the memory of the stored activations, bytes, for `rays` rays with `passes` transmitters each. Encodings and
    /// path factors, which are smaller, are not counted.
    pub(crate) fn activation_bytes(&self, samples: usize, rays: usize, passes: usize) -> usize {
        let per_sample = (self.trunk.depth() + 2) * self.width() + passes * (3 * self.width() / 2 + self.outputs);
        rays * samples * per_sample * size_of::<Real>()
    }

    /// Runs the backward pass of [`Self::transmitter_terms`], given the cotangents `d_terms` `[B, width]`. Adds to `d_weights`,
    /// and to `d_positions` if given, which requires positions as inputs.
    pub(crate) fn transmitter_terms_vjp(
        &self,
        weights: &[Real],
        conditions: &Conditions<'_>,
        unit: Real,
        d_terms: &[Real],
        (d_weights, d_positions): (&mut [Real], Option<&mut [[Real; 3]]>),
    ) {
        let (inputs, batch) = (self.transmitter_inputs(conditions, unit), conditions.len());
        let d = Matrix::new(d_terms, batch, self.width());
        let d_w = self.signal[0].weight_mut(d_weights).columns(self.transmitter_columns());
        product(d_w, StoreMode::Add, d.t(), Matrix::new(&inputs, batch, self.transmitter_width));
        let Some(d_positions) = d_positions else { return };
        let mut d_inputs = vec![0.0; inputs.len()];
        let w = self.signal[0].weight(weights).columns(self.transmitter_columns());
        product(MatrixMut::new(&mut d_inputs, batch, self.transmitter_width), StoreMode::Set, d, w);
        let rows = inputs.chunks_exact(self.transmitter_width).zip(d_inputs.chunks_exact(self.transmitter_width));
        for ((inputs, d), d_tx) in rows.zip(d_positions) {
            let mut d_scaled = [[0.0; 3]];
            encode_vjp(inputs, d, FREQUENCIES, &mut d_scaled);
            d_tx.iter_mut().zip(d_scaled[0]).for_each(|(sum, d)| *sum += d / unit);
        }
    }
}
