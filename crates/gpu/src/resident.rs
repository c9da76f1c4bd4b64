//! Whole training steps on the GPU: the kernels of `resident.wgsl` as passes of a [`GpuStep`]. Parameters, moments and
//! statistics stay in the buffers from step to step.
//!
//! ```text
//! STATE ─► encode ─► network ─► HEADS ──► arrange_terms, arrange_signals ─┐
//! STATE ─► depth_keys, sort ─► KEYS ────► arrange_cloud ──────────────────┴─► drawing, loss and their derivatives
//! D_ROWS, D_SPLATS ─► scatter_cloud ─► D_STATE ─► adam ─► STATE
//!                  ─► scatter_terms ─► D_HEADS ─► network ─► adam
//!                  ─► statistics ─► STATS
//! ```

use crate::adapters::Gpu;
use crate::draw::{CLOUD, D_ROWS, D_SPLATS, SIGNALS, SPLATS, TERMS};
use crate::passes::groups_of_256;
use crate::step::{ARGUMENTS, GpuStep};
use pwrfgs_core::{AdamUpdate, Real, Result};
use std::ops::Range;

/// Slots of [`Resident`], after its first one: values and moments of the Gaussians `[3, P]`.
pub const STATE: usize = 0;
/// Derivatives by the Gaussians `[P]`.
pub const D_STATE: usize = 1;
/// Statistics `[4, N]`: columns of `CloudStats`.
pub const STATS: usize = 2;
/// Keys of the depth order.
const KEYS: usize = 3;
/// Outputs of the network `[9, N]`.
pub const HEADS: usize = 4;
/// Their cotangents.
pub const D_HEADS: usize = 5;
/// Inputs of the steps that were uploaded together: encoded transmitters, constants of drawings and of losses, and spectra.
pub const INPUTS: usize = 6;

/// Number of outputs of the network: rotation 4, scales 3, signal 2.
const OUTPUTS: usize = 9;
/// Parameters per Gaussian.
const COLUMNS: usize = 13;
/// Number of keys that a workgroup sorts.
const SORTED: usize = 512;
/// Invocations per workgroup of the kernels per Gaussian, and per key or pair of keys.
const LANES: usize = 64;
const KEY_LANES: usize = 256;

/// Arguments of a kernel: `Op` of `resident.wgsl`.
#[derive(Clone, Copy, Default)]
struct Op {
    n: usize,
    a: usize,
    c: usize,
    k: usize,
    j: usize,
    x: [Real; 9],
}

impl Op {
    /// Returns the numbers in the order of `resident.wgsl`, those of `x` as their bits.
    fn numbers(self) -> [usize; ARGUMENTS] {
        let Self { n, a, c, k, j, x } = self;
        let mut all = [0; ARGUMENTS];
        all[..5].copy_from_slice(&[n, a, c, k, j]);
        all[5..14].iter_mut().zip(x).for_each(|(bits, x)| *bits = (x as f32).to_bits() as usize);
        all
    }
}

/// Gaussians whose parameters stay on the GPU.
#[derive(Clone, Copy, Debug)]
pub struct Resident {
    /// Number of Gaussians N.
    pub gaussians: usize,
    /// Number of channels of a drawing.
    pub channels: usize,
    /// First slot of the drawing.
    pub drawing: usize,
    /// First slot of the state.
    pub state: usize,
}

impl Resident {
    /// Returns the sizes of the slots of the state, from [`STATE`] to [`INPUTS`], for so many `inputs`.
    pub fn sizes(&self, inputs: usize) -> Vec<usize> {
        let (n, parameters) = (self.gaussians, self.parameters());
        vec![3 * parameters, parameters, 4 * n, 2 * self.keys(), OUTPUTS * n, OUTPUTS * n, inputs]
    }

    /// Returns the number of parameters P.
    pub fn parameters(&self) -> usize {
        COLUMNS * self.gaussians
    }

    /// Returns the number of keys: a power of two from [`SORTED`] on.
    fn keys(&self) -> usize {
        self.gaussians.next_power_of_two().max(SORTED)
    }

    /// Returns the slot in the step, given one of the state such as [`STATE`].
    pub fn slot(&self, slot: usize) -> usize {
        self.state + slot
    }

    /// Records a kernel with an invocation per Gaussian, slots A, H, E and C, and first constants `x`; B are the keys.
    fn record_per_gaussian(&self, step: &mut GpuStep<'_>, name: &str, [a, h, e, c]: [usize; 4], x: [Real; 3]) {
        let mut op = Op { n: self.gaussians, k: self.keys(), j: self.channels, ..Op::default() };
        op.x[..3].copy_from_slice(&x);
        let groups = [self.gaussians.div_ceil(LANES), 1, 1];
        step.pass(name, [a, self.slot(KEYS), h, e, c], op.numbers(), groups);
    }

    /// Sorts the Gaussians by their distance from `position`, nearest first, ties by index: a bitonic sort of the keys. Blocks
    /// of up to 512 keys are sorted at once; exchanges over longer distances take a pass each.
    pub fn sort(&self, step: &mut GpuStep<'_>, position: [Real; 3]) {
        let (keys, slot, means) = (self.keys(), self.slot(KEYS), self.slot(STATE));
        let mut op = Op { n: self.gaussians, k: keys, ..Op::default() };
        op.x[..3].copy_from_slice(&position);
        step.pass("depth_keys", [means, means, means, means, slot], op.numbers(), [keys.div_ceil(KEY_LANES), 1, 1]);
        let mut pass = |name: &str, op: Op, groups: usize| {
            step.pass(name, [means, means, means, means, slot], op.numbers(), [groups, 1, 1]);
        };
        let op = Op { k: keys, ..Op::default() };
        pass("sort_block", Op { j: 2, a: SORTED, ..op }, keys / SORTED); // blocks of 2 to 512
        let mut block = 2 * SORTED;
        while block <= keys {
            let mut distance = block / 2;
            while distance >= SORTED {
                pass("sort_pairs", Op { j: distance, a: block, ..op }, (keys / 2).div_ceil(KEY_LANES));
                distance /= 2;
            }
            pass("sort_block", Op { j: block, a: block, ..op }, keys / SORTED);
            block *= 2;
        }
    }

    /// Writes the Gaussians to the drawing in depth order.
    pub fn arrange_cloud(&self, step: &mut GpuStep<'_>) {
        let state = self.slot(STATE);
        let slots = [state, state, state, self.drawing + CLOUD];
        self.record_per_gaussian(step, "arrange_cloud", slots, [0.0; 3]);
    }

    /// Writes the outputs of the network to the drawing in depth order.
    pub fn arrange_heads(&self, step: &mut GpuStep<'_>) {
        let (heads, state) = (self.slot(HEADS), self.slot(STATE));
        self.record_per_gaussian(step, "arrange_terms", [heads, heads, heads, self.drawing + TERMS], [0.0; 3]);
        self.record_per_gaussian(step, "arrange_signals", [heads, state, heads, self.drawing + SIGNALS], [0.0; 3]);
    }

    /// Adds the derivatives of the drawing to those of the Gaussians, sets those of the outputs of the network, and adds to the
    /// statistics. `size` is that of the image, `drawings` the number of drawings of the step.
    pub fn scatter(&self, step: &mut GpuStep<'_>, size: (usize, usize), drawings: usize) {
        let (rows, splats) = (self.drawing + D_ROWS, self.drawing + D_SPLATS);
        self.record_per_gaussian(step, "scatter_cloud", [rows, splats, rows, self.slot(D_STATE)], [0.0; 3]);
        self.record_per_gaussian(step, "scatter_terms", [rows, splats, rows, self.slot(D_HEADS)], [0.0; 3]);
        let [width, height, drawings] = [size.0, size.1, drawings].map(|number| number as Real);
        let scales = [0.5 * width, 0.5 * height, drawings];
        self.record_per_gaussian(step, "statistics", [rows, splats, self.drawing + SPLATS, self.slot(STATS)], scales);
    }
}

impl GpuStep<'_> {
    /// Encodes `rows` means from row `first` of slot `means` with octaves, to slot `c` `[3 + 6L, rows]`.
    pub fn encode(&mut self, means: usize, (first, rows): (usize, usize), frequencies: usize, c: usize) {
        let op = Op { n: rows, a: 3 * first, k: frequencies, ..Op::default() };
        self.pass("encode", [means, means, means, means, c], op.numbers(), groups_of_256(3 * rows));
    }

    /// Runs Adam on parameters `range` of the state in slot `state` `[3, parameters]`, with their derivatives in slot `d`.
    pub fn adam(&mut self, (state, parameters): (usize, usize), d: usize, range: Range<usize>, update: &AdamUpdate) {
        let &AdamUpdate { rate, eps, unbias, l2, decay } = update;
        let ([unbias1, unbias2], [beta1, beta2]) = (unbias, AdamUpdate::BETAS);
        // The order of `adam` in `resident.wgsl`.
        let x = [rate, eps, unbias1, unbias2, l2, decay, beta1, beta2, AdamUpdate::NEGLIGIBLE];
        let op = Op { n: range.len(), a: range.start, c: range.start, k: parameters, x, ..Op::default() };
        self.pass("adam", [d, d, d, d, state], op.numbers(), groups_of_256(range.len()));
    }
}

impl Gpu {
    /// Begins training steps with buffers of at least `sizes` numbers by slot, which only such steps use.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn training_step(&self, sizes: &[usize]) -> Result<GpuStep<'_>> {
        self.step_in(&self.training, sizes, "use a smaller `width` or `depth`, fewer Gaussians, or the CPU")
    }
}
