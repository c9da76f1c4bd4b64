//! Splits: which samples are learned from, looked at while choosing, and read once at the end.
//!
//! A sample is a transmitter with all its links, so that what one receiver heard of it says nothing about the others in
//! the test; only [`LeaveReceiverOut`] and [`RandomLinks`] divide links.
//!
//! On this kind of data neighbours are millimetres apart, so a random split asks for interpolation over millimetres;
//! [`TimeBlock`], [`Voxel`] and [`Sparse`] ask for more. Every split can hold out a `validation` share of its training
//! part by its own rule.

mod blocks;
mod links;
#[cfg(test)]
mod many_receivers;
mod random;
#[cfg(test)]
pub(crate) mod testing;

pub use blocks::{TimeBlock, Voxel};
pub use links::{LeaveReceiverOut, RandomLinks};
pub use random::{Random, Sparse};

use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Result, Split};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Share of the training part that a split holds out unless told otherwise.
const DEFAULT_VALIDATION: f64 = 0.1;

/// `share` of `n`, rounded, but at least one where the share is positive, and never all.
fn part(share: f64, n: usize) -> usize {
    let wanted = (share * n as f64).round() as usize;
    wanted.max(usize::from(share > 0.0)).min(n.saturating_sub(1))
}

/// Moves a random `share` of `train` to a list of its own: (train, validation).
fn hold_out(mut train: Vec<usize>, share: f64, rng: &mut Rng) -> (Vec<usize>, Vec<usize>) {
    if share == 0.0 {
        return (train, Vec::new());
    }
    rng::shuffle(rng, &mut train);
    let validation = train.split_off(train.len() - part(share, train.len()));
    (train, validation)
}

/// The transmitters of some links, each once, in the order in which they come.
fn transmitters(data: &Dataset, links: &[usize]) -> Vec<usize> {
    let mut seen = BTreeSet::new();
    links.iter().map(|i| data.links[*i].transmitter).filter(|t| seen.insert(*t)).collect()
}

/// The partition of lists of transmitters: all links of each, sorted; refuses one without training or test samples.
fn finish(data: &Dataset, train: Vec<usize>, validation: Vec<usize>, test: Vec<usize>) -> Result<Partition> {
    let Partition { train, validation, test } = finish_links(train, validation, test)?;
    let links = |transmitters: Vec<usize>| data.links_of(&transmitters);
    Ok(Partition { train: links(train), validation: links(validation), test: links(test) })
}

/// The partition of lists of links (or whatever is counted), sorted; refuses one without training or test samples.
fn finish_links(mut train: Vec<usize>, mut validation: Vec<usize>, mut test: Vec<usize>) -> Result<Partition> {
    for (name, list) in [("training", &train), ("test", &test)] {
        if list.is_empty() {
            return Err(Error::Config(format!(
                "the split leaves no {name} sample of {} in all; change its shares or give more samples",
                train.len() + validation.len() + test.len()
            )));
        }
    }
    train.sort_unstable();
    validation.sort_unstable();
    test.sort_unstable();
    Ok(Partition { train, validation, test })
}

/// Refuses a validation share outside [0, 1).
fn check_validation(share: f64) -> Result<(), String> {
    if (0.0..1.0).contains(&share) {
        return Ok(());
    }
    Err(format!("`validation` is {share}; it is a share of the training part: use 0 for none, or a number below 1"))
}

/// Refuses a test share outside (0, 1).
fn check_test(name: &str, share: f64) -> Result<(), String> {
    if share > 0.0 && share < 1.0 {
        return Ok(());
    }
    Err(format!("`{name}` is {share}; it is a share of all samples: use a number between 0 and 1, such as 0.2"))
}

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
