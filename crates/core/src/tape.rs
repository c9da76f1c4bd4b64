//! Autodiff tape of a step (dfdx), and the function that adds a hand-written kernel to it.
//!
//! A pruner writes forward formulas on [`Trace`]s and obtains their derivatives. Expensive stages are [`op`]s: a
//! forward value computed outside the tape, and a vector-Jacobian product called in the backward pass.

use crate::{GaussianCloud, Real};
use dfdx::prelude::{
    Cpu, HasShape, Merge, OwnedTape, PutTape, SplitTape, Tape as _, Tensor, TensorFromVec, Trace as _,
};
use dfdx::tensor::Gradients;

/// Vector `[n]` on the tape of the step.
pub type Trace = Tensor<(usize,), Real, Cpu, OwnedTape<Real, Cpu>>;
/// Scalar on the tape of the step.
pub type TraceScalar = Tensor<(), Real, Cpu, OwnedTape<Real, Cpu>>;
/// Vector `[n]` outside the tape: a constant, or a leaf whose gradient is requested.
pub type Leaf = Tensor<(usize,), Real, Cpu>;

/// Columns of a cloud as leaves of the tape, for [`crate::Pruner::gate`] and [`crate::Pruner::penalty`].
pub struct TracedCloud {
    device: Cpu,
    len: usize,
    columns: Vec<(String, Leaf)>,
}

impl std::fmt::Debug for TracedCloud {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TracedCloud").field("len", &self.len).finish_non_exhaustive()
    }
}

impl TracedCloud {
    /// Makes every column of `cloud` a leaf.
    pub fn new(cloud: &GaussianCloud) -> Self {
        let device = Cpu::default();
        let columns = cloud
            .columns()
            .map(|(name, _, values)| (name.to_owned(), device.tensor_from_vec(values.to_vec(), (values.len(),))))
            .collect();
        Self { device, len: cloud.len(), columns }
    }

    /// Returns the number of Gaussians N.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Returns the names of the columns.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|(name, _)| name.as_str())
    }

    /// Returns the leaf of column `name`, row-major `[N · width]`.
    ///
    /// # Panics
    /// If the column does not exist: a pruner may only name standard columns and its own.
    pub fn leaf(&self, name: &str) -> &Leaf {
        &self.columns.iter().find(|(n, _)| n == name).unwrap_or_else(|| panic!("no column `{name}`")).1
    }

    /// Returns column `name` on the tape: its derivatives reach the cloud.
    ///
    /// # Panics
    /// As [`Self::leaf`].
    pub fn column(&self, name: &str) -> Trace {
        self.leaf(name).leaky_trace()
    }

    /// Returns opacities o = σ(logit), `[N]`, on the tape.
    pub fn opacities(&self) -> Trace {
        self.column("opacity_logits").sigmoid()
    }

    /// Creates constants, which are not differentiated.
    pub fn constant(&self, values: Vec<Real>) -> Leaf {
        let n = values.len();
        self.device.tensor_from_vec(values, (n,))
    }

    /// Returns the device of all tensors.
    pub fn device(&self) -> &Cpu {
        &self.device
    }

    /// Computes the straight-through gate, eq. (11): forward 1[score ≥ threshold], derivative of the identity.
    pub fn straight_through(&self, score: Trace, threshold: Real) -> Trace {
        let soft = values(&score);
        let shift = soft.iter().map(|s| Real::from(u8::from(*s >= threshold)) - s).collect();
        score + self.constant(shift)
    }
}

/// Returns the values of a vector. dfdx's own `as_vec` panics for length 0, such as the weights without a network.
pub fn values<T>(vector: &Tensor<(usize,), Real, Cpu, T>) -> Vec<Real> {
    if vector.shape().0 == 0 { Vec::new() } else { vector.as_vec() }
}

/// Values of several vectors, one list per vector.
pub type Vectors = Vec<Vec<Real>>;

/// Adds a kernel to the tape: `outputs` are its values for `inputs`; `vjp` converts the cotangents of the outputs to
/// those of the inputs: one vector per input, of its length.
///
/// # Panics
/// In the backward pass, if a cotangent from `vjp` differs in length from its input.
pub fn op(inputs: Vec<Trace>, outputs: Vectors, vjp: impl FnOnce(Vectors) -> Vectors + 'static) -> Vec<Trace> {
    let device = Cpu::default();
    let mut tape = OwnedTape::default();
    let leaves: Vec<Leaf> = inputs
        .into_iter()
        .map(|input| {
            let (leaf, input_tape) = input.split_tape();
            tape = std::mem::take(&mut tape).merge(input_tape);
            leaf
        })
        .collect();
    let outputs: Vec<Leaf> = outputs
        .into_iter()
        .map(|values| {
            let n = values.len();
            device.tensor_from_vec(values, (n,))
        })
        .collect();
    let slots = outputs.clone(); // a clone keeps the identity, hence the gradient slot
    tape.add_backward_op(move |gradients: &mut Gradients<Real, Cpu>| {
        let mut cotangents = Vec::with_capacity(slots.len());
        for slot in &slots {
            cotangents.push(gradients.get_or_alloc_mut(slot)?.to_vec());
        }
        for (leaf, d) in leaves.iter().zip(vjp(cotangents)) {
            let sum = gradients.get_or_alloc_mut(leaf)?;
            assert_eq!(sum.len(), d.len(), "a cotangent has the length of its input");
            sum.iter_mut().zip(d).for_each(|(s, d)| *s += d);
        }
        Ok(())
    });
    // The tape continues with the first output; the others join it when they are combined.
    let mut tape = Some(tape);
    outputs.into_iter().map(|out| out.put_tape(tape.take().unwrap_or_default())).collect()
}

/// Factor `[N]` of a pruner on Gaussians during training, on the tape of the step.
#[allow(missing_debug_implementations)] // a tape has no use as text
pub enum Gate {
    /// Factor on opacity and scale. A Gaussian with factor 0 is skipped in the step: it has no cost and no derivative.
    /// Result of `factor.into()`.
    Whole(Trace),
    /// Factor on the opacity γ at each pixel only: γ = M·min(0.99, o·G). A Gaussian with factor 0 still receives a derivative,
    /// so that it can come back.
    Existence(Trace),
}

impl Gate {
    /// Returns the factor of either variant.
    pub fn factor(self) -> Trace {
        match self {
            Self::Whole(factor) | Self::Existence(factor) => factor,
        }
    }

    /// Returns `true` for each Gaussian whose gate is open: its factor is not 0, `[N]`.
    pub fn open_mask(self) -> Vec<bool> {
        values(&self.factor()).into_iter().map(|factor| factor != 0.0).collect()
    }
}

impl From<Trace> for Gate {
    fn from(factor: Trace) -> Self {
        Self::Whole(factor)
    }
}
