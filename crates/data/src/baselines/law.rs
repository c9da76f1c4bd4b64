//! The law of distance: a power in dBm falls by 10 gamma decibels with each factor of ten.

use pwrfgs_core::{Dataset, Query, neighbours::distance};

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
