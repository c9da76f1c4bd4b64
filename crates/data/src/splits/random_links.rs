//! `RandomLinks`: every link by a draw of its own.

use super::{DEFAULT_VALIDATION, check_test, check_validation, finish_links, hold_out, part};
use pwrfgs_core::{
    Dataset, JsonSchema, Partition, Result, Split,
    rng::{self, Rng},
};
use serde::{Deserialize, Serialize};

/// A random share of the links is the test set: most transmitters are then in training and test, at different receivers.
///
/// Asks what a receiver hears of a transmitter that others heard. With one receiver it is [`Random`](crate::Random).
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("RandomLinks(test: 0.2, validation: 0.1)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RandomLinks {
    /// Share of all links in the test set, in (0, 1).
    pub test: f64,
    /// Share of the others held out at random, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for RandomLinks {
    fn default() -> Self {
        Self { test: 0.2, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for RandomLinks {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let mut all: Vec<usize> = (0..data.len()).collect();
        rng::shuffle(rng, &mut all);
        let test = all.split_off(all.len() - part(self.test, all.len()));
        let (train, validation) = hold_out(all, self.validation, rng);
        finish_links(train, validation, test)
    }

    fn check(&self) -> Result<(), String> {
        check_test("test", self.test)?;
        check_validation(self.validation)
    }
}
