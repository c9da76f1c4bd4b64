//! Compressed model files.

use crate::Model;
use crate::file::{CONSTANTS, NETWORK, model_tensors};
use crate::tensors::SCALES;
use pwrfgs_core::{Error, Result};
use std::collections::BTreeSet;

/// Bits per network weight in a compressed file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bits {
    /// Integers with a scale per row.
    Eight,
    /// Half precision.
    Sixteen,
}

/// Returns the bytes of a model file with 8 or 16 bits per number; every reader of model files reads it.
///
/// Weights `[out, in]` of the network are I8 with a scale per row, or F16. Biases, Gaussians and training positions are
/// F16. Scales and tensors that the network does not learn stay as they are.
///
/// # Errors
/// A number exceeds the range of 16 bits.
pub fn to_bytes(model: &Model, bits: Bits) -> Result<Vec<u8>> {
    let mut file = model_tensors(model);
    let weights = model.stages.layout().weights;
    let named = |name: &str| format!("{NETWORK}{name}");
    let fixed: BTreeSet<String> = weights.iter().filter(|spec| !spec.learns).map(|spec| named(&spec.name)).collect();
    if bits == Bits::Eight {
        let matrices = weights.iter().filter(|spec| spec.shape.len() == 2 && spec.learns);
        matrices.for_each(|spec| file.round_to_bytes(&named(&spec.name)));
    }
    let is_whole = |name: &str| name.starts_with(CONSTANTS) || name.ends_with(SCALES) || fixed.contains(name);
    file.to_bytes_half(|name| !is_whole(name)).map_err(Error::Config)
}
