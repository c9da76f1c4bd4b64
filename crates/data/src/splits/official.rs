//! `Official`: the split that comes with the data.

use super::{DEFAULT_VALIDATION, check_validation, finish_links, hold_out, transmitters};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Result, Split, rng::Rng};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The split that comes with the data: `train_index.txt` and `test_index.txt` of the NeRF2 layout.
///
/// Validation is drawn over transmitters, with all links of each. Use it to compare with published figures. Samples that neither list names are left out. The index files of the
/// NeRF2 spectra are random, so their test samples lie 8 mm from a training sample: read every score beside
/// [`NearestNeighbours`](crate::NearestNeighbours).
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("Official(validation: 0.1)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Official {
    /// Share of the training list held out at random, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for Official {
    fn default() -> Self {
        Self { validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for Official {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let Some((train, test)) = data.official.clone() else {
            return Err(Error::Config(format!(
                "{} comes without a split of its own (train_index.txt and test_index.txt); \
                 use Random(), TimeBlock(), Voxel() or Sparse()",
                data.title
            )));
        };
        let (_, held) = hold_out(transmitters(data, &train), self.validation, rng);
        let held: BTreeSet<usize> = held.into_iter().collect();
        let (validation, train) = train.into_iter().partition(|i| held.contains(&data.links[*i].transmitter));
        finish_links(train, validation, test)
    }

    fn check(&self) -> Result<(), String> {
        check_validation(self.validation)
    }
}
