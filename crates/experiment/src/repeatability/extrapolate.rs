//! Extrapolation of pairs at small distances to distance zero.

use super::pairs::SamplePair;
use crate::statistics::Summary;
use pwrfgs_core::Goal;
use std::collections::BTreeMap;

/// Largest number of consecutive samples in a block, since samples close in time are correlated.
const BLOCK: usize = 64;
/// Smallest number of blocks for few samples.
const BLOCKS: usize = 50;
/// Half-width of a 95 % interval, in standard deviations.
const DEVIATIONS: f64 = 1.96;

/// Metric of pairs, extrapolated to distance zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZeroDistanceEstimate {
    /// Summary over pairs.
    pub summary: Summary,
    /// 95 % confidence interval of the mean.
    pub interval: [f64; 2],
}

/// Reference values of a metric.
pub(super) struct MetricScale {
    pub(super) goal: Goal,
    /// Score of a spectrum as a prediction of itself.
    pub(super) best: f64,
    /// Mean score between unrelated spectra.
    pub(super) unrelated: f64,
}

impl MetricScale {
    /// Moves `value` of a pair from a mean of `from` to a mean of `to`: its deficit to the best value scales like
    /// that of the mean. With an infinite best value it is shifted by the change of the mean. If `from` is the best value,
    /// it is unchanged.
    fn rescale(&self, value: f64, from: f64, to: f64) -> f64 {
        match (self.best - to) / (self.best - from) {
            factor if factor.is_finite() => self.best - (self.best - value) * factor,
            _ if self.best.is_finite() => value,
            _ => value + to - from,
        }
    }

    /// Extrapolates the `values` of at least one pair to distance zero: a straight line over distance, weighted towards
    /// near pairs, gives the mean; values moved along it give median and tail percentile.
    ///
    /// # Errors
    /// The pairs do not determine the mean; the message gives the reason.
    pub(super) fn extrapolate(&self, pairs: &[SamplePair], values: &[f64]) -> Result<ZeroDistanceEstimate, String> {
        if values.iter().any(|value| !value.is_finite()) {
            return Err("some pairs have values that are not finite".into());
        }
        let reach = pairs.iter().fold(0.0, |reach: f64, pair| reach.max(pair.distance));
        // The factor 1.01 gives the farthest pair a weight too.
        let weights: Vec<f64> = pairs.iter().map(|pair| tricube(pair.distance / (1.01 * reach))).collect();
        let line = FittedLine::weighted_fit(pairs, values, &weights)
            .ok_or_else(|| format!("all pairs are {:.1} mm apart, none is closer", reach * 1e3))?;
        // A line extrapolated by more than half of the observed range towards unrelated spectra is unreliable.
        if (line.at_zero - line.mean).abs() > 0.5 * (line.mean - self.unrelated).abs() {
            let reason = "the closest pairs agree too little: they are up to";
            return Err(format!("{reason} {:.1} mm apart", reach * 1e3));
        }
        let capped = |value: f64| match self.goal {
            Goal::Higher => value.min(self.best),
            Goal::Lower => value.max(self.best),
        };
        let mean = capped(line.at_zero);
        let moved = |(pair, value): (&SamplePair, &f64)| {
            let fitted = line.at_zero + line.slope * pair.distance;
            self.rescale(*value, capped(fitted), mean)
        };
        let moved: Vec<f64> = pairs.iter().zip(values).map(moved).collect();
        let summary = Summary { mean, ..Summary::of(&moved, self.goal == Goal::Higher) };
        let half = DEVIATIONS * line.at_zero_deviation(pairs, values, &weights);
        let interval = [line.at_zero - half, line.at_zero + half].map(capped);
        Ok(ZeroDistanceEstimate { summary, interval })
    }
}

/// Returns the tricube weight (1 − t³)³ of a distance `t`, relative to the farthest: 1 at zero, 0 at one. 1 for NaN, if all
/// distances are zero.
fn tricube(t: f64) -> f64 {
    if t > 0.0 { (1.0 - t.powi(3)).powi(3) } else { 1.0 }
}

/// Straight line by weighted least squares.
struct FittedLine {
    /// Value at distance zero.
    at_zero: f64,
    /// Change of the value per metre.
    slope: f64,
    /// Weighted mean of the values.
    mean: f64,
    /// Weighted mean of the distances, metres.
    distance: f64,
    /// Weighted variance of the distances, square metres.
    spread: f64,
}

impl FittedLine {
    /// Fits the line to `values` over the distances of `pairs`; constant if all distances are zero, `None` if they are
    /// equal otherwise.
    fn weighted_fit(pairs: &[SamplePair], values: &[f64], weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let mean_of =
            |value: &dyn Fn(usize) -> f64| (0..pairs.len()).map(|k| weights[k] * value(k)).sum::<f64>() / total;
        let (mean, distance) = (mean_of(&|k| values[k]), mean_of(&|k| pairs[k].distance));
        let spread = mean_of(&|k| (pairs[k].distance - distance).powi(2));
        if distance == 0.0 {
            return Some(Self { at_zero: mean, slope: 0.0, mean, distance, spread: 1.0 }); // any spread: offsets are 0
        }
        // Distances within a thousandth of each other do not determine a slope.
        if spread < 1e-6 * distance * distance {
            return None;
        }
        let slope = mean_of(&|k| (pairs[k].distance - distance) * (values[k] - mean)) / spread;
        Some(Self { at_zero: mean - slope * distance, slope, mean, distance, spread })
    }

    /// Estimates the standard deviation of `at_zero`. Pairs that share a block of samples are dependent: it uses the
    /// variance for dyads of Aronow, Samii and Assenova (Political Analysis 23, 2015), with blocks of neighbouring
    /// samples as nodes.
    fn at_zero_deviation(&self, pairs: &[SamplePair], values: &[f64], weights: &[f64]) -> f64 {
        let samples = pairs.iter().fold(0, |most, pair| most.max(pair.later)) + 1;
        let length = (samples / BLOCKS).clamp(1, BLOCK);
        let total: f64 = weights.iter().sum();
        // Influence of the residual of each pair on the line at zero, summed by pairs of blocks, and by blocks.
        let (mut dyads, mut blocks): (BTreeMap<(usize, usize), f64>, BTreeMap<usize, f64>) = Default::default();
        for ((pair, value), weight) in pairs.iter().zip(values).zip(weights) {
            let offset = pair.distance - self.distance;
            let residual = value - self.mean - self.slope * offset;
            let influence = weight / total * residual * (1.0 - self.distance * offset / self.spread);
            let (a, b) = (pair.earlier / length, pair.later / length);
            *dyads.entry((a, b)).or_default() += influence;
            *blocks.entry(a).or_default() += influence;
            if a != b {
                *blocks.entry(b).or_default() += influence;
            }
        }
        let squares = |influence: f64| influence * influence;
        // A pair of two blocks was counted with each of them.
        let twice: f64 = dyads.iter().filter(|((a, b), _)| a != b).map(|(_, influence)| squares(*influence)).sum();
        let single: f64 = dyads.values().copied().map(squares).sum();
        let shared = blocks.values().copied().map(squares).sum::<f64>() - twice;
        shared.max(single).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HIGHER: MetricScale = MetricScale { goal: Goal::Higher, best: 1.0, unrelated: 0.0 };

    fn pair(earlier: usize, later: usize, distance: f64) -> SamplePair {
        SamplePair { earlier, later, distance }
    }

    #[test]
    fn extrapolates_linear_trend_to_zero_distance() {
        let pairs: Vec<SamplePair> = (1..=30).map(|k| pair(k, k + 40, f64::from(k as u32) * 1e-3)).collect();
        let values: Vec<f64> = pairs.iter().map(|pair| 0.8 - 3.0 * pair.distance).collect();
        let estimate = HIGHER.extrapolate(&pairs, &values).unwrap();
        for (value, expected) in [
            (estimate.summary.mean, 0.8),
            (estimate.summary.median, 0.8),
            (estimate.summary.tail10, 0.8),
            (estimate.interval[1], 0.8),
        ] {
            assert!((value - expected).abs() < 1e-12, "{value}");
        }
        let over: Vec<f64> = values.iter().map(|value| value + 0.25).collect();
        assert_eq!(
            HIGHER.extrapolate(&pairs, &over).unwrap().summary.mean,
            1.0,
            "no pair is more alike than a spectrum to itself"
        );
        assert!(
            (HIGHER.rescale(0.7, 0.7, 0.8) - 0.8).abs() < 1e-12 && (HIGHER.rescale(1.0, 0.7, 0.8) - 1.0).abs() < 1e-12
        );
        let psnr = MetricScale { best: f64::INFINITY, ..HIGHER };
        assert_eq!((psnr.rescale(30.0, 20.0, 25.0), HIGHER.rescale(0.5, 1.0, 1.0)), (35.0, 0.5));
        let error = MetricScale { goal: Goal::Lower, best: 0.0, unrelated: 1.0 };
        let errors: Vec<f64> = pairs.iter().map(|pair| 0.1 + 2.0 * pair.distance).collect();
        assert!((error.extrapolate(&pairs, &errors).unwrap().summary.mean - 0.1).abs() < 1e-12);
    }

    #[test]
    fn coincident_pairs_need_no_extrapolation() {
        let pairs: Vec<SamplePair> = (0..40).map(|k| pair(k, k + 100, 0.0)).collect();
        let values: Vec<f64> = (0..40).map(|k| if k < 30 { 0.9 } else { 0.5 }).collect();
        let estimate = HIGHER.extrapolate(&pairs, &values).unwrap();
        assert!(
            (estimate.summary.mean - 0.8).abs() < 1e-12
                && estimate.summary.median == 0.9
                && estimate.summary.tail10 == 0.5,
            "{estimate:?}"
        );
    }

    /// Pairs that share a sample carry less information than pairs that share none.
    #[test]
    fn interval_accounts_for_pairs_with_shared_samples() {
        let values: Vec<f64> = (0..40).map(|k| 0.6 + 0.1 * f64::from(k % 2)).collect();
        let width = |ends: &dyn Fn(usize) -> (usize, usize)| {
            let pairs: Vec<SamplePair> =
                (0..40).map(|k| (ends(k).0, ends(k).1)).map(|(a, b)| pair(a, b, 0.0)).collect();
            let [low, high] = HIGHER.extrapolate(&pairs, &values).unwrap().interval;
            high - low
        };
        let apart = width(&|k| (k, 3000 + 64 * k));
        // Two samples, one in all pairs of 0.6, the other in all of 0.7: two independent values, not forty.
        let shared = width(&|k| (k % 2 * 200, 3000 + 64 * k));
        assert!((apart - 2.0 * 1.96 * 0.05 / 40f64.sqrt()).abs() < 1e-9, "{apart}");
        assert!((shared - 2.0 * 1.96 * 0.05 / 2f64.sqrt()).abs() < 1e-9, "{shared}");
    }

    #[test]
    fn extrapolation_fails_with_reason() {
        let grid: Vec<SamplePair> = (0..40).map(|k| pair(k, k + 40, 0.01)).collect();
        let why = HIGHER.extrapolate(&grid, &[0.5; 40]).unwrap_err();
        assert_eq!(why, "all pairs are 10.0 mm apart, none is closer");
        let steep: Vec<SamplePair> = (0..40).map(|k| pair(k, k + 40, 0.01 + 1e-4 * f64::from(k as u32))).collect();
        let values: Vec<f64> = steep.iter().map(|pair| 0.9 - 60.0 * pair.distance).collect();
        let why = HIGHER.extrapolate(&steep, &values).unwrap_err();
        assert!(why.starts_with("the closest pairs agree too little"), "{why}");
        let why = HIGHER.extrapolate(&grid, &[f64::INFINITY; 40]).unwrap_err();
        assert_eq!(why, "some pairs have values that are not finite");
    }
}
