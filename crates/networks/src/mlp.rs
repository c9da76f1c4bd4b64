//! `Mlp`: the deformation network of P-WRFGS, `(Δs, ΔR, ΔS) = D_Θ(γ(μ), γ(p_tx))` of eq. (5).
//!
//! ```text
//! γ(p_tx) → tx.0, ReLU → tx.1 → e ──┐ (once per transmitter, folded into biases)
//! γ(μ) ─────────────────────────────┴→ trunk.0 … trunk.{depth-1} → heads: rotation 4, scaling 3, signal 2
//! ```

#[cfg(feature = "gpu")]
pub(crate) mod gpu;

use crate::check_carrier;
use crate::dense::{self, StoreMode};
use crate::encoding::{self, check_frequencies, encode};
use crate::linear::{Item, LayoutBuilder, Linear, WIDEST, lay_out, lay_out_for, sum_groups, work_items};
use crate::mlp_branch::{TxBranch, TxSide};
use crate::trunk::{Joints, Trunk, TrunkGradient, TrunkShape, check_stack};
use pwrfgs_core::{
    Cache, Deformation, DeformationInputs, DeformationTraits, DeformationVjp, Deltas, JsonSchema, KEPT_BYTES, Layout,
    Real, cached,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;

/// The network of P-WRFGS: additive changes of signal, rotation and scale per Gaussian and transmitter.
///
/// Two small layers process the encoding γ(p) of the transmitter. The result is concatenated with the encoding γ(μ) of
/// the centre. A stack of ReLU layers follows, in which both inputs enter again after layer `skip`, and linear heads
/// give the outputs. The default values are those of the released WRF-GS+, the basis of the paper (574,819 weights; its
/// two heads that do not affect the spectrum are left out).
///
/// With `outputs: Signals` only the signals depend on the transmitter. A whole batch then shares one projection and one
/// depth sort. Smaller networks are faster: their cost is proportional to `depth · width²`.
///
/// Centres receive no gradient through the network (the released code detaches them): `d_means` is unchanged.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_networks as _;
/// let small = "Mlp(depth: 4, width: 64, skip: None, outputs: Signals, head_init: 0.1)";
/// let small = Plugin::<dyn Deformation>::parse(small).unwrap();
/// assert!(!small.traits().varies_geometry);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Mlp {
    /// Number of ReLU layers, 1 or more.
    pub depth: usize,
    /// Units per layer.
    pub width: usize,
    /// Number of frequencies 2⁰…2^(L-1) rad/m in the encoding of the centre; 0 for the bare coordinates.
    pub position_frequencies: usize,
    /// Number of frequencies 2⁰…2^(L-1) rad/m in the encoding of the transmitter; 0 for the bare coordinates.
    pub tx_frequencies: usize,
    /// Units of the hidden layer of the transmitter branch.
    pub tx_hidden: usize,
    /// Number of outputs of the transmitter branch, which are inputs of the stack.
    pub tx_features: usize,
    /// Index of the layer (from 0) after which both inputs enter again; `None` for a plain stack.
    pub skip: Option<usize>,
    /// Outputs of the network, which depend on the transmitter.
    pub outputs: Outputs,
    /// Factor on the initial weights and biases of the heads. 1 is the PyTorch initialisation; with small values,
    /// training starts near the undeformed Gaussians.
    pub head_init: f64,
    /// Factor on the carrier, an input for data with several carriers: the logarithm of its frequency, from -1 to 1. Higher
    /// factors let signals vary faster from one carrier to the next. 0 ignores the carrier.
    pub carrier: f64,
}

impl Default for Mlp {
    fn default() -> Self {
        Self {
            depth: 8,
            width: 256,
            position_frequencies: 10,
            tx_frequencies: 6,
            tx_hidden: 256,
            tx_features: 90,
            skip: Some(4),
            outputs: Outputs::All,
            head_init: 1.0,
            carrier: 0.0,
        }
    }
}

impl Mlp {
    /// Plans the layers in the order of the weight vector.
    pub(super) fn plan_layers(&self, plan: &mut LayoutBuilder) -> MlpLayers {
        let carrier = (self.carrier != 0.0).then_some(self.carrier as Real);
        let tx_inputs = encoding::encoded_width(self.tx_frequencies) + usize::from(carrier.is_some());
        let layers =
            [plan.linear("tx.0", tx_inputs, self.tx_hidden), plan.linear("tx.1", self.tx_hidden, self.tx_features)];
        let branch = TxBranch { frequencies: self.tx_frequencies, carrier, layers };
        let gamma = encoding::encoded_width(self.position_frequencies);
        let &Self { position_frequencies, depth, width, skip, outputs, .. } = self;
        let trunk = Trunk::new(plan, TrunkShape { depth, width, skip, gamma, side: self.tx_features });
        // Rows in the order of [`ROTATION`], [`SCALING`] and [`SIGNAL`], which `resident.wgsl` repeats.
        let heads: &[(&str, usize)] = match outputs {
            Outputs::All => &[("rotation", 4), ("scaling", 3), ("signal", 2)],
            Outputs::Signals => &[("signal", 2)],
        };
        let heads = plan.heads(heads, width, self.head_init);
        MlpLayers { position_frequencies, outputs, branch, trunk, heads }
    }
}

#[typetag::serde]
impl Deformation for Mlp {
    fn traits(&self) -> DeformationTraits {
        DeformationTraits {
            varies_geometry: self.outputs == Outputs::All,
            reads_carrier: self.carrier != 0.0,
            kept_per_term: self.depth * self.width,
            differentiates_positions: true,
            runs_on_gpu: true,
            ..DeformationTraits::default()
        }
    }

    fn layout(&self) -> Layout {
        lay_out(|plan| self.plan_layers(plan)).1.layout()
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, _: &Cache) -> Deltas {
        let network = lay_out_for(inputs.weights, |plan| self.plan_layers(plan));
        #[cfg(feature = "gpu")]
        if let Some(gpu) = pwrfgs_gpu::current() {
            return network
                .gpu_forward(gpu, inputs, false)
                .map_or_else(|e| network.zeros_after(e, inputs), |(terms, _)| terms);
        }
        network.forward(inputs, false).0
    }

    fn forward_for_vjp(&self, inputs: &DeformationInputs<'_>) -> (Deltas, Cache) {
        let network = lay_out_for(inputs.weights, |plan| self.plan_layers(plan));
        #[cfg(feature = "gpu")]
        if let Some(gpu) = pwrfgs_gpu::current() {
            return match network.gpu_forward(gpu, inputs, true) {
                Ok((deltas, kept)) => (deltas, Some(Arc::new(kept))),
                Err(error) => (network.zeros_after(error, inputs), None),
            };
        }
        let (deltas, kept) = network.forward(inputs, true);
        (deltas, Some(Arc::new(kept)))
    }

    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        assert_eq!(sums.weights.len(), inputs.weights.len(), "a derivative for each weight");
        let network = lay_out_for(inputs.weights, |plan| self.plan_layers(plan));
        #[cfg(feature = "gpu")]
        if let Some(gpu) = pwrfgs_gpu::current() {
            return network.gpu_vjp(gpu, inputs, d, sums).unwrap_or_else(pwrfgs_core::device::fail);
        }
        network.vjp(inputs, d, sums);
    }

    fn check(&self) -> Result<(), String> {
        check_stack(self.depth, self.width, self.skip)?;
        check_carrier(self.carrier)?;
        for (name, value) in [("tx_hidden", self.tx_hidden), ("tx_features", self.tx_features)] {
            if !(1..=WIDEST).contains(&value) {
                return Err(format!("{name} is {value}; give a number from 1 to {WIDEST}"));
            }
        }
        check_frequencies("position_frequencies", self.position_frequencies)?;
        check_frequencies("tx_frequencies", self.tx_frequencies)?;
        if !(self.head_init.is_finite() && self.head_init >= 0.0) {
            return Err(format!("head_init is {}; give a finite number that is not negative", self.head_init));
        }
        Ok(())
    }
}

/// Outputs of an [`Mlp`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Outputs {
    /// Rotations (4), scales (3) and signals (2).
    #[default]
    All,
    /// Signals (2) only.
    Signals,
}

/// First rows of the heads of [`Outputs::All`], in the order of [`Mlp::plan_layers`].
const ROTATION: usize = 0;
const SCALING: usize = 4;
const SIGNAL: usize = 7;

/// Layers and the offsets of their weights.
#[derive(Debug)]
pub(super) struct MlpLayers {
    pub(super) position_frequencies: usize,
    pub(super) outputs: Outputs,
    pub(super) branch: TxBranch,
    pub(super) trunk: Trunk,
    pub(super) heads: Linear,
}

/// Buffers for one chunk, reused for all items of a task.
#[derive(Default)]
struct Scratch {
    gamma: Vec<Real>,
    shared: Joints,
    slots: Activations,
    out: Vec<Real>,
    d: Vec<Real>,
    spare: Vec<Real>,
}

/// Activations of a chunk for one transmitter, by layer.
type Activations = Vec<Vec<Real>>;

/// Activations of the forward pass per item and transmitter, for the backward pass; empty beyond [`KEPT_BYTES`].
pub(super) struct Kept(Vec<Vec<Activations>>);

impl MlpLayers {
    /// Computes γ of the centres of a chunk, into `scratch`.
    fn encode_means(&self, means: &[[Real; 3]], scratch: &mut Scratch) {
        scratch.gamma.resize(means.len() * encoding::encoded_width(self.position_frequencies), 0.0);
        encode(means.iter().copied(), self.position_frequencies, &mut scratch.gamma);
    }

    /// Computes γ and W·γ of the centres of a chunk, which all transmitters share, into `scratch`.
    fn share_means(&self, weights: &[Real], means: &[[Real; 3]], scratch: &mut Scratch) {
        self.encode_means(means, scratch);
        self.trunk.share_gamma(weights, &scratch.gamma, &mut scratch.shared);
    }

    /// Returns the terms `[B, N]` of all transmitters and Gaussians; if `is_kept`, also the activations of the first items
    /// that fit within [`KEPT_BYTES`].
    pub(super) fn forward(&self, inputs: &DeformationInputs<'_>, is_kept: bool) -> (Deltas, Kept) {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        let sides = self.branch.tx_sides(weights, &self.trunk, txs);
        let items = work_items(means.len(), txs.len(), self.trunk.width);
        let mut bytes = 0;
        let fits_memory = |item: &Item| {
            bytes += item.rows.len() * item.txs.len() * self.trunk.depth() * self.trunk.width * size_of::<Real>();
            is_kept && bytes <= KEPT_BYTES
        };
        let fits: Vec<bool> = items.iter().map(fits_memory).collect();
        let one = |scratch: &mut Scratch, (item, fits): (&Item, bool)| {
            self.share_means(weights, &means[item.rows.clone()], scratch);
            let mut kept = Vec::new();
            let mut deltas = Vec::new();
            for side in &sides[item.txs.clone()] {
                scratch.slots.resize_with(if fits { self.trunk.depth() } else { 2 }, Vec::new);
                deltas.push(self.tx_terms(weights, side, scratch));
                kept.extend(fits.then(|| std::mem::take(&mut scratch.slots)));
            }
            (deltas, kept)
        };
        let (pieces, kept): (Vec<Vec<Deltas>>, Vec<Vec<Activations>>) =
            items.par_iter().zip(fits).map_init(Scratch::default, one).unzip();
        // Each group of transmitters has the same chunks, see [`work_items`].
        let mut terms = Deltas::default();
        let mut start = 0; // first item of a group of transmitters
        while start < items.len() {
            let txs = &items[start].txs;
            let chunks = items[start..].iter().take_while(|item| item.txs == *txs).count();
            for b in 0..txs.len() {
                pieces[start..start + chunks].iter().for_each(|piece| append(&mut terms, &piece[b]));
            }
            start += chunks;
        }
        (terms, Kept(kept))
    }

    /// Returns the terms of the chunk in `scratch` for one transmitter; its activations stay in `scratch.slots`.
    fn tx_terms(&self, weights: &[Real], side: &TxSide, scratch: &mut Scratch) -> Deltas {
        let Scratch { shared, slots, out, .. } = scratch;
        self.trunk.forward(weights, shared, &side.folded, slots);
        self.heads.apply(weights, &slots[self.trunk.last_slot(slots.len())], out);
        self.gather_terms(out, out.len() / self.heads.outputs)
    }

    /// Returns the terms in the outputs of the heads `[outputs, R]`.
    fn gather_terms(&self, out: &[Real], rows: usize) -> Deltas {
        match self.outputs {
            Outputs::All => Deltas {
                quats: gather_rows(out, ROTATION, rows),
                scales: gather_rows(out, SCALING, rows),
                signals: gather_rows(out, SIGNAL, rows),
            },
            Outputs::Signals => Deltas { signals: gather_rows(out, 0, rows), ..Deltas::default() },
        }
    }

    /// Runs the backward pass of [`Self::forward`], given the cotangents `d` of the terms; adds to `sums`, without the
    /// centres, which are detached.
    pub(super) fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        let DeformationInputs { weights, means, txs, .. } = *inputs;
        let DeformationVjp { weights: d_weights, positions: d_txs, .. } = sums;
        let sides = self.branch.tx_sides(weights, &self.trunk, txs);
        let items = work_items(means.len(), txs.len(), self.trunk.width);
        let kept: &[Vec<Activations>] = if inputs.kept.is_some() { &cached::<Kept>(inputs.kept).0 } else { &[] };
        let items: Vec<(Item, &[Activations])> =
            items.into_iter().enumerate().map(|(k, item)| (item, kept.get(k).map_or(&[][..], Vec::as_slice))).collect();
        let group_sums = sum_groups(&items, d_weights, |items, d_weights| {
            let mut d_folded = self.trunk.zero_joints(txs.len() * self.trunk.width);
            let mut scratch = Scratch::default();
            for (item, kept) in items {
                self.item_vjp(inputs, &sides, d, (item, kept), &mut scratch, (d_weights, &mut d_folded));
            }
            d_folded
        });
        let mut d_folded = self.trunk.zero_joints(txs.len() * self.trunk.width);
        dense::add_in_order(&mut d_folded.first, &group_sums.iter().map(|s| s.first.as_slice()).collect::<Vec<_>>());
        dense::add_in_order(&mut d_folded.joined, &group_sums.iter().map(|s| s.joined.as_slice()).collect::<Vec<_>>());
        self.branch.vjp(weights, &self.trunk, &sides, &d_folded, d_weights, d_txs);
    }

    /// Runs the backward pass of one chunk for some transmitters; recomputes its forward pass first, unless it was
    /// kept. Adds to the derivatives of the weights and of the folded biases, `[B, width]` each.
    fn item_vjp(
        &self,
        inputs: &DeformationInputs<'_>,
        sides: &[TxSide],
        d: &Deltas,
        (item, kept): (&Item, &[Activations]),
        scratch: &mut Scratch,
        (d_weights, d_folded): (&mut [Real], &mut Joints),
    ) {
        let (weights, n, width) = (inputs.weights, inputs.means.len(), self.trunk.width);
        let means = &inputs.means[item.rows.clone()];
        if kept.is_empty() {
            self.share_means(weights, means, scratch);
        } else {
            self.encode_means(means, scratch);
        }
        let Scratch { gamma, shared, slots, out, d: d_h, spare } = scratch;
        let rows = item.rows.len();
        slots.resize_with(self.trunk.depth(), Vec::new);
        let mut d_shared = self.trunk.zero_joints(width * rows);
        out.resize(self.heads.outputs * rows, 0.0);
        for (k, b) in item.txs.clone().enumerate() {
            let slots = if let Some(slots) = kept.get(k) {
                slots
            } else {
                self.trunk.forward(weights, shared, &sides[b].folded, slots);
                &*slots
            };
            let terms = b * n + item.rows.start..b * n + item.rows.end;
            self.scatter_cotangents(d, terms, out);
            let h = &slots[self.trunk.depth() - 1];
            self.heads.apply_vjp(weights, (h, out), d_weights, (d_h, StoreMode::Set));
            let into = TrunkGradient { weights: d_weights, shared: &mut d_shared, folded: d_folded.tx_part(b, width) };
            self.trunk.backward(weights, slots, d_h, spare, into);
        }
        self.trunk.share_gamma_vjp(weights, gamma, &d_shared, d_weights, None);
    }

    /// Writes the cotangents of the range `terms` of `[B, N]` to `out` `[outputs, R]`, as the heads output them.
    fn scatter_cotangents(&self, d: &Deltas, terms: Range<usize>, out: &mut [Real]) {
        let rows = terms.len();
        match self.outputs {
            Outputs::All => {
                scatter_rows(d.quats.get(terms.clone()), out, ROTATION, rows);
                scatter_rows(d.scales.get(terms.clone()), out, SCALING, rows);
                scatter_rows(d.signals.get(terms), out, SIGNAL, rows);
            }
            Outputs::Signals => scatter_rows(d.signals.get(terms), out, 0, rows),
        }
    }
}

/// Appends the rows of `terms` to each column of `all`.
fn append(all: &mut Deltas, terms: &Deltas) {
    all.scales.extend_from_slice(&terms.scales);
    all.quats.extend_from_slice(&terms.quats);
    all.signals.extend_from_slice(&terms.signals);
}

/// Returns the features `from..from + K` of `[F, R]` as R rows.
fn gather_rows<const K: usize>(out: &[Real], from: usize, rows: usize) -> Vec<[Real; K]> {
    (0..rows).map(|r| std::array::from_fn(|k| out[(from + k) * rows + r])).collect()
}

/// Writes the R rows of `d` to the features `from..from + K` of `out` `[F, R]`, the inverse of [`gather_rows`]; zeros
/// without a cotangent.
fn scatter_rows<const K: usize>(d: Option<&[[Real; K]]>, out: &mut [Real], from: usize, rows: usize) {
    for (k, out) in out[from * rows..(from + K) * rows].chunks_exact_mut(rows).enumerate() {
        match d {
            Some(d) => out.iter_mut().zip(d).for_each(|(out, d)| *out = d[k]),
            None => out.fill(0.0),
        }
    }
}
