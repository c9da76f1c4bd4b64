//! Backward pass of [`super::Factored`].

use crate::dense::{self, Matrix, MatrixMut, StoreMode, product};
use crate::factored_network::{FactoredLayers, GROUP, TILES};
use crate::linear::Linear;
use crate::wave_mixture::{Basis, LANES, WaveMixture};
use pwrfgs_core::{Conditions, DeformationInputs, DeformationVjp, Deltas, Real};
use rayon::prelude::*;
use std::iter;
use std::ops::Range;

/// Index of the task, its tiles, and the derivatives of their centres if requested.
type Task<'a> = (usize, (&'a [[Real; LANES]], Option<&'a mut [[Real; 3]]>));

impl FactoredLayers {
    /// Runs the backward pass of [`Self::forward`] and [`Self::wave_mixtures`], given their `basis` and `mixed`, and the
    /// cotangents `d` of the signals; adds to `sums`.
    pub(super) fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        (basis, mixed): &(Basis, Vec<WaveMixture>),
        d: &Deltas,
        sums: DeformationVjp<'_>,
    ) {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        if means.is_empty() || txs.is_empty() {
            return;
        }
        let groups: Vec<Range<usize>> =
            (0..txs.len()).step_by(GROUP).map(|first| first..(first + GROUP).min(txs.len())).collect();
        let layers: Vec<Vec<Vec<Real>>> =
            groups.par_iter().map(|group| self.run_stack(weights, txs.rows(group.clone()))).collect();
        let mixed: Vec<WaveMixture> = mixed.chunks(GROUP).map(WaveMixture::join).collect();
        let d_mixed = self.tiles_vjp(basis, &groups, &mixed, d, sums.means);
        let mut d_txs = sums.positions.map(|d_txs| d_txs.chunks_mut(GROUP));
        let d_tx_parts: Vec<Option<&mut [[Real; 3]]>> =
            groups.iter().map(|_| d_txs.as_mut().and_then(Iterator::next)).collect();
        // The first group adds to the sums themselves.
        let mut others: Vec<Vec<Real>> = groups[1..].iter().map(|_| vec![0.0; weights.len()]).collect();
        let d_weights = iter::once(&mut *sums.weights).chain(others.iter_mut().map(Vec::as_mut_slice));
        let tasks: Vec<_> = d_weights.zip(d_tx_parts).enumerate().collect();
        tasks.into_par_iter().for_each(|(k, (d_weights, d_txs))| {
            self.group_vjp(weights, txs.rows(groups[k].clone()), &layers[k], &d_mixed[k], d_weights, d_txs);
        });
        dense::add_in_order(sums.weights, &others.iter().map(Vec::as_slice).collect::<Vec<_>>());
    }

    /// Returns the derivatives by the wave coefficients `mixed` of each group of transmitters; adds those by the centres to
    /// `d_means`, if given.
    fn tiles_vjp(
        &self,
        basis: &Basis,
        groups: &[Range<usize>],
        mixed: &[WaveMixture],
        d: &Deltas,
        d_means: Option<&mut [[Real; 3]]>,
    ) -> Vec<WaveMixture> {
        let (n, waves) = (basis.n, self.branch.inputs);
        let mut d_means = d_means.map(|d_means| d_means.chunks_mut(TILES * LANES));
        let d_mean_parts: Vec<Option<&mut [[Real; 3]]>> =
            (0..n).step_by(TILES * LANES).map(|_| d_means.as_mut().and_then(Iterator::next)).collect();
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
            basis.lanes.par_chunks(TILES * waves).zip(d_mean_parts).enumerate().map(task).collect();
        // Sums in the order of the tasks, independent of the threads.
        let mut results = results.into_iter();
        let mut sums = results.next().expect("a Gaussian or more");
        for terms in results {
            sums.iter_mut().zip(&terms).for_each(|(sum, term)| sum.add_mixture(term));
        }
        sums
    }

    /// Runs the backward pass of [`Self::forward`] for the `gaussians` of one tile: adds to the derivatives `sums` by the wave
    /// coefficients of each group of transmitters, and to those by the centres if given.
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

    /// Adds the derivatives by the weights from some transmitters to `d_weights`, and those by their positions to `d_txs` if
    /// given. `layers` is the result of [`Self::run_stack`], `d` the cotangent of the wave coefficients.
    fn group_vjp(
        &self,
        weights: &[Real],
        txs: Conditions<'_>,
        layers: &[Vec<Real>],
        d: &WaveMixture,
        d_weights: &mut [Real],
        mut d_txs: Option<&mut [[Real; 3]]>,
    ) {
        let batch = txs.len();
        let mut d_h = self.wave_mixture_vjp(weights, &layers[self.stack.len()], d, d_weights);
        if let (Some(near), Some(correlations)) = (&self.near, layers.get(self.stack.len() + 1)) {
            for c in 0..2 {
                near.weight_vjp(c, correlations, &d.waves[c], d_weights);
                if let Some(d_txs) = &mut d_txs {
                    near.position_vjp(weights, c, txs, correlations, &d.waves[c], d_txs);
                }
            }
        }
        let mut d_inputs = d_h.split_off((self.features - self.direct) * batch);
        for (l, layer) in self.stack.iter().enumerate().rev() {
            dense::add_bias_relu_vjp(&mut d_h, &layers[l + 1][..layer.outputs * batch], layer.bias_mut(d_weights));
            layer.whole().weight_vjp(d_weights, &layers[l], &d_h);
            if l == 0 && self.direct > 0 {
                layer.whole().input_vjp(weights, &d_h, &mut d_inputs, StoreMode::Add);
            } else if l == 0 {
                self.tx_encoding_vjp(weights, txs, &layers[0], &d_h, d_weights, d_txs.as_deref_mut());
            } else {
                let mut d_x = vec![0.0; layer.inputs * batch];
                layer.whole().input_vjp(weights, &d_h, &mut d_x, StoreMode::Set);
                d_h = d_x;
            }
        }
        if let Some(white) = &self.white {
            self.white_vjp(white, txs, &d_inputs, d_weights);
        }
    }

    /// Runs the backward pass of the inputs `gamma` of the stack, given the cotangents `d_h` of its first layer. Adds to
    /// `d_weights` for pseudo-positions; otherwise to `d_txs`, if given.
    fn tx_encoding_vjp(
        &self,
        weights: &[Real],
        txs: Conditions<'_>,
        gamma: &[Real],
        d_h: &[Real],
        d_weights: &mut [Real],
        d_txs: Option<&mut [[Real; 3]]>,
    ) {
        if self.pseudo.is_none() && d_txs.is_none() {
            return;
        }
        let mut d_gamma = vec![0.0; gamma.len()];
        self.stack[0].whole().input_vjp(weights, d_h, &mut d_gamma, StoreMode::Set);
        let encoded = self.encoded_len(txs.len());
        let encoding = (&gamma[..encoded], &d_gamma[..encoded]);
        match (&self.pseudo, d_txs) {
            (Some(pseudo), _) => pseudo.vjp(weights, txs, encoding, d_weights),
            (None, Some(d_txs)) => self.tx_encoding.encode_vjp(encoding, d_txs),
            (None, None) => {}
        }
    }

    /// Adds the derivatives by the layer `white` to `d_weights`, given the cotangent `d` of its output.
    fn white_vjp(&self, white: &Linear, txs: Conditions<'_>, d: &[Real], d_weights: &mut [Real]) {
        let mut features = vec![0.0; txs.len() * white.inputs];
        self.tx_encoding.encode_transmitters(txs, &mut features);
        dense::add_bias_vjp(d, white.bias_mut(d_weights));
        white.whole().weight_vjp(d_weights, &features, d);
    }

    /// Runs the backward pass of [`Self::wave_mixture`] for the features `t` `[features, B]`, without the correlations: adds to
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
            product(MatrixMut::new(d_factors, width, waves), StoreMode::Add, t, d_v.t());
            dense::add_bias_vjp(&d.waves[c], d_constant);
            let (d_biases, d_last) = self.branch.bias_mut(d_weights)[self.channel_rows(c)].split_at_mut(width);
            product(MatrixMut::new(d_biases, width, 1), StoreMode::Add, t, d_base.t());
            dense::add_bias_vjp(&d.base[c], d_last);
        }
        d_h
    }
}
