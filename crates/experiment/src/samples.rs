//! Samples of a data set: key of data and split, and `samples.csv` (position and set of each sample, distance to the nearest
//! training transmitter).

use crate::text::{csv_field, read_csv_rows};
use pwrfgs_core::neighbours::{Nearest, nearest_others};
use pwrfgs_core::{Dataset, Partition, Real, Result};
use pwrfgs_pipeline::Pipeline;
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

/// Header for data with one receiver.
const HEADER: &str = "id,x,y,z,split,nearest_train_m";
/// Header for data with several receivers: a row is a link.
const LINK_HEADER: &str = "link,id,receiver,x,y,z,split,nearest_train_m";

/// Returns a key of the data and split of a pipeline: equal for pipelines with the same samples in each set.
pub fn data_key(pipeline: &Pipeline) -> String {
    format!("{:?} {:?} {}", pipeline.data, pipeline.split, pipeline.split_seed.unwrap_or(pipeline.seed))
}

/// Formats the content of `samples.csv`: id, x, y, z in metres (empty if unknown), split, and the distance to the
/// nearest other transmitter with a link of `trained` in metres (empty if there is none). With several receivers a row is a
/// link: its number, as in `scores.csv`, is the first column, and the receiver name follows the id. `intervals` hold the
/// further columns of each test sample, in the order of `partition.test`; empty without intervals.
pub fn samples_csv(data: &Dataset, partition: &Partition, trained: &[usize], intervals: &[Vec<f64>]) -> String {
    let mut split = vec!["unused"; data.len()];
    for (set, name) in [(&partition.train, "train"), (&partition.validation, "validation"), (&partition.test, "test")] {
        for &i in set {
            split[i] = name;
        }
    }
    let nearest = nearest_training_distances(data, trained);
    let many = data.scene.receivers.len() > 1;
    let task = data.task();
    let columns = task.intervals.iter().flat_map(|words| words.columns).filter(|_| !intervals.is_empty());
    let columns: Vec<&str> = columns.copied().collect();
    let first = if many { LINK_HEADER } else { HEADER };
    let mut out = std::iter::once(first).chain(columns.iter().copied()).collect::<Vec<_>>().join(",") + "\n";
    let intervals_by_link: BTreeMap<usize, &Vec<f64>> = partition.test.iter().copied().zip(intervals).collect();
    for (i, ((sample, split), nearest)) in data.samples().zip(split).zip(nearest).enumerate() {
        let distance = if nearest.is_finite() && data.placed { nearest.to_string() } else { String::new() };
        let position = if data.placed { sample.position().map(|v| v.to_string()) } else { Default::default() };
        if many {
            let receiver = &data.scene.receivers[sample.receiver].name;
            _ = write!(out, "{},{},{},", data.label(i), sample.id, csv_field(receiver));
        } else {
            _ = write!(out, "{},", sample.id);
        }
        _ = write!(out, "{},{split},{distance}", position.join(","));
        let interval = intervals_by_link.get(&i);
        for k in 0..columns.len() {
            _ = write!(out, ",{}", interval.map_or_else(String::new, |interval| interval[k].to_string()));
        }
        out.push('\n');
    }
    out
}

/// Returns the distance from the transmitter of each link to the nearest other transmitter with a link of `trained`,
/// metres; infinity if there is none. Zero if the link is not one of them but another link of its transmitter is.
pub fn nearest_training_distances(data: &Dataset, trained: &[usize]) -> Vec<Real> {
    let mut locations: Vec<usize> = trained.iter().map(|&i| data.links[i].location).collect();
    locations.sort_unstable();
    locations.dedup();
    let train: Vec<[f64; 3]> = locations.iter().map(|&t| data.locations[t].position()).collect();
    let lookup = Nearest::of(&train);
    let nearest: Vec<f64> = data.locations.par_iter().map(|at| lookup.distance(&at.position())).collect();
    let mut others = nearest.clone();
    for (&t, other) in locations.iter().zip(nearest_others(&train)) {
        others[t] = other.map_or(f64::INFINITY, |(distance, _)| distance);
    }
    let mut is_training = vec![false; data.len()];
    trained.iter().for_each(|&i| is_training[i] = true);
    let distance = |(link, is_training): (&pwrfgs_core::Link, bool)| {
        if is_training { others[link.location] } else { nearest[link.location] }
    };
    data.links.iter().zip(is_training).map(|link| distance(link) as Real).collect()
}

/// Test samples, by label as in `scores.csv`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TestSamples {
    /// Distance to the nearest training transmitter, metres; infinity if there is none.
    pub nearest_train_m: BTreeMap<u32, f64>,
    /// Transmitter position, metres; `None` if unknown.
    pub positions: BTreeMap<u32, Option<[f64; 3]>>,
}

/// Row of `samples.csv`.
#[derive(Deserialize)]
struct SampleRow {
    /// Label in `scores.csv` if there are several receivers; otherwise `id` is the label.
    link: Option<u32>,
    id: u32,
    x: Option<f64>,
    y: Option<f64>,
    z: Option<f64>,
    split: String,
    nearest_train_m: Option<f64>,
}

impl TestSamples {
    /// Reads `samples.csv`.
    ///
    /// # Errors
    /// [`pwrfgs_core::Error::Read`], or [`pwrfgs_core::Error::Input`] with the line if the file is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let mut samples = Self::default();
        for SampleRow { link, id, x, y, z, split, nearest_train_m } in read_csv_rows(path)? {
            if split == "test" {
                let label = link.unwrap_or(id);
                samples.nearest_train_m.insert(label, nearest_train_m.unwrap_or(f64::INFINITY));
                samples.positions.insert(label, x.zip(y).zip(z).map(|((x, y), z)| [x, y, z]));
            }
        }
        Ok(samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    #[test]
    fn nearest_distance_excludes_sample_itself() {
        let sample = |id, x: f64| Sample::new(id, [x, 0.0, 0.0]);
        let samples = vec![sample(1, 0.0), sample(2, 2.0), sample(5, 2.5), sample(6, 9.0)];
        let data =
            Dataset::new("line", Pose::IDENTITY, vec![], samples, Spectra::grey((1, 1), vec![0; 4]).unwrap()).unwrap();
        let partition = Partition { train: vec![0, 1], validation: vec![], test: vec![2] };
        let text = samples_csv(&data, &partition, &partition.train, &[]);
        let expected = "id,x,y,z,split,nearest_train_m\n1,0,0,0,train,2\n2,2,0,0,train,2\n5,2.5,0,0,test,0.5\n\
                        6,9,0,0,unused,7\n";
        assert_eq!(text, expected);
    }

    #[test]
    fn test_samples_have_distances_and_positions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("samples.csv");
        let text = "id,x,y,z,split,nearest_train_m\n1,0,0,0,train,2\n5,2.5,0,1,test,0.5\n6,,,,test,\n";
        std::fs::write(&path, text).unwrap();
        let samples = TestSamples::read(&path).unwrap();
        assert_eq!(samples.nearest_train_m, BTreeMap::from([(5, 0.5), (6, f64::INFINITY)]));
        assert_eq!(samples.positions, BTreeMap::from([(5, Some([2.5, 0.0, 1.0])), (6, None)]));
    }
}
