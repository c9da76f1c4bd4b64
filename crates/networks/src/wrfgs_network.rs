//! Forward and backward pass of [`super::Wrfgs`], chunk by chunk; the output is S·A, without the gain.
//!
//! ```text
//! γ(X) → trunk.0 … trunk.{depth-1} ┬→ attn (2 → A = |lrelu|)      (once per Gaussian)
//!                                  └→ feat → signal branch → S    (once per Gaussian and transmitter, see `wrfgs_branch`)
//! ```

#[cfg(feature = "gpu")]
pub(crate) mod gpu;

use crate::dense::{self, StoreMode, amplitude, amplitude_slope};
use crate::encoding::{self, encode, encode_vjp};
use crate::linear::{Item, Linear, sum_groups, work_items};
use crate::trunk::{Joints, Trunk, TrunkGradient};
use crate::wrfgs_branch::{Branch, BranchScratch, TxSide};
use pwrfgs_core::{DeformationInputs, DeformationVjp, Real};
use rayon::prelude::*;

/// Layers and the offsets of their weights.
#[derive(Debug)]
pub(super) struct WrfgsLayers {
    pub(super) trunk: Trunk,
    pub(super) attenuation: Linear,
    pub(super) feature: Linear,
    pub(super) branch: Branch,
}

/// Values of a chunk of Gaussians that all transmitters share.
#[derive(Debug, Default)]
pub(super) struct TrunkOutput {
    attenuation: Vec<Real>,  // [2, R], before |lrelu|
    from_feature: Vec<Real>, // W·feature of `sig.0`
}

/// Buffers for one chunk, reused for all items of a task.
#[derive(Default)]
struct Scratch {
    gamma: Vec<Real>,
    shared: Joints,
    slots: Vec<Vec<Real>>,
    feature: Vec<Real>,
    branch: BranchScratch,
    // Cotangents.
    d_attenuation: Vec<Real>,
    d_from_feature: Vec<Real>,
    d: Vec<Real>,
    spare: Vec<Real>,
}

/// Accumulator of the backward pass, besides the derivatives of the weights.
struct GradientSum {
    /// Cotangents of the folded bias of `sig.0`, `[B, width]`.
    folded: Vec<Real>,
    /// Cotangents of the two biases of the trunk, which are added separately.
    trunk_biases: Joints,
    /// Derivative along the logarithm of the gain, Σ d·S·A.
    along_gain: f64,
    /// Cotangents of the centres of its items, in sequence, if requested.
    means: Option<Vec<[Real; 3]>>,
    /// Cotangents of the transmitters `[B]` through their distances to the centres, if requested.
    txs: Option<Vec<[Real; 3]>>,
    /// Offset of the current item in `means`.
    row: usize,
}

impl WrfgsLayers {
    /// Returns the values of a chunk that do not depend on the transmitter; activations stay in `scratch`. `slots` is 2 for
    /// predictions, or the number of trunk layers for the backward pass.
    fn run_trunk(&self, weights: &[Real], means: &[[Real; 3]], slots: usize, scratch: &mut Scratch) -> TrunkOutput {
        let Scratch { gamma, shared, feature, .. } = scratch;
        let (rows, width, frequencies) = (means.len(), self.trunk.width, self.branch.frequencies);
        gamma.resize(rows * encoding::encoded_width(frequencies), 0.0);
        encode(means.iter().copied(), frequencies, gamma);
        self.trunk.share_gamma(weights, gamma, shared);
        scratch.slots.resize_with(slots, Vec::new);
        self.trunk.forward(weights, shared, &self.trunk.fold_biases(weights, &[]), &mut scratch.slots);
        let h = &scratch.slots[self.trunk.last_slot(slots)];
        let mut attenuation = Vec::new();
        self.attenuation.apply(weights, h, &mut attenuation);
        self.feature.apply(weights, h, feature);
        let mut from_feature = vec![0.0; width * rows];
        self.branch.first_layer_parts()[0].apply(weights, feature, &mut from_feature, StoreMode::Set);
        TrunkOutput { attenuation, from_feature }
    }

    /// Runs the backward pass of [`Self::run_trunk`], whose activations and cotangents are in `scratch`: adds to
    /// `d_weights` and to `sum`.
    fn trunk_vjp(&self, weights: &[Real], scratch: &mut Scratch, d_weights: &mut [Real], sum: &mut GradientSum) {
        let Scratch { gamma, slots, feature, d_attenuation, d_from_feature, d, spare, .. } = scratch;
        let (h, width) = (&slots[self.trunk.depth() - 1], self.trunk.width);
        let [feature_part, ..] = self.branch.first_layer_parts();
        feature_part.weight_vjp(d_weights, feature, d_from_feature);
        spare.resize(feature.len(), 0.0);
        feature_part.input_vjp(weights, d_from_feature, spare, StoreMode::Set);
        self.feature.apply_vjp(weights, (h, spare), d_weights, (d, StoreMode::Set));
        self.attenuation.apply_vjp(weights, (h, d_attenuation), d_weights, (d, StoreMode::Add));
        let mut d_shared = self.trunk.zero_joints(h.len());
        let into =
            TrunkGradient { weights: d_weights, shared: &mut d_shared, folded: sum.trunk_biases.tx_part(0, width) };
        self.trunk.backward(weights, slots, d, spare, into);
        let mut d_gamma = sum.means.as_ref().map(|_| vec![0.0; gamma.len()]);
        self.trunk.share_gamma_vjp(weights, gamma, &d_shared, d_weights, d_gamma.as_deref_mut());
        if let (Some(d_gamma), Some(d_means)) = (d_gamma, &mut sum.means) {
            encode_vjp(gamma, &d_gamma, self.branch.frequencies, &mut d_means[sum.row..]);
        }
    }

    /// Returns the chunks of `n` Gaussians: the rows of the items. Each chunk is processed for all transmitters.
    fn chunks(&self, n: usize) -> Vec<Item> {
        work_items(n, 1, self.trunk.width)
    }

    /// Returns [`TrunkOutput`] of every chunk.
    pub(super) fn trunk_outputs(&self, weights: &[Real], means: &[[Real; 3]]) -> Vec<TrunkOutput> {
        let one = |scratch: &mut Scratch, item: &Item| self.run_trunk(weights, &means[item.rows.clone()], 2, scratch);
        self.chunks(means.len()).par_iter().map_init(Scratch::default, one).collect()
    }

    /// Returns the four outputs before |lrelu| in the order of the reference data: two of `attn`, two of `out`.
    #[cfg(test)]
    pub(super) fn raw(&self, weights: &[Real], means: &[[Real; 3]], tx: [Real; 3]) -> Vec<[Real; 4]> {
        let (mut scratch, n) = (Scratch::default(), means.len());
        let trunk_output = self.run_trunk(weights, means, 2, &mut scratch);
        let side = &self.branch.tx_sides(weights, &[tx])[0];
        self.branch.forward(weights, means, &trunk_output.from_feature, tx, side, &mut scratch.branch);
        let (a, s) = (trunk_output.attenuation, scratch.branch.out);
        (0..n).map(|r| [a[r], a[n + r], s[r], s[n + r]]).collect()
    }

    /// Returns S·A, `[B, N]`, from the result of [`Self::trunk_outputs`] if given.
    pub(super) fn forward(
        &self,
        weights: &[Real],
        means: &[[Real; 3]],
        txs: &[[Real; 3]],
        trunk_output: Option<&[TrunkOutput]>,
    ) -> Vec<Real> {
        let sides = self.branch.tx_sides(weights, txs);
        let pieces: Vec<Vec<Real>> = (self.chunks(means.len()).par_iter())
            .enumerate()
            .map_init(Scratch::default, |scratch, (chunk, item)| {
                let means = &means[item.rows.clone()];
                let fresh = trunk_output.is_none().then(|| self.run_trunk(weights, means, 2, scratch));
                let trunk_output = trunk_output.map(|all| &all[chunk]).or(fresh.as_ref()).expect("one or the other");
                let mut products = Vec::with_capacity(means.len() * txs.len());
                for (tx, side) in txs.iter().zip(&sides) {
                    self.branch.forward(weights, means, &trunk_output.from_feature, *tx, side, &mut scratch.branch);
                    let pairs = scratch.branch.out.iter().zip(&trunk_output.attenuation);
                    let magnitudes = pairs.take(means.len()); // phases follow
                    products.extend(magnitudes.map(|(&s, &a)| amplitude(s) * amplitude(a)));
                }
                products
            })
            .collect();
        let mut products = Vec::with_capacity(means.len() * txs.len());
        for b in 0..txs.len() {
            for piece in &pieces {
                let rows = piece.len() / txs.len();
                products.extend_from_slice(&piece[b * rows..(b + 1) * rows]);
            }
        }
        products
    }

    /// Runs the backward pass of [`Self::forward`], given the cotangents `d` `[B, N]`: adds to `sums`; returns Σ d·S·A.
    pub(super) fn vjp(&self, inputs: &DeformationInputs<'_>, d: &[Real], sums: &mut DeformationVjp<'_>) -> f64 {
        let DeformationInputs { weights, means, .. } = *inputs;
        let DeformationVjp { weights: d_weights, means: d_means, positions: d_txs } = sums;
        let txs = inputs.txs.positions();
        let sides = self.branch.tx_sides(weights, txs);
        let parts = sum_groups(&self.chunks(means.len()), d_weights, |items, d_weights| {
            let mut sum = GradientSum {
                folded: vec![0.0; txs.len() * self.trunk.width],
                trunk_biases: self.trunk.zero_joints(self.trunk.width),
                along_gain: 0.0,
                means: d_means.is_some().then(Vec::new),
                txs: d_txs.is_some().then(|| vec![[0.0; 3]; txs.len()]),
                row: 0,
            };
            let mut scratch = Scratch::default();
            for item in items {
                self.item_vjp(inputs, &sides, d, item, &mut scratch, (d_weights, &mut sum));
            }
            sum
        });
        for sum in &parts {
            self.trunk.add_joint_biases(d_weights, &sum.trunk_biases);
            self.branch.tx_sides_vjp(weights, &sides, &sum.folded, d_weights, d_txs.as_deref_mut());
            if let (Some(d_txs), Some(part)) = (&mut *d_txs, &sum.txs) {
                dense::add_assign(d_txs.as_flattened_mut(), part.as_flattened());
            }
        }
        if let Some(d_means) = d_means {
            let numbers = parts.iter().flat_map(|sum| sum.means.iter().flatten().flatten()).copied();
            dense::add_assign(d_means.as_flattened_mut(), &numbers.collect::<Vec<_>>());
        }
        parts.iter().map(|part| part.along_gain).sum()
    }

    /// Runs the backward pass of one chunk for all transmitters, given the cotangents `d` `[B, N]` of S·A; recomputes its
    /// forward pass first, and adds to `d_weights` and `sum`.
    fn item_vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        sides: &[TxSide],
        d: &[Real],
        item: &Item,
        scratch: &mut Scratch,
        (d_weights, sum): (&mut [Real], &mut GradientSum),
    ) {
        let (n, weights, width) = (inputs.means.len(), inputs.weights, self.trunk.width);
        let means = &inputs.means[item.rows.clone()];
        let trunk_output = self.run_trunk(weights, means, self.trunk.depth(), scratch);
        let Scratch { branch, d_attenuation, d_from_feature, .. } = &mut *scratch;
        d_attenuation.clear();
        d_attenuation.resize(2 * means.len(), 0.0);
        d_from_feature.clear();
        d_from_feature.resize(trunk_output.from_feature.len(), 0.0);
        if let Some(d_means) = &mut sum.means {
            sum.row = d_means.len();
            d_means.resize(sum.row + means.len(), [0.0; 3]);
        }
        for (b, (tx, side)) in inputs.txs.positions().iter().zip(sides).enumerate() {
            self.branch.forward(weights, means, &trunk_output.from_feature, *tx, side, branch);
            let (s, phase) = branch.out.split_at_mut(means.len());
            for (r, &d) in d[b * n..][item.rows.clone()].iter().enumerate() {
                let (signal, a) = (s[r], trunk_output.attenuation[r]);
                sum.along_gain += f64::from(d * amplitude(signal) * amplitude(a));
                d_attenuation[r] += d * amplitude(signal) * amplitude_slope(a);
                s[r] = d * amplitude(a) * amplitude_slope(signal);
            }
            phase.fill(0.0); // unused
            let d_means = sum.means.as_mut().map(|d_means| &mut d_means[sum.row..]);
            let d_folded = &mut sum.folded[b * width..(b + 1) * width];
            let d_tx = sum.txs.as_mut().map(|d_txs| &mut d_txs[b]);
            self.branch.vjp(weights, branch, d_weights, d_folded, d_from_feature, d_means, d_tx);
        }
        self.trunk_vjp(weights, scratch, d_weights, sum);
    }
}
