//! `Kriging`: a Gaussian process over the transmitter position.

mod equations;
mod likelihood;

use super::neighbours::Nearest;
use super::{ByReceiver, ReceiverPredictor, all_of, choosing, weighted_mean};
use equations::{Correlation, Trend, solve};
use likelihood::HeldOutCases;
use pwrfgs_core::{Baseline, Dataset, Error, FittingSet, Image, JsonSchema, Predict, Query, Real, Result};
use serde::{Deserialize, Serialize};

/// Ordinary kriging, a standard for radio coverage maps: best linear unbiased prediction of a Gaussian process over the
/// transmitter position.
///
/// Spectra are modelled as one Gaussian process. Its correlation over distance is exponential (Matern 1/2), Matern 3/2
/// or squared exponential, with one length scale per axis, plus independent noise per spectrum. All pixels share that
/// correlation, and so do all principal components of the spectra. The prediction is a weighted sum of training
/// spectra; weights add up to 1 and may be negative.
///
/// Correlation, length scales and noise maximise the likelihood of at most 160 validation spectra, each given its 24
/// nearest training spectra (the variance follows in closed form). Without a validation set, every tenth training
/// sample is held out for this. The prediction then uses the nearest training and validation samples, in units of the
/// length scales. A note under the tables reports the fit.
///
/// Each receiver has its own process; a receiver without training links is predicted from all links. For received
/// powers, the process models the residual of a least-squares path-loss model, RSSI = T - 10 gamma log10(d). Far from
/// all measurements, the prediction is the path-loss model. The correlation is then Matern 3/2 with one length scale
/// for all axes, and the fit maximises the likelihood of at most 320 training and validation powers, each
/// given the 16 nearest before it in random order. Data with link features in place of positions are an error.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("Kriging()").unwrap().name(), "Kriging");
/// assert!(Plugin::<dyn Baseline>::parse("Kriging(neighbours: 1)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Kriging {
    /// Number of samples per prediction, 2 to 512; time grows with its cube.
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

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if data.placed && data.features.is_none() {
            return Ok(());
        }
        let what = "has no transmitter positions, which Kriging needs";
        Err(Error::Config(format!("{} {what}; use NearestNeighbours()", data.title)))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        ByReceiver::fit(data, known, |known| {
            let all = all_of(known)?;
            let trend = Trend::of(data, &all);
            let cases = if trend.law.is_some() {
                HeldOutCases::of_powers(&trend, &all)
            } else {
                let (train, validation) = choosing(known);
                HeldOutCases::new(&trend, train, &validation)
            };
            let correlation = likelihood::most_likely(&cases);
            data.observations.check()?;
            let nearest = Nearest::new(all, 3, |i| correlation.scaled(data.sample(i).tx));
            Ok(Process { trend, nearest, correlation, neighbours: self.neighbours })
        })
    }

    fn check(&self) -> Result<(), String> {
        if !(2..=512).contains(&self.neighbours) {
            return Err(format!("`neighbours` is {}; give a number from 2 to 512, such as 48", self.neighbours));
        }
        Ok(())
    }
}

struct Process<'a> {
    trend: Trend<'a>,
    nearest: Nearest,
    correlation: Correlation,
    neighbours: usize,
}

impl Predict for Process<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let data = self.trend.data;
        let at = self.correlation.scaled(query.tx);
        let samples: Vec<usize> = self.nearest.find(&at, self.neighbours).1.into_iter().map(|(_, i)| i).collect();
        let places: Vec<[f64; 3]> = samples.iter().map(|&i| self.correlation.scaled(data.sample(i).tx)).collect();
        let solution = solve(&self.correlation, &places, at);
        if self.trend.law.is_none() {
            return weighted_mean(data, &samples.into_iter().zip(solution.weights).collect::<Vec<_>>());
        }
        let residual = |(&i, weight): (&usize, f64)| {
            let mut one = [0.0];
            self.trend.residual(i, 1, &mut one);
            weight * one[0] as f64
        };
        let dbm = self.trend.at(query) + samples.iter().zip(solution.simple).map(residual).sum::<f64>();
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }
}

impl ReceiverPredictor for Process<'_> {
    fn notes(each: &[(&str, &Self)]) -> Option<String> {
        match each {
            [] => None,
            [(_, one)] => Some(one.note_of_one()),
            many => Some(note_of_many(many)),
        }
    }
}

impl Process<'_> {
    /// Description of the fit for a single receiver.
    fn note_of_one(&self) -> String {
        let Correlation { kind, scales_m, noise } = &self.correlation;
        let [x, y, z] = scales_m.map(digits);
        let law = self.trend.law.map_or_else(String::new, |law| {
            let (level, slope) = (digits(law.level), digits(law.slope));
            format!(", path loss of {level} dBm at 1 m and {slope} dB per decade")
        });
        format!(
            "Kriging found a correlation that is {} with length scales of {x}, {y} and {z} m, and noise of {} of the \
             variance{law}",
            kind.words(),
            digits(*noise)
        )
    }

    /// Short description of the fit for one of several receivers, in the order of [`note_of_many`].
    fn in_short(&self) -> String {
        let Correlation { kind, scales_m, noise } = &self.correlation;
        let [x, y, z] = scales_m.map(digits);
        let scales = if x == y && y == z { x } else { format!("{x} x {y} x {z}") };
        let law = self.trend.law.map(|law| [digits(law.level), digits(law.slope)]);
        let numbers = [kind.words().to_owned(), scales, digits(*noise)].into_iter().chain(law.into_iter().flatten());
        numbers.collect::<Vec<_>>().join(", ")
    }
}

/// Description of the fits for several receivers. It lists every number, so that scores can be reproduced.
fn note_of_many(each: &[(&str, &Process<'_>)]) -> String {
    let law = if each.iter().any(|(_, process)| process.trend.law.is_some()) {
        ", path loss in dBm at 1 m and dB per decade"
    } else {
        ""
    };
    let list: Vec<String> = each.iter().map(|(name, process)| format!("{name}: {}", process.in_short())).collect();
    format!(
        "Kriging found, of {} receivers, correlations (length scales in m, noise in parts of the variance{law}): {}",
        each.len(),
        list.join("; ")
    )
}

/// Formats four significant digits, enough to reproduce a score.
fn digits(value: f64) -> String {
    let decimals = if value == 0.0 { 0.0 } else { (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) };
    format!("{value:.0$}", decimals as usize)
}

#[cfg(test)]
mod tests;
