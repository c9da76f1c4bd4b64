//! Maximum-likelihood fit of correlation, length scales and noise.

use super::super::neighbours::Nearest;
use super::equations::{Correlation, CorrelationKind, Trend, solve};
use pwrfgs_core::{Real, evenly, neighbours, rng};
use rayon::prelude::*;

/// Largest number of samples predicted in the fit.
const CASES: usize = 160;
/// Largest number of neighbours per prediction.
const FROM: usize = 24;
/// Largest number of powers predicted in the fit.
const POWERS: usize = 320;
const FROM_POWERS: usize = 16;
/// Approximate number of pixels per spectrum used in the fit: every n-th row and column.
const PIXELS: usize = 2_000;
/// Range of the noise; below it, coinciding positions are dominated by rounding.
const NOISE: [f64; 2] = [1e-4, 1e2];
/// Range of the length scales, in units of the sample distance.
const SCALE: [f64; 2] = [1e-2, 1e4];
/// Step sizes of the search, in powers of two.
const STEPS: [f64; 5] = [2.0, 1.0, 0.5, 0.25, 0.125];

/// Samples to predict, each with its nearest neighbours.
pub(super) struct HeldOutCases {
    all: Vec<HeldOutCase>,
    /// Whether the samples are powers: single numbers suffice only for Matern 3/2 with one common length scale.
    powers: bool,
    /// Median distance from a sample to its neighbours, metres.
    typical_m: f64,
}

struct HeldOutCase {
    at: [f64; 3],
    places: Vec<[f64; 3]>,
    /// Sums over pixels of products of two spectra: the predicted one (first) and its neighbours, square.
    products: Vec<f64>,
}

impl HeldOutCases {
    /// Predicts the `validation` samples from the `train` samples.
    pub(super) fn new(trend: &Trend<'_>, train: Vec<usize>, validation: &[usize]) -> Self {
        let place = |i: usize| trend.data.sample(i).tx;
        let nearest = Nearest::new(train, 3, place);
        let case = |&i: &usize| HeldOutCase::new(trend, i, &nearest.find(&place(i), FROM).1);
        Self::of(evenly(validation, CASES).par_iter().map(case).collect(), false)
    }

    /// Creates cases for powers: at most [`POWERS`] samples, each predicted from the nearest of those before it in
    /// random order. Their densities multiply to the joint density (Vecchia, Journal of the Royal Statistical Society B
    /// 50, 1988), and the first samples constrain long distances.
    pub(super) fn of_powers(trend: &Trend<'_>, all: &[usize]) -> Self {
        let mut order = evenly(all, POWERS);
        rng::shuffle(&mut rng::stream(0, "kriging", 0), &mut order);
        let place = |i: usize| trend.data.sample(i).tx;
        let case = |n: usize| {
            let before = Nearest::new(order[..n].to_vec(), 3, place);
            HeldOutCase::new(trend, order[n], &before.find(&place(order[n]), FROM_POWERS).1)
        };
        Self::of((1..order.len()).into_par_iter().map(case).collect(), true)
    }

    fn of(all: Vec<HeldOutCase>, powers: bool) -> Self {
        let mut distances: Vec<f64> = all.iter().map(HeldOutCase::reach_m).filter(|reach| *reach > 0.0).collect();
        distances.sort_by(f64::total_cmp);
        Self { typical_m: distances.get(distances.len() / 2).copied().unwrap_or(1.0), all, powers }
    }

    /// Log-likelihood at the best process variance, up to a constant and sign: half of n times the logarithm of that
    /// variance plus all logarithms of conditional variances. Lower is more likely.
    pub(super) fn log_likelihood(&self, correlation: &Correlation) -> f64 {
        let found: Vec<(f64, f64)> = self.all.par_iter().map(|case| case.error(correlation)).collect();
        let strength = found.iter().map(|(error, variance)| error / variance).sum::<f64>() / found.len() as f64;
        let logs: f64 = found.iter().map(|(_, variance)| variance.ln()).sum();
        // Identical spectra have zero variance.
        -0.5 * (found.len() as f64 * strength.max(1e-30).ln() + logs)
    }
}

impl HeldOutCase {
    fn new(trend: &Trend<'_>, sample: usize, from: &[(f64, usize)]) -> Self {
        let data = trend.data;
        let stride = ((data.width * data.height) as f64 / PIXELS as f64).sqrt().ceil().max(1.0) as usize;
        let picture = |i: usize| {
            let mut pixels = vec![0.0; data.width.div_ceil(stride) * data.height.div_ceil(stride)];
            trend.residual(i, stride, &mut pixels);
            pixels
        };
        let pictures: Vec<Vec<Real>> =
            std::iter::once(sample).chain(from.iter().map(|(_, i)| *i)).map(picture).collect();
        let product = |a: &[Real], b: &[Real]| a.iter().zip(b).map(|(a, b)| *a as f64 * *b as f64).sum::<f64>();
        // Differences from the first spectrum avoid cancellation for bright spectra.
        let less: Vec<Vec<Real>> =
            pictures.iter().map(|p| p.iter().zip(&pictures[0]).map(|(p, first)| p - first).collect()).collect();
        let products = less.iter().flat_map(|a| less.iter().map(|b| product(a, b))).collect();
        let place = |i: usize| data.sample(i).tx;
        Self { at: place(sample), places: from.iter().map(|(_, i)| place(*i)).collect(), products }
    }

    /// Distance from the predicted sample to its median neighbour, metres.
    fn reach_m(&self) -> f64 {
        self.places.get(self.places.len() / 2).map_or(0.0, |place| neighbours::distance(*place, self.at))
    }

    /// Squared prediction error, summed over pixels, and the variance predicted by the process.
    fn error(&self, correlation: &Correlation) -> (f64, f64) {
        let places: Vec<[f64; 3]> = self.places.iter().map(|place| correlation.scaled(*place)).collect();
        let solution = solve(correlation, &places, correlation.scaled(self.at));
        // Weights add up to 1, so the error is the weighted sum of differences from the predicted sample.
        let n = places.len() + 1;
        let row = |(i, weight): (usize, &f64)| {
            let products = &self.products[(i + 1) * n + 1..(i + 2) * n];
            weight * products.iter().zip(&solution.weights).map(|(p, w)| p * w).sum::<f64>()
        };
        (solution.weights.iter().enumerate().map(row).sum::<f64>().max(0.0), solution.variance)
    }
}

/// Finds the most likely correlation: coordinate search with step factors from 4 down to 1.09.
pub(super) fn most_likely(cases: &HeldOutCases) -> Correlation {
    let of_kind = |kind| {
        let start = Correlation { kind, scales_m: [8.0 * cases.typical_m; 3], noise: 0.1 };
        if cases.all.is_empty() { (0.0, start) } else { search(cases, start) }
    };
    if cases.powers {
        return of_kind(CorrelationKind::Matern32).1;
    }
    let found = CorrelationKind::ALL.map(of_kind);
    found.into_iter().reduce(|best, next| if next.0 > best.0 { next } else { best }).expect("three were tried").1
}

fn search(cases: &HeldOutCases, start: Correlation) -> (f64, Correlation) {
    let mut best = (cases.log_likelihood(&start), start);
    for step in STEPS {
        // Each round but the last improves the likelihood; the limit covers noise in the last digits.
        for _ in 0..20 {
            let before = best.0;
            for parameter in (0..6).filter(|p| !(cases.powers && (1..=3).contains(p))) {
                for factor in [step.exp2(), (-step).exp2()] {
                    while let Some(next) = moved(&best.1, parameter, factor, cases.typical_m) {
                        let likelihood = cases.log_likelihood(&next);
                        if likelihood.is_nan() || likelihood <= best.0 + 1e-6 * best.0.abs() {
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
    best
}

/// Multiplies one parameter by `factor`: one of three length scales, all of them, the noise, or length scales and noise
/// in opposite directions (longer scales go with a larger process variance, so relative noise falls). `None` outside
/// the range.
fn moved(from: &Correlation, parameter: usize, factor: f64, typical_m: f64) -> Option<Correlation> {
    let mut next = *from;
    match parameter {
        0 => next.scales_m = next.scales_m.map(|scale| scale * factor),
        1..=3 => next.scales_m[parameter - 1] *= factor,
        4 => next.noise *= factor,
        _ => (next.scales_m, next.noise) = (next.scales_m.map(|scale| scale * factor), next.noise / factor),
    }
    let within = |[low, high]: [f64; 2], value: f64| (low..=high).contains(&value);
    let fits = next.scales_m.iter().all(|scale| within(SCALE, scale / typical_m)) && within(NOISE, next.noise);
    fits.then_some(next)
}
