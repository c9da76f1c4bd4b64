//! Compressed model files.

use crate::Ensemble;
use crate::file::{CONSTANTS, NETWORK, model_prefixes, predictor_tensors};
use crate::residuals::RESIDUALS;
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
/// Weights `[out, in]` of networks are I8 with a scale per row, or F16. Biases, Gaussians and training positions are F16. Scales,
/// constants, residual processes and tensors that a network does not learn stay as they are. The calibration of intervals
/// is left out, since it is that of the exact predictions.
///
/// # Errors
/// A number exceeds the range of 16 bits.
pub fn to_bytes(ensemble: &Ensemble, bits: Bits) -> Result<Vec<u8>> {
    let mut file = predictor_tensors(ensemble);
    let mut fixed = BTreeSet::new();
    for (prefix, model) in model_prefixes(ensemble) {
        for spec in model.stages.layout().weights {
            let name = format!("{prefix}{NETWORK}{}", spec.name);
            if !spec.learns {
                fixed.insert(name);
            } else if bits == Bits::Eight && spec.shape.len() == 2 {
                file.round_to_bytes(&name);
            }
        }
    }
    let is_whole = |name: &str| {
        name.contains(CONSTANTS) || name.starts_with(RESIDUALS) || name.ends_with(SCALES) || fixed.contains(name)
    };
    file.to_bytes_half(|name| !is_whole(name)).map_err(Error::Config)
}
