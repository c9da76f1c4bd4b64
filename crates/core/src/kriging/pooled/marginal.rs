//! Likelihood of whitened powers with levels and slopes marginalised, and their posterior means.

/// Prior standard deviations of T and G about the mean power and 0, and of `t_j` and `g_j` about 0: dB, and dB per decade.
const SHARED: [f64; 2] = [60.0, 30.0];
const PER_RECEIVER: [f64; 2] = [15.0, 8.0];
/// Number of golden-section steps over ln(variance), and its range about ln(mean square of the powers).
const STEPS: usize = 40;
const RANGE: [f64; 2] = [-16.0, 4.0];

type Matrix = [[f64; 2]; 2];

/// Sums over the whitened powers of one receiver, for a process of variance 1.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Moments {
    /// Number of powers.
    pub(super) count: f64,
    /// Sum of the logarithms of conditional variances.
    pub(super) logs: f64,
    /// Sums of products of power, 1 and log-distance.
    pub(super) products: [[f64; 3]; 3],
}

impl Moments {
    /// Adds a whitened row, which had this conditional variance.
    pub(super) fn add(&mut self, row: [f64; 3], variance: f64) {
        self.count += 1.0;
        self.logs += variance.ln();
        for (sums, a) in self.products.iter_mut().zip(row) {
            sums.iter_mut().zip(row).for_each(|(sum, b)| *sum += a * b);
        }
    }
}

/// Returns the process variance that maximises the likelihood, and the log-likelihood there up to a constant. `scale` is
/// the mean square of the powers, dB².
pub(super) fn best_variance(moments: &[Moments], scale: f64) -> (f64, f64) {
    /// Golden ratio less 1.
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let value = |log: f64| log_likelihood(moments, log.exp());
    let middle = scale.max(1e-6).ln();
    let [mut low, mut high] = RANGE.map(|range| middle + range);
    let (mut a, mut b) = (high - RATIO * (high - low), low + RATIO * (high - low));
    let (mut at_a, mut at_b) = (value(a), value(b));
    for _ in 0..STEPS {
        if at_a >= at_b {
            (high, b, at_b) = (b, a, at_a);
            a = high - RATIO * (high - low);
            at_a = value(a);
        } else {
            (low, a, at_a) = (a, b, at_b);
            b = low + RATIO * (high - low);
            at_b = value(b);
        }
    }
    if at_a >= at_b { (a.exp(), at_a) } else { (b.exp(), at_b) }
}

/// Computes the log-likelihood at a process variance, up to a constant.
pub(super) fn log_likelihood(moments: &[Moments], variance: f64) -> f64 {
    let (shared, squares, logs) = marginalise(moments, variance);
    let (inverse, log_determinant) = invert(shared.precision);
    let mean = multiply(inverse, shared.sum);
    -0.5 * (squares - dot(shared.sum, mean) + logs + log_determinant)
}

/// Returns the posterior means of the level `T + t_j` and the rise `-(G + g_j)` of each receiver, about the means of the data.
pub(super) fn trends(moments: &[Moments], variance: f64) -> Vec<[f64; 2]> {
    let shared = marginalise(moments, variance).0;
    let common = multiply(invert(shared.precision).0, shared.sum);
    let trend = |m: &Moments| {
        let Information { precision, sum } = Information::new(m, variance);
        let explained = multiply(precision, common);
        let deviation = multiply(posterior(precision).0, [sum[0] - explained[0], sum[1] - explained[1]]);
        [common[0] + deviation[0], common[1] + deviation[1]]
    };
    moments.iter().map(trend).collect()
}

/// Information of powers on level and rise: precision and weighted sum.
struct Information {
    precision: Matrix,
    sum: [f64; 2],
}

impl Information {
    /// Returns the information of the powers of one receiver, given the process variance.
    fn new(moments: &Moments, variance: f64) -> Self {
        let [[_, power, power_log], [_, one, log], [_, _, log_log]] = moments.products;
        Self {
            precision: [[one / variance, log / variance], [log / variance, log_log / variance]],
            sum: [power / variance, power_log / variance],
        }
    }
}

/// Marginalises `t_j` and `g_j` (matrix inversion lemma). Returns the information on T and G with their prior, the sum of
/// squares, and the sum of logarithms of determinants.
fn marginalise(moments: &[Moments], variance: f64) -> (Information, f64, f64) {
    let mut shared = Information { precision: diagonal(SHARED), sum: [0.0; 2] };
    let (mut squares, mut logs) = (0.0, 0.0);
    let prior = diagonal(PER_RECEIVER);
    for m in moments {
        let Information { precision, sum } = Information::new(m, variance);
        let (covariance, log_determinant) = posterior(precision);
        squares += m.products[0][0] / variance - dot(sum, multiply(covariance, sum));
        logs += m.count * variance.ln() + m.logs + log_determinant;
        // With prior precision P and posterior covariance M: precision P - P M P, and sum P M sum.
        let mean = multiply(covariance, sum);
        for i in 0..2 {
            shared.sum[i] += prior[i][i] * mean[i];
            for j in 0..2 {
                shared.precision[i][j] += prior[i][j] - prior[i][i] * covariance[i][j] * prior[j][j];
            }
        }
    }
    (shared, squares, logs)
}

/// Returns the posterior covariance of `t_j` and `g_j` for the precision of their powers, and the logarithm of the
/// determinant of its inverse, relative to the prior.
fn posterior(mut precision: Matrix) -> (Matrix, f64) {
    let prior = diagonal(PER_RECEIVER);
    (0..2).for_each(|i| precision[i][i] += prior[i][i]);
    let (covariance, log_determinant) = invert(precision);
    (covariance, log_determinant - (prior[0][0] * prior[1][1]).ln())
}

/// Returns the precision of two independent numbers with these standard deviations.
fn diagonal([a, b]: [f64; 2]) -> Matrix {
    [[1.0 / (a * a), 0.0], [0.0, 1.0 / (b * b)]]
}

/// Returns the inverse of a positive definite matrix, and the logarithm of its determinant.
fn invert([[a, b], [c, d]]: Matrix) -> (Matrix, f64) {
    let determinant = a * d - b * c;
    ([[d / determinant, -b / determinant], [-c / determinant, a / determinant]], determinant.ln())
}

fn multiply(matrix: Matrix, vector: [f64; 2]) -> [f64; 2] {
    matrix.map(|row| dot(row, vector))
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
