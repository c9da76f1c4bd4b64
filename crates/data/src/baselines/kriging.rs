//! `Kriging`: a Gaussian process over the transmitter's position.

mod correlation;
mod likelihood;
mod system;

use super::nearest::Nearest;
use super::{all_of, choosing, weighted_mean};
use correlation::{Correlation, Kind};
use likelihood::Cases;
use pwrfgs_core::{Baseline, Dataset, Documented, Image, Known, Predict, Query, Result};
use serde::{Deserialize, Serialize};

/// Ordinary kriging: the best linear unbiased prediction of a Gaussian process over the transmitter's position, as maps of
/// radio coverage are made.
///
/// The spectra are taken as one Gaussian process whose correlation between two places is exponential (Matern 1/2), Matern
/// 3/2 or squared exponential, with a length scale for each axis, plus noise of each spectrum by itself. All pixels, and so
/// all principal components of the spectra, share that correlation. Then the prediction is a weighted sum of spectra
/// (weights add up to 1 and may be negative), no component has to be cut off, and nothing is kept but positions.
///
/// Correlation, length scales and noise are those under which the spectra of at most 160 validation samples are most likely,
/// given the 24 training spectra nearest to each (the strength follows in closed form). Where there is no validation part,
/// every tenth training sample is left out for this. The prediction then uses the nearest of all, in units of the length
/// scales. A note under the tables tells what was found.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("Kriging()").unwrap().name(), "Kriging");
/// assert!(Plugin::<dyn Baseline>::parse("Kriging(neighbours: 1)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct Kriging {
    /// Spectra that a prediction is made of, 2 to 512: its time grows with the third power.
    pub neighbours: usize,
}

impl Default for Kriging {
    fn default() -> Self {
        Self { neighbours: 48 }
    }
}

#[typetag::serde]
impl Baseline for Kriging {
    fn name(&self) -> String {
        "Kriging".into()
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        let all = all_of(known)?;
        let (train, validation) = choosing(known);
        let correlation = likelihood::most_likely(&Cases::new(data, train, &validation));
        data.observations.check()?;
        let nearest = Nearest::new(all, |i| correlation.scaled(data.sample(i).tx));
        Ok(Box::new(Process { data, nearest, correlation, neighbours: self.neighbours }))
    }

    fn about(&self) -> &'static str {
        "a Gaussian process over position, of the nearest spectra; length scales and noise by likelihood"
    }

    fn check(&self) -> Result<(), String> {
        if !(2..=512).contains(&self.neighbours) {
            return Err(format!("`neighbours` is {}; give a number from 2 to 512, such as 48", self.neighbours));
        }
        Ok(())
    }
}

struct Process<'a> {
    data: &'a Dataset,
    nearest: Nearest,
    correlation: Correlation,
    neighbours: usize,
}

impl Predict for Process<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let at = self.correlation.scaled(query.tx);
        let samples: Vec<usize> = self.nearest.find(at, self.neighbours).1.into_iter().map(|(_, i)| i).collect();
        let places: Vec<[f64; 3]> = samples.iter().map(|&i| self.correlation.scaled(self.data.sample(i).tx)).collect();
        let weights = system::solve(&self.correlation, &places, at).weights;
        weighted_mean(self.data, &samples.into_iter().zip(weights).collect::<Vec<_>>())
    }

    fn note(&self) -> Option<String> {
        let Correlation { kind, scales_m, noise } = &self.correlation;
        let kind = match kind {
            Kind::Exponential => "exponential",
            Kind::Matern32 => "Matern 3/2",
            Kind::SquaredExponential => "squared exponential",
        };
        let [x, y, z] = scales_m.map(|scale| format!("{scale:.3}"));
        Some(format!(
            "Kriging found a correlation that is {kind} with length scales of {x}, {y} and {z} m, and noise of {noise:.4} \
             of the variance"
        ))
    }
}

#[cfg(test)]
mod tests;
