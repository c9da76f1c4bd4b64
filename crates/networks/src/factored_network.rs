//! Forward pass of [`super::Factored`].
//!
//! ```text
//! (features of the data → tx.white →)
//! γ(p) → tx.0 … tx.{depth-1}, each with ReLU → T → branchᵀ → v ─┐ (once per transmitter)
//! (p → correlations with training positions → nearᵀ → + v) ─────┤
//! φ(μ) ─────────────────────────────────────────────────────────┴→ s = v·φ + v₀ (once per Gaussian)
//! ```
//! Factors G = branch·φ are linear in the waves, so G·T = φ·(branchᵀ·T). The product branchᵀ·T is computed once per
//! transmitter. A Gaussian then costs two products with one number per wave, however wide the stack is.

use crate::dense;
use crate::encoding::{Encoder, Pseudo};
use crate::linear::Linear;
use crate::near::NearLayer;
use crate::relu_rows::ReluRows;
use crate::wave_mixture::{Basis, LANES, SignalKernel, WaveMixture};
use pwrfgs_core::{Conditions, Deltas, LinearPart, Real, widest};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::Range;

/// Mean magnitude of a sine.
pub(super) const WAVE_MEAN: f64 = std::f64::consts::FRAC_2_PI;

/// Number of transmitters that share one backward pass. It is constant, so that results do not depend on the number of
/// threads.
pub(super) const GROUP: usize = 32;

/// Layers in the flat weight vector.
pub(super) struct FactoredLayers {
    pub(super) tx_encoding: Encoder,
    pub(super) position_encoding: Encoder,
    /// Factor on the carrier, which then is the last input of the stack.
    pub(super) carrier: Option<Real>,
    /// Layer that maps features of the data to a pseudo-position, if requested.
    pub(super) pseudo: Option<Pseudo>,
    /// Layer that decorrelates features of the data; `None` without [`Encoder::Features`].
    pub(super) white: Option<Linear>,
    pub(super) stack: Vec<Linear>,
    pub(super) branch: Linear,
    /// Number of features T.
    pub(super) features: usize,
    /// Number of direct features at the end of T, which are the inputs of the transmitter; 0 for positions.
    pub(super) direct: usize,
    /// Layer on correlations with training positions, if requested.
    pub(super) near: Option<NearLayer>,
}

/// Number of tiles of [`LANES`] Gaussians per task. It is constant, so that results do not depend on the number of
/// threads.
pub(super) const TILES: usize = 8;

impl FactoredLayers {
    /// Returns the waves of the centres, without the coordinates, times [`Self::wave_scale`].
    pub(super) fn basis(&self, means: &[[Real; 3]]) -> Basis {
        let (n, waves, scale) = (means.len(), self.branch.inputs, self.wave_scale());
        let mut lanes = vec![[0.0; LANES]; n.div_ceil(LANES) * waves];
        lanes.par_chunks_exact_mut(waves).zip(means.par_chunks(LANES)).for_each(|(tile, means)| {
            let mut gamma = vec![0.0; means.len() * (3 + waves)];
            self.position_encoding.encode(means, &mut gamma);
            for (lanes, values) in tile.iter_mut().zip(gamma[3 * means.len()..].chunks_exact(means.len())) {
                lanes.iter_mut().zip(values).for_each(|(lane, value)| *lane = value * scale);
            }
        });
        Basis { lanes, n }
    }

    /// Returns the linear part of the network: the last features of T are the inputs of the transmitter, and the factors
    /// of a Gaussian for them are linear in its waves. `None` without direct features, Gaussians or transmitters.
    pub(super) fn linear_part(&self, weights: &[Real], means: &[[Real; 3]], txs: Conditions<'_>) -> Option<LinearPart> {
        let (inputs, n, rows) = (self.direct, means.len(), txs.len());
        if inputs == 0 || n == 0 || rows == 0 {
            return None;
        }
        let encoded = self.encode(weights, txs); // [inputs, rows]
        let values = (0..rows * inputs).map(|i| encoded[(i % inputs) * rows + i / inputs]).collect();
        let (functions, lanes) = (self.branch.inputs, self.basis(means).lanes);
        let wave = |i: usize, k: usize| lanes[i / LANES * functions + k][i % LANES];
        let basis = (0..n * functions).map(|e| wave(e / functions, e % functions)).collect();
        // The direct features are the last before the constants.
        let first = |c: usize| self.branch.weight + (self.channel_rows(c).end - 1 - inputs) * functions;
        let cleared = self.branch.weight..self.branch.bias + self.branch.outputs;
        Some(LinearPart { inputs, values, functions, basis, cleared, first: [first(0), first(1)] })
    }

    /// Returns a scale with which the magnitudes of the waves of a Gaussian sum to 1 on average. A step of Adam on `branch`
    /// then changes factors as much as a step on the stack changes weights.
    pub(super) fn wave_scale(&self) -> Real {
        (1.0 / (WAVE_MEAN * self.branch.inputs as f64)) as Real
    }

    /// Returns the number of inputs of the stack for B transmitters without the carrier, which follows.
    pub(super) fn encoded_len(&self, batch: usize) -> usize {
        (self.stack[0].inputs - usize::from(self.carrier.is_some())) * batch
    }

    /// Encodes B transmitters: the inputs of the stack, `[inputs, B]`.
    fn encode(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<Real> {
        let mut inputs = vec![0.0; txs.len() * self.stack[0].inputs];
        let encoded = self.encoded_len(txs.len());
        match &self.pseudo {
            Some(pseudo) => self.tx_encoding.encode(&pseudo.positions(weights, txs), &mut inputs),
            None => self.tx_encoding.encode_transmitters(txs, &mut inputs[..encoded]),
        }
        if let Some(white) = &self.white {
            let mut x = Vec::new();
            white.apply(weights, &inputs, &mut x);
            inputs = x;
        }
        if let Some(factor) = self.carrier {
            (0..txs.len()).for_each(|b| inputs[encoded + b] = factor * txs.carrier(b));
        }
        inputs
    }

    /// Runs the stack for B transmitters; returns its inputs and the output of every layer, `[features, B]` each. The last
    /// output is T, with the direct features at its end. With `near`, its correlations follow as one more entry.
    pub(super) fn run_stack(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<Vec<Real>> {
        let mut layers = vec![self.encode(weights, txs)];
        for (l, layer) in self.stack.iter().enumerate() {
            let mut h = Vec::new();
            layer.apply_relu(weights, &layers[l], &mut h);
            layers.push(h);
        }
        if self.direct > 0 {
            let inputs = layers[0].clone();
            layers.last_mut().expect("a layer or more").extend(inputs);
        }
        if let Some(near) = &self.near {
            layers.push(near.correlations(weights, txs));
        }
        layers
    }

    /// Returns the features T `[B, features]` of B transmitters. Those of one do not depend on the others, to the bit.
    fn features(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<Real> {
        let inputs: Vec<Real> = (0..txs.len()).flat_map(|b| self.encode(weights, txs.rows(b..b + 1))).collect();
        let mut x = Cow::Borrowed(&inputs);
        for layer in &self.stack {
            let mut y = vec![0.0; txs.len() * layer.outputs];
            let (weights, bias) = (layer.rows(weights, 0..layer.outputs), layer.bias(weights));
            widest(ReluRows { weights, bias, x: &x, y: &mut y });
            x = Cow::Owned(y);
        }
        if self.direct == 0 {
            return x.into_owned();
        }
        let (hidden, direct) = (x.chunks_exact(self.features - self.direct), inputs.chunks_exact(self.direct));
        hidden.zip(direct).flat_map(|(h, inputs)| [h, inputs].concat()).collect()
    }

    /// Returns the rows of `branch` that produce the factors of channel `c`, and then its constants.
    pub(super) fn channel_rows(&self, c: usize) -> Range<usize> {
        c * (self.features + 1)..(c + 1) * (self.features + 1)
    }

    /// Returns wave coefficients and constant terms for the transmitter `tx` with the features `t`, including those of `near`.
    fn wave_mixture(&self, weights: &[Real], t: &[Real], tx: Conditions<'_>) -> WaveMixture {
        let waves = self.branch.inputs;
        let mut mixed = WaveMixture::zeros(waves, 1);
        for c in 0..2 {
            let rows = self.channel_rows(c);
            let (factors, constant) = self.branch.rows(weights, rows.clone()).split_at(self.features * waves);
            let (biases, last) = self.branch.bias(weights)[rows].split_at(self.features);
            mixed.waves[c].copy_from_slice(constant);
            mixed.base[c][0] = last[0] + t.iter().zip(biases).map(|(t, bias)| t * bias).sum::<Real>();
            dense::add_scaled_rows(&mut mixed.waves[c], &t.iter().copied().zip(factors.chunks_exact(waves)));
        }
        if let Some(near) = &self.near {
            near.add_wave_coefficients(weights, &tx.positions()[0], &mut mixed.waves);
        }
        mixed
    }

    /// Returns wave coefficients and constant terms for each transmitter. Batches are bit-identical to single calls, so groups
    /// may depend on the number of threads.
    pub(super) fn wave_mixtures(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<WaveMixture> {
        let size = txs.len().div_ceil(rayon::current_num_threads()).clamp(1, GROUP);
        let group = |first: usize| {
            let txs = txs.rows(first..(first + size).min(txs.len()));
            let one = |(b, t): (usize, &[Real])| self.wave_mixture(weights, t, txs.rows(b..b + 1));
            self.features(weights, txs).chunks_exact(self.features).enumerate().map(one).collect::<Vec<_>>()
        };
        (0..txs.len()).into_par_iter().step_by(size).flat_map_iter(group).collect()
    }

    /// Returns the signals `[B, N]` of the Gaussians of `basis`, given the wave coefficients `mixed` per transmitter.
    pub(super) fn forward(&self, basis: &Basis, mixed: &[WaveMixture]) -> Deltas {
        let n = basis.n;
        let mut signals = vec![[0.0; 2]; mixed.len() * n];
        if signals.is_empty() {
            return Deltas { signals, ..Deltas::default() };
        }
        // Signals of every transmitter for the Gaussians of each task.
        let tasks = basis.lanes.par_chunks(TILES * self.branch.inputs);
        let mut parts: Vec<Vec<&mut [[Real; 2]]>> = tasks.clone().map(|_| Vec::new()).collect();
        for row in signals.chunks_exact_mut(n) {
            parts.iter_mut().zip(row.chunks_mut(TILES * LANES)).for_each(|(part, signals)| part.push(signals));
        }
        tasks.zip(parts).for_each(|(tiles, part)| {
            let waves = self.branch.inputs;
            part.into_iter()
                .zip(mixed)
                .for_each(|(signals, mixed)| widest(SignalKernel { tiles, waves, mixed, signals }));
        });
        Deltas { signals, ..Deltas::default() }
    }
}
