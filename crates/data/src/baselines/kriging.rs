//! `Kriging`: a Gaussian process over the transmitter's position.

mod equations;
mod likelihood;

use super::neighbours::Nearest;
use super::{ByReceiver, Fitted, all_of, choosing, weighted_mean};
use equations::{Correlation, Trend, solve};
use likelihood::Cases;
use pwrfgs_core::{Baseline, Dataset, Error, Image, JsonSchema, Known, Predict, Query, Real, Result};
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
/// Each receiver has a process of its own; one without training links is predicted from those of all. Of received powers it
/// is the residual of a law of distance, RSSI = T - 10 gamma log10(d) by least squares, that is taken for the process; the
/// law is added again, and is the prediction where no measurement is near. Its correlation is Matern 3/2 with one length
/// scale for all axes, and those numbers are taken under which at most 320 training powers are most likely, each given the
/// 16 nearest before it in random order. Data whose links have features in the place of positions are refused.
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

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if data.placed && data.features.is_none() {
            return Ok(());
        }
        let what = "has no positions of transmitters to predict from, and Kriging is a process over position";
        Err(Error::Config(format!("{} {what}; use NearestNeighbours()", data.title)))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        ByReceiver::fit(data, known, |known| {
            let all = all_of(known)?;
            let trend = Trend::of(data, &all);
            let cases = if trend.law.is_some() {
                Cases::of_powers(&trend, &all)
            } else {
                let (train, validation) = choosing(known);
                Cases::new(&trend, train, &validation)
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

impl Fitted for Process<'_> {
    fn notes(each: &[(&str, &Self)]) -> Option<String> {
        match each {
            [] => None,
            [(_, one)] => Some(one.note_of_one()),
            many => Some(note_of_many(many)),
        }
    }
}

impl Process<'_> {
    /// What was found, where there is one receiver.
    fn note_of_one(&self) -> String {
        let Correlation { kind, scales_m, noise } = &self.correlation;
        let [x, y, z] = scales_m.map(digits);
        let law = self.trend.law.map_or_else(String::new, |law| {
            let (level, slope) = (digits(law.level), digits(law.slope));
            format!(", about a law of distance of {level} dBm at a metre and {slope} dB a factor of ten")
        });
        format!(
            "Kriging found a correlation that is {} with length scales of {x}, {y} and {z} m, and noise of {} of the \
             variance{law}",
            kind.words(),
            digits(*noise)
        )
    }

    /// The same of one among several, in the order of [`note_of_many`].
    fn in_short(&self) -> String {
        let Correlation { kind, scales_m, noise } = &self.correlation;
        let [x, y, z] = scales_m.map(digits);
        let scales = if x == y && y == z { x } else { format!("{x} x {y} x {z}") };
        let law = self.trend.law.map(|law| [digits(law.level), digits(law.slope)]);
        let numbers = [kind.words().to_owned(), scales, digits(*noise)].into_iter().chain(law.into_iter().flatten());
        numbers.collect::<Vec<_>>().join(", ")
    }
}

/// What was found of several receivers: every number, since scores cannot be repeated from their range.
fn note_of_many(each: &[(&str, &Process<'_>)]) -> String {
    let law = if each.iter().any(|(_, process)| process.trend.law.is_some()) {
        ", law of distance in dBm at a metre and dB a factor of ten"
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

/// Four significant digits: with those that are printed, a score can be repeated.
fn digits(value: f64) -> String {
    let decimals = if value == 0.0 { 0.0 } else { (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) };
    format!("{value:.0$}", decimals as usize)
}

#[cfg(test)]
mod tests;
