//! Predictors without Gaussians. What a model says is worth what it adds to these.

use pwrfgs_core::{Baseline, Dataset, Documented, Error, Image, Predict, Real, Result};
use serde::{Deserialize, Serialize};

/// The mean of all training spectra, whatever the transmitter: the floor of every score.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("MeanSpectrum()").unwrap().name(), "mean spectrum");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct MeanSpectrum {}

#[typetag::serde]
impl Baseline for MeanSpectrum {
    fn name(&self) -> String {
        "mean spectrum".into()
    }

    fn fit<'a>(&self, data: &'a Dataset, train: &[usize]) -> Result<Box<dyn Predict + 'a>> {
        refuse_empty(train)?;
        let weighted: Vec<(usize, f64)> = train.iter().map(|&i| (i, 1.0)).collect();
        Ok(Box::new(Constant(weighted_mean(data, &weighted))))
    }

    fn about(&self) -> &'static str {
        "the mean of all training spectra"
    }
}

/// The mean of the spectra of the k nearest training transmitters, weighted by inverse distance.
///
/// Where the transmitter stands on training transmitters, it is the mean of the spectra measured there.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("NearestNeighbours(k: 5)").unwrap().name(), "5-NN");
/// assert!(Plugin::<dyn Baseline>::parse("NearestNeighbours(k: 0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct NearestNeighbours {
    /// Neighbours that are averaged, at least 1; more than there are training samples means all of them.
    pub k: usize,
}

impl Default for NearestNeighbours {
    fn default() -> Self {
        Self { k: 3 }
    }
}

#[typetag::serde]
impl Baseline for NearestNeighbours {
    fn name(&self) -> String {
        format!("{}-NN", self.k)
    }

    fn fit<'a>(&self, data: &'a Dataset, train: &[usize]) -> Result<Box<dyn Predict + 'a>> {
        refuse_empty(train)?;
        Ok(Box::new(Lookup { data, train: train.to_vec(), k: self.k.min(train.len()) }))
    }

    fn about(&self) -> &'static str {
        "the spectra of the k nearest training transmitters, weighted by inverse distance"
    }

    fn check(&self) -> Result<(), String> {
        if self.k == 0 {
            return Err("`k` is 0; use at least 1 neighbour".into());
        }
        Ok(())
    }
}

fn refuse_empty(train: &[usize]) -> Result<()> {
    if train.is_empty() {
        return Err(Error::Config("a baseline needs at least one training sample; change the split".into()));
    }
    Ok(())
}

/// Always the same spectrum.
struct Constant(Image);

impl Predict for Constant {
    fn predict(&self, _: [f64; 3]) -> Image {
        self.0.clone()
    }
}

/// Looks at every training transmitter: 80,000 take less than a millisecond.
struct Lookup<'a> {
    data: &'a Dataset,
    train: Vec<usize>,
    k: usize,
}

impl Lookup<'_> {
    /// Samples with their weights: those at `tx` exactly, or else the k nearest. Ties go to the lower index.
    fn neighbours(&self, tx: [f64; 3]) -> Vec<(usize, f64)> {
        /// Candidates that are kept beyond the k before the worst of them are dropped.
        const SPARE: usize = 1024;
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let keep_nearest = |near: &mut Vec<(f64, usize)>| {
            if near.len() > self.k {
                near.select_nth_unstable_by(self.k - 1, by_distance);
                near.truncate(self.k);
            }
        };
        let (mut exact, mut near, mut worst) = (Vec::new(), Vec::with_capacity(self.k + SPARE), f64::INFINITY);
        for &i in &self.train {
            let distance = distance(self.data.samples[i].tx, tx);
            if distance == 0.0 {
                exact.push((i, 1.0));
            } else if distance <= worst {
                near.push((distance, i));
                if near.len() == self.k + SPARE {
                    keep_nearest(&mut near);
                    worst = near.iter().fold(0.0, |worst, n| worst.max(n.0));
                }
            }
        }
        if !exact.is_empty() {
            return exact;
        }
        keep_nearest(&mut near);
        near.sort_unstable_by(by_distance);
        near.into_iter().map(|(distance, i)| (i, 1.0 / distance)).collect()
    }
}

/// |a - b|, metres.
fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Predict for Lookup<'_> {
    fn predict(&self, tx: [f64; 3]) -> Image {
        weighted_mean(self.data, &self.neighbours(tx))
    }
}

/// The mean of the samples listed, each with a positive weight.
fn weighted_mean(data: &Dataset, weighted: &[(usize, f64)]) -> Image {
    let mut sum = vec![0.0; data.width * data.height];
    for &(i, weight) in weighted {
        data.spectra.add(i, weight, &mut sum);
    }
    let total: f64 = data.spectra.number().full_scale() * weighted.iter().map(|(_, w)| w).sum::<f64>();
    let pixels = sum.iter().map(|s| (s / total) as Real).collect();
    Image { width: data.width, height: data.height, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splits::testing::{line_of_samples, samples_at};

    fn predict(baseline: &dyn Baseline, data: &Dataset, train: &[usize], x: f64) -> f64 {
        let image = baseline.fit(data, train).unwrap().predict([x, 0.0, 0.0]);
        assert_eq!((image.width, image.height, image.pixels.len()), (1, 1, 1));
        image.pixels[0] as f64 * 255.0
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-4
    }

    #[test]
    fn the_mean_spectrum_ignores_the_transmitter() {
        let data = line_of_samples(4); // values 0, 1, 2, 3
        assert!(close(predict(&MeanSpectrum {}, &data, &[1, 3], 100.0), 2.0));
    }

    #[test]
    fn neighbours_are_weighted_by_inverse_distance() {
        let data = line_of_samples(10);
        assert!(close(predict(&NearestNeighbours { k: 1 }, &data, &[0, 4, 9], 5.0), 4.0));
        assert!(close(
            predict(&NearestNeighbours { k: 2 }, &data, &[0, 4, 9], 6.0),
            (4.0 / 2.0 + 9.0 / 3.0) / (1.0 / 2.0 + 1.0 / 3.0)
        ));
        // More neighbours than samples: all of them.
        let all = predict(&NearestNeighbours { k: 99 }, &data, &[4, 9], 6.0);
        assert!(close(all, (4.0 / 2.0 + 9.0 / 3.0) / (1.0 / 2.0 + 1.0 / 3.0)));
    }

    #[test]
    fn an_exact_hit_returns_what_was_measured_there() {
        let data = samples_at(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]);
        assert!(close(predict(&NearestNeighbours { k: 1 }, &data, &[0, 1, 2, 3], 1.0), 1.5));
        assert!(close(predict(&NearestNeighbours { k: 3 }, &data, &[0, 1, 3], 1.0), 1.0));
    }

    #[test]
    fn a_tie_goes_to_the_lower_index() {
        let data = line_of_samples(3);
        assert!(close(predict(&NearestNeighbours { k: 1 }, &data, &[2, 0], 1.0), 0.0));
    }

    #[test]
    fn the_nearest_of_thousands_are_found() {
        let places: Vec<[f64; 3]> = (0..5000).map(|i| [f64::from(i * 7919 % 5000), f64::from(i % 3), 0.0]).collect();
        let data = samples_at(&places);
        for k in [1, 3, 700, 5000] {
            let lookup = Lookup { data: &data, train: (0..5000).collect(), k };
            let tx = [2500.25, 1.0, 0.0];
            let mut all: Vec<(f64, usize)> =
                places.iter().enumerate().map(|(i, place)| (distance(*place, tx), i)).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let expected: Vec<(usize, f64)> = all[..k].iter().map(|(d, i)| (*i, 1.0 / d)).collect();
            assert_eq!(lookup.neighbours(tx), expected, "{k}");
        }
        let same = samples_at(&vec![[1.0; 3]; 3000]);
        let lookup = Lookup { data: &same, train: (0..3000).collect(), k: 2 };
        assert_eq!(lookup.neighbours([1.0; 3]).len(), 3000, "all that stand there");
    }

    #[test]
    fn nothing_to_learn_from_is_an_error() {
        let data = line_of_samples(3);
        for baseline in [&MeanSpectrum {} as &dyn Baseline, &NearestNeighbours::default()] {
            let message = baseline.fit(&data, &[]).err().unwrap().to_string();
            assert_eq!(message, "a baseline needs at least one training sample; change the split");
        }
    }
}
