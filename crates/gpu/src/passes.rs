//! The kernels of `kernels.wgsl` as passes of a [`GpuStep`].

use crate::block::{Block, Epilogue};
use crate::step::GpuStep;
use crate::{SCRATCH, SLICE};

/// Bits of `mode`, as in `kernels.wgsl`.
const BIAS: u32 = 1;
const RELU: u32 = 2;
const PLUS: u32 = 4;
const MASK: u32 = 8;
const ADD: u32 = 16;

impl GpuStep<'_> {
    /// Computes the product C = A·B, `[m, n]` with `k` terms, and its `epilogue`.
    pub fn product(&mut self, shape: (usize, usize, usize), a: Block, b: Block, c: Block, epilogue: Epilogue) {
        let (m, n, k) = shape;
        let Epilogue { plus, bias, relu, mask, add } = epilogue;
        [(a, (m, k)), (b, (k, n)), (c, (m, n))].into_iter().for_each(|(block, shape)| self.check(block, shape));
        plus.or(mask).into_iter().for_each(|other| self.check(Block::new(other, 0, n), (m, n)));
        let bits = [bias.is_some(), relu, plus.is_some(), mask.is_some(), add];
        let mode = bits.iter().zip([BIAS, RELU, PLUS, MASK, ADD]).filter(|(is_set, _)| **is_set).map(|(_, bit)| bit);
        let (h, h0) = bias.unwrap_or((a.slot, 0));
        let slots = [a.slot, b.slot, h, plus.or(mask).unwrap_or(a.slot), c.slot];
        let mode = mode.sum::<u32>() as usize;
        let arguments = [
            m,
            n,
            k,
            k,
            a.start,
            a.strides.0,
            a.strides.1,
            b.start,
            b.strides.0,
            b.strides.1,
            c.start,
            c.strides.0,
            h0,
            0,
            mode,
            1,
        ];
        self.pass("product", slots, arguments, [n.div_ceil(64), m.div_ceil(64), 1]);
    }

    /// Adds the product A·B over `rows` rows to C `[m, n]`: A is `[m, rows]`, B `[rows, n]`. Sums slices of [`SLICE`]
    /// rows, then adds them in order.
    pub fn add_gradient(&mut self, (m, n): (usize, usize), rows: usize, a: Block, b: Block, c: Block) {
        let slices = rows.div_ceil(SLICE);
        [(a, (m, rows)), (b, (rows, n)), (c, (m, n))].into_iter().for_each(|(block, shape)| self.check(block, shape));
        let arguments =
            [m, n, rows, SLICE, a.start, a.strides.0, a.strides.1, b.start, b.strides.0, b.strides.1, 0, n, 0, 0, 0, 1];
        let slots = [a.slot, b.slot, a.slot, a.slot, SCRATCH];
        self.pass("product", slots, arguments, [n.div_ceil(64), m.div_ceil(64), slices]);
        self.sum_planes((m, n), slices, c);
    }

    /// Adds the planes of [`SCRATCH`] `[planes, m, n]` to C, in order.
    fn sum_planes(&mut self, (m, n): (usize, usize), planes: usize, c: Block) {
        let arguments = [m, n, 0, 0, 0, 0, 0, 0, 0, 0, c.start, c.strides.0, 0, 0, 0, planes];
        self.check(Block::new(SCRATCH, 0, m * n), (planes, m * n));
        let groups = if planes == 0 { 0 } else { (m * n).div_ceil(64) };
        self.pass("sum_planes", [SCRATCH, SCRATCH, SCRATCH, SCRATCH, c.slot], arguments, [groups, 1, 1]);
    }

    /// Adds the sums over the rows of a chunk A `[features, rows]` to `features` numbers from `c`.
    pub fn add_row_sums(&mut self, (features, rows): (usize, usize), (a, start): (usize, usize), c: (usize, usize)) {
        let slices = rows.div_ceil(SLICE);
        self.check(Block::new(a, start, rows), (features, rows));
        self.check(Block::new(c.0, c.1, features), (1, features));
        let arguments = [features, rows, 0, SLICE, start, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        self.pass("sum_rows", [a, a, a, a, SCRATCH], arguments, [slices, features, 1]);
        self.sum_planes((1, features), slices, Block::new(c.0, c.1, features));
    }

    /// Computes C = relu(A + bias) of a chunk `[features, rows]`, with a bias per feature.
    pub fn bias_relu(&mut self, (features, rows): (usize, usize), a: usize, bias: (usize, usize), c: usize) {
        [a, c].into_iter().for_each(|slot| self.check(Block::new(slot, 0, rows), (features, rows)));
        let arguments = [features, rows, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, bias.1, 0, 0, 0];
        self.pass("bias_relu", [a, a, bias.0, a, c], arguments, groups_of_256(features * rows));
    }

    /// Adds `len` numbers of slot `a` to slot `c`.
    pub fn add(&mut self, len: usize, a: usize, c: usize) {
        [a, c].into_iter().for_each(|slot| self.check(Block::new(slot, 0, len), (1, len)));
        let arguments = [1, len, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        self.pass("add", [a, a, a, a, c], arguments, groups_of_256(len));
    }

    /// Runs the backward pass of |lrelu(A)|·|lrelu(B)| for `rows` rows, given the cotangents in slot `d`: slot `c` `[3, rows]`
    /// gets the cotangents of A; those of B, and the products of value and cotangent, are added.
    pub fn amplitudes_vjp(&mut self, rows: usize, [a, b, d, c]: [usize; 4]) {
        let arguments = [1, rows, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        self.pass("amplitudes_vjp", [a, b, a, d, c], arguments, groups_of_256(rows));
    }

    /// Adds the derivative through the octaves of `rows` points, whose encoding is in slot `a` and its cotangent in slot `d`,
    /// to slot `c` `[3, rows]`.
    pub fn encode_vjp(&mut self, (frequencies, rows): (usize, usize), [a, d, c]: [usize; 3]) {
        let arguments = [3, rows, frequencies, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        self.pass("encode_vjp", [a, d, a, a, c], arguments, groups_of_256(3 * rows));
    }
}

/// Returns the workgroups of 256 invocations for a loop over `len` numbers.
fn groups_of_256(len: usize) -> [usize; 3] {
    [len.div_ceil(256).min(65_535), 1, 1]
}
