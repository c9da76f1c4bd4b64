//! Splits: training, validation and test sets.
//!
//! A sample is a transmitter with all its links, so that links of a test transmitter never appear in training. Only
//! [`LeaveReceiverOut`] and [`RandomLinks`] split links.
//!
//! Dense trajectories have neighbours millimetres apart, so a random split tests interpolation over millimetres;
//! [`TimeBlock`], [`Voxel`] and [`Sparse`] are harder. Every split can hold out a `validation` share of its training
//! set by the same rule.

mod blocks;
mod fold;
mod links;
#[cfg(test)]
mod many_receivers;
mod random;
#[cfg(test)]
pub(crate) mod testing;

pub use blocks::{TimeBlock, Voxel};
pub use fold::Fold;
pub use links::{LeaveReceiverOut, RandomLinks};
pub use random::{Random, Sparse};

use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Result, Split};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Default share of the training set that is held out for validation.
const DEFAULT_VALIDATION: f64 = 0.1;

/// `share` of `n`, rounded; at least one if the share is positive, and never all.
fn part(share: f64, n: usize) -> usize {
    let target = (share * n as f64).round() as usize;
    target.max(usize::from(share > 0.0)).min(n.saturating_sub(1))
}

/// Moves a random `share` of `train` to a separate list: (train, validation).
fn hold_out(mut train: Vec<usize>, share: f64, rng: &mut Rng) -> (Vec<usize>, Vec<usize>) {
    if share == 0.0 {
        return (train, Vec::new());
    }
    rng::shuffle(rng, &mut train);
    let validation = train.split_off(train.len() - part(share, train.len()));
    (train, validation)
}

/// Transmitters of the given links, without repetition, in order.
fn transmitters(data: &Dataset, links: &[usize]) -> Vec<usize> {
    let mut seen = BTreeSet::new();
    links.iter().map(|i| data.links[*i].transmitter).filter(|t| seen.insert(*t)).collect()
}

/// Partition for lists of transmitters: all links of each, sorted; an error without training or test samples.
fn finish(data: &Dataset, train: Vec<usize>, validation: Vec<usize>, test: Vec<usize>) -> Result<Partition> {
    let Partition { train, validation, test } = finish_links(train, validation, test)?;
    let links = |transmitters: Vec<usize>| data.links_of(&transmitters);
    Ok(Partition { train: links(train), validation: links(validation), test: links(test) })
}

/// Partition for lists of links or samples, sorted; an error without training or test samples.
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

/// Returns an error for a validation share outside [0, 1).
fn check_validation(share: f64) -> Result<(), String> {
    if (0.0..1.0).contains(&share) {
        return Ok(());
    }
    Err(format!("`validation` is {share}; it is a share of the training part: use 0 for none, or a number below 1"))
}

/// Returns an error for a test share outside (0, 1).
fn check_test(name: &str, share: f64) -> Result<(), String> {
    if share > 0.0 && share < 1.0 {
        return Ok(());
    }
    Err(format!("`{name}` is {share}; it is a share of all samples: use a number between 0 and 1, such as 0.2"))
}

/// Split that comes with the data: `train_index.txt` and `test_index.txt` of the NeRF2 layout.
///
/// Use it to compare with published scores. Validation transmitters are drawn at random, with all their links. Samples
/// in neither list are ignored. The NeRF2 index files are random, so test samples lie 8 mm from a training sample:
/// compare every score with [`NearestNeighbours`](crate::NearestNeighbours).
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
