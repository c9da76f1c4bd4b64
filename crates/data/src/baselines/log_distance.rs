//! `LogDistance`: power falls with distance, and nothing else is known: by 10 gamma decibels with each factor of ten.

use super::all_of;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::words::clean;
use pwrfgs_core::{Baseline, Dataset, Error, Image, JsonSchema, Known, Predict, Query, Real, Result, Task};
use serde::{Deserialize, Serialize};

/// Links that a receiver needs to have a law of its own.
const FEW: usize = 3;

/// A law of distance by least squares: RSSI = T - 10 gamma log10(d), with d in metres from transmitter to receiver.
///
/// One T and one gamma for all receivers is what NeRF2 calls MRI. With `offset` each receiver has a T of its own, its
/// gain, and gamma is shared; with `per_receiver` each has T and gamma of its own. A receiver with fewer than
/// three training links has the shared gamma and an offset from the links it has; one without any has the T of all
/// training links together. A note under the table names such receivers. It is for received powers alone.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("LogDistance()").unwrap().name(), "log-distance");
/// let text = "LogDistance(per_receiver: true)";
/// assert_eq!(Plugin::<dyn Baseline>::parse(text).unwrap().name(), "log-distance, per receiver");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LogDistance {
    /// Whether T and gamma are fitted for each receiver.
    pub per_receiver: bool,
    /// Whether T alone is fitted for each receiver; `per_receiver` does that too.
    pub offset: bool,
}

#[typetag::serde]
impl Baseline for LogDistance {
    fn name(&self) -> String {
        match (self.per_receiver, self.offset) {
            (true, _) => "log-distance, per receiver".into(),
            (_, true) => "log-distance, offset".into(),
            _ => "log-distance".into(),
        }
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if data.task().is_scalar && data.placed {
            return Ok(());
        }
        let holds = if data.placed { data.task().plural } else { "no places of transmitters" };
        let what =
            format!("LogDistance() is a law of received powers at known places, and {} holds {holds}", data.title);
        Err(Error::Config(format!("{what}; remove it from `baselines`")))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let mut own = vec![Vec::new(); data.scene.receivers.len()];
        all_of(known)?.into_iter().for_each(|i| own[data.links[i].receiver].push(i));
        let own: Vec<Vec<(f64, f64)>> = own.iter().map(|links| points(data, links)).collect();
        let groups: Vec<&[(f64, f64)]> = own.iter().map(Vec::as_slice).collect();
        let (shared, levels) = Law::with_offsets(&groups);
        let one = Law::fit(&groups.concat());
        let law = |(points, level): (&&[(f64, f64)], f64)| match points.len() {
            FEW.. if self.per_receiver => Law::fit(points),
            _ if self.per_receiver || self.offset => Law { level, ..shared },
            _ => one,
        };
        let of_each = groups.iter().zip(levels).map(law).collect();
        let enough = if self.per_receiver { FEW } else { usize::from(self.offset) };
        let names = data.scene.receivers.iter().map(|receiver| clean(&receiver.name));
        let borrowed = names.zip(&groups).filter(|(_, own)| own.len() < enough).map(|(name, _)| name).collect();
        Ok(Box::new(Laws { data, of_each, borrowed }))
    }

    fn supports(&self, task: Task) -> bool {
        task.is_scalar
    }
}

struct Laws<'a> {
    data: &'a Dataset,
    of_each: Vec<Law>,
    /// Receivers with too few links for a law of their own.
    borrowed: Vec<String>,
}

impl Predict for Laws<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let law = self.of_each.get(query.receiver).or(self.of_each.first()).expect("data have a receiver");
        let dbm = law.at(log_distance(self.data, query));
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }

    fn note(&self) -> Option<String> {
        let names = self.borrowed.join(", ");
        (!names.is_empty()).then(|| {
            format!("{names} has too few training links for a law of distance of its own and shares that of the others")
        })
    }
}

/// Transmitters nearer than this count as this far, metres: at the receiver the law has no value.
const NEAREST_M: f64 = 0.01;

/// RSSI = level - slope log10(d / m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Law {
    /// T, dBm at a metre.
    pub(super) level: f64,
    /// 10 gamma, dB a factor of ten.
    pub(super) slope: f64,
}

impl Law {
    /// By least squares of (log10 of the distance, dBm); a constant where all distances are alike.
    pub(super) fn fit(points: &[(f64, f64)]) -> Self {
        Self::with_offsets(&[points]).0
    }

    /// One slope for several groups, each with a level of its own: the law of the first and the level of each. A group
    /// without points has the mean level of all points.
    pub(super) fn with_offsets(groups: &[&[(f64, f64)]]) -> (Self, Vec<f64>) {
        let mean = |points: &[(f64, f64)]| {
            let n = points.len().max(1) as f64;
            (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n)
        };
        let means: Vec<(f64, f64)> = groups.iter().map(|points| mean(points)).collect();
        let (mut spread, mut fall) = (0.0, 0.0);
        for (points, (x_mean, y_mean)) in groups.iter().zip(&means) {
            for (x, y) in *points {
                spread += (x - x_mean) * (x - x_mean);
                fall -= (x - x_mean) * (y - y_mean);
            }
        }
        let slope = if spread > 1e-9 { fall / spread } else { 0.0 };
        let level = |(x, y): (f64, f64)| y + slope * x;
        let of_all = level(mean(&groups.concat()));
        let levels: Vec<f64> =
            groups.iter().zip(means).map(|(points, m)| if points.is_empty() { of_all } else { level(m) }).collect();
        (Self { level: levels.first().copied().unwrap_or(of_all), slope }, levels)
    }

    /// dBm at a distance, given as its logarithm.
    pub(super) fn at(&self, log_m: f64) -> f64 {
        self.level - self.slope * log_m
    }
}

/// log10 of the distance from transmitter to receiver, metres.
pub(super) fn log_distance(data: &Dataset, query: Query<'_>) -> f64 {
    let receiver = data.scene.receivers.get(query.receiver).map_or([0.0; 3], |receiver| receiver.pose.position);
    let origin = data.scene.origin.0;
    let receiver = [0, 1, 2].map(|k| receiver[k] + origin[k]);
    distance(query.tx, receiver).max(NEAREST_M).log10()
}

/// (log10 of the distance, dBm) of links of powers.
pub(super) fn points(data: &Dataset, links: &[usize]) -> Vec<(f64, f64)> {
    let point = |&i: &usize| (log_distance(data, data.query(i)), data.image(i).pixels[0] as f64);
    links.iter().map(point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn laws_are_found_and_degenerate_ones_are_constants() {
        let law = Law { level: -40.0, slope: 21.0 };
        let on = |law: Law, xs: &[f64]| xs.iter().map(|x| (*x, law.at(*x))).collect::<Vec<_>>();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} instead of {b}");
        let found = Law::fit(&on(law, &[0.1, 0.5, 1.3]));
        close(found.level, -40.0);
        close(found.slope, 21.0);
        assert_eq!(Law::fit(&[(0.5, -60.0), (0.5, -62.0)]), Law { level: -61.0, slope: 0.0 });
        let other = on(Law { level: -50.0, ..law }, &[0.7, 0.9]);
        let (shared, levels) = Law::with_offsets(&[&on(law, &[0.1, 1.0]), &other, &[]]);
        close(shared.slope, 21.0);
        close(levels[0], -40.0);
        close(levels[1], -50.0);
        close(levels[2], -45.0);
    }
}
