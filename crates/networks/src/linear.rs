//! `Linear`: one layer inside the flat weight vector, and its products with chunks. `LayoutBuilder`: the layout of the layers in
//! that vector. Chunks distribute the work over threads.

use crate::dense::{self, Matrix, MatrixMut, StoreMode, product};
use pwrfgs_core::{Layout, Real, WeightSpec};
use rayon::prelude::*;
use std::ops::Range;

/// Maximum number of units per layer.
pub(crate) const WIDEST: usize = 8192;

/// Linear layer y = W·x + b: `W` `[outputs, inputs]` row-major and `b` `[outputs]` inside a flat vector.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    /// Number of components of x.
    pub inputs: usize,
    /// Number of components of y.
    pub outputs: usize,
    /// Offset of `W` in the flat vector.
    pub weight: usize,
    /// Offset of `b` in the flat vector.
    pub bias: usize,
}

impl Linear {
    /// Returns W in the flat vector.
    pub fn weight<'a>(&self, flat: &'a [Real]) -> Matrix<'a> {
        Matrix::new(&flat[self.weight..][..self.outputs * self.inputs], self.outputs, self.inputs)
    }

    /// Returns W in the flat vector, mutable.
    pub fn weight_mut<'a>(&self, flat: &'a mut [Real]) -> MatrixMut<'a> {
        MatrixMut::new(&mut flat[self.weight..][..self.outputs * self.inputs], self.outputs, self.inputs)
    }

    /// Returns the given rows of W in the flat vector, `[rows, inputs]`.
    pub fn rows<'a>(&self, flat: &'a [Real], rows: Range<usize>) -> &'a [Real] {
        &flat[self.weight + rows.start * self.inputs..self.weight + rows.end * self.inputs]
    }

    /// Returns the given rows of W in the flat vector, `[rows, inputs]`, mutable.
    pub fn rows_mut<'a>(&self, flat: &'a mut [Real], rows: Range<usize>) -> &'a mut [Real] {
        &mut flat[self.weight + rows.start * self.inputs..self.weight + rows.end * self.inputs]
    }

    /// Returns b in the flat vector.
    pub fn bias<'a>(&self, flat: &'a [Real]) -> &'a [Real] {
        &flat[self.bias..][..self.outputs]
    }

    /// Returns b in the flat vector, mutable.
    pub fn bias_mut<'a>(&self, flat: &'a mut [Real]) -> &'a mut [Real] {
        &mut flat[self.bias..][..self.outputs]
    }

    /// Returns the columns of W that multiply one of several inputs.
    pub fn part(&self, columns: Range<usize>) -> LayerPart {
        LayerPart { layer: *self, columns }
    }

    /// Returns all columns of W.
    pub fn whole(&self) -> LayerPart {
        self.part(0..self.inputs)
    }

    /// Computes y = W·x + b of a chunk: x `[inputs, R]`; `y` becomes `[outputs, R]`.
    pub fn apply(&self, weights: &[Real], x: &[Real], y: &mut Vec<Real>) {
        y.resize(x.len() / self.inputs * self.outputs, 0.0);
        self.whole().apply(weights, x, y, StoreMode::Set);
        dense::add_bias(y, self.bias(weights));
    }

    /// Computes y = relu(W·x + b) of a chunk, as [`Self::apply`].
    pub fn apply_relu(&self, weights: &[Real], x: &[Real], y: &mut Vec<Real>) {
        y.resize(x.len() / self.inputs * self.outputs, 0.0);
        self.whole().apply(weights, x, y, StoreMode::Set);
        dense::add_bias_relu(y, self.bias(weights));
    }

    /// Runs the backward pass of [`Self::apply`], given `x` and the cotangent `d_y`: adds to `d_weights`, and sets `d_x` or
    /// adds to it, depending on `store`.
    pub fn apply_vjp(
        &self,
        weights: &[Real],
        (x, d_y): (&[Real], &[Real]),
        d_weights: &mut [Real],
        (d_x, store): (&mut Vec<Real>, StoreMode),
    ) {
        self.whole().weight_vjp(d_weights, x, d_y);
        dense::add_bias_vjp(d_y, self.bias_mut(d_weights));
        d_x.resize(x.len(), 0.0);
        self.whole().input_vjp(weights, d_y, d_x, store);
    }
}

/// Some columns of W of a layer, acting on chunks: x `[columns, R]`, y `[outputs, R]`.
#[derive(Clone, Debug)]
pub struct LayerPart {
    layer: Linear,
    columns: Range<usize>,
}

impl LayerPart {
    /// Computes `y = W·x` or `y += W·x`, depending on `store`.
    pub fn apply(&self, weights: &[Real], x: &[Real], y: &mut [Real], store: StoreMode) {
        let (features, outputs) = (self.columns.len(), self.layer.outputs);
        let rows = y.len() / outputs;
        let w = self.layer.weight(weights).columns(self.columns.clone());
        product(MatrixMut::new(y, outputs, rows), store, w, Matrix::new(x, features, rows));
    }

    /// Adds the derivative by W of [`Self::apply`] to `d_weights`, given `x` and the cotangent `d_y`.
    pub fn weight_vjp(&self, d_weights: &mut [Real], x: &[Real], d_y: &[Real]) {
        let (features, outputs) = (self.columns.len(), self.layer.outputs);
        let rows = d_y.len() / outputs;
        let d_w = self.layer.weight_mut(d_weights).columns(self.columns.clone());
        product(d_w, StoreMode::Add, Matrix::new(d_y, outputs, rows), Matrix::new(x, features, rows).t());
    }

    /// Computes `d_x = Wᵀ·d_y` or `d_x += Wᵀ·d_y`, depending on `store`.
    pub fn input_vjp(&self, weights: &[Real], d_y: &[Real], d_x: &mut [Real], store: StoreMode) {
        let (features, outputs) = (self.columns.len(), self.layer.outputs);
        let rows = d_y.len() / outputs;
        let w = self.layer.weight(weights).columns(self.columns.clone());
        product(MatrixMut::new(d_x, features, rows), store, w.t(), Matrix::new(d_y, outputs, rows));
    }
}

#[cfg(feature = "gpu")]
impl Linear {
    /// Returns the layer with its first `outputs` outputs only.
    pub(crate) fn with_outputs(&self, outputs: usize) -> Self {
        Self { outputs, ..*self }
    }
}

#[cfg(feature = "gpu")]
impl LayerPart {
    /// Returns the columns of W as a matrix in `slot`, which has the layout of the flat vector.
    pub fn block(&self, slot: usize) -> pwrfgs_gpu::Block {
        pwrfgs_gpu::Block::new(slot, self.layer.weight + self.columns.start, self.layer.inputs)
    }

    /// Returns the numbers of outputs and of columns.
    pub fn shape(&self) -> (usize, usize) {
        (self.layer.outputs, self.columns.len())
    }
}

/// Tensors of a network, in order, during the layout of its layers.
#[derive(Debug, Default)]
pub struct LayoutBuilder {
    tensors: Vec<WeightSpec>,
    len: usize,
}

impl LayoutBuilder {
    /// Adds a tensor; returns its offset in the flat vector.
    fn add_tensor(&mut self, spec: WeightSpec) -> usize {
        let start = self.len;
        self.len += spec.len();
        self.tensors.push(spec);
        start
    }

    /// Adds a tensor with initial values uniform within ±`bound`; returns its offset in the flat vector.
    fn add_uniform(&mut self, name: String, shape: Vec<usize>, bound: f64) -> usize {
        self.add_tensor(WeightSpec::uniform(name, shape, bound))
    }

    /// Adds a tensor of zeros. Returns its offset in the flat vector.
    pub fn zeros(&mut self, name: &str, shape: Vec<usize>) -> usize {
        self.add_tensor(WeightSpec::zeros(name, shape))
    }

    /// Adds a tensor of zeros that the training set replaces and that does not learn. Returns its offset in the flat vector.
    pub fn fixed(&mut self, name: &str, shape: Vec<usize>) -> usize {
        self.add_tensor(WeightSpec { learns: false, ..WeightSpec::zeros(name, shape) })
    }

    /// Adds a layer with PyTorch's initial values: weights and biases uniform within ±1/√inputs.
    pub fn linear(&mut self, name: &str, inputs: usize, outputs: usize) -> Linear {
        self.heads(&[(name, outputs)], inputs, 1.0)
    }

    /// Adds a linear layer before a ReLU, with He's initial values: weights uniform within ±√(6/inputs), biases 0. The
    /// magnitude of activations is then constant for any depth of the stack. Dropout applies to its outputs.
    pub fn linear_before_relu(&mut self, name: &str, inputs: usize, outputs: usize) -> Linear {
        let layer = self.linear_within(name, inputs, outputs, (6.0 / inputs as f64).sqrt());
        self.tensors.iter_mut().rev().take(2).for_each(|spec| spec.hidden = true); // weights and biases
        layer
    }

    /// Adds a layer with weights uniform within ±`bound` and biases 0.
    pub fn linear_within(&mut self, name: &str, inputs: usize, outputs: usize, bound: f64) -> Linear {
        let weight = self.add_uniform(format!("{name}.weight"), vec![outputs, inputs], bound);
        let bias = self.add_uniform(format!("{name}.bias"), vec![outputs], 0.0);
        Linear { inputs, outputs, weight, bias }
    }

    /// Adds layers that share their input, stored weights first and then biases, so that they act as one layer. `heads` are
    /// names and numbers of outputs. Initial values are PyTorch's times `scale`.
    pub fn heads(&mut self, heads: &[(&str, usize)], inputs: usize, scale: f64) -> Linear {
        let bound = scale / (inputs as f64).sqrt();
        let (weight, outputs) = (self.len, heads.iter().map(|h| h.1).sum());
        for (name, outputs) in heads {
            self.add_uniform(format!("{name}.weight"), vec![*outputs, inputs], bound);
        }
        let bias = self.len;
        for (name, outputs) in heads {
            self.add_uniform(format!("{name}.bias"), vec![*outputs], bound);
        }
        Linear { inputs, outputs, weight, bias }
    }

    /// Returns the length of the flat vector.
    pub fn weight_count(&self) -> usize {
        self.len
    }

    /// Returns the tensors of the flat vector, in order, without constants.
    pub fn layout(self) -> Layout {
        Layout { weights: self.tensors, constants: Vec::new() }
    }
}

/// Lays out a network with `build`; returns the network and its plan.
pub fn lay_out<N>(build: impl FnOnce(&mut LayoutBuilder) -> N) -> (N, LayoutBuilder) {
    let mut plan = LayoutBuilder::default();
    (build(&mut plan), plan)
}

/// Lays out a network with `build` for existing weights.
///
/// # Panics
/// If the number of weights is not that of the layout.
pub fn lay_out_for<N>(weights: &[Real], build: impl FnOnce(&mut LayoutBuilder) -> N) -> N {
    let (network, plan) = lay_out(build);
    assert_eq!(weights.len(), plan.weight_count(), "as many weights as in the layout");
    network
}

/// Work item: some Gaussians for some transmitters.
#[derive(Clone, Debug)]
pub struct Item {
    /// Range of the points.
    pub rows: Range<usize>,
    /// Range of the transmitters in the batch.
    pub txs: Range<usize>,
}

/// Returns the number of Gaussians per chunk, a multiple of 16: whole vectors. It depends only on N and the width, so that
/// results do not depend on the number of threads or the batch size. The maximum is 192, or fewer for more than 256 units,
/// but at least 48: two activations of width 256 then fit 1 MiB of second-level cache. A stride of 256 or 512 floats, at
/// which gemm loses half its speed to cache conflicts, never occurs. For small N there are up to 24 chunks of about 64 rows,
/// an even number, so that two threads share N = 157.
pub fn rows_per_chunk(n: usize, width: usize) -> usize {
    let most = (192 * 256 / width.max(1) / 16 * 16).clamp(48, 192);
    let chunks = n.div_ceil(most).max((n / 64).min(24)).next_multiple_of(2);
    n.div_ceil(chunks.max(1)).next_multiple_of(16).clamp(16, most)
}

/// Returns the work items for `n` Gaussians and `batch` transmitters, in layers of `width` units: for each group of
/// transmitters all chunks of Gaussians. The batch is one group, unless there are fewer than 16 chunks; more items then use
/// more threads.
pub fn work_items(n: usize, batch: usize, width: usize) -> Vec<Item> {
    let rows = rows_per_chunk(n, width);
    let chunks = n.div_ceil(rows);
    let groups = 16usize.div_ceil(chunks.max(1)).clamp(1, batch.max(1));
    let group = batch.div_ceil(groups).max(1);
    let group_starts = (0..batch).step_by(group);
    group_starts
        .flat_map(|b| {
            let txs = b..(b + group).min(batch);
            (0..n).step_by(rows).map(move |i| Item { rows: i..(i + rows).min(n), txs: txs.clone() })
        })
        .collect()
}

/// Runs `run` on groups of `items` in parallel. `run` adds derivatives of the weights to its second argument; their sum over
/// the groups is added to `d_weights`. Returns the results of `run` in the order of the groups.
///
/// There are up to 16 groups, whatever the number of threads. Each is summed in order, the first in `d_weights` itself; the
/// sums of the others are then added in order. Further threads share the products of a group.
pub fn sum_groups<T: Sync, R: Send>(
    items: &[T],
    d_weights: &mut [Real],
    run: impl Fn(&[T], &mut [Real]) -> R + Sync,
) -> Vec<R> {
    let groups = (1_usize << (items.len() / 2).max(1).ilog2()).clamp(2, 16);
    let size = items.len().div_ceil(groups).max(1);
    let (numbers, groups) = (d_weights.len(), items.len().div_ceil(size));
    let threads = rayon::current_num_threads();
    let mut first = Some(&mut *d_weights);
    let totals: Vec<Option<&mut [Real]>> = (0..groups).map(|_| first.take()).collect();
    let one = |(items, total): (&[T], Option<&mut [Real]>)| {
        let mut sum = vec![0.0; if total.is_some() { 0 } else { numbers }];
        let result = dense::run_with_product_threads(threads / groups, || run(items, total.unwrap_or(&mut sum)));
        (sum, result)
    };
    let (sums, results): (Vec<Vec<Real>>, Vec<R>) = items.par_chunks(size).zip(totals).map(one).unzip();
    dense::add_in_order(d_weights, &sums.iter().skip(1).map(Vec::as_slice).collect::<Vec<_>>());
    results
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_items_cover_each_gaussian_and_transmitter_once() {
        for (n, batch, width) in [(1, 1, 256), (50, 3, 64), (157, 1, 256), (157, 32, 256), (2613, 5, 1024), (7, 40, 1)]
        {
            let mut seen = vec![0; n * batch];
            for item in work_items(n, batch, width) {
                assert!(item.rows.len() <= 192);
                for b in item.txs {
                    item.rows.clone().for_each(|i| seen[b * n + i] += 1);
                }
            }
            assert!(seen.iter().all(|&s| s == 1), "{n} {batch} {width}");
        }
        assert_eq!(work_items(157, 1, 256).len(), 2);
        assert!(work_items(0, 3, 256).is_empty() && work_items(3, 0, 256).is_empty());
    }
}
