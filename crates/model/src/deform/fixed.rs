//! `Fixed`: no deformation at all.

use pwrfgs_core::{Conditions, Deformation, DeformationInputs, Deltas, Documented, Pose, Real};
use serde::{Deserialize, Serialize};

/// No deformation: every transmitter sees the same Gaussians and the same signals. No weights, no settings.
///
/// Of use to fit a single spectrum, to test everything else, and as the floor below which no network may fall.
///
/// ```
/// use pwrfgs_core::{Deformation, Plugin};
/// # use pwrfgs_model as _;
/// let none = Plugin::<dyn Deformation>::parse("Fixed()").unwrap();
/// assert!(none.layout().is_empty());
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct Fixed {}

#[typetag::serde]
impl Deformation for Fixed {
    fn varies_geometry(&self) -> bool {
        false
    }

    fn forward(&self, _: &[Real], _: &[[Real; 3]], _: Conditions<'_>, _: &Pose) -> Deltas {
        Deltas::default()
    }

    fn vjp(&self, _: &DeformationInputs<'_>, _: &Deltas, _: &mut [Real], _: Option<&mut [[Real; 3]]>) {}
}
