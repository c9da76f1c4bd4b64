//! `Choice`: settings that validation samples choose, by the density at their true positions.

use crate::region::Density;
use pwrfgs_core::statistics::{mean, median, sorted};
use rayon::prelude::*;

/// Sharpnesses to choose from. Few features, such as one power, have a fingerprint without misfit at many wrong positions,
/// and need low ones.
const SHARPNESSES: [f64; 11] = [0.002, 0.008, 0.03, 0.125, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// Kernel widths to choose from, in units of the distance between neighbouring training positions.
const BANDWIDTHS: [f64; 6] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// Of this number of true positions, one may be outside its region: regions should hold 90 %. They thus need nine samples,
/// a number in the messages of [`Locator::missing_regions`](crate::Locator::missing_regions).
const MISSED: usize = 10;
/// Settings without validation samples: sharpness, and kernel width as in [`BANDWIDTHS`].
const DEFAULTS: (f64, f64) = (4.0, 1.0);

/// Settings of a [`Locator`](crate::Locator) that validation samples choose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Share of the model in the fingerprints; the rest is measured.
    pub share: f32,
    /// Sharpness s of the weights exp(-s·misfit/scale).
    pub sharpness: f64,
    /// Misfit of the best fingerprint of a typical sample.
    pub scale: f64,
    /// Width of the kernel around every position, metres.
    pub bandwidth: f64,
    /// Width of the kernels whose mode is the estimate, metres.
    pub mode_bandwidth: f64,
    /// Sharpness of the weights whose mode is the estimate, in units of `sharpness`.
    pub mode_sharpness: f64,
    /// Whether the mode is improved by descent along the model.
    pub descends: bool,
}

/// Fingerprints of least misfit: indices and misfits, least first.
pub(crate) type NearestList = Vec<(u32, f32)>;

/// Validation sample.
#[derive(Clone, Debug)]
pub(crate) struct ValidationSample {
    /// Observation, `[D]`.
    pub(crate) observation: Vec<f32>,
    /// True position, metres.
    pub(crate) position: [f64; 3],
}

/// Validation samples with the fingerprints that resemble them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ComparedSamples<'a> {
    /// Positions of all fingerprints, metres.
    pub(crate) positions: &'a [[f64; 3]],
    pub(crate) samples: &'a [ValidationSample],
    /// Fingerprints of least misfit per sample.
    pub(crate) nearest: &'a [NearestList],
}

impl ComparedSamples<'_> {
    /// Returns the settings with the highest mean log density at the true positions of the samples, for this `share` of the
    /// model; default settings if no mean is finite. The scale is the median of the least misfits in `nearest`, or 1 if that is
    /// not above 0. `half_spacing` is half the distance of neighbouring positions, metres.
    pub(crate) fn most_likely_choice(&self, share: f32, half_spacing: f64) -> Choice {
        let Self { positions, samples, nearest } = *self;
        let typical = median(nearest.iter().map(|near| least_misfit(near)).filter(|m| m.is_finite()));
        let scale = if typical > 0.0 { typical } else { 1.0 };
        let settings = |(sharpness, width): (f64, f64)| Choice {
            share,
            sharpness,
            scale,
            bandwidth: 2.0 * width * half_spacing,
            mode_bandwidth: 2.0 * width * half_spacing,
            mode_sharpness: 1.0,
            descends: false,
        };
        let choices: Vec<Choice> = SHARPNESSES.into_iter().flat_map(|s| BANDWIDTHS.map(|b| settings((s, b)))).collect();
        let densities = |(near, sample): (&NearestList, &ValidationSample)| {
            let per_sharpness = choices.chunks(BANDWIDTHS.len());
            per_sharpness.flat_map(|chunk| log_densities(chunk, near, positions, sample.position)).collect()
        };
        let densities: Vec<Vec<f64>> = nearest.par_iter().zip(samples).map(densities).collect();
        let score = |k: usize| mean(densities.iter().map(|values| values[k]));
        let scored =
            choices.iter().enumerate().map(|(k, choice)| (score(k), *choice)).filter(|(score, _)| score.is_finite());
        let best = scored.max_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or_else(|| settings(DEFAULTS), |(_, choice)| choice)
    }

    /// Returns the level of the regions that hold nine of ten true positions of the samples, with the rank of split conformal
    /// prediction; `None` with fewer than nine samples.
    pub(crate) fn region_level(&self, choice: Choice) -> Option<f32> {
        let Self { positions, samples, nearest } = *self;
        // The smallest of n values holds n/(n + 1) of new ones.
        let rank = ((samples.len() + 1) / MISSED).checked_sub(1)?;
        let level = |(near, ValidationSample { position: [x, y, _], .. }): (&NearestList, &ValidationSample)| {
            f64::from(choice.density(near, positions).grid().level_at([*x, *y]))
        };
        let levels = sorted(nearest.par_iter().zip(samples).map(level).collect::<Vec<f64>>());
        Some(levels[rank] as f32)
    }
}

impl Choice {
    /// Returns the density over the floor, given the fingerprints of least misfit of an observation. Their weights are
    /// exp(-s·misfit/scale); equal ones if no misfit is finite.
    pub(crate) fn density(&self, near: &[(u32, f32)], positions: &[[f64; 3]]) -> Density {
        let (gain, least) = (self.sharpness / self.scale, least_misfit(near));
        // Without a common feature with any fingerprint, all are equal.
        let weight = |m: f32| if least.is_finite() { (-gain * (f64::from(m) - least)).exp() } else { 1.0 };
        Density::new(near.iter().map(|(k, m)| (weight(*m), positions[*k as usize])).collect(), self.bandwidth)
    }
}

/// Returns the log density at a position for each of `choices`, which differ in the kernel width only; `near` and `positions`
/// as in [`Choice::density`].
fn log_densities(choices: &[Choice], near: &[(u32, f32)], positions: &[[f64; 3]], [x, y, _]: [f64; 3]) -> Vec<f64> {
    let mut density = choices[0].density(near, positions);
    let mut log_densities = Vec::with_capacity(choices.len());
    for choice in choices {
        density.bandwidth = choice.bandwidth;
        log_densities.push(density.value_at([x, y]).ln());
    }
    log_densities
}

/// Returns the least misfit; infinite without any.
pub(crate) fn least_misfit(near: &[(u32, f32)]) -> f64 {
    near.first().map_or(f64::INFINITY, |(_, misfit)| f64::from(*misfit))
}
