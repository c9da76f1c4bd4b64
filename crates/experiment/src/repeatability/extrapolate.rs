//! From pairs at small distances to distance zero.

use super::pairs::Pair;
use crate::statistics::Summary;
use pwrfgs_core::Goal;
use std::collections::BTreeMap;

/// Most samples that count as one, since what is measured within a moment is alike.
const BLOCK: usize = 64;
/// Least number of such blocks, where samples are few.
const BLOCKS: usize = 50;
/// Standard deviations on either side that hold 95 %.
const DEVIATIONS: f64 = 1.96;

/// A metric of pairs at distance zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtZero {
    /// Over pairs.
    pub summary: Summary,
    /// Where the mean lies with 95 % confidence.
    pub interval: [f64; 2],
}

/// What the values of a metric mean.
pub(super) struct Scale {
    pub(super) goal: Goal,
    /// Of a spectrum and itself.
    pub(super) best: f64,
    /// Mean over spectra that have nothing to do with each other.
    pub(super) unrelated: f64,
}

impl Scale {
    /// `value` of a pair, where the mean is `there`, as it would be where the mean is `here`: what it lacks of the best
    /// grows or shrinks as what the mean lacks does. Where the best is infinite it moves as far as the mean.
    fn moved(&self, value: f64, there: f64, here: f64) -> f64 {
        match (self.best - here) / (self.best - there) {
            part if part.is_finite() => self.best - (self.best - value) * part,
            _ if self.best.is_finite() => value,
            _ => value + here - there,
        }
    }
}

/// A straight line through `values` against distance, near pairs weighing most, gives the mean; the values moved with it to
/// distance zero give median and bad tail. There is at least one pair.
pub(super) fn at_zero(pairs: &[Pair], values: &[f64], scale: &Scale) -> Result<AtZero, String> {
    if values.iter().any(|value| !value.is_finite()) {
        return Err("some pairs have no finite value".into());
    }
    let reach = pairs.iter().fold(0.0, |reach: f64, pair| reach.max(pair.distance));
    let weights: Vec<f64> = pairs.iter().map(|pair| tricube(pair.distance / (1.01 * reach))).collect();
    let line = Line::through(pairs, values, &weights)
        .ok_or_else(|| format!("all pairs are {:.1} mm apart, none is closer", reach * 1e3))?;
    // A line that goes on for longer than half of what was seen on the way from unrelated spectra is a guess.
    if (line.at_zero - line.mean).abs() > 0.5 * (line.mean - scale.unrelated).abs() {
        let what = "the closest pairs have too little in common for it: they are up to";
        return Err(format!("{what} {:.1} mm apart", reach * 1e3));
    }
    let capped = |value: f64| match scale.goal {
        Goal::Higher => value.min(scale.best),
        Goal::Lower => value.max(scale.best),
    };
    let mean = capped(line.at_zero);
    let moved = |(pair, value): (&Pair, &f64)| {
        let there = line.at_zero + line.slope * pair.distance;
        scale.moved(*value, capped(there), mean)
    };
    let moved: Vec<f64> = pairs.iter().zip(values).map(moved).collect();
    let summary = Summary { mean, ..Summary::of(&moved, scale.goal == Goal::Higher) };
    let half = DEVIATIONS * line.deviation(pairs, values, &weights);
    let interval = [line.at_zero - half, line.at_zero + half].map(capped);
    Ok(AtZero { summary, interval })
}

/// 1 at zero, 0 at one; for NaN, where all distances are zero, 1.
fn tricube(part: f64) -> f64 {
    if part > 0.0 { (1.0 - part.powi(3)).powi(3) } else { 1.0 }
}

/// A straight line by weighted least squares.
struct Line {
    at_zero: f64,
    slope: f64,
    /// Weighted mean of the values, of the distances, and the variance of these.
    mean: f64,
    distance: f64,
    spread: f64,
}

impl Line {
    /// `None` where the distances are all the same and not zero.
    fn through(pairs: &[Pair], values: &[f64], weights: &[f64]) -> Option<Self> {
        let total: f64 = weights.iter().sum();
        let mean_of = |of: &dyn Fn(usize) -> f64| (0..pairs.len()).map(|k| weights[k] * of(k)).sum::<f64>() / total;
        let (mean, distance) = (mean_of(&|k| values[k]), mean_of(&|k| pairs[k].distance));
        let spread = mean_of(&|k| (pairs[k].distance - distance).powi(2));
        if distance == 0.0 {
            return Some(Self { at_zero: mean, slope: 0.0, mean, distance, spread: 1.0 });
        }
        // A thousandth of the distance is no range to see a slope over.
        if spread < 1e-6 * distance * distance {
            return None;
        }
        let slope = mean_of(&|k| (pairs[k].distance - distance) * (values[k] - mean)) / spread;
        Some(Self { at_zero: mean - slope * distance, slope, mean, distance, spread })
    }

    /// Standard deviation of `at_zero`. Pairs that share a block of samples are not independent: the variance for dyads of
    /// Aronow, Samii and Assenova (Political Analysis 23, 2015), with blocks of neighbouring samples for nodes.
    fn deviation(&self, pairs: &[Pair], values: &[f64], weights: &[f64]) -> f64 {
        let samples = pairs.iter().fold(0, |most, pair| most.max(pair.later)) + 1;
        let length = (samples / BLOCKS).clamp(1, BLOCK);
        let total: f64 = weights.iter().sum();
        // What each pair's residual moves the line by at zero, summed by pairs of blocks, and by blocks.
        let (mut dyads, mut blocks): (BTreeMap<(usize, usize), f64>, BTreeMap<usize, f64>) = Default::default();
        for ((pair, value), weight) in pairs.iter().zip(values).zip(weights) {
            let aside = pair.distance - self.distance;
            let residual = value - self.mean - self.slope * aside;
            let moves = weight / total * residual * (1.0 - self.distance * aside / self.spread);
            let (a, b) = (pair.earlier / length, pair.later / length);
            *dyads.entry((a, b)).or_default() += moves;
            *blocks.entry(a).or_default() += moves;
            if a != b {
                *blocks.entry(b).or_default() += moves;
            }
        }
        let squares = |moves: f64| moves * moves;
        // A pair of two blocks was counted with each of them.
        let twice: f64 = dyads.iter().filter(|((a, b), _)| a != b).map(|(_, moves)| squares(*moves)).sum();
        let single: f64 = dyads.values().copied().map(squares).sum();
        let shared = blocks.values().copied().map(squares).sum::<f64>() - twice;
        shared.max(single).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HIGHER: Scale = Scale { goal: Goal::Higher, best: 1.0, unrelated: 0.0 };

    fn pair(earlier: usize, later: usize, distance: f64) -> Pair {
        Pair { earlier, later, distance }
    }

    #[test]
    fn a_line_is_followed_to_zero() {
        let pairs: Vec<Pair> = (1..=30).map(|k| pair(k, k + 40, f64::from(k as u32) * 1e-3)).collect();
        let values: Vec<f64> = pairs.iter().map(|pair| 0.8 - 3.0 * pair.distance).collect();
        let found = at_zero(&pairs, &values, &HIGHER).unwrap();
        for (found, expected) in
            [(found.summary.mean, 0.8), (found.summary.median, 0.8), (found.summary.p10, 0.8), (found.interval[1], 0.8)]
        {
            assert!((found - expected).abs() < 1e-12, "{found}");
        }
        let over: Vec<f64> = values.iter().map(|value| value + 0.25).collect();
        assert_eq!(
            at_zero(&pairs, &over, &HIGHER).unwrap().summary.mean,
            1.0,
            "no pair is more alike than a spectrum to itself"
        );
        assert!((HIGHER.moved(0.7, 0.7, 0.8) - 0.8).abs() < 1e-12 && (HIGHER.moved(1.0, 0.7, 0.8) - 1.0).abs() < 1e-12);
        let psnr = Scale { best: f64::INFINITY, ..HIGHER };
        assert_eq!((psnr.moved(30.0, 20.0, 25.0), HIGHER.moved(0.5, 1.0, 1.0)), (35.0, 0.5));
        let error = Scale { goal: Goal::Lower, best: 0.0, unrelated: 1.0 };
        let errors: Vec<f64> = pairs.iter().map(|pair| 0.1 + 2.0 * pair.distance).collect();
        assert!((at_zero(&pairs, &errors, &error).unwrap().summary.mean - 0.1).abs() < 1e-12);
    }

    #[test]
    fn pairs_at_one_place_need_no_line() {
        let pairs: Vec<Pair> = (0..40).map(|k| pair(k, k + 100, 0.0)).collect();
        let values: Vec<f64> = (0..40).map(|k| if k < 30 { 0.9 } else { 0.5 }).collect();
        let found = at_zero(&pairs, &values, &HIGHER).unwrap();
        assert!(
            (found.summary.mean - 0.8).abs() < 1e-12 && found.summary.median == 0.9 && found.summary.p10 == 0.5,
            "{found:?}"
        );
    }

    /// Pairs that share a sample are worth less than as many that share none.
    #[test]
    fn the_interval_knows_which_pairs_share_samples() {
        let values: Vec<f64> = (0..40).map(|k| 0.6 + 0.1 * f64::from(k % 2)).collect();
        let width = |of: &dyn Fn(usize) -> (usize, usize)| {
            let pairs: Vec<Pair> = (0..40).map(|k| (of(k).0, of(k).1)).map(|(a, b)| pair(a, b, 0.0)).collect();
            let [low, high] = at_zero(&pairs, &values, &HIGHER).unwrap().interval;
            high - low
        };
        let apart = width(&|k| (k, 3000 + 64 * k));
        // Two samples, one in all pairs of 0.6, the other in all of 0.7: two numbers, not forty.
        let shared = width(&|k| (k % 2 * 200, 3000 + 64 * k));
        assert!((apart - 2.0 * 1.96 * 0.05 / 40f64.sqrt()).abs() < 1e-9, "{apart}");
        assert!((shared - 2.0 * 1.96 * 0.05 / 2f64.sqrt()).abs() < 1e-9, "{shared}");
    }

    #[test]
    fn what_nobody_can_tell_is_refused() {
        let grid: Vec<Pair> = (0..40).map(|k| pair(k, k + 40, 0.01)).collect();
        let why = at_zero(&grid, &[0.5; 40], &HIGHER).unwrap_err();
        assert_eq!(why, "all pairs are 10.0 mm apart, none is closer");
        let steep: Vec<Pair> = (0..40).map(|k| pair(k, k + 40, 0.01 + 1e-4 * f64::from(k as u32))).collect();
        let values: Vec<f64> = steep.iter().map(|pair| 0.9 - 60.0 * pair.distance).collect();
        let why = at_zero(&steep, &values, &HIGHER).unwrap_err();
        assert!(why.starts_with("the closest pairs have too little in common"), "{why}");
        let why = at_zero(&grid, &[f64::INFINITY; 40], &HIGHER).unwrap_err();
        assert_eq!(why, "some pairs have no finite value");
    }
}
