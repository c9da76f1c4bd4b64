//! Splits: training, validation and test sets.
//!
//! A sample is a transmitter with all its links, so that links of a test transmitter never appear in training. Only
//! [`LeaveReceiverOut`] and [`RandomLinks`] split links.
//!
//! Dense trajectories have neighbours millimetres apart, so a random split tests interpolation over millimetres;
//! [`TimeBlock`], [`Voxel`] and [`Sparse`] are harder. Every split can hold out a `validation` share of its training
//! set by the same rule.

mod blocks;
mod links;
#[cfg(test)]
mod many_receivers;
#[cfg(test)]
pub(crate) mod testing;

pub use blocks::{TimeBlock, Voxel};
pub use links::{LeaveReceiverOut, RandomLinks};

use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Plugin, Result, Split};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Default share of the training set that is held out for validation.
const DEFAULT_VALIDATION: f64 = 0.1;

/// Returns the number of elements in a `share` of `n`, rounded; at least one if the share is positive, and never all.
fn share_count(share: f64, n: usize) -> usize {
    let target = (share * n as f64).round() as usize;
    target.max(usize::from(share > 0.0)).min(n.saturating_sub(1))
}

/// Moves a random `share` of `train` to the validation set: (training, validation). Shuffles both unless the share is 0.
fn hold_out(mut train: Vec<usize>, share: f64, rng: &mut Rng) -> (Vec<usize>, Vec<usize>) {
    if share == 0.0 {
        return (train, Vec::new());
    }
    rng::shuffle(rng, &mut train);
    let validation = train.split_off(train.len() - share_count(share, train.len()));
    (train, validation)
}

/// Returns `links` without all links of a random `share` of their transmitters, and those links: (training, validation).
fn hold_out_links(data: &Dataset, links: Vec<usize>, share: f64, rng: &mut Rng) -> (Vec<usize>, Vec<usize>) {
    let mut seen = BTreeSet::new();
    let transmitters = links.iter().map(|i| data.links[*i].location).filter(|t| seen.insert(*t)).collect();
    let (_, validation) = hold_out(transmitters, share, rng);
    let validation: BTreeSet<usize> = validation.into_iter().collect();
    links.into_iter().partition(|i| !validation.contains(&data.links[*i].location))
}

/// Returns a random partition of 0..n: `test` elements, a share `validation` of the others, and the training set.
fn random_partition(n: usize, test: usize, validation: f64, rng: &mut Rng) -> Partition {
    let mut shuffled: Vec<usize> = (0..n).collect();
    rng::shuffle(rng, &mut shuffled);
    let test = shuffled.split_off(n - test);
    let (train, validation) = hold_out(shuffled, validation, rng);
    Partition { train, validation, test }
}

/// Returns the partition of links from that of locations: all links of each, sorted. Returns an error if the training or
/// test set is empty.
fn partition_of_locations(data: &Dataset, lists: Partition) -> Result<Partition> {
    let Partition { train, validation, test } = sorted_partition(lists)?;
    let links = |transmitters: Vec<usize>| data.links_of(&transmitters);
    Ok(Partition { train: links(train), validation: links(validation), test: links(test) })
}

/// Returns the partition with sorted sets. Returns an error if the training or test set is empty.
fn sorted_partition(mut lists: Partition) -> Result<Partition> {
    let Partition { train, validation, test } = &mut lists;
    for (name, list) in [("training", &*train), ("test", &*test)] {
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
    Ok(lists)
}

/// Returns an error for a validation share outside [0, 1).
fn check_validation_share(share: f64) -> Result<(), String> {
    if (0.0..1.0).contains(&share) {
        return Ok(());
    }
    Err(format!("`validation` is {share}; it is a share of the training part: use 0 for none, or a number below 1"))
}

/// Returns an error for a test share outside (0, 1).
fn check_test_share(name: &str, share: f64) -> Result<(), String> {
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
        let (train, validation) = hold_out_links(data, train, self.validation, rng);
        sorted_partition(Partition { train, validation, test })
    }

    fn check(&self) -> Result<(), String> {
        check_validation_share(self.validation)
    }
}

/// Random share of the transmitters as the test set, with all links of each.
///
/// The usual split of this field, and the easiest: on a dense trajectory each test sample is close to a training
/// sample. Use [`TimeBlock`] or [`Voxel`] to test more than interpolation.
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
        let count = data.locations.len();
        partition_of_locations(data, random_partition(count, share_count(self.test, count), self.validation, rng))
    }

    fn check(&self) -> Result<(), String> {
        check_test_share("test", self.test)?;
        check_validation_share(self.validation)
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
        let count = data.locations.len();
        if self.train >= count {
            return Err(Error::Config(format!(
                "Sparse(train: {}) leaves no test sample: there are {count} samples; lower `train`",
                self.train
            )));
        }
        partition_of_locations(data, random_partition(count, count - self.train, self.validation, rng))
    }

    fn is_sparse(&self) -> bool {
        true
    }

    fn check(&self) -> Result<(), String> {
        if self.train == 0 {
            return Err("`train` is 0; use at least 1 training sample, such as 220".into());
        }
        check_validation_share(self.validation)
    }
}

/// Largest number of folds.
const MOST_FOLDS: usize = 100;

/// Fold of a cross-validation: the test set is that of another split. Its training and validation sets together are
/// divided into `count` folds; fold `index` becomes the validation set, and the others the training set.
///
/// A fold holds what the other split holds out together: transmitters at random, whole cells of `Voxel`, a part of the
/// trajectory for `TimeBlock`. Experiments with `join: true` and `residuals: Kriged(folds: true)` use this split, so that
/// every known sample is in the validation set of one model.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("Fold(of: Official(validation: 0.0), index: 3, count: 4)").is_ok());
/// assert!(Plugin::<dyn Split>::parse("Fold(index: 4, count: 4)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Fold {
    /// Split whose training set is divided.
    pub of: Plugin<dyn Split>,
    /// Fold that becomes the validation set, counted from 0.
    pub index: usize,
    /// Number of folds, 2 to 100.
    pub count: usize,
}

impl Default for Fold {
    fn default() -> Self {
        let outer: Box<dyn Split> = Box::new(Random::default());
        Self { of: outer.into(), index: 0, count: 4 }
    }
}

#[typetag::serde]
impl Split for Fold {
    /// Divides the units of the outer split into folds: in order for a trajectory, else at random.
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let outer = self.of.split(data, rng)?;
        let mut units = self.of.units(data, &outer.known().all());
        if units.len() < self.count {
            let problem = format!("the training set has {} parts, fewer than {} folds", units.len(), self.count);
            return Err(Error::Config(format!("Fold: {problem}; give more samples, or fewer models or folds")));
        }
        let (unit_count, is_in_order) = (units.len(), self.of.is_in_order());
        if !is_in_order {
            rng::shuffle(rng, &mut units); // the stream is the same for all folds
        }
        let fold_of = |unit: usize| if is_in_order { unit * self.count / unit_count } else { unit % self.count };
        let (mut train, mut validation) = (Vec::new(), Vec::new());
        for (unit, links) in units.into_iter().enumerate() {
            if fold_of(unit) == self.index { &mut validation } else { &mut train }.extend(links);
        }
        sorted_partition(Partition { train, validation, test: outer.test })
    }

    fn units(&self, data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        self.of.units(data, links)
    }

    fn blocks(&self, data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        self.of.blocks(data, links)
    }

    fn is_in_order(&self) -> bool {
        self.of.is_in_order()
    }

    fn is_sparse(&self) -> bool {
        self.of.is_sparse()
    }

    fn check_ready(&self) -> Result<()> {
        self.of.check_ready()
    }

    fn check(&self) -> Result<(), String> {
        if !(2..=MOST_FOLDS).contains(&self.count) {
            return Err(format!("`count` is {}; give 2 to {MOST_FOLDS} folds", self.count));
        }
        if self.index >= self.count {
            return Err(format!("`index` is {}; folds are counted from 0 to {}", self.index, self.count - 1));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::testing::line_of_samples;
    use super::*;
    use pwrfgs_core::rng;

    fn folds(outer: &str, data: &Dataset) -> Vec<Partition> {
        let outer = Plugin::<dyn Split>::parse(outer).unwrap();
        let fold = |index| Fold { of: outer.clone(), index, count: 4 };
        (0..4).map(|index| fold(index).split(data, &mut rng::stream(3, "split", 0)).unwrap()).collect()
    }

    #[test]
    fn folds_divide_the_known_samples_and_keep_the_test_set() {
        let data = line_of_samples(200);
        for outer in [
            "Random(test: 0.2)",
            "TimeBlock(start: 0.4, length: 0.2)",
            "Voxel(size_m: 5.0, test: 0.2)",
            "RandomLinks()",
        ] {
            let folds = folds(outer, &data);
            let whole =
                Plugin::<dyn Split>::parse(outer).unwrap().split(&data, &mut rng::stream(3, "split", 0)).unwrap();
            let mut held_out: Vec<usize> = folds.iter().flat_map(|fold| fold.validation.clone()).collect();
            held_out.sort_unstable();
            assert_eq!(held_out, whole.known().all(), "{outer}");
            for fold in &folds {
                assert_eq!((&fold.test, fold.known().all()), (&whole.test, whole.known().all()), "{outer}");
                assert!((20..60).contains(&fold.validation.len()), "{outer}: {:?}", fold.sizes());
            }
        }
    }

    /// Fewer blocks than transmitters for a trajectory; a fold has the blocks of its split.
    #[test]
    fn blocks_are_transmitters_cells_or_stretches_of_the_trajectory() {
        let (data, links) = (line_of_samples(200), (20..200).collect::<Vec<_>>());
        for (outer, count) in [("Random()", 180), ("Voxel(size_m: 5.0)", 36), ("TimeBlock()", 36)] {
            let fold = format!("Fold(of: {outer}, index: 0, count: 4)");
            for split in [outer, &fold].map(|text| Plugin::<dyn Split>::parse(text).unwrap()) {
                let blocks = split.blocks(&data, &links);
                assert_eq!((blocks.len(), blocks.concat()), (count, links.clone()), "{outer}");
            }
        }
    }

    #[test]
    fn folds_hold_whole_cells_and_parts_of_the_trajectory() {
        let data = line_of_samples(200);
        for fold in folds("Voxel(size_m: 5.0, test: 0.2)", &data) {
            let cells = |links: &[usize]| {
                links.iter().map(|&i| (data.sample(i).position()[0] / 5.0).floor() as i64).collect::<Vec<_>>()
            };
            let held_out = cells(&fold.validation);
            assert!(cells(&fold.train).iter().all(|cell| !held_out.contains(cell)));
        }
        for fold in folds("TimeBlock(start: 0.8, length: 0.2)", &data) {
            assert!(fold.validation.is_sorted_by(|a, b| b - a == 1), "{:?}", fold.validation);
        }
    }
}
