//! `TimeBlock`: a stretch of the trajectory is the test set.

use super::{DEFAULT_VALIDATION, check_test, check_validation, finish, part};
use pwrfgs_core::{Dataset, JsonSchema, Partition, Result, Split, rng::Rng};
use serde::{Deserialize, Serialize};

/// A contiguous block of the sorted ids of transmitters is the test set, with all links of each.
///
/// Ids follow the trajectory, so this holds out a stretch of it: most test samples are centimetres from training
/// samples, not millimetres. Validation is a block too: the ids right behind the test block, and where these do not
/// suffice, the ids right before it.
///
/// At the ends of the block consecutive ids are neighbours again. `gap` leaves out the samples on both sides of it: they
/// serve neither part. `docs/data.md` says what a gap changes on measured spectra; `samples.csv` lists every distance.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("TimeBlock(start: 0.4, length: 0.2, gap: 30)").is_ok());
/// assert!(Plugin::<dyn Split>::parse("TimeBlock(start: 0.9, length: 0.2)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TimeBlock {
    /// Where the test block begins, a fraction of the sorted ids in [0, 1).
    pub start: f64,
    /// Length of the test block, a fraction of the sorted ids in (0, 1).
    pub length: f64,
    /// Samples left out on either side of the test block.
    pub gap: usize,
    /// Share of the others held out next to the test block, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for TimeBlock {
    fn default() -> Self {
        Self { start: 0.4, length: 0.2, gap: 0, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for TimeBlock {
    fn split(&self, data: &Dataset, _: &mut Rng) -> Result<Partition> {
        let count = data.transmitters.len();
        let length = part(self.length, count);
        let first = ((self.start * count as f64).round() as usize).min(count - length);
        let test = first..first + length;
        // What lies before the block and behind it, without the gaps.
        let (low, high) = (first.saturating_sub(self.gap), test.end.saturating_add(self.gap).min(count));
        let held = part(self.validation, low + count - high);
        let behind = held.min(count - high);
        let before = held - behind;
        let train = (0..low - before).chain(high + behind..count).collect();
        let validation = (low - before..low).chain(high..high + behind).collect();
        finish(data, train, validation, test.collect())
    }

    fn check(&self) -> Result<(), String> {
        if !(0.0..1.0).contains(&self.start) {
            return Err(format!(
                "`start` is {}; it is a fraction of the sorted ids: use a number from 0 to below 1",
                self.start
            ));
        }
        check_test("length", self.length)?;
        if self.start + self.length > 1.0 + 1e-9 {
            let end = self.start + self.length;
            return Err(format!(
                "`start` + `length` is {end}; the block must end at 1 at the latest: lower one of them"
            ));
        }
        check_validation(self.validation)
    }
}
