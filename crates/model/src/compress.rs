//! Compressed model files.

use crate::Model;
use crate::file::{CONSTANTS, NETWORK, tensors};
use crate::tensors::Stored;
use pwrfgs_core::{Error, Result};

/// Returns the bytes of a model file with 8 or 16 bits per number; every reader of model files reads it.
///
/// Weights `[out, in]` of the network are I8 with a scale per row, or F16. Biases, Gaussians and training positions are
/// F16. Tensors that the network does not learn stay as they are.
///
/// # Errors
/// A number exceeds the range of 16 bits.
pub fn to_bytes(model: &Model, bits: Bits) -> Result<Vec<u8>> {
    let layout = model.stages.layout();
    let stored = |name: &str| {
        let spec = name.strip_prefix(NETWORK).and_then(|name| layout.weights.iter().find(|spec| spec.name == name));
        match spec {
            _ if name.starts_with(CONSTANTS) => Stored::Whole,
            Some(spec) if spec.fixed => Stored::Whole,
            Some(spec) if spec.shape.len() == 2 && bits == Bits::Eight => Stored::Byte,
            _ => Stored::Half,
        }
    };
    tensors(model).to_bytes_as(stored).map_err(Error::Config)
}

/// Bits per network weight in a compressed file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    /// Integers with a scale per row.
    Eight,
    /// Half precision.
    Sixteen,
}
