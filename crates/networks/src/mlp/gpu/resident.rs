//! `ResidentMlp`: `Mlp` in training steps whose weights stay on the GPU, one transmitter after another.

use crate::encoding::{encode, encoded_width};
use crate::linear::{LayerPart, Linear, lay_out};
use crate::mlp::{Mlp, MlpLayers, Outputs};
use crate::trunk::gpu::{D, D_FOLDED, D_WEIGHTS, FOLDED, GAMMA, GpuTrunk, NETWORK, WEIGHTS, chunk_rows};
use pwrfgs_core::Real;
use pwrfgs_gpu::{Block, Epilogue, Gpu, GpuStep, SCRATCH, scratch_len};
use std::ops::Range;

/// Most frequencies of the encoding of a centre that the GPU computes with full precision.
const MOST_FREQUENCIES: usize = 10;

/// Activations and cotangents of the transmitter branch: after `tx.0`, and after `tx.1`.
const HIDDEN: [usize; 2] = [NETWORK, NETWORK + 1];
const FEATURES: [usize; 2] = [NETWORK + 2, NETWORK + 3];
/// Output of the first layer of the trunk.
const FIRST: usize = NETWORK + 4;

/// Weights with their moments in slot [`ResidentMlp::WEIGHTS`], and the slots of the centres, of the outputs and of their
/// cotangents.
#[derive(Debug)]
pub struct ResidentMlp {
    network: MlpLayers,
    weights: usize,
    gaussians: usize,
    /// Maximum number of Gaussians per chunk.
    most: usize,
    slots: ResidentSlots,
}

/// Slots outside the network.
#[derive(Clone, Copy, Debug)]
pub struct ResidentSlots {
    /// Centres `[N, 3]`.
    pub means: usize,
    /// Outputs `[9, N]`: rotation 4, scales 3, signal 2.
    pub heads: usize,
    /// Cotangents of the outputs.
    pub d_heads: usize,
    /// Encoded transmitters.
    pub inputs: usize,
}

impl ResidentMlp {
    /// Slot of values and moments of the weights, `[3, weights]`.
    pub const WEIGHTS: usize = WEIGHTS;
    /// Slot of their derivatives.
    pub const D_WEIGHTS: usize = D_WEIGHTS;

    /// Returns whether the weights of a network can stay on the GPU: it has all outputs, no carrier, and few enough
    /// frequencies for centres.
    pub fn supports(mlp: &Mlp) -> bool {
        mlp.outputs == Outputs::All && mlp.carrier == 0.0 && mlp.position_frequencies <= MOST_FREQUENCIES
    }

    /// Returns the number of slots of a network.
    pub fn slot_count(mlp: &Mlp) -> usize {
        FIRST + mlp.depth
    }

    /// Returns the maximum number of Gaussians per chunk on a GPU.
    pub fn most_rows(mlp: &Mlp, gpu: &Gpu) -> usize {
        chunk_rows(gpu, mlp.width, encoded_width(mlp.position_frequencies))
    }

    /// Lays out a network for N Gaussians, in chunks of at most `most`.
    pub fn new(mlp: &Mlp, gaussians: usize, most: usize, slots: ResidentSlots) -> Self {
        let (network, plan) = lay_out(|plan| mlp.plan_layers(plan));
        Self { network, weights: plan.weight_count(), gaussians, most, slots }
    }

    /// Returns the sizes of the slots of the network.
    pub fn sizes(&self) -> Vec<usize> {
        let MlpLayers { trunk, branch, heads, .. } = &self.network;
        let rows = self.gaussians.min(self.most);
        let mut sizes = self.chunk(rows).sizes(self.weights, 1, heads.outputs, true);
        let [tx_hidden, tx_features] = branch.layers.map(|layer| layer.outputs);
        // Partial sums: of derivatives by weights of the branch and of e over one transmitter, of bias sums over all Gaussians.
        let weights = |layer: Linear| layer.outputs * layer.inputs;
        let needed = branch.layers.map(weights).into_iter().chain([trunk.width * tx_features]).max().unwrap_or(0);
        sizes[SCRATCH] = sizes[SCRATCH].max(needed).max(scratch_len(self.gaussians, heads.outputs));
        sizes[WEIGHTS] = 3 * self.weights;
        sizes.extend([tx_hidden, tx_hidden, tx_features, tx_features]); // slots [`HIDDEN`] and [`FEATURES`]
        sizes.resize(FIRST + trunk.depth(), trunk.width * rows);
        sizes
    }

    /// Returns the number of weights.
    pub fn weight_count(&self) -> usize {
        self.weights
    }

    /// Returns the number of inputs per transmitter.
    pub fn encoded_width(&self) -> usize {
        encoded_width(self.network.branch.frequencies)
    }

    /// Encodes the position of a transmitter, metres from the origin.
    pub fn encode_transmitter(&self, position: [Real; 3]) -> Vec<Real> {
        let mut gamma = vec![0.0; self.encoded_width()];
        encode([position].into_iter(), self.network.branch.frequencies, &mut gamma);
        gamma
    }

    /// Begins a step: sets derivatives to zero, and computes W·γ for all transmitters if all Gaussians are one chunk.
    pub fn begin(&self, step: &mut GpuStep<'_>) {
        step.clear(D_WEIGHTS, self.weights);
        if let Some(rows) = self.lone_chunk() {
            self.share_means(step, rows);
        }
    }

    /// Computes the outputs for the transmitter that is encoded at offset `tx` of the inputs.
    pub fn forward(&self, step: &mut GpuStep<'_>, tx: usize) {
        let MlpLayers { trunk, branch, heads, .. } = &self.network;
        let [first, second] = &branch.layers;
        let gamma = column(self.slots.inputs, tx);
        apply(step, first, gamma, HIDDEN[0], true);
        apply(step, second, column(HIDDEN[0], 0), FEATURES[0], false);
        // The folded biases.
        for (j, layer) in trunk.joints().enumerate() {
            let part = layer.part(trunk.side_columns());
            let (outputs, inputs) = part.shape();
            let bias = Epilogue { bias: Some((WEIGHTS, layer.bias)), ..Epilogue::default() };
            let folded = column(FOLDED, j * trunk.width);
            step.product((outputs, 1, inputs), part.block(WEIGHTS), column(FEATURES[0], 0), folded, bias);
        }
        for rows in self.chunks() {
            if self.lone_chunk().is_none() {
                self.share_means(step, rows.clone());
            }
            let on = self.chunk(rows.len());
            on.forward(step);
            let bias = Epilogue { bias: Some((WEIGHTS, heads.bias)), ..Epilogue::default() };
            let (outputs, inputs) = heads.whole().shape();
            let out = self.chunk_columns(self.slots.heads, &rows);
            step.product((outputs, rows.len(), inputs), heads.whole().block(WEIGHTS), on.chunk(on.last()), out, bias);
        }
    }

    /// Adds the derivatives by the weights for the transmitter at offset `tx` of the inputs, given the cotangents of the
    /// outputs. Follows its [`Self::forward`], whose activations it uses if all Gaussians are one chunk.
    pub fn backward(&self, step: &mut GpuStep<'_>, tx: usize) {
        let MlpLayers { trunk, heads, .. } = &self.network;
        step.clear(D_FOLDED, 2 * trunk.width);
        for rows in self.chunks() {
            let on = self.chunk(rows.len());
            if self.lone_chunk().is_none() {
                self.share_means(step, rows.clone());
                on.forward(step);
            }
            let d_out = self.chunk_columns(self.slots.d_heads, &rows);
            on.weight_vjp(step, &heads.whole(), on.last(), d_out);
            on.input_vjp(step, &heads.whole(), d_out, D, Epilogue { mask: Some(on.last()), ..Epilogue::default() });
            on.backward(step, [0, trunk.width]);
            if self.lone_chunk().is_none() {
                on.share_gamma_vjp(step, None);
            }
        }
        step.add_row_sums((heads.outputs, self.gaussians), (self.slots.d_heads, 0), (D_WEIGHTS, heads.bias));
        self.branch_vjp(step, tx);
    }

    /// Ends a step: adds the derivatives by the weights of W·γ, which [`Self::backward`] leaves out if all Gaussians are one
    /// chunk.
    pub fn end(&self, step: &mut GpuStep<'_>) {
        if let Some(rows) = self.lone_chunk() {
            self.chunk(rows.len()).share_gamma_vjp(step, None);
        }
    }

    /// Adds the derivatives by the weights of the transmitter branch and of e, given the cotangents of the folded biases.
    fn branch_vjp(&self, step: &mut GpuStep<'_>, tx: usize) {
        let MlpLayers { trunk, branch, .. } = &self.network;
        let [first, second] = &branch.layers;
        for (j, layer) in trunk.joints().enumerate() {
            let (part, d) = (layer.part(trunk.side_columns()), column(D_FOLDED, j * trunk.width));
            add_outer(step, &part, layer.bias, d, column(FEATURES[0], 0));
            let (outputs, inputs) = part.shape();
            let sum = Epilogue { add: j > 0, ..Epilogue::default() };
            step.product((inputs, 1, outputs), part.block(WEIGHTS).t(), d, column(FEATURES[1], 0), sum);
        }
        let d = column(FEATURES[1], 0);
        add_outer(step, &second.whole(), second.bias, d, column(HIDDEN[0], 0));
        let mask = Epilogue { mask: Some(HIDDEN[0]), ..Epilogue::default() };
        let (outputs, inputs) = second.whole().shape();
        step.product((inputs, 1, outputs), second.whole().block(WEIGHTS).t(), d, column(HIDDEN[1], 0), mask);
        add_outer(step, &first.whole(), first.bias, column(HIDDEN[1], 0), column(self.slots.inputs, tx));
    }

    /// Encodes the centres of a chunk, computes W·γ, and sets its cotangent to zero.
    fn share_means(&self, step: &mut GpuStep<'_>, rows: Range<usize>) {
        let on = self.chunk(rows.len());
        step.encode(self.slots.means, (rows.start, rows.len()), self.network.position_frequencies, GAMMA);
        on.share_gamma(step);
        on.clear_shared(step);
    }

    /// Returns the ranges of Gaussians of all chunks.
    fn chunks(&self) -> impl Iterator<Item = Range<usize>> {
        let (n, most) = (self.gaussians, self.most);
        (0..n).step_by(most).map(move |start| start..n.min(start + most))
    }

    /// Returns the range of all Gaussians, if they are one chunk.
    fn lone_chunk(&self) -> Option<Range<usize>> {
        (self.gaussians <= self.most).then_some(0..self.gaussians)
    }

    /// Returns the trunk for chunks of `rows` rows.
    fn chunk(&self, rows: usize) -> GpuTrunk<'_> {
        let trunk = &self.network.trunk;
        GpuTrunk { trunk, rows, first: FIRST, slots: trunk.depth() }
    }

    /// Returns the columns of a chunk in a slot `[9, N]`.
    fn chunk_columns(&self, slot: usize, rows: &Range<usize>) -> Block {
        Block::new(slot, rows.start, self.gaussians)
    }
}

/// Returns the numbers of a slot from `start` on as a matrix of one column.
fn column(slot: usize, start: usize) -> Block {
    Block::new(slot, start, 1)
}

/// Computes W·x + b of a layer, or relu of it, from column `x` to slot `y`.
fn apply(step: &mut GpuStep<'_>, layer: &Linear, x: Block, y: usize, relu: bool) {
    let epilogue = Epilogue { bias: Some((WEIGHTS, layer.bias)), relu, ..Epilogue::default() };
    step.product((layer.outputs, 1, layer.inputs), layer.whole().block(WEIGHTS), x, column(y, 0), epilogue);
}

/// Adds the derivatives by W and b of y = W·x + b, given columns `d` and `x`.
fn add_outer(step: &mut GpuStep<'_>, part: &LayerPart, bias: usize, d: Block, x: Block) {
    step.add_gradient(part.shape(), 1, d, x.t(), part.block(D_WEIGHTS));
    step.add_row_sums((part.shape().0, 1), (d.slot, d.start), (D_WEIGHTS, bias));
}
