//! `IntervalCalibration`: prediction intervals by split conformal prediction (Vovk, Gammerman and Shafer, Algorithmic
//! Learning in a Random World, 2005), with blocks of links as units.
//!
//! A score is the absolute error of a link that the predictor was not fitted to, in units of its deviation. All K blocks
//! have the same weight 1/(K+1), and a next block has an infinite score (Lee, Barber and Willett, Distribution-free
//! inference with hierarchical data, 2023). If the blocks are exchangeable, a random value of a random link of the next
//! block is inside its interval with at least the probability `level`.

use crate::tensors::Tensors;
use pwrfgs_core::{Error, Image, Real, Result, Task};

/// Largest number of scores that are kept per link.
const LINK_SCORES: usize = 256;
/// Largest number of scores that are kept per calibration.
const MOST_SCORES: usize = 1_000;
/// Rounding error of the sums of weights.
const ROUNDING: f64 = 1e-6;
/// Smallest deviation, dB or parts of the full scale: scores stay finite.
const LEAST: f64 = 1e-6;

/// Names of the tensors.
const BLOCKS: &str = "calibration.blocks";
const VALUES: &str = "calibration.values";
const SSIM: &str = "calibration.ssim";

/// Distribution of scores: ascending scores, each with the share of scores up to it; the last share is 1.
type Distribution = Vec<[Real; 2]>;

/// Scores of a link that a predictor was not fitted to.
#[derive(Clone, Debug)]
pub struct HeldOutScores {
    /// Errors of the values in units of the deviation.
    values: Distribution,
    /// 1 - SSIM in units of the deviation; `None` without pixels.
    ssim: Option<f64>,
}

impl HeldOutScores {
    /// Compares a prediction, as it is shown, with the measurement. `deviation` is that of [`Predict::deviation`].
    ///
    /// [`Predict::deviation`]: pwrfgs_core::Predict::deviation
    pub fn of(task: Task, prediction: &Image, deviation: f64, truth: &Image) -> Self {
        let deviation = deviation.max(LEAST);
        let score = |(p, t): (&Real, &Real)| ((*p as f64 - *t as f64).abs() / deviation, 1.0);
        let values =
            weighted_distribution(prediction.pixels.iter().zip(&truth.pixels).map(score).collect(), LINK_SCORES);
        Self { values, ssim: task.ssim(prediction, truth).map(|score| (1.0 - score).max(0.0) / deviation) }
    }
}

/// Scores of known links in blocks, for prediction intervals of any level.
#[derive(Clone, Debug, PartialEq)]
pub struct IntervalCalibration {
    blocks: usize,
    values: Distribution,
    /// `None` without pixels.
    ssim: Option<Distribution>,
}

/// Factors from the deviation of a prediction to its interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntervalFactors {
    /// Factor to half the width.
    pub half_width: f64,
    /// Factor to the largest difference of the SSIM from 1; `None` without pixels.
    pub ssim: Option<f64>,
}

/// Prediction interval of an observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Interval {
    /// Lower ends, one per value.
    pub lower: Image,
    /// Upper ends, one per value.
    pub upper: Image,
    /// Lower bound of the SSIM; `None` without pixels.
    pub ssim: Option<f64>,
}

impl IntervalFactors {
    /// Returns the interval of a prediction, as it is shown, with its deviation. Intervals of pixels end at 0 and 1.
    pub fn interval(&self, task: Task, prediction: &Image, deviation: f64) -> Interval {
        let deviation = deviation.max(LEAST);
        let half = self.half_width * deviation;
        let end = |half: f64| {
            let moved = prediction.pixels.iter().map(|p| (*p as f64 + half) as Real).collect();
            task.shown(Image { pixels: moved, ..*prediction })
        };
        let ssim = self.ssim.map(|factor| (1.0 - factor * deviation).max(-1.0));
        Interval { lower: end(-half), upper: end(half), ssim }
    }
}

/// Returns the distribution of scores, given as (score, weight). Of more than `most` scores, it holds the quantiles at
/// multiples of 1/`most`.
fn weighted_distribution(mut scores: Vec<(f64, f64)>, most: usize) -> Distribution {
    scores.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = scores.iter().map(|(_, weight)| weight).sum();
    let share = |reached: &mut f64, (score, weight): &(f64, f64)| {
        *reached += weight;
        Some((*score, *reached / total))
    };
    let shares: Vec<(f64, f64)> = scores.iter().scan(0.0, share).collect();
    let quantile = |k: usize| {
        let share = k as f64 / most as f64;
        let index = shares.partition_point(|(_, reached)| *reached < share - ROUNDING);
        (shares[index.min(shares.len() - 1)].0, share)
    };
    let quantiles = if shares.len() > most { (1..=most).map(quantile).collect() } else { shares.clone() };
    // Scores stay finite in a file of single precision, and rounded shares reach 1.
    let mut distribution: Distribution =
        quantiles.iter().map(|(score, share)| [score.min(f64::from(f32::MAX)) as Real, *share as Real]).collect();
    distribution.last_mut().into_iter().for_each(|last| last[1] = 1.0);
    distribution
}

impl IntervalCalibration {
    /// Creates the calibration of the blocks; empty ones do not count. `None` without a link.
    pub fn new(blocks: &[Vec<HeldOutScores>]) -> Option<Self> {
        let blocks: Vec<&Vec<HeldOutScores>> = blocks.iter().filter(|block| !block.is_empty()).collect();
        let weighted = || blocks.iter().flat_map(|block| block.iter().map(|link| (link, 1.0 / block.len() as f64)));
        let link_scores = |(link, weight): (&HeldOutScores, f64)| -> Vec<(f64, f64)> {
            let before = std::iter::once(0.0).chain(link.values.iter().map(|[_, share]| *share as f64));
            let scores = link.values.iter().zip(before);
            scores.map(|([score, share], before)| (*score as f64, weight * (*share as f64 - before))).collect()
        };
        let values = weighted_distribution(weighted().flat_map(link_scores).collect(), MOST_SCORES);
        let ssim: Option<Vec<(f64, f64)>> = weighted().map(|(link, weight)| Some((link.ssim?, weight))).collect();
        let ssim = ssim.map(|scores| weighted_distribution(scores, MOST_SCORES));
        (!values.is_empty()).then_some(Self { blocks: blocks.len(), values, ssim })
    }

    /// Returns the number of blocks.
    pub fn block_count(&self) -> usize {
        self.blocks
    }

    /// Returns the factors for intervals that hold with probability `level`.
    ///
    /// # Errors
    /// [`Error::Config`] if the level is not between 0 and 1, or needs more blocks.
    pub fn factors(&self, level: f64) -> Result<IntervalFactors> {
        if !(level > 0.0 && level < 1.0) {
            let problem = format!("interval level is {level}, expected a number above 0 and below 1, such as 0.9");
            return Err(Error::Config(problem));
        }
        let share = level * (self.blocks + 1) as f64 / self.blocks as f64;
        if share > 1.0 + ROUNDING {
            let (have, need) = (self.blocks, (level / (1.0 - level) - ROUNDING).ceil());
            // Rounded down to three decimals.
            let largest = (1000.0 * have as f64 / (have + 1) as f64).floor() / 1000.0;
            return Err(Error::Config(format!(
                "an interval of level {level} needs {need} calibration blocks, but the model has {have}; lower the level \
                 to {largest} or less, or train with more validation samples"
            )));
        }
        let factor = |distribution: &Distribution| {
            let index = distribution.partition_point(|[_, reached]| (*reached as f64) < share - ROUNDING);
            distribution[index.min(distribution.len() - 1)][0] as f64
        };
        Ok(IntervalFactors { half_width: factor(&self.values), ssim: self.ssim.as_ref().map(factor) })
    }

    /// Adds the tensors of the calibration to a file.
    pub(crate) fn put(&self, file: &mut Tensors) {
        file.put(BLOCKS, vec![1], vec![self.blocks as Real]);
        for (name, scores) in [(VALUES, Some(&self.values)), (SSIM, self.ssim.as_ref())] {
            scores.into_iter().for_each(|scores| file.put(name, vec![scores.len(), 2], scores.as_flattened().to_vec()));
        }
    }

    /// Takes the calibration of a model for `task` out of its file; `None` if there is none.
    ///
    /// # Errors
    /// A tensor is missing, has another shape or type, or holds invalid values; the message names it.
    pub(crate) fn take(file: &mut Tensors, task: Task) -> Result<Option<Self>, String> {
        if file.shape(BLOCKS).is_none() {
            return Ok(None);
        }
        let blocks = file.take(BLOCKS, &[1])?[0];
        if !(blocks >= 1.0 && blocks <= 1e6 as Real && blocks.fract() == 0.0) {
            return Err(format!("tensor `{BLOCKS}` holds {blocks}, expected a number of blocks from 1 to 1,000,000"));
        }
        let mut take = |name: &str| {
            let count = file.shape(name).and_then(|shape| shape.first().copied()).unwrap_or(0);
            let scores = file.take(name, &[count.max(1), 2])?.as_chunks().0.to_vec(); // rejects an empty tensor
            let is_ascending = scores.is_sorted_by(|a: &[Real; 2], b| a[0] <= b[0] && a[1] <= b[1]);
            if !is_ascending || scores[0].iter().any(|v| *v < 0.0) || scores[scores.len() - 1][1] != 1.0 {
                return Err(format!("tensor `{name}` holds no ascending scores and shares from 0 to 1"));
            }
            Ok(scores)
        };
        let values = take(VALUES)?;
        let ssim = task.has_pixels.then(|| take(SSIM)).transpose()?;
        Ok(Some(Self { blocks: blocks as usize, values, ssim }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;

    /// Powers with these errors in dB, and a deviation of 1 dB.
    fn block(errors: &[f64]) -> Vec<HeldOutScores> {
        let power = |v: f64| Image { width: 1, height: 1, pixels: vec![v as Real] };
        errors.iter().map(|e| HeldOutScores::of(Task::Power, &power(0.0), 1.0, &power(*e))).collect()
    }

    fn calibration(blocks: &[Vec<f64>]) -> IntervalCalibration {
        IntervalCalibration::new(&blocks.iter().map(|errors| block(errors)).collect::<Vec<_>>()).unwrap()
    }

    /// Scores stay finite and are never negative, so that every reader takes the file.
    #[test]
    fn exact_and_huge_errors_are_read_back() {
        let image = |v: Real| Image { width: 9, height: 9, pixels: vec![v; 81] };
        let link = |p: Real, t: Real| vec![HeldOutScores::of(Task::Spectrum, &image(p), 0.0, &image(t))];
        let written = IntervalCalibration::new(&[link(0.0, 0.0), link(0.3, 0.3), link(1e36, 0.0)]).unwrap();
        let mut file = Tensors::default();
        written.put(&mut file);
        assert_eq!(IntervalCalibration::take(&mut file, Task::Spectrum).unwrap().unwrap(), written);
    }

    /// One link per block: the factor is order statistic ⌈level · (K + 1)⌉ of the scores.
    #[test]
    fn factor_is_the_order_statistic_of_single_links() {
        for blocks in 1..60 {
            let calibration =
                calibration(&(0..blocks).map(|k| vec![((k + 7) % blocks + 1) as f64]).collect::<Vec<_>>());
            let factor = |level: f64| calibration.factors(level / (blocks + 1) as f64);
            for rank in (1..=blocks).map(|rank| rank as f64) {
                let expected = IntervalFactors { half_width: rank, ssim: None };
                assert_eq!([rank - 0.9, rank].map(|level| factor(level).unwrap()), [expected; 2], "{blocks} blocks");
            }
            let message = factor(blocks as f64 + 0.1).unwrap_err().to_string();
            assert!(message.contains(&format!("but the model has {blocks}")), "{message}");
        }
    }

    /// Blocks of 1 to 20 links share an error, so a mean over links would be dominated by few blocks. Over many draws, the
    /// next block is covered with the nominal probability, up to the steps of 1/(K + 1).
    #[test]
    fn simulated_intervals_cover_the_next_block() {
        const DRAWS: u64 = 2_000;
        for (count, level) in [(9, 0.9), (30, 0.9), (20, 0.5)] {
            let mut covered = 0.0;
            for draw in 0..DRAWS {
                let mut random = rng::stream(draw, "draw", count as u64);
                let mut one = |_| {
                    let (shared, links) = (rng::normal(&mut random), 1 + (20.0 * rng::uniform(&mut random)) as usize);
                    (0..links)
                        .map(|_| (1.0 + links as f64) * (shared + 0.5 * rng::normal(&mut random)) as f64)
                        .collect()
                };
                let blocks: Vec<Vec<f64>> = (0..=count).map(&mut one).collect();
                let half = calibration(&blocks[1..]).factors(level).unwrap().half_width;
                covered += blocks[0].iter().filter(|e| e.abs() <= half).count() as f64 / blocks[0].len() as f64;
            }
            let coverage = covered / DRAWS as f64;
            let highest = level + 1.0 / (count + 1) as f64 + 0.02;
            assert!((level - 0.02..highest).contains(&coverage), "{coverage} with {count} blocks, expected {level}");
        }
    }

    #[test]
    fn many_scores_are_thinned_upwards_by_a_thousandth() {
        let scores: Vec<(f64, f64)> = (1..=100_000).map(|k| (f64::from(k), 1.0)).collect();
        let thinned = weighted_distribution(scores, MOST_SCORES);
        assert_eq!(thinned.len(), MOST_SCORES);
        let calibration = IntervalCalibration { blocks: 1_000_000, values: thinned, ssim: None };
        for level in [0.001, 0.3333, 0.9, 0.99] {
            let half = calibration.factors(level).unwrap().half_width;
            assert!((0.0..101.0).contains(&(half - 100_000.0 * level)), "{half} at {level}");
        }
    }

    #[test]
    fn invalid_levels_and_empty_blocks_are_refused() {
        let calibration = calibration(&[vec![], vec![1.0, 2.0], vec![3.0]]);
        assert_eq!((calibration.block_count(), calibration.factors(0.6).unwrap().half_width), (2, 3.0));
        for level in [0.0, 1.0, 1.5, -0.5, f64::NAN, f64::INFINITY] {
            assert!(calibration.factors(level).unwrap_err().to_string().contains("expected a number above 0"));
        }
        assert!(
            calibration
                .factors(0.9)
                .unwrap_err()
                .to_string()
                .contains("needs 9 calibration blocks, but the model has 2")
        );
        assert_eq!(IntervalCalibration::new(&[vec![]]), None);
    }

    #[test]
    fn bands_of_spectra_end_at_the_limits_of_pixels() {
        let image = Image { width: 2, height: 1, pixels: vec![0.1, 0.8] };
        let factors = IntervalFactors { half_width: 2.0, ssim: Some(3.0) };
        let Interval { lower, upper, ssim } = factors.interval(Task::Spectrum, &image, 0.15);
        assert_eq!((lower.pixels, upper.pixels), (vec![0.0, 0.5], vec![0.4, 1.0]));
        assert!((ssim.unwrap() - 0.55).abs() < 1e-12);
    }
}
