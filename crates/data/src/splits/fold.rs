//! `Fold`: one fold of a cross-validation within the training set of another split.

use super::{Random, finish_links};
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Plugin, Result, Split};
use serde::{Deserialize, Serialize};

/// Largest number of folds.
const MOST_FOLDS: usize = 100;

/// Fold of a cross-validation: the test set is that of another split. Its training and validation sets together are
/// divided into `count` folds; fold `index` becomes the validation set, and the others the training set.
///
/// A fold holds what the other split holds out together: transmitters at random, whole cells of `Voxel`, a part of the
/// trajectory for `TimeBlock`. Experiments with `join: true` and `residuals: Kriged(folds: true)` use this split, so that every known sample is
/// in the validation set of one model.
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
        let of: Box<dyn Split> = Box::new(Random::default());
        Self { of: of.into(), index: 0, count: 4 }
    }
}

#[typetag::serde]
impl Split for Fold {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let outer = self.of.split(data, rng)?;
        let mut units = self.of.units(data, &outer.known().all());
        if units.len() < self.count {
            let what = format!("the training set has {} parts, fewer than {} folds", units.len(), self.count);
            return Err(Error::Config(format!("Fold: {what}; give more samples, or fewer models or folds")));
        }
        let (parts, in_order) = (units.len(), self.of.is_in_order());
        if !in_order {
            rng::shuffle(rng, &mut units); // the stream is the same for all folds
        }
        let fold_of = |unit: usize| if in_order { unit * self.count / parts } else { unit % self.count };
        let (mut train, mut validation) = (Vec::new(), Vec::new());
        for (unit, links) in units.into_iter().enumerate() {
            if fold_of(unit) == self.index { &mut validation } else { &mut train }.extend(links);
        }
        finish_links(train, validation, outer.test)
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

    fn ready(&self) -> Result<()> {
        self.of.ready()
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
    use super::super::testing::line_of_samples;
    use super::*;
    use pwrfgs_core::rng;

    fn folds(of: &str, data: &Dataset) -> Vec<Partition> {
        let of = Plugin::<dyn Split>::parse(of).unwrap();
        let fold = |index| Fold { of: of.clone(), index, count: 4 };
        (0..4).map(|index| fold(index).split(data, &mut rng::stream(3, "split", 0)).unwrap()).collect()
    }

    #[test]
    fn folds_divide_the_known_samples_and_keep_the_test_set() {
        let data = line_of_samples(200);
        for of in [
            "Random(test: 0.2)",
            "TimeBlock(start: 0.4, length: 0.2)",
            "Voxel(size_m: 5.0, test: 0.2)",
            "RandomLinks()",
        ] {
            let folds = folds(of, &data);
            let whole = Plugin::<dyn Split>::parse(of).unwrap().split(&data, &mut rng::stream(3, "split", 0)).unwrap();
            let mut all: Vec<usize> = folds.iter().flat_map(|fold| fold.validation.clone()).collect();
            all.sort_unstable();
            assert_eq!(all, whole.known().all(), "{of}");
            for fold in &folds {
                assert_eq!((&fold.test, fold.known().all()), (&whole.test, whole.known().all()), "{of}");
                assert!((20..60).contains(&fold.validation.len()), "{of}: {:?}", fold.sizes());
            }
        }
    }

    /// Fewer blocks than transmitters for a trajectory; a fold has the blocks of its split.
    #[test]
    fn blocks_are_transmitters_cells_or_stretches_of_the_trajectory() {
        let (data, links) = (line_of_samples(200), (20..200).collect::<Vec<_>>());
        for (of, count) in [("Random()", 180), ("Voxel(size_m: 5.0)", 36), ("TimeBlock()", 36)] {
            let fold = format!("Fold(of: {of}, index: 0, count: 4)");
            for split in [of, &fold].map(|text| Plugin::<dyn Split>::parse(text).unwrap()) {
                let blocks = split.blocks(&data, &links);
                assert_eq!((blocks.len(), blocks.concat()), (count, links.clone()), "{of}");
            }
        }
    }

    #[test]
    fn folds_hold_whole_cells_and_parts_of_the_trajectory() {
        let data = line_of_samples(200);
        for fold in folds("Voxel(size_m: 5.0, test: 0.2)", &data) {
            let cells = |links: &[usize]| {
                links.iter().map(|&i| (data.sample(i).tx[0] / 5.0).floor() as i64).collect::<Vec<_>>()
            };
            let held = cells(&fold.validation);
            assert!(cells(&fold.train).iter().all(|cell| !held.contains(cell)));
        }
        for fold in folds("TimeBlock(start: 0.8, length: 0.2)", &data) {
            assert!(fold.validation.is_sorted_by(|a, b| b - a == 1), "{:?}", fold.validation);
        }
    }
}
