//! `Random`: every sample by a draw of its own.

use super::{DEFAULT_VALIDATION, check_test, check_validation, finish, hold_out, part};
use pwrfgs_core::{
    Dataset, JsonSchema, Partition, Result, Split,
    rng::{self, Rng},
};
use serde::{Deserialize, Serialize};

/// A random share of the transmitters is the test set, with all links of each.
///
/// The usual split of this field, and the easiest: with a dense trajectory each test sample has a training sample
/// beside it. Use [`TimeBlock`](crate::TimeBlock) or [`Voxel`](crate::Voxel) to ask for more than interpolation.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("Random(test: 0.2, validation: 0.1)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Random {
    /// Share of all samples in the test set, in (0, 1).
    pub test: f64,
    /// Share of the others held out at random, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for Random {
    fn default() -> Self {
        Self { test: 0.2, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for Random {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let mut all: Vec<usize> = (0..data.transmitters.len()).collect();
        rng::shuffle(rng, &mut all);
        let test = all.split_off(all.len() - part(self.test, all.len()));
        let (train, validation) = hold_out(all, self.validation, rng);
        finish(data, train, validation, test)
    }

    fn check(&self) -> Result<(), String> {
        check_test("test", self.test)?;
        check_validation(self.validation)
    }
}
