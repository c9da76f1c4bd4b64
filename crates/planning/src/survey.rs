//! `Survey`: greedy selection of positions that lower the integrated variance most.
//!
//! A measurement at candidate j lowers the variance, summed over the region, by `S[j] / (v[j] + σ²)` with
//! `S[j] = Σ_r c(j, r)²` and posterior covariance c (Krause, Singh and Guestrin, Journal of Machine Learning Research 9,
//! 2008, discuss such designs). A measurement with factor row u changes c(j, r) by `−u[j] u[r]`, so
//! `S[j] ← S[j] − 2 u[j] Σ_r c(j, r) u[r] + u[j]² Σ_r u[r]²`. With the factor rows V of earlier measurements,
//! `Σ_r c(j, r) u[r] = Σ_r k(j, r) u[r] − Σ_i V[i][j] Σ_r V[i][r] u[r]`. A step takes O(M R) operations for M candidates and R
//! points of the region, and the covariances c are never stored.

use crate::posterior::Posterior;
use pwrfgs_core::kriging::{Correlation, CorrelationKind};
use pwrfgs_core::rng;
use pwrfgs_core::statistics::{bounds, evenly};
use rayon::prelude::*;

/// Products below this share of the square of the new row are neglected.
const NEGLIGIBLE: f64 = 1e-12;
/// Length scale without measurements, in parts of the diagonal of the region.
const DEFAULT_LENGTH: f64 = 0.2;
/// Noise variance without measurements, in parts of the variance.
const DEFAULT_NOISE: f64 = 0.1;
/// Number of selected candidates at which the correlation is learned first; then at every doubling.
const FIRST_LEARNED: usize = 8;

/// Returns the exponential correlation of a region without measurements: a length scale of a fifth of its diagonal, or 1 m if
/// the region is one point, and a noise variance of a tenth.
pub fn default_correlation(region: &[[f64; 3]]) -> Correlation {
    let diagonal = box_diagonal(region);
    let length = if diagonal > 0.0 { DEFAULT_LENGTH * diagonal } else { 1.0 };
    Correlation {
        kind: CorrelationKind::Exponential,
        scales: [length, length, length, f64::INFINITY],
        noise: DEFAULT_NOISE,
    }
}

/// Returns the diagonal of the smallest box around `points`, metres; 0 without points.
pub(crate) fn box_diagonal(points: &[[f64; 3]]) -> f64 {
    let extent = |k: usize| {
        let (low, high) = bounds(points.iter().map(|p| p[k]));
        (high - low).max(0.0)
    };
    (0..3).map(|k| extent(k).powi(2)).sum::<f64>().sqrt()
}

/// Positions of a survey: candidates, the region to predict, and measured positions.
#[derive(Clone, Debug)]
pub struct Survey {
    /// Points, metres: candidates `[M]`, then points of the region that are not candidates, then measured points.
    points: Vec<[f64; 3]>,
    /// Number of candidates M.
    candidates: usize,
    /// Points of the region `[R]`.
    region: Vec<usize>,
    /// Points with measurements.
    measured: Vec<usize>,
}

/// Selected candidates with the correlation that they were selected by.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyPlan {
    /// Selected candidates, in the order of selection.
    pub order: Vec<usize>,
    /// Correlation at the end.
    pub correlation: Correlation,
    /// Number of selected candidates, the first ones, that the correlation was learned from; 0 if it was not.
    pub learned_from: usize,
}

impl Survey {
    /// Creates the survey of `candidates` with the `region` to predict and measurements at `measured` positions,
    /// metres.
    pub fn new(candidates: &[[f64; 3]], region: &[[f64; 3]], measured: &[[f64; 3]]) -> Self {
        let mut points = candidates.to_vec();
        let mut sorted: Vec<usize> = (0..candidates.len()).collect();
        let compare = |a: &[f64; 3], b: &[f64; 3]| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal);
        sorted.sort_by(|&a, &b| compare(&candidates[a], &candidates[b]).then(a.cmp(&b)));
        let mut indices = Vec::with_capacity(region.len());
        for point in region {
            if let Ok(at) = sorted.binary_search_by(|&i| compare(&candidates[i], point)) {
                indices.push(sorted[at]);
            } else {
                indices.push(points.len());
                points.push(*point);
            }
        }
        let first = points.len();
        points.extend(measured);
        Self { candidates: candidates.len(), region: indices, measured: (first..points.len()).collect(), points }
    }

    /// Selects `count` candidates, or all if there are fewer, one after another, each lowering the integrated variance most;
    /// of equal candidates the first. `learn` estimates the correlation from the candidates selected so far; `None` keeps the
    /// last one. It is called at 8 candidates and at every doubling, if more are to be selected. `progress` gets the number of
    /// selected candidates and returns whether to go on.
    pub fn select(
        &self,
        correlation: Correlation,
        count: usize,
        learn: impl Fn(&[usize]) -> Option<Correlation>,
        mut progress: impl FnMut(usize) -> bool,
    ) -> SurveyPlan {
        let mut plan = SurveyPlan { order: Vec::new(), correlation, learned_from: 0 };
        let count = count.min(self.candidates);
        let mut search = self.start_search(&plan);
        loop {
            let until = (plan.order.len().max(FIRST_LEARNED / 2) * 2).min(count);
            while plan.order.len() < until {
                if !progress(plan.order.len()) {
                    return plan;
                }
                let next = search.best_candidate();
                search.add_measurement(next);
                plan.order.push(next);
            }
            if until == count {
                return plan;
            }
            if let Some(learned) = learn(&plan.order) {
                plan.learned_from = plan.order.len();
                if learned != plan.correlation {
                    plan.correlation = learned;
                    search = self.start_search(&plan);
                }
            }
        }
    }

    /// Returns the prior covariances of candidates and region `[M,R]`.
    fn prior_covariances(&self, correlation: Correlation) -> Vec<f64> {
        let (posterior, region) = (Posterior::new(correlation, &self.points), &self.region);
        let row = |j: usize| region.iter().map(|&r| posterior.prior_covariance(j, r)).collect::<Vec<f64>>();
        (0..self.candidates).into_par_iter().flat_map_iter(row).collect()
    }

    /// Returns the state after the measurements of the survey and those of `plan`.
    fn start_search(&self, plan: &SurveyPlan) -> Search<'_> {
        let (prior, width) = (self.prior_covariances(plan.correlation), self.region.len());
        let sum = |j: usize| dot(&prior[j * width..][..width], &prior[j * width..][..width]);
        let mut search = Search {
            posterior: Posterior::new(plan.correlation, &self.points),
            sums: (0..self.candidates).into_par_iter().map(sum).collect(),
            prior,
            is_taken: vec![false; self.candidates],
            region: &self.region,
        };
        self.measured.iter().chain(&plan.order).for_each(|&s| search.add_measurement(s));
        search
    }

    /// Returns the posterior after the measurements of the survey.
    fn posterior(&self, correlation: Correlation) -> Posterior {
        let mut posterior = Posterior::new(correlation, &self.points);
        self.measured.iter().for_each(|&s| _ = posterior.add_measurement(s));
        posterior
    }

    /// Selects `count` candidates, or all if there are fewer, one after another, each with the largest variance; of
    /// equal candidates the first.
    pub fn select_by_variance(&self, correlation: Correlation, count: usize) -> Vec<usize> {
        let mut posterior = self.posterior(correlation);
        let mut is_taken = vec![false; self.candidates];
        let mut order = Vec::new();
        while order.len() < count.min(self.candidates) {
            let free = (0..self.candidates).filter(|&j| !is_taken[j]);
            let next = first_largest(free, |j| posterior.variances()[j]);
            is_taken[next] = true;
            posterior.add_measurement(next);
            order.push(next);
        }
        order
    }

    /// Selects `count` candidates, evenly in their order.
    pub fn select_regular(&self, count: usize) -> Vec<usize> {
        evenly(&(0..self.candidates).collect::<Vec<_>>(), count)
    }

    /// Selects `count` random candidates, in random order.
    pub fn select_random(&self, count: usize, seed: u64) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.candidates).collect();
        rng::shuffle(&mut rng::stream(seed, "survey", 0), &mut order);
        order.truncate(count);
        order
    }

    /// Returns the mean variance over the region, in units of the process variance, before (first) and after each
    /// measurement of `order`.
    pub fn mean_variances(&self, correlation: Correlation, order: &[usize]) -> Vec<f64> {
        let mut posterior = self.posterior(correlation);
        let mean = |posterior: &Posterior| {
            let sum: f64 = self.region.iter().map(|&r| posterior.variances()[r]).sum();
            sum / self.region.len().max(1) as f64
        };
        let mut means = vec![mean(&posterior)];
        for &s in order {
            posterior.add_measurement(s);
            means.push(mean(&posterior));
        }
        means
    }
}

/// Returns the candidate with the largest value, the first of equal ones; 0 without candidates.
fn first_largest(candidates: impl Iterator<Item = usize>, value: impl Fn(usize) -> f64) -> usize {
    let best = candidates.map(|j| (value(j), j)).reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map_or(0, |(_, j)| j)
}

/// Greedy search.
struct Search<'a> {
    posterior: Posterior,
    /// Prior covariances of candidates and region `[M,R]`.
    prior: Vec<f64>,
    /// S `[M]`.
    sums: Vec<f64>,
    is_taken: Vec<bool>,
    region: &'a [usize],
}

impl Search<'_> {
    /// Returns the free candidate j that lowers the summed variance most, by `S[j] / (v[j] + σ²)`.
    fn best_candidate(&self) -> usize {
        let (variances, noise) = (self.posterior.variances(), self.posterior.noise());
        first_largest((0..self.sums.len()).filter(|&j| !self.is_taken[j]), |j| self.sums[j] / (variances[j] + noise))
    }

    /// Adds a measurement at point `s`, marks it as taken if it is a candidate, and updates the sums S.
    fn add_measurement(&mut self, s: usize) {
        let before = self.posterior.factor_rows().count();
        let row = self.posterior.add_measurement(s).to_vec();
        if let Some(is_taken) = self.is_taken.get_mut(s) {
            *is_taken = true;
        }
        let inside: Vec<f64> = self.region.iter().map(|&r| row[r]).collect();
        let square = dot(&inside, &inside);
        // Products of the earlier rows with u, to turn prior into posterior covariances.
        let product = |other: &[f64]| self.region.iter().zip(&inside).map(|(&r, u)| other[r] * u).sum::<f64>();
        let mut explained = vec![0.0; self.sums.len()];
        for other in self.posterior.factor_rows().take(before) {
            let product = product(other);
            if product.abs() > NEGLIGIBLE * square {
                explained.iter_mut().zip(other).for_each(|(sum, v)| *sum += product * v);
            }
        }
        let update = |((sum, prior), (u, explained)): ((&mut f64, &[f64]), (&f64, &f64))| {
            *sum = (*sum - 2.0 * u * (dot(prior, &inside) - explained) + u * u * square).max(0.0);
        };
        let prior = self.prior.par_chunks_exact(self.region.len().max(1));
        self.sums.par_iter_mut().zip(prior).zip(row.par_iter().zip(&explained)).for_each(update);
    }
}

/// Returns the scalar product in a fixed order of eight partial sums.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a, b) = (a.chunks_exact(8), b.chunks_exact(8));
    let remainder: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    a.zip(b).for_each(|(a, b)| (0..8).for_each(|k| sums[k] += a[k] * b[k]));
    sums.iter().sum::<f64>() + remainder
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Cholesky;

    /// Returns an exponential correlation with one length scale.
    fn exponential(scale: f64, noise: f64) -> Correlation {
        Correlation { kind: CorrelationKind::Exponential, scales: [scale, scale, scale, f64::INFINITY], noise }
    }

    /// Returns `count` random points in a box of 3 x 2 x 0.5 m.
    fn scattered(count: usize, seed: u64) -> Vec<[f64; 3]> {
        let mut random = rng::stream(seed, "scattered", 0);
        (0..count).map(|_| [3.0, 2.0, 0.5].map(|side| side * rng::uniform_f64(&mut random))).collect()
    }

    /// Returns the variance summed over `region` after measurements at `measured`, by the inverse of their covariance
    /// matrix.
    fn summed(correlation: &Correlation, region: &[[f64; 3]], measured: &[[f64; 3]]) -> f64 {
        let at = |a: [f64; 3], b: [f64; 3]| {
            correlation.kind.at(pwrfgs_core::neighbours::distance(a, b) / correlation.scales[0])
        };
        let n = measured.len();
        let mut matrix: Vec<f64> = measured.iter().flat_map(|a| measured.iter().map(move |b| at(*a, *b))).collect();
        (0..n).for_each(|i| matrix[i * n + i] += correlation.noise);
        let factor = Cholesky::new(matrix, n).unwrap();
        let variance = |point: &[f64; 3]| {
            let towards: Vec<f64> = measured.iter().map(|other| at(*other, *point)).collect();
            let mut weights = towards.clone();
            factor.solve(&mut weights);
            1.0 - towards.iter().zip(&weights).map(|(t, w)| t * w).sum::<f64>()
        };
        region.iter().map(variance).sum()
    }

    #[test]
    fn greedy_selection_equals_brute_force() {
        let (candidates, region, initial) = (scattered(30, 1), scattered(50, 2), scattered(3, 3));
        let correlation = exponential(0.7, 0.05);
        let survey = Survey::new(&candidates, &region, &initial);
        let plan = survey.select(correlation, 8, |_| None, |_| true);
        let (mut measured, mut order) = (initial.clone(), Vec::new());
        for _ in 0..8 {
            let variance_with = |j: usize| summed(&correlation, &region, &[&measured[..], &[candidates[j]]].concat());
            let free = (0..30).filter(|j| !order.contains(j));
            let next = free.min_by(|&a, &b| variance_with(a).total_cmp(&variance_with(b))).unwrap();
            order.push(next);
            measured.push(candidates[next]);
        }
        assert_eq!(plan.order, order);
        let means = survey.mean_variances(correlation, &order);
        assert!((means[8] - summed(&correlation, &region, &measured) / 50.0).abs() < 1e-12, "{means:?}");
        assert!(means.is_sorted_by(|a, b| a > b), "every measurement lowers the variance");
    }

    #[test]
    fn empty_region_selects_each_candidate_once() {
        let survey = Survey::new(&scattered(3, 1), &[], &[]);
        assert_eq!(survey.select(exponential(1.0, 0.1), 3, |_| None, |_| true).order, [0, 1, 2]);
    }

    #[test]
    fn ties_go_to_first_candidate_and_all_candidates_can_be_selected() {
        let square = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]];
        let survey = Survey::new(&square, &square[..4], &[]);
        let plan = survey.select(exponential(1.0, 0.1), 9, |_| None, |_| true);
        assert_eq!(plan.order[..2], [0, 3], "the first corner, then the opposite one");
        let mut sorted = plan.order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, [0, 1, 2, 3, 4]);
        assert_eq!(survey.select_regular(2), [0, 2]);
        assert_eq!(survey.select_by_variance(exponential(1.0, 0.1), 2), [0, 3]);
        let point = Survey::new(&square[..1], &square[..1], &[]);
        let correlation = default_correlation(&square[..1]);
        assert_eq!(point.select(correlation, 3, |_| None, |_| true).order, [0]);
    }

    #[test]
    fn selection_is_identical_with_any_number_of_threads() {
        let candidates = scattered(700, 4);
        let survey = Survey::new(&candidates, &candidates, &[]);
        let select = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let plan = survey.select(exponential(0.4, 0.1), 40, |_| None, |_| true);
                let bits = |v: &f64| v.to_bits();
                (survey.mean_variances(plan.correlation, &plan.order).iter().map(bits).collect::<Vec<_>>(), plan)
            })
        };
        assert_eq!(select(1), select(3));
    }

    #[test]
    fn learns_at_doublings_and_stops_on_request() {
        let candidates = scattered(60, 5);
        let survey = Survey::new(&candidates, &candidates, &[]);
        let calls = std::cell::RefCell::new(Vec::new());
        let learn = |order: &[usize]| {
            calls.borrow_mut().push(order.len());
            Some(exponential(0.3, 0.2))
        };
        let plan = survey.select(exponential(1.0, 0.1), 40, learn, |_| true);
        assert_eq!(
            (calls.into_inner(), plan.order.len(), plan.correlation, plan.learned_from),
            (vec![8, 16, 32], 40, exponential(0.3, 0.2), 32)
        );
        assert_eq!(survey.select(exponential(1.0, 0.1), 40, |_| None, |done| done < 5).order.len(), 5);
    }
}
