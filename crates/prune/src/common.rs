//! Shared parts of strategies: traits, shares and quantiles, requested statistics, rates and noise of masks.

use pwrfgs_core::{Budget, GaussianCloud, PrunerTraits, Real};

/// Returns the traits of a pruner that only ranks Gaussians: the number to keep is that of the target.
pub(crate) fn ranking_traits() -> PrunerTraits {
    PrunerTraits { budget: Some(Budget::Gradual), requires_target: true, ..PrunerTraits::default() }
}

/// Returns `share` · `n`, rounded to a whole number if it differs from one only by the rounding of the share.
pub(crate) fn rounded_share(n: usize, share: Real) -> f64 {
    let part = n as f64 * f64::from(share);
    if (part - part.round()).abs() <= 1e-6 * n as f64 { part.round() } else { part }
}

/// Returns `column`, a requested statistic `[N]`; the opacity logits if the pass did not compute it.
pub(crate) fn requested_statistic(column: &[Real], cloud: &GaussianCloud) -> Vec<Real> {
    if column.len() == cloud.len() { column.to_vec() } else { cloud.opacity_logits.clone() }
}

/// Returns the values of a column of width 1; the opacity logits if the cloud does not have it.
pub(crate) fn learned_column(cloud: &GaussianCloud, column: &str) -> Vec<Real> {
    cloud.extra(column).map_or_else(|| cloud.opacity_logits.clone(), |column| column.values.clone())
}

/// Returns the learning rate at which masks fall equally far in a training of `scale` times the steps. It is limited,
/// because noise closes faster masks: with Adam to 0.1, or to `rate` if that is higher; without it to ten times `rate`,
/// because a mask then moves by its gradient, whose magnitude is unknown here.
pub(crate) fn shortened_rate(rate: Real, adam: bool, scale: f64) -> Real {
    let most = if adam { rate.max(0.1) } else { 10.0 * rate };
    ((f64::from(rate) / scale) as Real).min(most)
}

/// Returns the quantile `q` of `values` without interpolation, one of the values; −∞ if `values` is empty.
pub(crate) fn quantile(values: &[Real], q: Real) -> Real {
    let mut sorted = values.to_vec();
    sorted.sort_by(Real::total_cmp);
    let rank = rounded_share(sorted.len(), q).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied().unwrap_or(Real::NEG_INFINITY)
}

/// Draws `n` samples of the logistic distribution, which is that of the difference of two Gumbel samples.
pub(crate) fn logistic_noise(n: usize, random: &mut pwrfgs_core::rng::Rng) -> Vec<Real> {
    const EDGE: Real = 1e-6; // keeps logarithms finite
    let draw = |_| pwrfgs_core::rng::uniform(random).clamp(EDGE, 1.0 - EDGE);
    (0..n).map(draw).map(|u| u.ln() - (1.0 - u).ln()).collect()
}
