//! The kernels of `kernels.wgsl` as passes of a [`GpuStep`].

use crate::block::{Block, Epilogue};
use crate::step::{ARGUMENTS, GpuStep};
use crate::{SCRATCH, SLICE};

/// Bits of `mode`, as in `kernels.wgsl`.
const BIAS: u32 = 1;
const RELU: u32 = 2;
const PLUS: u32 = 4;
const MASK: u32 = 8;
const ADD: u32 = 16;

/// Rows and columns of C that a workgroup of `product` computes.
const SIDE: usize = 64;
/// Invocations per workgroup of `sum_planes`.
const LANES: usize = 64;

/// Arguments of a kernel: `Op` of `kernels.wgsl`.
#[derive(Clone, Copy, Default)]
struct Op {
    m: usize,
    n: usize,
    k: usize,
    slice: usize,
    /// Offset and strides of A.
    a: (usize, (usize, usize)),
    /// Offset and strides of B.
    b: (usize, (usize, usize)),
    /// Offset of C, and its stride from row to row.
    c: (usize, usize),
    /// Offset of H.
    h: usize,
    mode: u32,
    planes: usize,
}

impl Op {
    /// Returns the numbers in the order of `kernels.wgsl`; the offset of E is 0.
    fn numbers(self) -> [usize; ARGUMENTS] {
        let Self { m, n, k, slice, a: (a, (a0, a1)), b: (b, (b0, b1)), c: (c, c0), h, mode, planes } = self;
        [m, n, k, slice, a, a0, a1, b, b0, b1, c, c0, h, 0, mode as usize, planes]
    }
}

impl GpuStep<'_> {
    /// Computes the product C = A·B, `[m, n]` with `k` terms, and its `epilogue`; `shape` is (m, n, k). Rows of C are
    /// contiguous.
    pub fn product(&mut self, shape: (usize, usize, usize), a: Block, b: Block, c: Block, epilogue: Epilogue) {
        let (m, n, k) = shape;
        let Epilogue { plus, bias, relu, mask, add } = epilogue;
        [(a, (m, k)), (b, (k, n)), (c, (m, n))].into_iter().for_each(|(block, shape)| self.check(block, shape));
        plus.or(mask).into_iter().for_each(|other| self.check(Block::new(other, 0, n), (m, n)));
        let bits = [bias.is_some(), relu, plus.is_some(), mask.is_some(), add];
        let mode = bits.iter().zip([BIAS, RELU, PLUS, MASK, ADD]).filter(|(is_set, _)| **is_set).map(|(_, bit)| bit);
        let (bias_slot, h) = bias.unwrap_or((a.slot, 0));
        let slots = [a.slot, b.slot, bias_slot, plus.or(mask).unwrap_or(a.slot), c.slot];
        let (a, b, c) = ((a.start, a.strides), (b.start, b.strides), (c.start, c.strides.0));
        let op = Op { m, n, k, slice: k, a, b, c, h, mode: mode.sum(), planes: 1 };
        self.pass("product", slots, op.numbers(), [n.div_ceil(SIDE), m.div_ceil(SIDE), 1]);
    }

    /// Adds the product A·B over `rows` rows to C `[m, n]`: A is `[m, rows]`, B `[rows, n]`. Sums slices of [`SLICE`]
    /// rows, then adds them in order. Rows of C are contiguous.
    pub fn add_gradient(&mut self, (m, n): (usize, usize), rows: usize, a: Block, b: Block, c: Block) {
        let slices = rows.div_ceil(SLICE);
        [(a, (m, rows)), (b, (rows, n)), (c, (m, n))].into_iter().for_each(|(block, shape)| self.check(block, shape));
        let slots = [a.slot, b.slot, a.slot, a.slot, SCRATCH];
        let (a, b) = ((a.start, a.strides), (b.start, b.strides));
        let op = Op { m, n, k: rows, slice: SLICE, a, b, c: (0, n), planes: 1, ..Op::default() };
        self.pass("product", slots, op.numbers(), [n.div_ceil(SIDE), m.div_ceil(SIDE), slices]);
        self.sum_planes((m, n), slices, c);
    }

    /// Adds the planes of [`SCRATCH`] `[planes, m, n]` to C, in order.
    fn sum_planes(&mut self, (m, n): (usize, usize), planes: usize, c: Block) {
        let op = Op { m, n, c: (c.start, c.strides.0), planes, ..Op::default() };
        self.check(Block::new(SCRATCH, 0, m * n), (planes, m * n));
        let groups = if planes == 0 { 0 } else { (m * n).div_ceil(LANES) };
        self.pass("sum_planes", [SCRATCH, SCRATCH, SCRATCH, SCRATCH, c.slot], op.numbers(), [groups, 1, 1]);
    }

    /// Adds the sums over the rows of a chunk A `[features, rows]` to `features` numbers of C; both are slot and offset. A pass
    /// has at most 65,535 features, one workgroup each.
    pub fn add_row_sums(&mut self, (features, rows): (usize, usize), (a, start): (usize, usize), c: (usize, usize)) {
        let (slices, sums) = (rows.div_ceil(SLICE), Block::new(c.0, c.1, features));
        self.check(Block::new(a, start, rows), (features, rows));
        self.check(sums, (1, features));
        let op = Op { m: features, n: rows, slice: SLICE, a: (start, (0, 0)), ..Op::default() };
        self.pass("sum_rows", [a, a, a, a, SCRATCH], op.numbers(), [slices, features, 1]);
        self.sum_planes((1, features), slices, sums);
    }

    /// Computes C = relu(A + bias) of a chunk `[features, rows]`; `bias` is slot and offset of one number per feature.
    pub fn bias_relu(&mut self, (features, rows): (usize, usize), a: usize, bias: (usize, usize), c: usize) {
        [a, c].into_iter().for_each(|slot| self.check(Block::new(slot, 0, rows), (features, rows)));
        let op = Op { m: features, n: rows, h: bias.1, ..Op::default() };
        self.pass("bias_relu", [a, a, bias.0, a, c], op.numbers(), groups_of_256(features * rows));
    }

    /// Adds `len` numbers of slot `a` to slot `c`.
    pub fn add(&mut self, len: usize, a: usize, c: usize) {
        [a, c].into_iter().for_each(|slot| self.check(Block::new(slot, 0, len), (1, len)));
        let op = Op { m: 1, n: len, ..Op::default() };
        self.pass("add", [a, a, a, a, c], op.numbers(), groups_of_256(len));
    }

    /// Runs the backward pass of |lrelu(A)|·|lrelu(B)| for `rows` rows, given the cotangents in slot `d`. In slot `c`
    /// `[3, rows]` it sets the first row to the cotangents of A, and adds those of B to the second and value times cotangent to
    /// the third.
    pub fn amplitudes_vjp(&mut self, rows: usize, [a, b, d, c]: [usize; 4]) {
        let op = Op { m: 1, n: rows, ..Op::default() };
        self.pass("amplitudes_vjp", [a, b, a, d, c], op.numbers(), groups_of_256(rows));
    }

    /// Adds the derivative through the octaves of `rows` points, whose encoding is in slot `a` and its cotangent in slot `d`,
    /// to slot `c` `[3, rows]`.
    pub fn encode_vjp(&mut self, (frequencies, rows): (usize, usize), [a, d, c]: [usize; 3]) {
        let op = Op { m: 3, n: rows, k: frequencies, ..Op::default() };
        self.pass("encode_vjp", [a, d, a, a, c], op.numbers(), groups_of_256(3 * rows));
    }
}

/// Returns the workgroups of 256 invocations for a loop over `len` numbers, within the limit of every GPU.
pub(crate) fn groups_of_256(len: usize) -> [usize; 3] {
    [len.div_ceil(256).min(65_535), 1, 1]
}
