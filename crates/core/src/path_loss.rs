//! `PathLoss`: received power over the distance to the receiver, in decibels per decade.

use crate::neighbours::distance;

/// Minimum distance, metres: the model is singular at the receiver.
const NEAREST_M: f64 = 0.01;

/// Path-loss model RSSI = level - slope log10(d / m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathLoss {
    /// T, dBm at 1 m.
    pub level: f64,
    /// 10 gamma, dB per decade.
    pub slope: f64,
}

impl PathLoss {
    /// Fits (log10 of the distance, dBm) by least squares; a constant if all distances are equal.
    pub fn fit(points: &[(f64, f64)]) -> Self {
        Self::with_offsets(&[points]).0
    }

    /// Fits one slope for several groups, with one level per group: (model of the first group, level of each). A group
    /// without points gets the mean level of all points.
    pub fn with_offsets(groups: &[&[(f64, f64)]]) -> (Self, Vec<f64>) {
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

    /// Power in dBm at a distance, given as its logarithm.
    pub fn at(&self, log_m: f64) -> f64 {
        self.level - self.slope * log_m
    }
}

/// Returns log10 of the distance between two positions, metres.
pub fn log_distance(from: [f64; 3], to: [f64; 3]) -> f64 {
    distance(from, to).max(NEAREST_M).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fits_path_loss_and_returns_constant_if_degenerate() {
        let law = PathLoss { level: -40.0, slope: 21.0 };
        let on = |law: PathLoss, xs: &[f64]| xs.iter().map(|x| (*x, law.at(*x))).collect::<Vec<_>>();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} instead of {b}");
        let found = PathLoss::fit(&on(law, &[0.1, 0.5, 1.3]));
        close(found.level, -40.0);
        close(found.slope, 21.0);
        assert_eq!(PathLoss::fit(&[(0.5, -60.0), (0.5, -62.0)]), PathLoss { level: -61.0, slope: 0.0 });
        let other = on(PathLoss { level: -50.0, ..law }, &[0.7, 0.9]);
        let (shared, levels) = PathLoss::with_offsets(&[&on(law, &[0.1, 1.0]), &other, &[]]);
        close(shared.slope, 21.0);
        close(levels[0], -40.0);
        close(levels[1], -50.0);
        close(levels[2], -45.0);
    }
}
