//! Matrices in the buffers of the GPU, and operations after a product.

/// Matrix in the buffer of a slot: element (i, j) has index `start + i · strides.0 + j · strides.1`.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Slot of the buffer.
    pub slot: usize,
    /// Index of the first element.
    pub start: usize,
    /// Distances of elements along columns and rows.
    pub strides: (usize, usize),
}

impl Block {
    /// Creates a matrix with contiguous rows of `columns` numbers.
    pub fn new(slot: usize, start: usize, columns: usize) -> Self {
        Self { slot, start, strides: (columns, 1) }
    }

    /// Returns the transpose.
    pub fn t(self) -> Self {
        Self { strides: (self.strides.1, self.strides.0), ..self }
    }
}

/// Operations after a product, in this order.
#[derive(Clone, Copy, Debug, Default)]
pub struct Epilogue {
    /// Slot of a matrix to add, with the shape of the product.
    pub plus: Option<usize>,
    /// Slot and offset of a number to add per row of the product.
    pub bias: Option<(usize, usize)>,
    /// Whether negative numbers become zero.
    pub relu: bool,
    /// Slot of a matrix with the shape of the product, which becomes zero where this is not positive. Not with `plus`: both
    /// have the same binding.
    pub mask: Option<usize>,
    /// Whether the result is added to the previous values.
    pub add: bool,
}
