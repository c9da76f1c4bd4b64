//! Predictors without Gaussians. What a model says is worth what it adds to these.

mod by_receiver;
#[cfg(test)]
mod floors;
mod kriging;
mod law;
mod log_distance;
mod nearest;
mod neighbours;
mod ridge;
mod zero;

pub use kriging::Kriging;
pub use log_distance::LogDistance;
pub use neighbours::{NearestNeighbours, Neighbours};
pub use ridge::Ridge;
pub use zero::Zero;

use by_receiver::{ByReceiver, Fitted};
use pwrfgs_core::{Baseline, Dataset, Error, Image, JsonSchema, Known, Predict, Query, Real, Result, Task};
use serde::{Deserialize, Serialize};

/// The mean of all training spectra, whatever the transmitter: the floor of every score. Of powers and channels it is the
/// mean of what the receiver observed, called "mean of the receiver"; a receiver without training links has the mean of all.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("MeanSpectrum()").unwrap().name(), "mean spectrum");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MeanSpectrum {}

#[typetag::serde]
impl Baseline for MeanSpectrum {
    fn name(&self) -> String {
        "mean spectrum".into()
    }

    fn name_for(&self, task: Task) -> String {
        if task.has_pixels { self.name() } else { "mean of the receiver".into() }
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        ByReceiver::fit(data, known, |known| {
            let weighted: Vec<(usize, f64)> = all_of(known)?.into_iter().map(|i| (i, 1.0)).collect();
            Ok(Constant(weighted_mean(data, &weighted)))
        })
    }
}

/// All known samples, sorted; refuses none.
fn all_of(known: Known<'_>) -> Result<Vec<usize>> {
    let all = known.all();
    if all.is_empty() {
        return Err(Error::Config("a baseline needs at least one training sample; change the split".into()));
    }
    Ok(all)
}

/// What choices are made on: training samples, and others that they are to predict. Without a validation part every tenth
/// training sample is left out; without two samples there is nothing to predict.
fn choosing(known: Known<'_>) -> (Vec<usize>, Vec<usize>) {
    const EVERY: usize = 10;
    if !known.validation.is_empty() && !known.train.is_empty() {
        return (known.train.to_vec(), known.validation.to_vec());
    }
    let all = known.all();
    let samples = |out: bool| all.iter().enumerate().filter(move |(k, _)| (k % EVERY == 1) == out).map(|(_, i)| *i);
    (samples(false).collect(), samples(true).collect())
}

/// Always the same.
struct Constant(Image);

impl Predict for Constant {
    fn predict(&self, _: Query<'_>) -> Image {
        self.0.clone()
    }
}

impl Fitted for Constant {
    fn notes(_: &[(&str, &Self)]) -> Option<String> {
        None
    }
}

/// The mean of the samples listed, each with a weight; they do not add up to zero.
fn weighted_mean(data: &Dataset, weighted: &[(usize, f64)]) -> Image {
    let mut sum = vec![0.0; data.width * data.height];
    for &(i, weight) in weighted {
        data.observations.add(i, weight, &mut sum);
    }
    let total: f64 = data.observations.full_scale() * weighted.iter().map(|(_, w)| w).sum::<f64>();
    let pixels = sum.iter().map(|s| (s / total) as Real).collect();
    Image { width: data.width, height: data.height, pixels }
}

#[cfg(test)]
mod tests;
