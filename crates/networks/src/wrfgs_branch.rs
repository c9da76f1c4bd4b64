//! Signal branch of [`super::Wrfgs`]: from the feature of a Gaussian and the transmitter to the amplitude S.
//!
//! ```text
//! feature ─────────────────────────┐
//! γ(p) (folded into the bias) ─────┼→ sig.0, ReLU → sig.1, ReLU → out (2 → S = |lrelu|)
//! γ(X - p) ────────────────────────┘
//! ```

use crate::dense::{self, StoreMode};
use crate::encoding::{self, encode, encode_vjp};
use crate::linear::{LayerPart, Linear};
use pwrfgs_core::Real;
use rayon::prelude::*;

/// Layers and the offsets of their weights.
#[derive(Debug)]
pub(super) struct Branch {
    pub(super) frequencies: usize,
    pub(super) signal: [Linear; 2],
    pub(super) out: Linear,
}

/// Activations per transmitter: γ(p), and the bias of `sig.0` including W·γ(p).
pub(super) struct TxSide {
    gamma: Vec<Real>,
    pub(super) folded: Vec<Real>,
}

/// Buffers for one chunk and transmitter, reused.
#[derive(Default)]
pub(super) struct BranchScratch {
    offset: Vec<Real>, // γ(X - p)
    hidden: [Vec<Real>; 2],
    /// Output `[2, R]` before |lrelu| of [`Branch::forward`], and the cotangent for [`Branch::vjp`].
    pub(super) out: Vec<Real>,
    d: Vec<Real>,
    spare: Vec<Real>,
    d_offset: Vec<[Real; 3]>, // cotangents of X - p
}

impl Branch {
    /// Returns the columns of `sig.0` for the feature, γ(p) and γ(X - p).
    pub(super) fn first_layer_parts(&self) -> [LayerPart; 3] {
        let (first, gamma) = (&self.signal[0], encoding::encoded_width(self.frequencies));
        // The feature has as many values as this layer has outputs: the width of the network.
        let width = first.outputs;
        [first.part(0..width), first.part(width..width + gamma), first.part(width + gamma..width + 2 * gamma)]
    }

    /// Runs the part of the branch that depends on the transmitter only, for each transmitter on its own, so that batches
    /// are bit-identical to single calls.
    pub(super) fn tx_sides(&self, weights: &[Real], txs: &[[Real; 3]]) -> Vec<TxSide> {
        let [_, tx_part, _] = self.first_layer_parts();
        let side = |&tx: &[Real; 3]| {
            let mut gamma = vec![0.0; encoding::encoded_width(self.frequencies)];
            encode([tx].into_iter(), self.frequencies, &mut gamma);
            let mut folded = self.signal[0].bias(weights).to_vec();
            tx_part.apply(weights, &gamma, &mut folded, StoreMode::Add);
            TxSide { gamma, folded }
        };
        txs.par_iter().map(side).collect()
    }

    /// Runs the backward pass of [`Self::tx_sides`], given the cotangents of the folded biases, `[B, width]`. Adds to
    /// `d_weights`, and to the cotangents `d_txs` of the positions if given.
    pub(super) fn tx_sides_vjp(
        &self,
        weights: &[Real],
        sides: &[TxSide],
        d_folded: &[Real],
        d_weights: &mut [Real],
        d_txs: Option<&mut [[Real; 3]]>,
    ) {
        let [_, tx_part, _] = self.first_layer_parts();
        let mut d_txs = d_txs.map(|d_txs| d_txs.chunks_mut(1));
        for (side, d) in sides.iter().zip(d_folded.chunks_exact(self.signal[0].outputs)) {
            tx_part.weight_vjp(d_weights, &side.gamma, d);
            dense::add_assign(self.signal[0].bias_mut(d_weights), d);
            if let Some(d_tx) = d_txs.as_mut().and_then(Iterator::next) {
                let mut d_gamma = vec![0.0; side.gamma.len()];
                tx_part.input_vjp(weights, d, &mut d_gamma, StoreMode::Set);
                encode_vjp(&side.gamma, &d_gamma, self.frequencies, d_tx);
            }
        }
    }

    /// Runs the branch for a chunk and one transmitter into `scratch.out`; `from_feature` `[width, R]` is W·feature of `sig.0`.
    pub(super) fn forward(
        &self,
        weights: &[Real],
        means: &[[Real; 3]],
        from_feature: &[Real],
        tx: [Real; 3],
        side: &TxSide,
        scratch: &mut BranchScratch,
    ) {
        let BranchScratch { offset, hidden: [first, second], out, .. } = scratch;
        let rows = means.len();
        offset.resize(rows * encoding::encoded_width(self.frequencies), 0.0);
        encode(means.iter().map(|x| std::array::from_fn(|k| x[k] - tx[k])), self.frequencies, offset);
        first.clear();
        first.extend_from_slice(from_feature);
        self.first_layer_parts()[2].apply(weights, offset, first, StoreMode::Add);
        dense::add_bias_relu(first, &side.folded);
        self.signal[1].apply_relu(weights, first, second);
        self.out.apply(weights, second, out);
    }

    /// Runs the backward pass of [`Self::forward`], whose activations are in `scratch`, with the cotangent in `scratch.out`.
    /// Adds to the cotangents of the weights, the folded bias `[width]`, `from_feature`, and if requested of the centres and,
    /// through X - p only, of the transmitter.
    #[allow(clippy::too_many_arguments)] // the two ends of the derivative
    pub(super) fn vjp(
        &self,
        weights: &[Real],
        scratch: &mut BranchScratch,
        d_weights: &mut [Real],
        d_folded: &mut [Real],
        d_from_feature: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
        d_tx: Option<&mut [Real; 3]>,
    ) {
        let BranchScratch { offset, hidden: [first, second], out, d, spare, d_offset } = scratch;
        self.out.apply_vjp(weights, (second, out), d_weights, (spare, StoreMode::Set));
        dense::add_bias_relu_vjp(spare, second, self.signal[1].bias_mut(d_weights));
        self.signal[1].whole().weight_vjp(d_weights, first, spare);
        d.resize(first.len(), 0.0);
        self.signal[1].whole().input_vjp(weights, spare, d, StoreMode::Set);
        dense::add_bias_relu_vjp(d, first, d_folded);
        dense::add_assign(d_from_feature, d);
        let [_, _, offset_part] = self.first_layer_parts();
        offset_part.weight_vjp(d_weights, offset, d);
        if d_means.is_none() && d_tx.is_none() {
            return;
        }
        spare.resize(offset.len(), 0.0);
        offset_part.input_vjp(weights, d, spare, StoreMode::Set);
        if let Some(d_tx) = d_tx {
            d_offset.clear();
            d_offset.resize(out.len() / 2, [0.0; 3]);
            encode_vjp(offset, spare, self.frequencies, d_offset);
            d_offset.iter().for_each(|d| (0..3).for_each(|k| d_tx[k] -= d[k]));
        }
        if let Some(d_means) = d_means {
            encode_vjp(offset, spare, self.frequencies, d_means);
        }
    }
}
