//! Forward and backward pass of [`super::Factored`].
//!
//! ```text
//! (features of the data → tx.white →)
//! γ(p) → tx.0 … tx.{depth-1}, each with ReLU → T → branchᵀ → v ─┐ (once a transmitter)
//! (p → correlations with training positions → nearᵀ → + v) ─────┤
//! φ(μ) ─────────────────────────────────────────────────────────┴→ s = v·φ + v₀ (once a Gaussian)
//! ```
//! Factors G = branch·φ are linear in the waves, so G·T = φ·(branchᵀ·T). The product branchᵀ·T is computed once per
//! transmitter. A Gaussian then costs two products with one number per wave, however wide the stack is.

use crate::dense::{self, Matrix, MatrixMut, StoreMode, product};
use crate::encoding::{Encoder, Pseudo};
use crate::linear::Linear;
use crate::near::NearLayer;
use crate::wave_mixture::{Basis, LANES, SignalKernel, WaveMixture};
use pwrfgs_core::{Conditions, DeformationInputs, DeformationVjp, Deltas, LinearPart, Real, widest};
use rayon::prelude::*;
use std::ops::Range;

/// Mean magnitude of a sine.
pub(super) const WAVE_MEAN: f64 = std::f64::consts::FRAC_2_PI;

/// Number of transmitters that share one backward pass. It is constant, so that results do not depend on the number of
/// threads.
const GROUP: usize = 32;

/// Layers in the flat weight vector.
pub(super) struct FactoredLayers {
    pub(super) tx_encoding: Encoder,
    pub(super) position_encoding: Encoder,
    /// Factor on the carrier, which then is the last input of the stack.
    pub(super) carrier: Option<Real>,
    /// Layer that maps features of the data to a pseudo-position, if requested.
    pub(super) pseudo: Option<Pseudo>,
    /// Layer that decorrelates features of the data; `None` for positions.
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
const TILES: usize = 8;

/// Index of the task, its tiles, and the derivatives of their centres if requested.
type Task<'a> = (usize, (&'a [[Real; LANES]], Option<&'a mut [[Real; 3]]>));

impl FactoredLayers {
    /// Encodes the centres of the Gaussians, scaled by [`Self::wave_scale`].
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
        let inputs_by_row = self.run_stack(weights, txs).swap_remove(0); // [inputs, rows]
        let values = (0..rows * inputs).map(|i| inputs_by_row[(i % inputs) * rows + i / inputs]).collect();
        let (functions, lanes) = (self.branch.inputs, self.basis(means).lanes);
        let wave = |i: usize, k: usize| lanes[i / LANES * functions + k][i % LANES];
        let basis = (0..n * functions).map(|e| wave(e / functions, e % functions)).collect();
        let first =
            |channel: usize| self.branch.weight + (channel * (self.features + 1) + self.features - inputs) * functions;
        let cleared = self.branch.weight..self.branch.bias + self.branch.outputs;
        Some(LinearPart { inputs, values, functions, basis, cleared, first: [first(0), first(1)] })
    }

    /// Returns a scale with which the magnitudes of the waves of a Gaussian sum to 1. A step of Adam on `branch` then
    /// changes factors as much as a step on the stack changes weights.
    fn wave_scale(&self) -> Real {
        (1.0 / (WAVE_MEAN * self.branch.inputs as f64)) as Real
    }

    /// Runs the stack for B transmitters; returns γ(p) and the output of every layer, feature-major `[·, B]`. The last
    /// output is T, followed by the correlations of `near` if there are any.
    fn run_stack(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<Vec<Real>> {
        let mut layers = vec![vec![0.0; txs.len() * self.stack[0].inputs]];
        let encoded = layers[0].len() - if self.carrier.is_some() { txs.len() } else { 0 };
        match &self.pseudo {
            Some(pseudo) => self.tx_encoding.encode(&pseudo.positions(weights, txs), &mut layers[0]),
            None => self.tx_encoding.encode_transmitters(txs, &mut layers[0][..encoded]),
        }
        if let Some(white) = &self.white {
            let mut x = Vec::new();
            white.apply(weights, &layers[0], &mut x);
            layers[0] = x;
        }
        if let Some(factor) = self.carrier {
            (0..txs.len()).for_each(|b| layers[0][encoded + b] = factor * txs.carrier(b));
        }
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

    /// Returns the rows of `branch` that produce the factors of channel `c`, and then its constants.
    fn channel_rows(&self, c: usize) -> Range<usize> {
        c * (self.features + 1)..(c + 1) * (self.features + 1)
    }

    /// Returns the coefficients of the waves per transmitter, from the output `layers` of [`Self::run_stack`].
    fn wave_mixture(&self, weights: &[Real], layers: &[Vec<Real>]) -> WaveMixture {
        let t = &layers[self.stack.len()];
        let (waves, batch) = (self.branch.inputs, t.len() / self.features);
        let mut mixed = WaveMixture::zeros(waves, batch);
        let features = Matrix::new(t, self.features, batch);
        for c in 0..2 {
            // Sums start with the row of constants.
            let (factors, constant) = self.branch.rows(weights, self.channel_rows(c)).split_at(self.features * waves);
            let (biases, last) = self.branch.bias(weights)[self.channel_rows(c)].split_at(self.features);
            for (row, constant) in mixed.waves[c].chunks_exact_mut(batch).zip(constant) {
                row.fill(*constant);
            }
            mixed.base[c].fill(last[0]);
            let factors = Matrix::new(factors, self.features, waves).t();
            product(MatrixMut::new(&mut mixed.waves[c], waves, batch), StoreMode::Add, factors, features);
            let biases = Matrix::new(biases, 1, self.features);
            product(MatrixMut::new(&mut mixed.base[c], 1, batch), StoreMode::Add, biases, features);
            if let (Some(near), Some(correlations)) = (&self.near, layers.get(self.stack.len() + 1)) {
                near.add_wave_coefficients(weights, c, correlations, &mut mixed.waves[c]);
            }
        }
        mixed
    }

    /// Computes the signals `[B, N]` of all Gaussians. Runs the stack for one transmitter at a time, so that batches are
    /// bit-identical to single calls.
    pub(super) fn forward(&self, weights: &[Real], basis: &Basis, txs: Conditions<'_>) -> Deltas {
        let n = basis.n;
        let mut signals = vec![[0.0; 2]; txs.len() * n];
        if signals.is_empty() {
            return Deltas { signals, ..Deltas::default() };
        }
        let one = |b: usize| {
            let layers = self.run_stack(weights, txs.rows(b..b + 1));
            self.wave_mixture(weights, &layers)
        };
        let mixed: Vec<WaveMixture> = (0..txs.len()).into_par_iter().map(one).collect();
        // Signals of every transmitter for the Gaussians of each task.
        let tasks = basis.lanes.par_chunks(TILES * self.branch.inputs);
        let mut parts: Vec<Vec<&mut [[Real; 2]]>> = tasks.clone().map(|_| Vec::new()).collect();
        for row in signals.chunks_exact_mut(n) {
            parts.iter_mut().zip(row.chunks_mut(TILES * LANES)).for_each(|(part, signals)| part.push(signals));
        }
        tasks.zip(parts).for_each(|(tiles, part)| {
            let waves = self.branch.inputs;
            part.into_iter()
                .zip(&mixed)
                .for_each(|(signals, mixed)| widest(SignalKernel { tiles, waves, mixed, signals }));
        });
        Deltas { signals, ..Deltas::default() }
    }

    /// Runs the backward pass of [`Self::forward`], given the cotangents `d` of the signals; adds to `sums`.
    pub(super) fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        if means.is_empty() || txs.is_empty() {
            return;
        }
        let groups: Vec<Range<usize>> =
            (0..txs.len()).step_by(GROUP).map(|first| first..(first + GROUP).min(txs.len())).collect();
        let layers: Vec<Vec<Vec<Real>>> =
            groups.par_iter().map(|group| self.run_stack(weights, txs.rows(group.clone()))).collect();
        let mixed: Vec<WaveMixture> = layers.par_iter().map(|layers| self.wave_mixture(weights, layers)).collect();
        let d_mixed = self.tiles_vjp(&self.basis(means), &groups, &mixed, d, sums.means);
        let mut d_txs = sums.positions.map(|d_txs| d_txs.chunks_mut(GROUP));
        let parts: Vec<Option<&mut [[Real; 3]]>> =
            groups.iter().map(|_| d_txs.as_mut().and_then(Iterator::next)).collect();
        let group = |(k, d_txs): (usize, Option<&mut [[Real; 3]]>)| {
            self.group_vjp(weights, txs.rows(groups[k].clone()), &layers[k], &d_mixed[k], d_txs)
        };
        let d_weights: Vec<Vec<Real>> = parts.into_par_iter().enumerate().map(group).collect();
        dense::add_in_order(sums.weights, &d_weights.iter().map(Vec::as_slice).collect::<Vec<_>>());
    }

    /// Returns the derivatives of the wave coefficients of each group of transmitters; adds those of the centres to
    /// `d_means`.
    fn tiles_vjp(
        &self,
        basis: &Basis,
        groups: &[Range<usize>],
        mixed: &[WaveMixture],
        d: &Deltas,
        d_means: Option<&mut [[Real; 3]]>,
    ) -> Vec<WaveMixture> {
        let (n, waves) = (basis.n, self.branch.inputs);
        let mut centres = d_means.map(|d_means| d_means.chunks_mut(TILES * LANES));
        let parts: Vec<Option<&mut [[Real; 3]]>> =
            (0..n).step_by(TILES * LANES).map(|_| centres.as_mut().and_then(Iterator::next)).collect();
        let task = |(k, (tiles, mut d_means)): Task<'_>| {
            let mut sums: Vec<WaveMixture> = groups.iter().map(|g| WaveMixture::zeros(waves, g.len())).collect();
            for (j, tile) in tiles.chunks_exact(waves).enumerate() {
                let first = (k * TILES + j) * LANES;
                let gaussians = first..(first + LANES).min(n);
                let d_tile = d_means.as_mut().map(|d| &mut d[j * LANES..][..gaussians.len()]);
                self.tile_vjp(tile, gaussians, groups, mixed, d, d_tile, &mut sums);
            }
            sums
        };
        let results: Vec<Vec<WaveMixture>> =
            basis.lanes.par_chunks(TILES * waves).zip(parts).enumerate().map(task).collect();
        // Sums in the order of the tasks, independent of the threads.
        let mut results = results.into_iter();
        let mut sums = results.next().expect("a Gaussian or more");
        for terms in results {
            sums.iter_mut().zip(&terms).for_each(|(sum, term)| sum.add_mixture(term));
        }
        sums
    }

    /// Runs the backward pass of the `gaussians` of one tile: adds to the derivatives `sums` of the wave coefficients, and
    /// to those of the centres if given.
    #[allow(clippy::too_many_arguments)] // the tile, and both ends of the derivative
    fn tile_vjp(
        &self,
        tile: &[[Real; LANES]],
        gaussians: Range<usize>,
        groups: &[Range<usize>],
        mixed: &[WaveMixture],
        d: &Deltas,
        d_means: Option<&mut [[Real; 3]]>,
        sums: &mut [WaveMixture],
    ) {
        let (n, waves, r) = (d.signals.len() / groups.last().map_or(1, |g| g.end), tile.len(), gaussians.len());
        let phi = Matrix::strided(tile.as_flattened(), (waves, r), (LANES, 1));
        let mut d_phi = vec![0.0; if d_means.is_some() { waves * r } else { 0 }];
        for ((group, mixed), sum) in groups.iter().zip(mixed).zip(sums) {
            let batch = group.len();
            for c in 0..2 {
                // Signals of one channel: element (i, b) has index 2(bN + i) + c.
                let first = 2 * (group.start * n + gaussians.start) + c;
                let d_s = Matrix::strided(&d.signals.as_flattened()[first..], (r, batch), (2, 2 * n));
                product(MatrixMut::new(&mut sum.waves[c], waves, batch), StoreMode::Add, phi, d_s);
                for (b, sum) in group.clone().zip(&mut sum.base[c]) {
                    *sum += d.signals[b * n..][gaussians.clone()].iter().map(|d| d[c]).sum::<Real>();
                }
                if d_means.is_some() {
                    let coefficients = Matrix::new(&mixed.waves[c], waves, batch);
                    product(MatrixMut::new(&mut d_phi, waves, r), StoreMode::Add, coefficients, d_s.t());
                }
            }
        }
        if let Some(d_means) = d_means {
            // Waves were scaled, and so are their slopes; the derivative of the encoding uses unscaled values.
            let scale = self.wave_scale();
            let unscaled: Vec<Real> = tile.iter().flat_map(|row| &row[..r]).map(|w| w / scale).collect();
            d_phi.iter_mut().for_each(|d| *d *= scale);
            self.position_encoding.waves_vjp(&unscaled, &d_phi, d_means);
        }
    }

    /// Returns the derivatives of the weights from some transmitters; adds those of their positions to `d_txs` if given.
    fn group_vjp(
        &self,
        weights: &[Real],
        txs: Conditions<'_>,
        layers: &[Vec<Real>],
        d: &WaveMixture,
        mut d_txs: Option<&mut [[Real; 3]]>,
    ) -> Vec<Real> {
        let (batch, mut d_weights) = (txs.len(), vec![0.0; weights.len()]);
        let mut d_h = self.wave_mixture_vjp(weights, &layers[self.stack.len()], d, &mut d_weights);
        if let (Some(near), Some(correlations)) = (&self.near, layers.get(self.stack.len() + 1)) {
            for c in 0..2 {
                near.vjp(c, correlations, &d.waves[c], &mut d_weights);
                if let Some(d_txs) = &mut d_txs {
                    near.position_vjp(weights, c, txs, correlations, &d.waves[c], d_txs);
                }
            }
        }
        let mut d_inputs = d_h.split_off((self.features - self.direct) * batch);
        for (l, layer) in self.stack.iter().enumerate().rev() {
            dense::add_bias_relu_vjp(&mut d_h, &layers[l + 1][..layer.outputs * batch], layer.bias_mut(&mut d_weights));
            layer.whole().weight_vjp(&mut d_weights, &layers[l], &d_h);
            if l == 0 && self.direct > 0 {
                layer.whole().input_vjp(weights, &d_h, &mut d_inputs, StoreMode::Add);
            }
            if l == 0 && self.direct == 0 && (self.pseudo.is_some() || d_txs.is_some()) {
                let mut d_gamma = vec![0.0; layer.inputs * batch];
                layer.whole().input_vjp(weights, &d_h, &mut d_gamma, StoreMode::Set);
                let encoded = layers[0].len() - if self.carrier.is_some() { batch } else { 0 };
                let encoding = (&layers[0][..encoded], &d_gamma[..encoded]);
                match (&self.pseudo, &mut d_txs) {
                    (Some(pseudo), _) => pseudo.vjp(weights, txs, encoding, &mut d_weights),
                    (None, Some(d_txs)) => self.tx_encoding.encode_vjp(encoding, d_txs),
                    (None, None) => {}
                }
            }
            if l > 0 {
                let mut d_x = vec![0.0; layer.inputs * batch];
                layer.whole().input_vjp(weights, &d_h, &mut d_x, StoreMode::Set);
                d_h = d_x;
            }
        }
        if let Some(white) = &self.white {
            self.white_vjp(white, txs, &d_inputs, &mut d_weights);
        }
        d_weights
    }

    /// Adds the derivatives of the layer `white` to `d_weights`, given those of its output.
    fn white_vjp(&self, white: &Linear, txs: Conditions<'_>, d: &[Real], d_weights: &mut [Real]) {
        let mut features = vec![0.0; txs.len() * white.inputs];
        self.tx_encoding.encode_transmitters(txs, &mut features);
        dense::add_bias_vjp(d, white.bias_mut(d_weights));
        white.whole().weight_vjp(d_weights, &features, d);
    }

    /// Runs the backward pass of [`Self::wave_mixture`] for the features `t` `[F, B]`, without the correlations: adds to
    /// `d_weights`; returns the cotangents of the features.
    fn wave_mixture_vjp(&self, weights: &[Real], t: &[Real], d: &WaveMixture, d_weights: &mut [Real]) -> Vec<Real> {
        let (width, waves, batch) = (self.features, self.branch.inputs, t.len() / self.features);
        let mut d_h = vec![0.0; width * batch];
        let t = Matrix::new(t, width, batch);
        for c in 0..2 {
            let d_v = Matrix::new(&d.waves[c], waves, batch);
            let d_base = Matrix::new(&d.base[c], 1, batch);
            let factors = Matrix::new(&self.branch.rows(weights, self.channel_rows(c))[..width * waves], width, waves);
            product(MatrixMut::new(&mut d_h, width, batch), StoreMode::Add, factors, d_v);
            let biases = Matrix::new(&self.branch.bias(weights)[self.channel_rows(c)][..width], 1, width);
            product(MatrixMut::new(&mut d_h, width, batch), StoreMode::Add, biases.t(), d_base);
            let (d_factors, d_constant) =
                self.branch.rows_mut(d_weights, self.channel_rows(c)).split_at_mut(width * waves);
            product(MatrixMut::new(d_factors, width, waves), StoreMode::Set, t, d_v.t());
            dense::add_bias_vjp(&d.waves[c], d_constant);
            let (d_biases, d_last) = self.branch.bias_mut(d_weights)[self.channel_rows(c)].split_at_mut(width);
            product(MatrixMut::new(d_biases, width, 1), StoreMode::Set, t, d_base.t());
            dense::add_bias_vjp(&d.base[c], d_last);
        }
        d_h
    }
}
