//! `Random` and `Sparse`: random splits, with many or few training transmitters.

use super::{DEFAULT_VALIDATION, check_test, check_validation, finish, hold_out, part};
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Result, Split};
use serde::{Deserialize, Serialize};

/// Random share of the transmitters as the test set, with all links of each.
///
/// The usual split of this field, and the easiest: on a dense trajectory each test sample is close to a training
/// sample. Use [`TimeBlock`](crate::TimeBlock) or [`Voxel`](crate::Voxel) to test more than interpolation.
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
    /// Share of the remaining samples held out at random, in [0, 1); 0 for none.
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

/// Fixed number of random training transmitters with all their links; all others are the test set.
///
/// Tests learning from few measurements: with 220 of the NeRF2 spectra the nearest training sample is 6 cm away.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("Sparse(train: 220)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Sparse {
    /// Number of training samples, including those held out for validation.
    pub train: usize,
    /// Share of `train` held out at random, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for Sparse {
    fn default() -> Self {
        Self { train: 220, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for Sparse {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let count = data.transmitters.len();
        if self.train >= count {
            return Err(Error::Config(format!(
                "Sparse(train: {}) leaves no test sample: there are {count} samples; lower `train`",
                self.train
            )));
        }
        let mut all: Vec<usize> = (0..count).collect();
        rng::shuffle(rng, &mut all);
        let test = all.split_off(self.train);
        let (train, validation) = hold_out(all, self.validation, rng);
        finish(data, train, validation, test)
    }

    fn is_sparse(&self) -> bool {
        true
    }

    fn check(&self) -> Result<(), String> {
        if self.train == 0 {
            return Err("`train` is 0; use at least 1 training sample, such as 220".into());
        }
        check_validation(self.validation)
    }
}
