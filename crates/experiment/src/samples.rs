//! Samples of a data set: `samples.csv` (where each transmitter stood, what it served, how far the nearest one trained on
//! is).

use pwrfgs_core::{Dataset, Partition, Real, neighbours};
use std::fmt::Write as _;

/// The text of `samples.csv`: id, x, y, z in metres, split, and the distance to the nearest other training transmitter
/// in metres (empty where there is none).
pub(crate) fn to_csv(data: &Dataset, partition: &Partition) -> String {
    let mut split = vec!["unused"; data.len()];
    for (part, name) in [(&partition.train, "train"), (&partition.validation, "validation"), (&partition.test, "test")]
    {
        for &i in part {
            split[i] = name;
        }
    }
    let nearest = nearest_train(data, partition);
    let mut out = String::from("id,x,y,z,split,nearest_train_m\n");
    for ((sample, split), nearest) in data.samples().zip(split).zip(nearest) {
        let [x, y, z] = sample.tx;
        let distance = if nearest.is_finite() { nearest.to_string() } else { String::new() };
        let _ = writeln!(out, "{},{x},{y},{z},{split},{distance}", sample.id);
    }
    out
}

/// Metres from each sample to the nearest other training sample; infinity where there is none.
pub fn nearest_train(data: &Dataset, partition: &Partition) -> Vec<Real> {
    let all: Vec<[Real; 3]> = data.samples().map(|s| data.scene.origin.local(s.tx)).collect();
    let train: Vec<[Real; 3]> = partition.train.iter().map(|&i| all[i]).collect();
    let mut squared = neighbours::nearest_squared(&all, &train);
    for (&i, own) in partition.train.iter().zip(neighbours::nearest_other_squared(&train)) {
        squared[i] = own;
    }
    squared.into_iter().map(Real::sqrt).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    #[test]
    fn distances_leave_the_sample_itself_out() {
        let sample = |id, x: f64| Sample::new(id, [x, 0.0, 0.0]);
        let samples = vec![sample(1, 0.0), sample(2, 2.0), sample(5, 2.5), sample(6, 9.0)];
        let data =
            Dataset::new("line", Pose::IDENTITY, vec![], samples, Spectra::grey((1, 1), vec![0; 4]).unwrap()).unwrap();
        let partition = Partition { train: vec![0, 1], validation: vec![], test: vec![2] };
        let text = to_csv(&data, &partition);
        let expected = "id,x,y,z,split,nearest_train_m\n1,0,0,0,train,2\n2,2,0,0,train,2\n5,2.5,0,0,test,0.5\n\
                        6,9,0,0,unused,7\n";
        assert_eq!(text, expected);
    }
}
