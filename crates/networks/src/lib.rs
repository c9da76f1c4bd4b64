//! Deformations `D_Θ` of eq. (5): what the transmitter's position changes.
//!
//! [`Mlp`] is the network of P-WRFGS, [`Wrfgs`] the one of its ancestor, [`Factored`] runs once a transmitter and not once
//! a Gaussian, [`Fixed`] is none. A network is a [`linear::Plan`] of tensors
//! in one flat vector of weights, [`linear::Linear`] layers that know where theirs lie, and passes over chunks whose points lie
//! next to each other ([`dense`]); [`trunk`] is the ReLU stack. NeRF2 has the same layers. Derivatives are written by hand.
//! Nothing is kept between calls: the derivative recomputes each chunk's activations while they fit the cache.

pub mod dense;
pub mod encoding;
mod factored;
mod factored_network;
pub mod linear;
mod mlp;
#[cfg(test)]
mod oracle;
#[cfg(test)]
mod tests;
pub mod trunk;
mod wrfgs;
mod wrfgs_branch;
mod wrfgs_network;

pub use encoding::Encoding;
pub use factored::Factored;
pub use mlp::{Mlp, Outputs};
pub use wrfgs::Wrfgs;

use pwrfgs_core::{Cache, Deformation, DeformationInputs, DeformationTraits, Deltas, JsonSchema, Real};
use serde::{Deserialize, Serialize};

/// No deformation: every transmitter sees the same Gaussians and the same signals. No weights, no settings.
///
/// Of use to fit a single spectrum, to test everything else, and as the floor below which no network may fall.
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
        DeformationTraits::default()
    }

    fn forward(&self, _: &DeformationInputs<'_>, _: &Cache) -> Deltas {
        Deltas::default()
    }

    fn vjp(&self, _: &DeformationInputs<'_>, _: &Deltas, _: &mut [Real], _: Option<&mut [[Real; 3]]>) {}
}
