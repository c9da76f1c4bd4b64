//! `Fixed`: no deformation at all.

use pwrfgs_core::{Cache, Deformation, DeformationInputs, DeformationTraits, Deltas, JsonSchema, Real};
use serde::{Deserialize, Serialize};

/// No deformation: every transmitter sees the same Gaussians and the same signals. No weights, no settings.
///
/// Of use to fit a single spectrum, to test everything else, and as the floor below which no network may fall.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_model as _;
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
