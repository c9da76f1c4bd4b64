//! Forward and backward of [`super::Wrfgs`], chunk by chunk; here the output is S·A, without the gain.
//!
//! ```text
//! γ(X) → trunk.0 … trunk.7 ┬→ attn (2 → A = |lrelu|)                        (once a Gaussian)
//!                          └→ feat ┐
//! γ(p) (folded into the bias) ─────┼→ sig.0, ReLU → sig.1, ReLU → out (2 → S = |lrelu|)
//! γ(X - p) ────────────────────────┘
//! ```

use super::dense::{self, Store};
use super::encoding::{self, encode, encode_vjp};
use super::layers::{Item, Plan, items, items_per_sum};
use super::linear::{Linear, Part};
use super::trunk::{Joints, Trunk, TrunkGradient, TrunkShape};
use super::wrfgs::Wrfgs;
use pwrfgs_core::{DeformationInputs, Real};
use rayon::prelude::*;

/// The layers of a [`Wrfgs`] and where their weights lie.
#[derive(Debug)]
pub(super) struct Network {
    frequencies: usize,
    trunk: Trunk,
    attenuation: Linear,
    feature: Linear,
    signal: [Linear; 2],
    out: Linear,
}

/// A transmitter: γ(p), and the bias of `sig.0` with W·γ(p) in it.
struct TxSide {
    gamma: Vec<Real>,
    folded: Vec<Real>,
}

/// What a chunk of Gaussians gives to every transmitter.
#[derive(Debug, Default)]
pub(super) struct Ahead {
    attenuation: Vec<Real>,  // [2, R], before |lrelu|
    from_feature: Vec<Real>, // W·feature of `sig.0`
}

/// Room for one chunk, kept from item to item of a task.
#[derive(Default)]
struct Scratch {
    // Once a chunk.
    gamma: Vec<Real>,
    shared: Joints,
    slots: Vec<Vec<Real>>,
    feature: Vec<Real>,
    // Once a transmitter.
    offset: Vec<Real>, // γ(X - p)
    hidden: [Vec<Real>; 2],
    out: Vec<Real>, // [2, R], before |lrelu|
    // Cotangents.
    d_attenuation: Vec<Real>,
    d_from_feature: Vec<Real>,
    d: Vec<Real>,
    spare: Vec<Real>,
}

/// One accumulator of the backward pass.
struct Sum {
    weights: Vec<Real>,
    /// Of the folded bias of `sig.0`, `[B, width]`.
    folded: Vec<Real>,
    /// Of the two biases of the trunk that are handed over separately.
    trunk_biases: Joints,
    /// Σ d·S·A, the derivative along the logarithm of the gain.
    along_gain: f64,
    /// Of the centres of its items, one after the other, where asked for.
    means: Option<Vec<[Real; 3]>>,
    /// Where the present item starts in `means`.
    row: usize,
}

impl Sum {
    /// The cotangents of the present item's centres.
    fn d_means(&mut self) -> Option<&mut [[Real; 3]]> {
        self.means.as_mut().map(|means| &mut means[self.row..])
    }
}

/// |lrelu(z)| with slope 0.01.
fn amplitude(z: Real) -> Real {
    if z < 0.0 { -0.01 * z } else { z }
}

/// The derivative of [`amplitude`]; 0 at 0.
fn amplitude_slope(z: Real) -> Real {
    if z > 0.0 {
        1.0
    } else if z < 0.0 {
        -0.01
    } else {
        0.0
    }
}

impl Network {
    pub(super) fn new(wrfgs: &Wrfgs, plan: &mut Plan) -> Self {
        let (width, gamma) = (wrfgs.width, encoding::width(wrfgs.frequencies));
        let shape = TrunkShape { depth: wrfgs.depth, width, skip: wrfgs.skip, gamma, side: 0 };
        Self {
            frequencies: wrfgs.frequencies,
            trunk: Trunk::new(plan, shape),
            attenuation: plan.linear("attn", width, 2),
            feature: plan.linear("feat", width, width),
            signal: [plan.linear("sig.0", width + 2 * gamma, width), plan.linear("sig.1", width, width / 2)],
            out: plan.linear("out", width / 2, 2),
        }
    }

    /// Multiplies the factors of the weights that see encodings by how far each frequency is let in.
    pub(super) fn dim(&self, factors: &mut [Real], share: f64) {
        let window = encoding::window(self.frequencies, share);
        self.trunk.dim(factors, &window);
        self.signal[0].dim(factors, self.trunk.width, &[window.as_slice(), &window].concat());
    }

    /// The columns of `sig.0` that see the feature, γ(p) and γ(X - p).
    fn signal_parts(&self) -> [Part; 3] {
        let (width, gamma) = (self.trunk.width, encoding::width(self.frequencies));
        let first = &self.signal[0];
        [first.part(0..width), first.part(width..width + gamma), first.part(width + gamma..width + 2 * gamma)]
    }

    fn tx_sides(&self, weights: &[Real], txs: &[[Real; 3]]) -> Vec<TxSide> {
        let [_, of_tx, _] = self.signal_parts();
        let side = |&tx: &[Real; 3]| {
            let mut gamma = vec![0.0; encoding::width(self.frequencies)];
            encode([tx].into_iter(), self.frequencies, &mut gamma);
            let mut folded = self.signal[0].bias(weights).to_vec();
            of_tx.apply(weights, &gamma, &mut folded, Store::Add);
            TxSide { gamma, folded }
        };
        txs.par_iter().map(side).collect()
    }

    /// What the Gaussians of a chunk give without knowing the transmitter.
    fn begin(&self, weights: &[Real], means: &[[Real; 3]], slots: usize, scratch: &mut Scratch) -> Ahead {
        let Scratch { gamma, shared, feature, .. } = scratch;
        let (rows, width) = (means.len(), self.trunk.width);
        gamma.resize(rows * encoding::width(self.frequencies), 0.0);
        encode(means.iter().copied(), self.frequencies, gamma);
        self.trunk.share(weights, gamma, shared);
        scratch.slots.resize_with(slots, Vec::new);
        self.trunk.forward(weights, shared, &self.trunk.fold(weights, &[]), &mut scratch.slots);
        let h = &scratch.slots[self.trunk.last(slots)];
        let mut attenuation = vec![0.0; 2 * rows];
        self.attenuation.whole().apply(weights, h, &mut attenuation, Store::Set);
        dense::add_bias(&mut attenuation, self.attenuation.bias(weights));
        feature.resize(width * rows, 0.0);
        self.feature.whole().apply(weights, h, feature, Store::Set);
        dense::add_bias(feature, self.feature.bias(weights));
        let mut from_feature = vec![0.0; width * rows];
        self.signal_parts()[0].apply(weights, feature, &mut from_feature, Store::Set);
        Ahead { attenuation, from_feature }
    }

    /// [`Ahead`] of every chunk.
    pub(super) fn ahead(&self, weights: &[Real], means: &[[Real; 3]]) -> Vec<Ahead> {
        let items = items(means.len(), 1, self.trunk.width);
        let begin = |scratch: &mut Scratch, item: &Item| self.begin(weights, &means[item.rows.clone()], 2, scratch);
        items.par_iter().map_init(Scratch::default, begin).collect()
    }

    /// The signal branch for one transmitter, into `scratch.out`.
    fn branch(
        &self,
        weights: &[Real],
        means: &[[Real; 3]],
        ahead: &Ahead,
        tx: [Real; 3],
        side: &TxSide,
        scratch: &mut Scratch,
    ) {
        let Scratch { offset, hidden: [first, second], out, .. } = scratch;
        let rows = means.len();
        offset.resize(rows * encoding::width(self.frequencies), 0.0);
        encode(means.iter().map(|x| std::array::from_fn(|k| x[k] - tx[k])), self.frequencies, offset);
        first.clone_from(&ahead.from_feature);
        self.signal_parts()[2].apply(weights, offset, first, Store::Add);
        dense::bias_relu(first, &side.folded);
        second.resize(self.signal[1].outputs * rows, 0.0);
        self.signal[1].whole().apply(weights, first, second, Store::Set);
        dense::bias_relu(second, self.signal[1].bias(weights));
        out.resize(2 * rows, 0.0);
        self.out.whole().apply(weights, second, out, Store::Set);
        dense::add_bias(out, self.out.bias(weights));
    }

    /// The four outputs before |lrelu|, as the reference renders list them: two of `attn`, two of `out`.
    #[cfg(test)]
    pub(super) fn raw(&self, weights: &[Real], means: &[[Real; 3]], tx: [Real; 3]) -> Vec<[Real; 4]> {
        let (mut scratch, n) = (Scratch::default(), means.len());
        let ahead = self.begin(weights, means, 2, &mut scratch);
        self.branch(weights, means, &ahead, tx, &self.tx_sides(weights, &[tx])[0], &mut scratch);
        let (a, s) = (ahead.attenuation, scratch.out);
        (0..n).map(|r| [a[r], a[n + r], s[r], s[n + r]]).collect()
    }

    /// S·A, `[B, N]`, given what [`Self::ahead`] made, or nothing.
    pub(super) fn forward(
        &self,
        weights: &[Real],
        means: &[[Real; 3]],
        txs: &[[Real; 3]],
        ahead: Option<&[Ahead]>,
    ) -> Vec<Real> {
        let sides = self.tx_sides(weights, txs);
        let pieces: Vec<Vec<Real>> = items(means.len(), 1, self.trunk.width)
            .par_iter()
            .enumerate()
            .map_init(Scratch::default, |scratch, (chunk, item)| {
                let means = &means[item.rows.clone()];
                let fresh = ahead.is_none().then(|| self.begin(weights, means, 2, scratch));
                let ahead = ahead.map(|all| &all[chunk]).or(fresh.as_ref()).expect("one or the other");
                let mut products = Vec::with_capacity(means.len() * txs.len());
                for (tx, side) in txs.iter().zip(&sides) {
                    self.branch(weights, means, ahead, *tx, side, scratch);
                    let both = scratch.out.iter().zip(&ahead.attenuation).take(means.len());
                    products.extend(both.map(|(&s, &a)| amplitude(s) * amplitude(a)));
                }
                products
            })
            .collect();
        let mut all = Vec::with_capacity(means.len() * txs.len());
        for b in 0..txs.len() {
            for piece in &pieces {
                let rows = piece.len() / txs.len();
                all.extend_from_slice(&piece[b * rows..(b + 1) * rows]);
            }
        }
        all
    }

    /// The vjp of [`Self::forward`] at the cotangents `d` `[B, N]`: adds to `d_weights`, and to `d_means` where given;
    /// returns Σ d·S·A.
    pub(super) fn vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        d: &[Real],
        d_weights: &mut [Real],
        d_means: Option<&mut [[Real; 3]]>,
    ) -> f64 {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        let sides = self.tx_sides(weights, txs);
        let items = items(means.len(), 1, self.trunk.width);
        let sums: Vec<Sum> = items
            .par_chunks(items_per_sum(items.len()))
            .map(|items| {
                let mut sum = Sum {
                    weights: vec![0.0; weights.len()],
                    folded: vec![0.0; txs.len() * self.trunk.width],
                    trunk_biases: self.trunk.zero_joints(self.trunk.width),
                    along_gain: 0.0,
                    means: d_means.is_some().then(Vec::new),
                    row: 0,
                };
                let mut scratch = Scratch::default();
                for item in items {
                    self.item_vjp(inputs, &sides, d, item, &mut scratch, &mut sum);
                }
                sum
            })
            .collect();
        dense::add_in_order(d_weights, &sums.iter().map(|s| s.weights.as_slice()).collect::<Vec<_>>());
        let [_, of_tx, _] = self.signal_parts();
        for sum in &sums {
            self.trunk.add_joint_biases(d_weights, &sum.trunk_biases);
            for (side, d) in sides.iter().zip(sum.folded.chunks_exact(self.trunk.width)) {
                of_tx.weight_vjp(d_weights, &side.gamma, d);
                dense::add(self.signal[0].bias_mut(d_weights), d);
            }
        }
        if let Some(d_means) = d_means {
            dense::add(
                d_means.as_flattened_mut(),
                &sums.iter().flat_map(|s| s.means.iter().flatten().flatten()).copied().collect::<Vec<_>>(),
            );
        }
        sums.iter().map(|s| s.along_gain).sum()
    }

    /// One chunk for all transmitters: the forward pass once more, then back.
    fn item_vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        sides: &[TxSide],
        d: &[Real],
        item: &Item,
        scratch: &mut Scratch,
        sum: &mut Sum,
    ) {
        let (n, weights) = (inputs.means.len(), inputs.weights);
        let means = &inputs.means[item.rows.clone()];
        let ahead = self.begin(weights, means, self.trunk.depth(), scratch);
        scratch.d_attenuation.clear();
        scratch.d_attenuation.resize(2 * means.len(), 0.0);
        scratch.d_from_feature.clear();
        scratch.d_from_feature.resize(ahead.from_feature.len(), 0.0);
        if let Some(d_means) = &mut sum.means {
            sum.row = d_means.len();
            d_means.resize(sum.row + means.len(), [0.0; 3]);
        }
        for (b, (tx, side)) in inputs.txs.iter().zip(sides).enumerate() {
            self.branch(weights, means, &ahead, *tx, side, scratch);
            let d = &d[b * n + item.rows.start..b * n + item.rows.end];
            self.branch_vjp(weights, &ahead.attenuation, b, d, scratch, sum);
        }
        self.begin_vjp(weights, scratch, sum);
    }

    /// The vjp of [`Self::branch`] and of S·A, for transmitter `b`.
    fn branch_vjp(
        &self,
        weights: &[Real],
        attenuation: &[Real],
        b: usize,
        d: &[Real],
        scratch: &mut Scratch,
        sum: &mut Sum,
    ) {
        let Scratch { offset, hidden: [first, second], out, d_attenuation, spare, .. } = scratch;
        let (rows, width) = (d.len(), self.trunk.width);
        for (r, &d) in d.iter().enumerate() {
            let (s, a) = (out[r], attenuation[r]);
            sum.along_gain += f64::from(d * amplitude(s) * amplitude(a));
            d_attenuation[r] += d * amplitude(s) * amplitude_slope(a);
            out[r] = d * amplitude(a) * amplitude_slope(s);
            out[rows + r] = 0.0; // the phase is not used
        }
        self.out.whole().weight_vjp(&mut sum.weights, second, out);
        dense::add_bias_vjp(out, self.out.bias_mut(&mut sum.weights));
        spare.resize(second.len(), 0.0);
        self.out.whole().input_vjp(weights, out, spare, Store::Set);
        dense::bias_relu_vjp(spare, second, self.signal[1].bias_mut(&mut sum.weights));
        self.signal[1].whole().weight_vjp(&mut sum.weights, first, spare);
        scratch.d.resize(first.len(), 0.0);
        self.signal[1].whole().input_vjp(weights, spare, &mut scratch.d, Store::Set);
        dense::bias_relu_vjp(&mut scratch.d, first, &mut sum.folded[b * width..(b + 1) * width]);
        dense::add(&mut scratch.d_from_feature, &scratch.d);
        let of_offset = &self.signal_parts()[2];
        of_offset.weight_vjp(&mut sum.weights, offset, &scratch.d);
        if let Some(d_means) = sum.d_means() {
            spare.resize(offset.len(), 0.0);
            of_offset.input_vjp(weights, &scratch.d, spare, Store::Set);
            encode_vjp(offset, spare, self.frequencies, d_means);
        }
    }

    /// The vjp of [`Self::begin`].
    fn begin_vjp(&self, weights: &[Real], scratch: &mut Scratch, sum: &mut Sum) {
        let Scratch { gamma, slots, feature, d_attenuation, d_from_feature, d, spare, .. } = scratch;
        let (h, width) = (&slots[self.trunk.depth() - 1], self.trunk.width);
        let of_feature = &self.signal_parts()[0];
        of_feature.weight_vjp(&mut sum.weights, feature, d_from_feature);
        spare.resize(feature.len(), 0.0);
        of_feature.input_vjp(weights, d_from_feature, spare, Store::Set);
        self.feature.whole().weight_vjp(&mut sum.weights, h, spare);
        dense::add_bias_vjp(spare, self.feature.bias_mut(&mut sum.weights));
        d.resize(h.len(), 0.0);
        self.feature.whole().input_vjp(weights, spare, d, Store::Set);
        self.attenuation.whole().weight_vjp(&mut sum.weights, h, d_attenuation);
        dense::add_bias_vjp(d_attenuation, self.attenuation.bias_mut(&mut sum.weights));
        self.attenuation.whole().input_vjp(weights, d_attenuation, d, Store::Add);
        let mut d_shared = self.trunk.zero_joints(h.len());
        let into = TrunkGradient {
            weights: &mut sum.weights,
            shared: &mut d_shared,
            folded: sum.trunk_biases.of_tx(0, width),
        };
        self.trunk.backward(weights, slots, d, spare, into);
        let mut d_gamma = sum.means.as_ref().map(|_| vec![0.0; gamma.len()]);
        self.trunk.share_vjp(weights, gamma, &d_shared, &mut sum.weights, d_gamma.as_deref_mut());
        if let (Some(d_gamma), Some(d_means)) = (d_gamma, sum.d_means()) {
            encode_vjp(gamma, &d_gamma, self.frequencies, d_means);
        }
    }
}
