//! Transmitter branch of [`super::Mlp`]: from the position, and the carrier, to features and biases of the trunk.

use crate::dense::{self, Matrix, MatrixMut, StoreMode, product};
use crate::encoding::{self, encode, encode_vjp};
use crate::linear::Linear;
use crate::trunk::{Joints, Trunk};
use pwrfgs_core::{Conditions, Real};
use rayon::prelude::*;

/// Layers of the branch.
#[derive(Debug)]
pub(super) struct TxBranch {
    /// Number of frequencies of the encoding of the position.
    pub(super) frequencies: usize,
    /// Factor on the carrier, which then is the last input.
    pub(super) carrier: Option<Real>,
    pub(super) layers: [Linear; 2],
}

/// Activations that depend on the transmitter only.
pub(super) struct TxSide {
    /// Encoding γ of the transmitter position, and the carrier.
    gamma: Vec<Real>,
    /// Activations after `tx.0`.
    hidden: Vec<Real>,
    /// Features e, after `tx.1`.
    features: Vec<Real>,
    /// Biases of the trunk including W·e.
    pub(super) folded: Joints,
}

impl TxBranch {
    /// Runs the transmitter branch for each transmitter on its own, so that batches are bit-identical to single calls.
    pub(super) fn tx_sides(&self, weights: &[Real], trunk: &Trunk, txs: Conditions<'_>) -> Vec<TxSide> {
        let side = |(b, &tx): (usize, &[Real; 3])| {
            let mut gamma = vec![0.0; encoding::encoded_width(self.frequencies)];
            encode([tx].into_iter(), self.frequencies, &mut gamma);
            gamma.extend(self.carrier.map(|factor| factor * txs.carrier(b)));
            let (mut hidden, mut features) = (Vec::new(), Vec::new());
            self.layers[0].apply_relu(weights, &gamma, &mut hidden);
            self.layers[1].apply(weights, &hidden, &mut features);
            let folded = trunk.fold_biases(weights, &features);
            TxSide { gamma, hidden, features, folded }
        };
        txs.positions().par_iter().enumerate().map(side).collect()
    }

    /// Runs the backward pass of the transmitter branch for all transmitters at once, given the cotangents of the folded
    /// biases, `[B, width]` each: adds to `d_weights`, and to the cotangents `d_txs` of the positions if given.
    pub(super) fn vjp(
        &self,
        weights: &[Real],
        trunk: &Trunk,
        sides: &[TxSide],
        d_folded: &Joints,
        d_weights: &mut [Real],
        d_txs: Option<&mut [[Real; 3]]>,
    ) {
        let batch = sides.len();
        let stack = |field: fn(&TxSide) -> &[Real]| -> Vec<Real> { sides.iter().flat_map(field).copied().collect() };
        let features = stack(|s| &s.features);
        let d_features = trunk.fold_biases_vjp(weights, &features, d_folded, d_weights);
        let [first, second] = &self.layers;
        let d_e = Matrix::new(&d_features, batch, second.outputs);
        let hidden = stack(|s| &s.hidden);
        product(second.weight_mut(d_weights), StoreMode::Add, d_e.t(), Matrix::new(&hidden, batch, second.inputs));
        d_features.chunks_exact(second.outputs).for_each(|d| dense::add_assign(second.bias_mut(d_weights), d));
        let mut d_hidden = vec![0.0; hidden.len()];
        product(MatrixMut::new(&mut d_hidden, batch, second.inputs), StoreMode::Set, d_e, second.weight(weights));
        d_hidden.iter_mut().zip(&hidden).for_each(|(d, &h)| *d = if h > 0.0 { *d } else { 0.0 });
        let gamma = stack(|s| &s.gamma);
        let d_z = Matrix::new(&d_hidden, batch, first.outputs);
        product(first.weight_mut(d_weights), StoreMode::Add, d_z.t(), Matrix::new(&gamma, batch, first.inputs));
        d_hidden.chunks_exact(first.outputs).for_each(|d| dense::add_assign(first.bias_mut(d_weights), d));
        let Some(d_txs) = d_txs else { return };
        let mut d_gamma = vec![0.0; gamma.len()];
        product(MatrixMut::new(&mut d_gamma, batch, first.inputs), StoreMode::Set, d_z, first.weight(weights));
        let rows = gamma.chunks_exact(first.inputs).zip(d_gamma.chunks_exact(first.inputs));
        let each = rows.zip(d_txs.chunks_mut(1));
        let encoded = encoding::encoded_width(self.frequencies); // the carrier may follow
        each.for_each(|((gamma, d), d_tx)| encode_vjp(&gamma[..encoded], &d[..encoded], self.frequencies, d_tx));
    }
}
