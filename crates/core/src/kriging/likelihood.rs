//! Maximum-likelihood fit of correlation, scales and noise.

use super::{Correlation, CorrelationKind, Mean, Place, Solution, StopCheck, position_of, solve};
use crate::{Real, Result, neighbours, statistics::sorted};
use rayon::prelude::*;

/// Range of the noise, in units of the process variance; below it, coinciding positions are dominated by rounding.
pub(super) const NOISE: [f64; 2] = [1e-4, 1e2];
/// Range of the length scales, in units of the sample distance.
const SCALE: [f64; 2] = [1e-2, 1e4];
/// Range of the time scale, and its start, samples.
const TIME: [f64; 2] = [1.0, 1e5];
const TIME_START: f64 = 100.0;
/// Step sizes of the search, in powers of two.
const STEPS: [f64; 5] = [2.0, 1.0, 0.5, 0.25, 0.125];
/// Largest number of rounds per step size: each but the last improves the likelihood, maybe by noise in the last digits.
const ROUNDS: usize = 20;
/// Smallest relative improvement of a likelihood for which a search moves.
pub(super) const IMPROVEMENT: f64 = 1e-6;

/// Samples to predict, each from other samples.
#[derive(Debug)]
pub struct HeldOutCases {
    cases: Vec<HeldOutCase>,
    /// Median over the cases of the distance to the median neighbour, metres; 1 if none is positive.
    typical_m: f64,
    mean: Mean,
}

/// Sample to predict from its neighbours.
#[derive(Debug)]
struct HeldOutCase {
    place: Place,
    neighbours: Vec<Place>,
    /// Sums over values of products of any two observations, `[1 + n, 1 + n]`: the predicted one, then its n neighbours. With an
    /// unknown mean, they are those of differences from the predicted observation.
    products: Vec<f64>,
}

impl HeldOutCases {
    /// Creates cases: a sample to predict with its neighbours, nearest first. `place` returns the place of a sample, metres.
    /// `values` returns the values of a sample, given the index of the case and the sample.
    pub fn new(
        cases: &[(usize, Vec<usize>)],
        mean: Mean,
        place: impl Fn(usize) -> Place + Sync,
        values: impl Fn(usize, usize) -> Vec<Real> + Sync,
    ) -> Self {
        let case = |(c, (sample, neighbours)): (usize, &(usize, Vec<usize>))| {
            let values: Vec<Vec<Real>> = std::iter::once(sample).chain(neighbours).map(|i| values(c, *i)).collect();
            HeldOutCase {
                place: place(*sample),
                neighbours: neighbours.iter().map(|i| place(*i)).collect(),
                products: sum_products(&values, mean),
            }
        };
        let cases: Vec<HeldOutCase> = cases.par_iter().enumerate().map(case).collect();
        let distances = sorted(cases.iter().map(HeldOutCase::median_distance_m).filter(|distance| *distance > 0.0));
        Self { typical_m: distances.get(distances.len() / 2).copied().unwrap_or(1.0), cases, mean }
    }

    /// Computes the squared prediction error of each case, summed over values, and the variance that the process of
    /// variance 1 predicts for it.
    fn prediction_errors(&self, correlation: &Correlation) -> Vec<(f64, f64)> {
        self.cases.par_iter().map(|case| case.prediction_error(correlation, self.mean)).collect()
    }

    /// Returns the most likely process variance, summed over values: the mean of squared errors in units of the
    /// predicted variance. NaN without cases.
    pub fn variance(&self, correlation: &Correlation) -> f64 {
        process_variance(&self.prediction_errors(correlation))
    }

    /// Returns the log-likelihood at the best process variance, up to a constant: −½ (n log(variance) + Σ log(conditional
    /// variance)) of n cases. Higher is more likely.
    pub fn log_likelihood(&self, correlation: &Correlation) -> f64 {
        let errors = self.prediction_errors(correlation);
        let logs: f64 = errors.iter().map(|(_, variance)| variance.ln()).sum();
        // Identical spectra have zero variance.
        -0.5 * (errors.len() as f64 * process_variance(&errors).max(1e-30).ln() + logs)
    }
}

/// Computes the mean of squared errors in units of their predicted variances.
fn process_variance(errors: &[(f64, f64)]) -> f64 {
    errors.iter().map(|(error, variance)| error / variance).sum::<f64>() / errors.len() as f64
}

/// Computes the sums of products of any two of the n observations, `[n, n]`: with an unknown mean, of their differences from the
/// first.
fn sum_products(values: &[Vec<Real>], mean: Mean) -> Vec<f64> {
    let product = |a: &[Real], b: &[Real]| a.iter().zip(b).map(|(a, b)| *a as f64 * *b as f64).sum::<f64>();
    // Weights that add up to 1 give the same errors from differences, and those of bright spectra do not cancel.
    let first = if mean == Mean::Zero { vec![0.0; values[0].len()] } else { values[0].clone() };
    let differences: Vec<Vec<Real>> =
        values.iter().map(|p| p.iter().zip(&first).map(|(p, first)| p - first).collect()).collect();
    differences.iter().flat_map(|a| differences.iter().map(|b| product(a, b))).collect()
}

impl HeldOutCase {
    /// Computes the distance from the predicted sample to its median neighbour, metres; 0 without neighbours.
    fn median_distance_m(&self) -> f64 {
        let median = self.neighbours.get(self.neighbours.len() / 2);
        median.map_or(0.0, |neighbour| neighbours::distance(position_of(*neighbour), position_of(self.place)))
    }

    /// Computes the squared prediction error, summed over values, and the variance that the process of variance 1
    /// predicts for it.
    fn prediction_error(&self, correlation: &Correlation, mean: Mean) -> (f64, f64) {
        let places: Vec<Place> = self.neighbours.iter().map(|neighbour| correlation.scaled(*neighbour)).collect();
        let Solution { weights, variance } = solve(correlation, mean, &places, correlation.scaled(self.place));
        // The error is the weighted sum of the neighbours minus the predicted sample.
        let terms: Vec<f64> = std::iter::once(-1.0).chain(weights).collect();
        let row = |(products, term): (&[f64], &f64)| {
            term * products.iter().zip(&terms).map(|(product, other)| product * other).sum::<f64>()
        };
        (self.products.chunks_exact(terms.len()).zip(&terms).map(row).sum::<f64>().max(0.0), variance)
    }
}

/// Finds the most likely correlation by coordinate search, with step factors from 4 down to 1.09. `check` is called several
/// times per second and ends the search with its error.
///
/// # Errors
/// An error of `check`.
///
/// # Panics
/// If `space` has no correlation function.
pub fn fit_correlation(cases: &HeldOutCases, space: SearchSpace<'_>, check: StopCheck<'_>) -> Result<Correlation> {
    search(&|correlation| cases.log_likelihood(correlation), cases.typical_m, space, check).map(|best| best.1)
}

/// Finds the correlation with the largest `log_likelihood` as [`fit_correlation`] does. Returns that likelihood and the
/// correlation, or an error of `check`. The search starts at length scales of eight times `typical_m`, metres.
pub(super) fn search(
    log_likelihood: &(dyn Fn(&Correlation) -> f64 + Sync),
    typical_m: f64,
    space: SearchSpace<'_>,
    check: StopCheck<'_>,
) -> Result<(f64, Correlation)> {
    let best_of_kind = |&kind: &CorrelationKind| {
        let time = if space.time { TIME_START } else { f64::INFINITY };
        let length = 8.0 * typical_m;
        let start = Correlation { kind, scales: [length, length, length, time], noise: 0.1 };
        search_coordinates(log_likelihood, typical_m, start, space, check)
    };
    let candidates = space.kinds.par_iter().map(best_of_kind).collect::<Result<Vec<_>>>()?;
    let best = candidates.into_iter().reduce(|best, next| if next.0 > best.0 { next } else { best });
    Ok(best.expect("a kind is given"))
}

/// Correlations that are compared.
#[derive(Clone, Copy, Debug)]
pub struct SearchSpace<'a> {
    /// Correlation functions, at least one.
    pub kinds: &'a [CorrelationKind],
    /// Whether all axes have the same length scale. Single numbers suffice only for this.
    pub isotropic: bool,
    /// Whether time has an effect.
    pub time: bool,
}

/// Searches from `start` along one parameter at a time, with smaller and smaller steps, while the likelihood improves.
/// Returns the log-likelihood and the correlation, or an error of `check`.
fn search_coordinates(
    log_likelihood: &dyn Fn(&Correlation) -> f64,
    typical_m: f64,
    start: Correlation,
    space: SearchSpace<'_>,
    check: StopCheck<'_>,
) -> Result<(f64, Correlation)> {
    let mut best = (log_likelihood(&start), start);
    let is_searched = |parameter: &Parameter| match parameter {
        Parameter::Length(_) => !space.isotropic,
        Parameter::Time => space.time,
        _ => true,
    };
    for step in STEPS {
        for _ in 0..ROUNDS {
            let before = best.0;
            for parameter in Parameter::ALL.into_iter().filter(is_searched) {
                for factor in [step.exp2(), (-step).exp2()] {
                    while let Some(next) = scaled_parameter(&best.1, parameter, factor, typical_m) {
                        check()?;
                        let likelihood = log_likelihood(&next);
                        if likelihood.is_nan() || likelihood <= best.0 + IMPROVEMENT * best.0.abs() {
                            break;
                        }
                        best = (likelihood, next);
                    }
                }
            }
            if best.0 <= before {
                break;
            }
        }
    }
    Ok(best)
}

/// Parameter of a correlation that the search changes.
#[derive(Clone, Copy)]
enum Parameter {
    /// All length scales.
    Lengths,
    /// One length scale: x, y or z.
    Length(usize),
    Noise,
    /// All length scales, and the noise in the opposite direction: longer scales go with a larger process variance, so relative
    /// noise falls.
    LengthsAndNoise,
    Time,
}

impl Parameter {
    /// All parameters, in the order of the search.
    const ALL: [Self; 7] = [
        Self::Lengths,
        Self::Length(0),
        Self::Length(1),
        Self::Length(2),
        Self::Noise,
        Self::LengthsAndNoise,
        Self::Time,
    ];
}

/// Multiplies one parameter of `from` by `factor`. `None` if a result is outside its range.
fn scaled_parameter(from: &Correlation, parameter: Parameter, factor: f64, typical_m: f64) -> Option<Correlation> {
    let mut next = *from;
    if let Parameter::Lengths | Parameter::LengthsAndNoise = parameter {
        next.scales[..3].iter_mut().for_each(|scale| *scale *= factor);
    }
    match parameter {
        Parameter::Lengths => {}
        Parameter::Length(axis) => next.scales[axis] *= factor,
        Parameter::Noise => next.noise *= factor,
        Parameter::LengthsAndNoise => next.noise /= factor,
        Parameter::Time => next.scales[3] *= factor,
    }
    let within = |[low, high]: [f64; 2], value: f64| (low..=high).contains(&value);
    let time = next.scales[3];
    let fits = next.scales[..3].iter().all(|scale| within(SCALE, scale / typical_m)) && within(NOISE, next.noise);
    (fits && (time.is_infinite() || within(TIME, time))).then_some(next)
}
