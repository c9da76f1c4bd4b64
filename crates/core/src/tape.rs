//! The step's autodiff tape (dfdx), and the one way to put a hand-written kernel on it.
//!
//! A pruner writes forward formulas on [`Trace`]s and gets their derivatives. Heavy stages are [`op`]s: a forward value
//! computed outside and a vector-Jacobian product called when the gradients run back.

use crate::{GaussianCloud, Real};
use dfdx::prelude::{
    Cpu, HasShape, Merge, OwnedTape, PutTape, SplitTape, Tape as _, Tensor, TensorFromVec, Trace as _,
};
use dfdx::tensor::Gradients;

/// A vector `[n]` on the step's tape.
pub type Trace = Tensor<(usize,), Real, Cpu, OwnedTape<Real, Cpu>>;
/// A number on the step's tape.
pub type TraceScalar = Tensor<(), Real, Cpu, OwnedTape<Real, Cpu>>;
/// A vector `[n]` that is not differentiated, or the leaf whose gradient is asked for.
pub type Leaf = Tensor<(usize,), Real, Cpu>;

/// The columns of a cloud as leaves of the tape; what [`crate::Pruner::gate`] and [`crate::Pruner::penalty`] see.
pub struct Traced {
    device: Cpu,
    len: usize,
    columns: Vec<(String, Leaf)>,
}

impl std::fmt::Debug for Traced {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Traced").field("len", &self.len).finish_non_exhaustive()
    }
}

impl Traced {
    /// Every column of `cloud` becomes a leaf.
    pub fn new(cloud: &GaussianCloud) -> Self {
        let device = Cpu::default();
        let columns = cloud
            .columns()
            .map(|(name, _, values)| (name.to_owned(), device.tensor_from_vec(values.to_vec(), (values.len(),))))
            .collect();
        Self { device, len: cloud.len(), columns }
    }

    /// N.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Names of the columns.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.columns.iter().map(|(name, _)| name.as_str())
    }

    /// The leaf of column `name`, row-major `[N · width]`.
    ///
    /// # Panics
    /// Where no such column exists: a pruner may only name fixed columns and those of its own `columns()`.
    pub fn leaf(&self, name: &str) -> &Leaf {
        &self.columns.iter().find(|(n, _)| n == name).unwrap_or_else(|| panic!("no column `{name}`")).1
    }

    /// Column `name` on the tape: derivatives taken of it reach the cloud.
    pub fn column(&self, name: &str) -> Trace {
        self.leaf(name).leaky_trace()
    }

    /// Opacities o = σ(logit), `[N]`, on the tape.
    pub fn opacities(&self) -> Trace {
        self.column("opacity_logits").sigmoid()
    }

    /// Numbers that are not differentiated.
    pub fn constant(&self, values: Vec<Real>) -> Leaf {
        let n = values.len();
        self.device.tensor_from_vec(values, (n,))
    }

    /// The device of all tensors.
    pub fn device(&self) -> &Cpu {
        &self.device
    }

    /// The straight-through gate of eq. (11): forward 1[score ≥ threshold], derivative of the identity.
    pub fn straight_through(&self, score: Trace, threshold: Real) -> Trace {
        let soft = values(&score);
        let shift = soft.iter().map(|s| Real::from(u8::from(*s >= threshold)) - s).collect();
        score + self.constant(shift)
    }
}

/// The numbers of a vector. dfdx's own `as_vec` panics on one of length 0, such as the weights of no network.
pub fn values<T>(vector: &Tensor<(usize,), Real, Cpu, T>) -> Vec<Real> {
    if vector.shape().0 == 0 { Vec::new() } else { vector.as_vec() }
}

/// Puts a kernel on the tape: `outputs` are its values for `inputs`; `vjp` turns the cotangents of the outputs into
/// those of the inputs (one vector an input, same lengths).
pub fn op(
    inputs: Vec<Trace>,
    outputs: Vec<Vec<Real>>,
    vjp: impl FnOnce(Vec<Vec<Real>>) -> Vec<Vec<Real>> + 'static,
) -> Vec<Trace> {
    let device = Cpu::default();
    let mut tape = OwnedTape::default();
    let leaves: Vec<Leaf> = inputs
        .into_iter()
        .map(|input| {
            let (leaf, its_tape) = input.split_tape();
            tape = std::mem::take(&mut tape).merge(its_tape);
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
    // The tape goes with the first output; the others join it where they meet again.
    let mut tape = Some(tape);
    outputs.into_iter().map(|out| out.put_tape(tape.take().unwrap_or_default())).collect()
}

/// What a pruner multiplies Gaussians by: a factor `[N]` while training, on the step's tape.
#[allow(missing_debug_implementations)] // a tape has no use as text
pub enum Gate {
    /// On opacity and scale. A Gaussian whose factor is 0 is left out of the step: it costs nothing and has no derivative.
    /// What `factor.into()` gives.
    Whole(Trace),
    /// On the light that it takes, and on nothing else: γ = M·min(0.99, o·G). A Gaussian whose factor is 0 takes part in
    /// the derivative still, so that it can come back.
    Presence(Trace),
}

impl Gate {
    /// The factor, whatever it is on.
    pub fn factor(self) -> Trace {
        match self {
            Self::Whole(factor) | Self::Presence(factor) => factor,
        }
    }
}

impl From<Trace> for Gate {
    fn from(factor: Trace) -> Self {
        Self::Whole(factor)
    }
}
