//! Passes of the trunk on the GPU, over a chunk `[F, R]` of rows: the same order of operations as on the CPU, with larger
//! chunks. Also the slots that all networks use.

use crate::encoding::{encode, encoded_width};
use crate::linear::LayerPart;
use crate::trunk::{Joints, Trunk};
use pwrfgs_core::Real;
use pwrfgs_gpu::{Block, Epilogue, Gpu, GpuStep, SCRATCH, SLICE, scratch_len};

/// Slot of the flat vector of weights.
pub const WEIGHTS: usize = SCRATCH + 1;
/// Slot of its derivative.
pub const D_WEIGHTS: usize = WEIGHTS + 1;
/// Slot of γ of the chunk, `[gamma, R]`.
pub const GAMMA: usize = D_WEIGHTS + 1;
/// Slots of W·γ of both layers with inputs γ and e, `[width, R]`, and of the cotangents.
const SHARED: [usize; 2] = [GAMMA + 1, GAMMA + 2];
const D_SHARED: [usize; 2] = [GAMMA + 3, GAMMA + 4];
/// Slot of the folded biases of both layers, `[2, width]`.
pub const FOLDED: usize = GAMMA + 5;
/// Slot of their cotangents.
pub const D_FOLDED: usize = FOLDED + 1;
/// Slot of the cotangent of the last layer, `[width, R]`.
pub const D: usize = D_FOLDED + 1;
/// Slot of a work buffer of the same size.
pub const SPARE: usize = D + 1;
/// First slot for the values of a network beyond its trunk.
pub const NETWORK: usize = SPARE + 1;

/// Trunk with a chunk of rows on the GPU. Layer l writes slot `first + l % slots`.
#[derive(Clone, Copy, Debug)]
pub struct GpuTrunk<'a> {
    /// Layers.
    pub trunk: &'a Trunk,
    /// Number of rows R of the chunk.
    pub rows: usize,
    /// Slot of the output of the first layer.
    pub first: usize,
    /// 2 for predictions, or one per layer for derivatives.
    pub slots: usize,
}

/// Returns the number of rows per chunk for layers of `width` units with inputs of up to `inputs` components.
pub fn chunk_rows(gpu: &Gpu, width: usize, inputs: usize) -> usize {
    let widest = width.max(inputs);
    // Numbers per row of the largest buffers: values of a layer, and partial sums of its derivative in slot [`SCRATCH`].
    gpu.chunk_rows(widest.max((width * widest).div_ceil(SLICE)))
}

/// Encodes R points with octaves, `[3 + 6L, R]`. Spawns threads instead of using those of the pool: a thread of the pool that
/// waits for others could take up work that waits for the GPU.
pub fn encode_chunk(points: &[[Real; 3]], frequencies: usize) -> Vec<Real> {
    const LEAST: usize = 2048; // points per thread
    let width = encoded_width(frequencies);
    let one = |points: &[[Real; 3]]| {
        let mut out = vec![0.0; width * points.len()];
        encode(points.iter().copied(), frequencies, &mut out);
        out
    };
    if points.len() < 2 * LEAST {
        return one(points);
    }
    let size = points.len().div_ceil(rayon::current_num_threads()).max(LEAST);
    let pieces: Vec<Vec<Real>> = std::thread::scope(|scope| {
        let threads: Vec<_> = points.chunks(size).map(|points| scope.spawn(move || one(points))).collect();
        threads.into_iter().map(|thread| thread.join().expect("encoding does not panic")).collect()
    });
    let mut encoded = Vec::with_capacity(width * points.len());
    for feature in 0..width {
        for piece in &pieces {
            let rows = piece.len() / width;
            encoded.extend_from_slice(&piece[feature * rows..(feature + 1) * rows]);
        }
    }
    encoded
}

impl Trunk {
    /// Returns the cotangents of the folded biases, given the numbers of slot [`D_FOLDED`]: `joined` after `first`.
    pub fn folded_joints(&self, numbers: &[Real]) -> Joints {
        let (first, joined) = numbers.split_at(numbers.len() / 2);
        let joined = if self.joined.is_some() { joined.to_vec() } else { Vec::new() };
        Joints { first: first.to_vec(), joined }
    }
}

impl GpuTrunk<'_> {
    /// Returns the sizes of the slots before [`NETWORK`], for `weights` weights, `batch` folded biases per layer, and heads with
    /// `outputs` outputs. A backward pass (`is_derived`) needs more than predictions.
    pub fn sizes(&self, weights: usize, batch: usize, outputs: usize, is_derived: bool) -> Vec<usize> {
        let &Self { trunk, rows, .. } = self;
        let (width, gamma) = (trunk.width, trunk.gamma);
        let chunk = width * rows;
        let joined = if trunk.joined.is_some() { chunk } else { 1 };
        let derived = |size: usize| if is_derived { size } else { 1 };
        let mut sizes = vec![1; NETWORK];
        sizes[SCRATCH] = derived(scratch_len(rows, width * width.max(gamma).max(outputs)));
        (sizes[WEIGHTS], sizes[D_WEIGHTS]) = (weights, derived(weights));
        sizes[GAMMA] = gamma * rows;
        [sizes[SHARED[0]], sizes[SHARED[1]]] = [chunk, joined];
        [sizes[D_SHARED[0]], sizes[D_SHARED[1]]] = [derived(chunk), derived(joined)];
        (sizes[FOLDED], sizes[D_FOLDED]) = (2 * width, derived(2 * width * batch));
        (sizes[D], sizes[SPARE]) = (derived(chunk), derived(chunk));
        sizes
    }

    /// Returns the slot of the output of layer `l`.
    fn hidden(&self, l: usize) -> usize {
        self.first + l % self.slots
    }

    /// Returns the slot of the output of the last layer.
    pub fn last(&self) -> usize {
        self.hidden(self.trunk.depth() - 1)
    }

    /// Returns a chunk of R rows in a slot.
    pub fn chunk(&self, slot: usize) -> Block {
        Block::new(slot, 0, self.rows)
    }

    /// Computes W·x of a part of a layer, from slot `x` to slot `y`, with the `epilogue`.
    pub fn apply(&self, step: &mut GpuStep<'_>, part: &LayerPart, x: usize, y: usize, epilogue: Epilogue) {
        let (outputs, inputs) = part.shape();
        step.product((outputs, self.rows, inputs), part.block(WEIGHTS), self.chunk(x), self.chunk(y), epilogue);
    }

    /// Adds the derivative by W of [`Self::apply`] to slot [`D_WEIGHTS`], given slot `x` and the cotangent `d_y`.
    pub fn weight_vjp(&self, step: &mut GpuStep<'_>, part: &LayerPart, x: usize, d_y: Block) {
        step.add_gradient(part.shape(), self.rows, d_y, self.chunk(x).t(), part.block(D_WEIGHTS));
    }

    /// Computes the cotangent of x of [`Self::apply`] in slot `d_x`, with the `epilogue`, given the cotangent `d_y`.
    pub fn input_vjp(&self, step: &mut GpuStep<'_>, part: &LayerPart, d_y: Block, d_x: usize, epilogue: Epilogue) {
        let (outputs, inputs) = part.shape();
        step.product((inputs, self.rows, outputs), part.block(WEIGHTS).t(), d_y, self.chunk(d_x), epilogue);
    }

    /// Writes the folded biases of a transmitter to slot [`FOLDED`]: `joined` after `first`.
    pub fn upload_folded(&self, step: &mut GpuStep<'_>, folded: &Joints) {
        step.upload(FOLDED, 0, &folded.first);
        step.upload(FOLDED, self.trunk.width, &folded.joined);
    }

    /// Computes W·γ of the layers with inputs γ and e, from slot [`GAMMA`].
    pub fn share_gamma(&self, step: &mut GpuStep<'_>) {
        for (layer, shared) in self.trunk.joints().zip(SHARED) {
            self.apply(step, &layer.part(0..self.trunk.gamma), GAMMA, shared, Epilogue::default());
        }
    }

    /// Runs all layers for the transmitter whose biases are in slot [`FOLDED`], after [`Self::share_gamma`].
    pub fn forward(&self, step: &mut GpuStep<'_>) {
        let &Self { trunk, rows, .. } = self;
        step.bias_relu((trunk.width, rows), SHARED[0], (FOLDED, 0), self.hidden(0));
        for l in 1..trunk.depth() {
            let with = Epilogue { relu: true, ..Epilogue::default() };
            let epilogue = if Some(l) == trunk.joined {
                Epilogue { plus: Some(SHARED[1]), bias: Some((FOLDED, trunk.width)), ..with }
            } else {
                Epilogue { bias: Some((WEIGHTS, trunk.layers[l].bias)), ..with }
            };
            self.apply(step, &trunk.hidden_part(l), self.hidden(l - 1), self.hidden(l), epilogue);
        }
    }

    /// Sets the cotangents of [`Self::share_gamma`] to zero.
    pub fn clear_shared(&self, step: &mut GpuStep<'_>) {
        D_SHARED.iter().take(self.trunk.joints().count()).for_each(|&d| step.clear(d, self.trunk.width * self.rows));
    }

    /// Runs the backward pass of [`Self::forward`], given the cotangent of the last layer in slot [`D`], which must be zero
    /// wherever its output is zero. `folded` are the offsets of the cotangents of both folded biases in slot [`D_FOLDED`].
    pub fn backward(&self, step: &mut GpuStep<'_>, folded: [usize; 2]) {
        let &Self { trunk, rows, .. } = self;
        let (mut d, mut spare) = (D, SPARE);
        for l in (0..trunk.depth()).rev() {
            // Index of the layer in [`Trunk::joints`].
            let joint = if l == 0 { Some(0) } else { (Some(l) == trunk.joined).then_some(1) };
            let bias = joint.map_or((D_WEIGHTS, trunk.layers[l].bias), |j| (D_FOLDED, folded[j]));
            step.add_row_sums((trunk.width, rows), (d, 0), bias);
            if let Some(j) = joint {
                step.add(trunk.width * rows, d, D_SHARED[j]);
            }
            if l == 0 {
                return;
            }
            let (part, below) = (trunk.hidden_part(l), self.hidden(l - 1));
            self.weight_vjp(step, &part, below, self.chunk(d));
            self.input_vjp(step, &part, self.chunk(d), spare, Epilogue { mask: Some(below), ..Epilogue::default() });
            std::mem::swap(&mut d, &mut spare);
        }
    }

    /// Runs the backward pass of [`Self::share_gamma`]: adds to slot [`D_WEIGHTS`], and sets the cotangent of γ in slot
    /// `d_gamma`, if given.
    pub fn share_gamma_vjp(&self, step: &mut GpuStep<'_>, d_gamma: Option<usize>) {
        for (j, layer) in self.trunk.joints().enumerate() {
            let part = layer.part(0..self.trunk.gamma);
            self.weight_vjp(step, &part, GAMMA, self.chunk(D_SHARED[j]));
            if let Some(d_gamma) = d_gamma {
                let epilogue = Epilogue { add: j > 0, ..Epilogue::default() };
                self.input_vjp(step, &part, self.chunk(D_SHARED[j]), d_gamma, epilogue);
            }
        }
    }
}
