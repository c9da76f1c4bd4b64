//! Stack of ReLU layers that networks share: h₀ = relu(W₀·[γ, e] + b₀), …; after layer `skip`, [γ, e] is concatenated
//! to h again.
//!
//! γ depends on the Gaussian only and e on the transmitter only. W·γ is therefore computed once per chunk for all
//! transmitters of the batch. W·e is computed once per transmitter and added to the bias. Only h → h remains for each
//! pair.

#[cfg(feature = "gpu")]
pub mod gpu;

use crate::dense::{self, Matrix, MatrixMut, StoreMode, product};
use crate::linear::{LayerPart, LayoutBuilder, Linear, WIDEST};
use pwrfgs_core::Real;
use std::ops::Range;

/// Layers and input connections of a stack.
#[derive(Debug)]
pub struct Trunk {
    layers: Vec<Linear>,
    /// Index of the layer with the inputs [γ, e, h].
    joined: Option<usize>,
    /// Number of components of γ.
    gamma: usize,
    /// Number of components of e.
    side: usize,
    /// Units per layer.
    pub width: usize,
}

/// Arguments of [`Trunk::new`].
#[derive(Clone, Copy, Debug)]
pub struct TrunkShape {
    /// Number of layers.
    pub depth: usize,
    /// Units per layer.
    pub width: usize,
    /// Index of the layer after which [γ, e] enter again.
    pub skip: Option<usize>,
    /// Number of components of γ.
    pub gamma: usize,
    /// Number of components of e.
    pub side: usize,
}

/// Vector for each of the two layers with inputs γ and e: `[width]` as biases, `[width, R]` as W·γ. `joined` is empty
/// without a skip.
#[derive(Clone, Debug, Default)]
pub struct Joints {
    /// Vector of the first layer.
    pub first: Vec<Real>,
    /// Vector of the layer after the skip.
    pub joined: Vec<Real>,
}

/// Accumulators of [`Trunk::backward`].
#[derive(Debug)]
pub struct TrunkGradient<'a> {
    /// Derivatives of the weights, of equal length.
    pub weights: &'a mut [Real],
    /// Derivatives of W·γ, `[width, R]` each.
    pub shared: &'a mut Joints,
    /// Derivatives of the folded biases, `[width]` each; the second is unused without a skip.
    pub folded: [&'a mut [Real]; 2],
}

impl Trunk {
    /// Plans layers `trunk.0`, `trunk.1`, … with PyTorch's initial values.
    pub fn new(plan: &mut LayoutBuilder, shape: TrunkShape) -> Self {
        let joined = shape.skip.map(|s| s + 1);
        let (gamma, side, width) = (shape.gamma, shape.side, shape.width);
        let layers = (0..shape.depth)
            .map(|l| {
                let inputs = match l {
                    0 => gamma + side,
                    _ if Some(l) == joined => gamma + side + width,
                    _ => width,
                };
                plan.linear(&format!("trunk.{l}"), inputs, width)
            })
            .collect();
        Self { layers, joined, gamma, side, width }
    }

    /// Returns the number of layers.
    pub fn depth(&self) -> usize {
        self.layers.len()
    }

    /// Returns the columns of layer `l`, from the second on, that multiply h.
    fn hidden_part(&self, l: usize) -> LayerPart {
        let before = if Some(l) == self.joined { self.gamma + self.side } else { 0 };
        self.layers[l].part(before..before + self.width)
    }

    /// Iterates over the layers with inputs γ and e, in order.
    pub(crate) fn joints(&self) -> impl Iterator<Item = &Linear> {
        self.layers.first().into_iter().chain(self.joined.map(|l| &self.layers[l]))
    }

    /// Returns the columns that multiply e in the layers with inputs γ and e.
    pub(crate) fn side_columns(&self) -> Range<usize> {
        self.gamma..self.gamma + self.side
    }

    /// Returns zeros, `len` for each layer with inputs γ and e.
    pub fn zero_joints(&self, len: usize) -> Joints {
        Joints { first: vec![0.0; len], joined: vec![0.0; if self.joined.is_some() { len } else { 0 }] }
    }

    /// Returns the biases including W·e of the layers with inputs γ and e, `[width]` each, for a transmitter with `e` `[side]`.
    pub fn fold_biases(&self, weights: &[Real], e: &[Real]) -> Joints {
        let mut folded = self.joints().map(|layer| {
            let mut bias = layer.bias(weights).to_vec();
            let w = layer.weight(weights).columns(self.side_columns());
            product(MatrixMut::new(&mut bias, self.width, 1), StoreMode::Add, w, Matrix::new(e, self.side, 1));
            bias
        });
        Joints { first: folded.next().unwrap_or_default(), joined: folded.next().unwrap_or_default() }
    }

    /// Runs the backward pass of [`Self::fold_biases`] for B transmitters: `e` `[B, side]`, `d` one vector `[B, width]`
    /// per layer. Adds to `d_weights` and returns the cotangent of e, `[B, side]`.
    pub fn fold_biases_vjp(&self, weights: &[Real], e: &[Real], d: &Joints, d_weights: &mut [Real]) -> Vec<Real> {
        let batch = d.first.len() / self.width;
        let mut d_e = vec![0.0; batch * self.side];
        for (layer, d) in self.joints().zip([&d.first, &d.joined]) {
            let d_rows = Matrix::new(d, batch, self.width);
            let d_w = layer.weight_mut(d_weights).columns(self.side_columns());
            product(d_w, StoreMode::Add, d_rows.t(), Matrix::new(e, batch, self.side));
            d.chunks_exact(self.width).for_each(|d| dense::add_assign(layer.bias_mut(d_weights), d));
            let w = layer.weight(weights).columns(self.side_columns());
            product(MatrixMut::new(&mut d_e, batch, self.side), StoreMode::Add, d_rows, w);
        }
        d_e
    }

    /// Adds the derivatives `d` of the biases of the layers with inputs γ and e to `d_weights`.
    pub fn add_joint_biases(&self, d_weights: &mut [Real], d: &Joints) {
        for (layer, d) in self.joints().zip([&d.first, &d.joined]) {
            dense::add_assign(layer.bias_mut(d_weights), d);
        }
    }

    /// Computes W·γ of the layers with inputs γ and e in `shared`, for a chunk γ `[components, R]`.
    pub fn share_gamma(&self, weights: &[Real], gamma: &[Real], shared: &mut Joints) {
        let rows = gamma.len() / self.gamma;
        for (layer, out) in self.joints().zip([&mut shared.first, &mut shared.joined]) {
            out.resize(self.width * rows, 0.0);
            layer.part(0..self.gamma).apply(weights, gamma, out, StoreMode::Set);
        }
    }

    /// Runs the backward pass of [`Self::share_gamma`], given γ and the cotangents `d_shared`: adds to `d_weights`, and to
    /// `d_gamma` if given.
    pub fn share_gamma_vjp(
        &self,
        weights: &[Real],
        gamma: &[Real],
        d_shared: &Joints,
        d_weights: &mut [Real],
        mut d_gamma: Option<&mut [Real]>,
    ) {
        for (layer, d) in self.joints().zip([&d_shared.first, &d_shared.joined]) {
            let part = layer.part(0..self.gamma);
            part.weight_vjp(d_weights, gamma, d);
            if let Some(d_gamma) = &mut d_gamma {
                part.input_vjp(weights, d, d_gamma, StoreMode::Add);
            }
        }
    }

    /// Runs all layers for one chunk and one transmitter. Layer l writes slot `l % slots.len()`: use two slots for
    /// predictions, one per layer for derivatives. The result is in slot [`Self::last_slot`].
    pub fn forward(&self, weights: &[Real], shared: &Joints, folded: &Joints, slots: &mut [Vec<Real>]) {
        for (l, layer) in self.layers.iter().enumerate() {
            let out = l % slots.len();
            if l == 0 {
                slots[out].clone_from(&shared.first);
                dense::add_bias_relu(&mut slots[out], &folded.first);
                continue;
            }
            let mut h = std::mem::take(&mut slots[out]);
            let input = &slots[(l - 1) % slots.len()];
            if Some(l) == self.joined {
                h.clone_from(&shared.joined);
                self.hidden_part(l).apply(weights, input, &mut h, StoreMode::Add);
                dense::add_bias_relu(&mut h, &folded.joined);
            } else {
                h.resize(shared.first.len(), 0.0);
                self.hidden_part(l).apply(weights, input, &mut h, StoreMode::Set);
                dense::add_bias_relu(&mut h, layer.bias(weights));
            }
            slots[out] = h;
        }
    }

    /// Returns the index of the slot that holds the output of the last layer, of so many `slots`.
    pub fn last_slot(&self, slots: usize) -> usize {
        (self.depth() - 1) % slots
    }

    /// Runs the backward pass of [`Self::forward`] with all activations in `slots`; adds to `into`. `d` is the cotangent of
    /// the last layer and is overwritten; `spare` is a work buffer.
    pub fn backward(
        &self,
        weights: &[Real],
        slots: &[Vec<Real>],
        d: &mut Vec<Real>,
        spare: &mut Vec<Real>,
        into: TrunkGradient<'_>,
    ) {
        let TrunkGradient { weights: d_weights, shared: d_shared, folded: [d_first, d_joined] } = into;
        for (l, layer) in self.layers.iter().enumerate().rev() {
            if l == 0 {
                dense::add_bias_relu_vjp(d, &slots[0], d_first);
                dense::add_assign(&mut d_shared.first, d);
                return;
            }
            if Some(l) == self.joined {
                dense::add_bias_relu_vjp(d, &slots[l], d_joined);
                dense::add_assign(&mut d_shared.joined, d);
            } else {
                dense::add_bias_relu_vjp(d, &slots[l], layer.bias_mut(d_weights));
            }
            self.hidden_part(l).weight_vjp(d_weights, &slots[l - 1], d);
            spare.resize(d.len(), 0.0);
            self.hidden_part(l).input_vjp(weights, d, spare, StoreMode::Set);
            std::mem::swap(d, spare);
        }
    }
}

impl Joints {
    /// Returns the rows of transmitter `b` in both vectors, `[B, width]` each; the second is empty without a skip.
    pub fn tx_part(&mut self, b: usize, width: usize) -> [&mut [Real]; 2] {
        let part = b * width..(b + 1) * width;
        [&mut self.first[part.clone()], self.joined.get_mut(part).unwrap_or_default()]
    }
}

/// Maximum number of layers of a stack.
const DEEPEST: usize = 256;

/// Rejects stacks with an invalid number of layers or units, or without a layer after `skip`; the error says which.
pub(crate) fn check_stack(depth: usize, width: usize, skip: Option<usize>) -> Result<(), String> {
    if !(1..=DEEPEST).contains(&depth) {
        return Err(format!("depth is {depth}; give a number of layers from 1 to {DEEPEST}"));
    }
    if !(1..=WIDEST).contains(&width) {
        return Err(format!("width is {width}; give a number from 1 to {WIDEST}"));
    }
    match skip {
        Some(skip) if skip >= depth - 1 => Err(format!(
            "skip is {skip}, but after that layer none of the {depth} is left to join; give a smaller one or \
             `skip: None`"
        )),
        _ => Ok(()),
    }
}
