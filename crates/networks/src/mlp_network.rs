//! Forward and backward of [`super::Mlp`], chunk by chunk.
//!
//! ```text
//! γ(p_tx) → tx.0, ReLU → tx.1 → e ──┐ (once a transmitter, folded into biases)
//! γ(μ) ─────────────────────────────┴→ trunk.0 … trunk.{depth-1} → heads: rotation 4, scaling 3, signal 2
//! ```

use crate::layers::dense::{self, Matrix, MatrixMut, Store, product};
use crate::layers::encoding::{self, encode};
use crate::layers::linear::Linear;
use crate::layers::plan::{Item, items, items_per_sum};
use crate::layers::trunk::{Joints, Trunk, TrunkGradient};
use pwrfgs_core::{DeformationInputs, Deltas, JsonSchema, Real};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What an [`Mlp`](super::Mlp) changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Outputs {
    /// Rotations (4), scales (3) and signals (2).
    #[default]
    All,
    /// Signals (2) only.
    Signals,
}

/// The layers and where their weights lie.
#[derive(Debug)]
pub(super) struct Network {
    pub(super) position_frequencies: usize,
    pub(super) tx_frequencies: usize,
    pub(super) outputs: Outputs,
    pub(super) tx: [Linear; 2],
    pub(super) trunk: Trunk,
    pub(super) heads: Linear,
}

/// What depends on a transmitter alone.
struct TxSide {
    /// γ of its position.
    gamma: Vec<Real>,
    /// After `tx.0`.
    hidden: Vec<Real>,
    /// e, after `tx.1`.
    features: Vec<Real>,
    /// Biases of the trunk with W·e in them.
    folded: Joints,
}

/// Room for one chunk, kept from item to item of a task.
#[derive(Default)]
struct Scratch {
    gamma: Vec<Real>,
    shared: Joints,
    slots: Vec<Vec<Real>>,
    out: Vec<Real>,
    d: Vec<Real>,
    spare: Vec<Real>,
}

/// One accumulator of the backward pass.
struct Sum {
    weights: Vec<Real>,
    /// Of the folded biases, `[B, width]` each.
    folded: Joints,
}

impl Network {
    /// The transmitter's branch. One transmitter at a time: a batch then gives the bits of single calls.
    fn tx_side(&self, weights: &[Real], tx: [Real; 3]) -> TxSide {
        let mut gamma = vec![0.0; self.tx[0].inputs];
        encode([tx].into_iter(), self.tx_frequencies, &mut gamma);
        let apply = |layer: &Linear, x: &[Real]| {
            let mut y = vec![0.0; layer.outputs];
            layer.whole().apply(weights, x, &mut y, Store::Set);
            y
        };
        let mut hidden = apply(&self.tx[0], &gamma);
        dense::bias_relu(&mut hidden, self.tx[0].bias(weights));
        let mut features = apply(&self.tx[1], &hidden);
        dense::add_bias(&mut features, self.tx[1].bias(weights));
        let folded = self.trunk.fold(weights, &features);
        TxSide { gamma, hidden, features, folded }
    }

    fn tx_sides(&self, weights: &[Real], txs: &[[Real; 3]]) -> Vec<TxSide> {
        txs.par_iter().map(|&tx| self.tx_side(weights, tx)).collect()
    }

    /// γ and W·γ of a chunk's centres.
    fn begin(&self, weights: &[Real], means: &[[Real; 3]], scratch: &mut Scratch) {
        scratch.gamma.resize(means.len() * encoding::width(self.position_frequencies), 0.0);
        encode(means.iter().copied(), self.position_frequencies, &mut scratch.gamma);
        self.trunk.share(weights, &scratch.gamma, &mut scratch.shared);
    }

    pub(super) fn forward(&self, weights: &[Real], means: &[[Real; 3]], txs: &[[Real; 3]]) -> Deltas {
        let sides = self.tx_sides(weights, txs);
        let items = items(means.len(), txs.len(), self.trunk.width);
        let pieces: Vec<Vec<Deltas>> = items
            .par_iter()
            .map_init(Scratch::default, |scratch, item| {
                self.begin(weights, &means[item.rows.clone()], scratch);
                sides[item.txs.clone()].iter().map(|side| self.deltas(weights, side, scratch)).collect()
            })
            .collect();
        let mut all = Deltas::default();
        let mut start = 0;
        while start < items.len() {
            let txs = &items[start].txs;
            let chunks = items[start..].iter().take_while(|item| item.txs == *txs).count();
            for b in 0..txs.len() {
                for piece in &pieces[start..start + chunks] {
                    all.scales.extend_from_slice(&piece[b].scales);
                    all.quats.extend_from_slice(&piece[b].quats);
                    all.signals.extend_from_slice(&piece[b].signals);
                }
            }
            start += chunks;
        }
        all
    }

    /// The heads' outputs for the chunk in `scratch` and one transmitter.
    fn deltas(&self, weights: &[Real], side: &TxSide, scratch: &mut Scratch) -> Deltas {
        let Scratch { shared, slots, out, .. } = scratch;
        slots.resize_with(2, Vec::new);
        self.trunk.forward(weights, shared, &side.folded, slots);
        let h = &slots[self.trunk.last(2)];
        let rows = h.len() / self.trunk.width;
        out.resize(self.heads.outputs * rows, 0.0);
        self.heads.whole().apply(weights, h, out, Store::Set);
        dense::add_bias(out, self.heads.bias(weights));
        match self.outputs {
            Outputs::All => {
                Deltas { quats: gather(out, 0, rows), scales: gather(out, 4, rows), signals: gather(out, 7, rows) }
            }
            Outputs::Signals => Deltas { signals: gather(out, 0, rows), ..Deltas::default() },
        }
    }

    pub(super) fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, d_weights: &mut [Real]) {
        let DeformationInputs { weights, means, .. } = *inputs;
        let txs = inputs.txs.positions();
        let sides = self.tx_sides(weights, txs);
        let items = items(means.len(), txs.len(), self.trunk.width);
        let sums: Vec<Sum> = items
            .par_chunks(items_per_sum(items.len()))
            .map(|items| {
                let folded = self.trunk.zero_joints(txs.len() * self.trunk.width);
                let mut sum = Sum { weights: vec![0.0; weights.len()], folded };
                let mut scratch = Scratch::default();
                for item in items {
                    self.item_vjp(inputs, &sides, d, item, &mut scratch, &mut sum);
                }
                sum
            })
            .collect();
        dense::add_in_order(d_weights, &sums.iter().map(|s| s.weights.as_slice()).collect::<Vec<_>>());
        let mut folded = self.trunk.zero_joints(txs.len() * self.trunk.width);
        dense::add_in_order(&mut folded.first, &sums.iter().map(|s| s.folded.first.as_slice()).collect::<Vec<_>>());
        dense::add_in_order(&mut folded.joined, &sums.iter().map(|s| s.folded.joined.as_slice()).collect::<Vec<_>>());
        self.tx_vjp(weights, &sides, &folded, d_weights);
    }

    /// One chunk for some transmitters: the forward pass once more, then back.
    fn item_vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        sides: &[TxSide],
        d: &Deltas,
        item: &Item,
        scratch: &mut Scratch,
        sum: &mut Sum,
    ) {
        let (weights, n, width) = (inputs.weights, inputs.means.len(), self.trunk.width);
        self.begin(weights, &inputs.means[item.rows.clone()], scratch);
        let Scratch { gamma, shared, slots, out, d: d_h, spare } = scratch;
        let rows = item.rows.len();
        slots.resize_with(self.trunk.depth(), Vec::new);
        let mut d_shared = self.trunk.zero_joints(width * rows);
        out.resize(self.heads.outputs * rows, 0.0);
        for b in item.txs.clone() {
            self.trunk.forward(weights, shared, &sides[b].folded, slots);
            let here = b * n + item.rows.start..b * n + item.rows.end;
            match self.outputs {
                Outputs::All => {
                    scatter(d.quats.get(here.clone()), out, 0, rows);
                    scatter(d.scales.get(here.clone()), out, 4, rows);
                    scatter(d.signals.get(here), out, 7, rows);
                }
                Outputs::Signals => scatter(d.signals.get(here), out, 0, rows),
            }
            self.heads.whole().weight_vjp(&mut sum.weights, &slots[self.trunk.depth() - 1], out);
            dense::add_bias_vjp(out, self.heads.bias_mut(&mut sum.weights));
            d_h.resize(width * rows, 0.0);
            self.heads.whole().input_vjp(weights, out, d_h, Store::Set);
            let into =
                TrunkGradient { weights: &mut sum.weights, shared: &mut d_shared, folded: sum.folded.of_tx(b, width) };
            self.trunk.backward(weights, slots, d_h, spare, into);
        }
        self.trunk.share_vjp(weights, gamma, &d_shared, &mut sum.weights, None);
    }

    /// Back through the transmitters' branch, all of them at once.
    fn tx_vjp(&self, weights: &[Real], sides: &[TxSide], d_folded: &Joints, d_weights: &mut [Real]) {
        let batch = sides.len();
        let stack = |of: fn(&TxSide) -> &[Real]| -> Vec<Real> { sides.iter().flat_map(of).copied().collect() };
        let features = stack(|s| &s.features);
        let d_features = self.trunk.fold_vjp(weights, &features, d_folded, d_weights);
        let [first, second] = &self.tx;
        let d_e = Matrix::new(&d_features, batch, second.outputs);
        let hidden = stack(|s| &s.hidden);
        product(second.weight_mut(d_weights), Store::Add, d_e.t(), Matrix::new(&hidden, batch, second.inputs));
        d_features.chunks_exact(second.outputs).for_each(|d| dense::add(second.bias_mut(d_weights), d));
        let mut d_hidden = vec![0.0; hidden.len()];
        product(MatrixMut::new(&mut d_hidden, batch, second.inputs), Store::Set, d_e, second.weight(weights));
        d_hidden.iter_mut().zip(&hidden).for_each(|(d, &h)| *d = if h > 0.0 { *d } else { 0.0 });
        let gamma = stack(|s| &s.gamma);
        let d_z = Matrix::new(&d_hidden, batch, first.outputs);
        product(first.weight_mut(d_weights), Store::Add, d_z.t(), Matrix::new(&gamma, batch, first.inputs));
        d_hidden.chunks_exact(first.outputs).for_each(|d| dense::add(first.bias_mut(d_weights), d));
    }
}

/// Features `from..from + K` of `[F, R]` as R rows.
fn gather<const K: usize>(out: &[Real], from: usize, rows: usize) -> Vec<[Real; K]> {
    (0..rows).map(|r| std::array::from_fn(|k| out[(from + k) * rows + r])).collect()
}

/// The reverse of [`gather`]; zeros where there is no cotangent.
fn scatter<const K: usize>(d: Option<&[[Real; K]]>, out: &mut [Real], from: usize, rows: usize) {
    for (k, out) in out[from * rows..(from + K) * rows].chunks_exact_mut(rows).enumerate() {
        match d {
            Some(d) => out.iter_mut().zip(d).for_each(|(out, d)| *out = d[k]),
            None => out.fill(0.0),
        }
    }
}
