//! Deformation networks `D_Θ` of eq. (5), which model the effect of the transmitter position.
//!
//! [`Mlp`] is the network of P-WRFGS and [`Wrfgs`] that of WRF-GS. [`Factored`] runs once per transmitter instead of
//! once per Gaussian, and [`Fixed`] has no network. A network is a [`linear::LayoutBuilder`] of tensors in one flat weight
//! vector, [`linear::Linear`] layers with their offsets, and passes over chunks of contiguous points ([`dense`]);
//! [`trunk`] is the ReLU stack. NeRF2 uses the same layers. Derivatives are written by hand. The backward
//! pass recomputes the activations of each chunk, unless `Mlp` kept them within `KEPT_BYTES`.

pub mod dense;
pub mod encoding;
mod factored;
mod factored_network;
mod factored_vjp;
#[cfg(feature = "gpu")]
#[cfg(test)]
mod gpu_tests;
pub mod linear;
mod mlp;
mod mlp_branch;
mod near;
#[cfg(test)]
mod oracle;
mod relu_rows;
#[cfg(test)]
mod tests;
pub mod trunk;
mod wave_mixture;
mod wrfgs;
mod wrfgs_branch;
mod wrfgs_network;

pub use encoding::Encoding;
pub use factored::Factored;
#[cfg(feature = "gpu")]
pub use mlp::gpu::resident::{ResidentMlp, ResidentSlots};
pub use mlp::{Mlp, Outputs};
pub use near::Near;
pub use wrfgs::Wrfgs;

use pwrfgs_core::{Cache, Deformation, DeformationInputs, DeformationTraits, DeformationVjp, Deltas, JsonSchema};
use serde::{Deserialize, Serialize};

/// Rejects factors on the carrier that are negative, NaN, or above 100, such as a frequency in MHz.
fn check_carrier(carrier: f64) -> Result<(), String> {
    if (0.0..=100.0).contains(&carrier) {
        return Ok(());
    }
    Err(format!("carrier is {carrier}; give a factor from 0 to 100, such as 2, or 0 to ignore the carrier"))
}

/// No deformation: geometry and signals are equal for all transmitters. No weights, no settings.
///
/// Use it to fit a single spectrum, for tests, and as the baseline for all networks.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_networks as _;
/// let none = Plugin::<dyn Deformation>::parse("Fixed()").unwrap();
/// assert!(none.layout().weights.is_empty());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Fixed {}

#[typetag::serde]
impl Deformation for Fixed {
    fn traits(&self) -> DeformationTraits {
        DeformationTraits { differentiates_positions: true, ..DeformationTraits::default() }
    }

    fn forward(&self, _: &DeformationInputs<'_>, _: &Cache) -> Deltas {
        Deltas::default()
    }

    fn vjp(&self, _: &DeformationInputs<'_>, _: &Deltas, _: DeformationVjp<'_>) {}
}
