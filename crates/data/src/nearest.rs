//! How far a division keeps its parts from each other: distances to the nearest training transmitter.

use pwrfgs_core::{Dataset, Partition, Real, neighbours};

/// For each point of `from`, the distance to the nearest of `to` in metres; infinite where `to` is empty.
pub fn nearest_distances(from: &[[Real; 3]], to: &[[Real; 3]]) -> Vec<Real> {
    neighbours::nearest_squared(from, to).into_iter().map(Real::sqrt).collect()
}

/// For each sample, the distance in metres to the nearest *other* training sample; infinite where there is none.
pub fn nearest_train_distance(data: &Dataset, partition: &Partition) -> Vec<Real> {
    let all: Vec<[Real; 3]> = data.samples.iter().map(|s| s.tx).collect();
    let train: Vec<[Real; 3]> = partition.train.iter().map(|&i| all[i]).collect();
    let mut distances = nearest_distances(&all, &train);
    for (&i, square) in partition.train.iter().zip(neighbours::nearest_other_squared(&train)) {
        distances[i] = square.sqrt();
    }
    distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splits::testing::line_of_samples;

    #[test]
    fn distances_are_those_of_the_nearest() {
        let from = [[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]];
        let to = [[0.0, 3.0, 4.0], [5.0, 0.0, 1.0]];
        assert_eq!(nearest_distances(&from, &to), [5.0, 1.0]);
        assert_eq!(nearest_distances(&from, &[]), [Real::INFINITY; 2]);
    }

    #[test]
    fn a_training_sample_is_not_its_own_neighbour() {
        let data = line_of_samples(5); // one metre apart
        let partition = Partition { train: vec![0, 1, 4], validation: vec![], test: vec![2, 3] };
        assert_eq!(nearest_train_distance(&data, &partition), [1.0, 1.0, 1.0, 1.0, 3.0]);
    }
}
