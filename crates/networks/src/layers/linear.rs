//! `Linear`: one layer inside the flat weight vector, and its products with chunks.

use crate::layers::dense::{Matrix, MatrixMut, Store, product};
use pwrfgs_core::Real;
use std::ops::Range;

/// A linear layer y = W·x + b: `W` `[outputs, inputs]` row-major and `b` `[outputs]` inside a flat vector.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    /// Numbers of x.
    pub inputs: usize,
    /// Numbers of y.
    pub outputs: usize,
    /// Where `W` starts.
    pub weight: usize,
    /// Where `b` starts.
    pub bias: usize,
}

impl Linear {
    /// W in the flat vector.
    pub fn weight<'a>(&self, flat: &'a [Real]) -> Matrix<'a> {
        Matrix::new(&flat[self.weight..][..self.outputs * self.inputs], self.outputs, self.inputs)
    }

    /// W in the flat vector, to be written.
    pub fn weight_mut<'a>(&self, flat: &'a mut [Real]) -> MatrixMut<'a> {
        MatrixMut::new(&mut flat[self.weight..][..self.outputs * self.inputs], self.outputs, self.inputs)
    }

    /// Some rows of `W`.
    pub fn rows<'a>(&self, flat: &'a [Real], rows: Range<usize>) -> &'a [Real] {
        &flat[self.weight + rows.start * self.inputs..self.weight + rows.end * self.inputs]
    }

    /// Some rows of `W`, to be written.
    pub fn rows_mut<'a>(&self, flat: &'a mut [Real], rows: Range<usize>) -> &'a mut [Real] {
        &mut flat[self.weight + rows.start * self.inputs..self.weight + rows.end * self.inputs]
    }

    /// b in the flat vector.
    pub fn bias<'a>(&self, flat: &'a [Real]) -> &'a [Real] {
        &flat[self.bias..][..self.outputs]
    }

    /// b in the flat vector, to be written.
    pub fn bias_mut<'a>(&self, flat: &'a mut [Real]) -> &'a mut [Real] {
        &mut flat[self.bias..][..self.outputs]
    }

    /// The columns of W that see one of several inputs.
    pub fn part(&self, columns: Range<usize>) -> Part {
        Part { layer: *self, columns }
    }

    /// All columns of W.
    pub fn whole(&self) -> Part {
        self.part(0..self.inputs)
    }
}

/// Some columns of a layer's W, acting on chunks: x `[columns, R]`, y `[outputs, R]`.
#[derive(Clone, Debug)]
pub struct Part {
    layer: Linear,
    columns: Range<usize>,
}

impl Part {
    /// `y = W·x` or `y += W·x`.
    pub fn apply(&self, weights: &[Real], x: &[Real], y: &mut [Real], store: Store) {
        let (features, outputs) = (self.columns.len(), self.layer.outputs);
        let rows = y.len() / outputs;
        let w = self.layer.weight(weights).columns(self.columns.clone());
        product(MatrixMut::new(y, outputs, rows), store, w, Matrix::new(x, features, rows));
    }

    /// Adds the derivative along W to `d_weights`.
    pub fn weight_vjp(&self, d_weights: &mut [Real], x: &[Real], d_y: &[Real]) {
        let (features, outputs) = (self.columns.len(), self.layer.outputs);
        let rows = d_y.len() / outputs;
        let d_w = self.layer.weight_mut(d_weights).columns(self.columns.clone());
        product(d_w, Store::Add, Matrix::new(d_y, outputs, rows), Matrix::new(x, features, rows).t());
    }

    /// `d_x = Wᵀ·d_y` or `d_x += Wᵀ·d_y`.
    pub fn input_vjp(&self, weights: &[Real], d_y: &[Real], d_x: &mut [Real], store: Store) {
        let (features, outputs) = (self.columns.len(), self.layer.outputs);
        let rows = d_y.len() / outputs;
        let w = self.layer.weight(weights).columns(self.columns.clone());
        product(MatrixMut::new(d_x, features, rows), store, w.t(), Matrix::new(d_y, outputs, rows));
    }
}
