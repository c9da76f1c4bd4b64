//! Small data sets for tests, and properties that every split must have.

use super::*;
use proptest::prelude::*;
use pwrfgs_core::{Dataset, Plugin, Pose, Sample, Spectra, Split};
use std::collections::BTreeMap;

/// Samples with one-pixel spectra at these positions; every fifth belongs to the official test list.
pub(crate) fn samples_at(places: &[[f64; 3]]) -> Dataset {
    let to_sample = |(i, &tx): (usize, &[f64; 3])| Sample::new(i as u32 + 1, tx);
    let (test, train) = (0..places.len()).partition(|i| i % 5 == 4);
    let samples = places.iter().enumerate().map(to_sample).collect();
    let spectra = Spectra::grey((1, 1), (0..places.len()).map(|i| i as u8).collect()).unwrap();
    let data = Dataset::new("test", Pose::IDENTITY, vec![], samples, spectra).unwrap();
    Dataset { official: Some((train, test)), ..data }
}

/// `count` samples on the x axis, one metre apart.
pub(crate) fn line_of_samples(count: usize) -> Dataset {
    samples_at(&(0..count).map(|i| [i as f64, 0.0, 0.0]).collect::<Vec<_>>())
}

fn split(split: &dyn Split, data: &Dataset) -> Result<Partition, String> {
    split.split(data, &mut rng::stream(3, "split", 0)).map_err(|e| e.to_string())
}

/// Checks that a split is sorted, disjoint, complete and reproducible, and that training and test sets are not empty.
fn check_partition_laws(plugin: &dyn Split, data: &Dataset) -> Result<Partition, TestCaseError> {
    let partition = split(plugin, data).map_err(TestCaseError::fail)?;
    let lists = [&partition.train, &partition.validation, &partition.test];
    for list in lists {
        prop_assert!(list.is_sorted_by(|a, b| a < b));
    }
    let mut sorted: Vec<usize> = lists.into_iter().flatten().copied().collect();
    sorted.sort_unstable();
    prop_assert_eq!(sorted, (0..data.len()).collect::<Vec<_>>());
    prop_assert!(!partition.train.is_empty() && !partition.test.is_empty());
    prop_assert_eq!(split(plugin, data).map_err(TestCaseError::fail)?, partition.clone());
    Ok(partition)
}

proptest! {
    #[test]
    fn official_split_takes_validation_from_training_list(n in 5usize..60, validation in 0.0..0.99) {
        let data = line_of_samples(n);
        let partition = check_partition_laws(&Official { validation }, &data)?;
        let (train, test) = data.official.clone().unwrap();
        prop_assert_eq!(&partition.test, &test);
        prop_assert_eq!(partition.validation.len(), share_count(validation, train.len()));
    }

    #[test]
    fn random_split_has_requested_shares(n in 2usize..60, test in 0.01..0.99, validation in 0.0..0.99) {
        let partition = check_partition_laws(&Random { test, validation }, &line_of_samples(n))?;
        prop_assert_eq!(partition.test.len(), share_count(test, n));
        prop_assert_eq!(partition.validation.len(), share_count(validation, n - share_count(test, n)));
    }

    #[test]
    fn sparse_split_has_requested_count(n in 2usize..60, share in 0.0..0.99, validation in 0.0..0.99) {
        let train = share_count(share, n).max(1);
        let partition = check_partition_laws(&Sparse { train, validation }, &line_of_samples(n))?;
        prop_assert_eq!(partition.train.len() + partition.validation.len(), train);
    }

    #[test]
    fn time_block_is_contiguous_and_adjacent_to_validation(
        n in 2usize..60, start in 0.0..0.99, length in 0.01..0.99, validation in 0.0..0.99,
    ) {
        let plugin = TimeBlock { start, length: length * (1.0 - start), gap: 0, validation };
        prop_assert!(plugin.check().is_ok());
        let partition = check_partition_laws(&plugin, &line_of_samples(n))?;
        let is_contiguous = |list: &[usize]| list.windows(2).all(|w| w[1] == w[0] + 1);
        prop_assert!(is_contiguous(&partition.test));
        let mut held_out = [partition.test, partition.validation].concat();
        held_out.sort_unstable();
        prop_assert!(is_contiguous(&held_out));
    }

    #[test]
    fn voxel_split_never_divides_cell(
        places in prop::collection::vec(prop::array::uniform3(-1.0..1.0_f64), 10..80),
        size_m in 0.1..0.9, test in 0.01..0.99, validation in 0.0..0.99,
    ) {
        let plugin = Voxel { size_m, test, validation };
        let data = samples_at(&places);
        let mut part_of_cell = BTreeMap::new();
        prop_assume!(places.iter().any(|p| plugin.cell(*p) != plugin.cell(places[0])));
        let partition = check_partition_laws(&plugin, &data)?;
        for (name, list) in [("train", partition.train), ("validation", partition.validation), ("test", partition.test)] {
            for i in list {
                prop_assert_eq!(*part_of_cell.entry(plugin.cell(places[i])).or_insert(name), name);
            }
        }
    }
}

#[test]
fn zero_validation_share_gives_empty_validation_set() {
    let data = line_of_samples(30);
    for text in ["Official", "Random", "TimeBlock", "Voxel", "Sparse"] {
        let arguments = if text == "Sparse" { "train: 10, validation: 0" } else { "validation: 0" };
        let plugin = Plugin::<dyn Split>::parse(&format!("{text}({arguments})")).unwrap();
        assert_eq!(split(plugin.get(), &data).unwrap().validation, Vec::<usize>::new(), "{text}");
    }
}

#[test]
fn time_block_starts_at_requested_share() {
    let partition = split(&TimeBlock::default(), &line_of_samples(100)).unwrap();
    assert_eq!(partition.test, (40..60).collect::<Vec<_>>());
    assert_eq!(partition.validation, (60..68).collect::<Vec<_>>());
    let at_the_end = TimeBlock { start: 0.75, length: 0.2, gap: 0, validation: 0.1 };
    let partition = split(&at_the_end, &line_of_samples(100)).unwrap();
    assert_eq!(partition.test, (75..95).collect::<Vec<_>>());
    assert_eq!(partition.validation, [72, 73, 74, 95, 96, 97, 98, 99]);
}

#[test]
fn samples_in_gap_are_unused() {
    let parts = |gap, start, data: &Dataset| split(&TimeBlock { start, gap, ..TimeBlock::default() }, data);
    let range = |range: std::ops::Range<usize>| range.collect::<Vec<_>>();
    let partition = parts(5, 0.4, &line_of_samples(100)).unwrap();
    assert_eq!((partition.test, partition.validation), (range(40..60), range(65..72)));
    assert_eq!(partition.train, [range(0..35), range(72..100)].concat());
    // At either end the gap is shorter, and validation may lie before the block.
    let partition = parts(5, 0.02, &line_of_samples(100)).unwrap();
    assert_eq!((partition.train, partition.validation), (range(34..100), range(27..34)));
    let partition = parts(5, 0.78, &line_of_samples(100)).unwrap();
    assert_eq!((partition.test, partition.validation), (range(78..98), range(66..73)));
    for gap in [40, usize::MAX] {
        let message = parts(gap, 0.4, &line_of_samples(100)).unwrap_err();
        assert!(message.starts_with("the split leaves no training sample"), "{message}");
    }
}

#[test]
fn voxel_split_reaches_share_with_small_cells() {
    let places: Vec<[f64; 3]> = (0..1000).map(|i| [i % 10, i / 10 % 10, i / 100].map(f64::from)).collect();
    let partition = split(&Voxel { size_m: 1.0, test: 0.2, validation: 0.1 }, &samples_at(&places)).unwrap();
    assert_eq!((partition.train.len(), partition.validation.len(), partition.test.len()), (720, 80, 200));
}

#[test]
fn rejects_impossible_split_with_advice() {
    let mut plain = line_of_samples(30);
    plain.official = None;
    let cases: [(&dyn Split, &Dataset, &str); 5] = [
        (
            &Official::default(),
            &plain,
            "test comes without a split of its own (train_index.txt and test_index.txt); \
             use Random(), TimeBlock(), Voxel() or Sparse()",
        ),
        (&Sparse::default(), &plain, "Sparse(train: 220) leaves no test sample: there are 30 samples; lower `train`"),
        (
            &Voxel { size_m: 100.0, ..Voxel::default() },
            &plain,
            "all 30 samples lie in one cell of 100 m; lower `size_m` of Voxel",
        ),
        (
            &Random::default(),
            &line_of_samples(1),
            "the split leaves no test sample of 1 in all; change its shares or give more samples",
        ),
        (
            &TimeBlock::default(),
            &line_of_samples(1),
            "the split leaves no test sample of 1 in all; change its shares or give more samples",
        ),
    ];
    for (plugin, data, message) in cases {
        assert_eq!(split(plugin, data).unwrap_err(), message);
    }
}

#[test]
fn rejects_settings_out_of_range_when_read() {
    let texts = [
        "Official(validation: 1)",
        "Official(validation: -0.1)",
        "Official(validation: NaN)",
        "Random(test: 0)",
        "Random(test: 1)",
        "Random(test: NaN)",
        "TimeBlock(start: 1)",
        "TimeBlock(start: -0.1)",
        "TimeBlock(start: NaN)",
        "TimeBlock(length: 0)",
        "TimeBlock(gap: -1)",
        "TimeBlock(start: 0.9, length: 0.2)",
        "Voxel(size_m: 0)",
        "Voxel(size_m: inf)",
        "Voxel(size_m: NaN)",
        "Voxel(test: 2)",
        "Sparse(train: 0)",
        "Sparse(validation: 1)",
        "Random(tset: 0.2)",
    ];
    for text in texts {
        assert!(Plugin::<dyn Split>::parse(text).is_err(), "{text}");
    }
}
