//! Metrics of received power and channels.

use crate::{check_paired, create_measurement, score_samples, single_measurement, unsupported_task};
use pwrfgs_core::{Evaluation, Goal, Image, JsonSchema, Measurement, Metric, Result, Scope, Task, Values};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// Absolute error |predicted − measured| of a received power, dB.
///
/// Key `power_error_db`. Tables give mean, median and 90th percentile over links; papers often print mean or median
/// without naming it. Repeated readings at one position vary; the noise ceiling estimates this limit.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("PowerError()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PowerError {}

#[typetag::serde]
impl Metric for PowerError {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = score_samples(self, evaluation, |p, t| Task::Power.score(p, t))?;
        Ok(single_measurement("power_error_db", "dB", Goal::Lower, values))
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::Power]
    }

    fn scope(&self) -> Scope {
        Scope::Sample
    }
}

/// Signal-to-noise ratio of predicted channels, dB: −10 log₁₀(Σ|h′ − h|² / Σ|h|²).
///
/// Keys:
///
/// - `snr_db`: one value per snapshot (all links of a transmitter together; NeRF2 sums over antennas and subcarriers in
///   the same way and prints the median).
/// - `snr_all_db`: one ratio over the whole test set, as in `NeWRF`.
///
/// A prediction of zeros has 0 dB in both; strong snapshots have more weight in the second.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("ChannelSnr()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ChannelSnr {}

/// Limit for a channel without any error, dB.
const PERFECT: f64 = 200.0;

/// Energies Σ|h′ − h|² and Σ|h|².
#[derive(Clone, Copy, Default)]
struct Energies {
    error: f64,
    signal: f64,
}

impl Energies {
    /// Computes the energies of the channel h of a link and its prediction h′.
    fn of(prediction: &Image, truth: &Image) -> Self {
        let mut sum = Self::default();
        for (p, t) in prediction.pixels.iter().zip(&truth.pixels) {
            sum.error += ((p - t) as f64).powi(2);
            sum.signal += (*t as f64).powi(2);
        }
        sum
    }

    /// Returns the sum of both energies.
    fn plus(self, other: Self) -> Self {
        Self { error: self.error + other.error, signal: self.signal + other.signal }
    }

    /// Returns the SNR in dB, at most [`PERFECT`]; 0 for a channel of zeros, whatever the prediction.
    fn snr(self) -> f64 {
        match self {
            Self { signal: 0.0, .. } => 0.0,
            // Unlike `min`, `clamp` keeps NaN.
            Self { error, signal } => (-10.0 * (error / signal).log10()).clamp(f64::NEG_INFINITY, PERFECT),
        }
    }
}

#[typetag::serde]
impl Metric for ChannelSnr {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let measured = |key, values| create_measurement(key, "dB", Goal::Higher, values);
        if let Some(values) = unsupported_task(self, evaluation) {
            return Ok(vec![measured("snr_db", values.clone()), measured("snr_all_db", values)]);
        }
        let energies = match evaluation.energies {
            [] => Cow::Owned(self.energies(evaluation)?),
            given => Cow::Borrowed(given),
        };
        let each: Vec<Energies> = energies.iter().map(|&[error, signal]| Energies { error, signal }).collect();
        let transmitter = |i: usize| evaluation.links.get(i).map_or(i, |link| link.location);
        let mut snapshots = Vec::with_capacity(each.len());
        let rows: Vec<usize> = (0..each.len()).collect();
        for rows in rows.chunk_by(|a, b| transmitter(*a) == transmitter(*b)) {
            let snapshot = rows.iter().fold(Energies::default(), |sum, i| sum.plus(each[*i]));
            snapshots.extend(rows.iter().map(|_| snapshot.snr())); // one value per link
        }
        let whole = each.iter().fold(Energies::default(), |sum, energies| sum.plus(*energies));
        let over_all =
            if each.is_empty() { Values::NotApplicable("no sample".into()) } else { Values::Whole(whole.snr()) };
        Ok(vec![measured("snr_db", Values::PerSample(snapshots)), measured("snr_all_db", over_all)])
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::Channel]
    }

    fn scope(&self) -> Scope {
        Scope::Energies
    }

    fn energies(&self, evaluation: &Evaluation<'_>) -> Result<Vec<[f64; 2]>> {
        check_paired(evaluation)?;
        let both = evaluation.predictions.iter().zip(evaluation.truths);
        Ok(both.map(|(p, t)| Energies::of(p, t)).map(|Energies { error, signal }| [error, signal]).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_kind, plane, scene, spectra, value};
    use pwrfgs_core::Link;

    #[test]
    fn power_error_is_difference_in_decibels() {
        let power = |dbm| Image { width: 1, height: 1, pixels: vec![dbm] };
        let measured = of_kind(&PowerError {}, Task::Power, &power(-70.5), &power(-60.0));
        assert_eq!((value(&measured[0]), measured[0].unit.as_str()), (10.5, "dB"));
        let other = of_kind(&PowerError {}, Task::Channel, &power(1.0), &power(1.0));
        assert!(matches!(&other[0].values, Values::NotApplicable(why) if why.contains("channels")));
    }

    #[test]
    fn snapshots_are_summed_over_their_links() {
        let channel = |re, im| Image { width: 1, height: 2, pixels: vec![re, im] };
        let truths = [channel(3.0, 4.0), channel(0.0, 5.0), channel(1.0, 0.0)];
        let predictions = [channel(3.0, 4.0), channel(1.0, 5.0), channel(0.0, 0.0)];
        let links = [(0, 0), (0, 1), (1, 0)].map(|(location, receiver)| Link { location, receiver });
        let (plane, scene) = (plane(1, 2), scene(&[]));
        let evaluation = Evaluation {
            task: Task::Channel,
            links: &links,
            predictions: &predictions,
            truths: &truths,
            ..spectra(&plane, &scene)
        };
        let measured = ChannelSnr {}.evaluate(&evaluation).unwrap();
        let first = -10.0 * (1.0_f64 / 50.0).log10();
        assert_eq!(measured[0].values, Values::PerSample(vec![first, first, 0.0]));
        assert_eq!(measured[1].values, Values::Whole(-10.0 * (2.0_f64 / 51.0).log10()));
        let exact = Evaluation { predictions: &truths, ..evaluation };
        assert_eq!(ChannelSnr {}.evaluate(&exact).unwrap()[1].values, Values::Whole(PERFECT));
        assert!(Energies { error: f64::NAN, signal: 1.0 }.snr().is_nan());
    }
}
