//! Inputs of pruners and densification: `StepContext`, the `CloudStats` that training accumulates, and the `PassStatistics` of a
//! pass over training transmitters that a pruner requests.

use crate::{ImagePlane, Real, RenderVjp, Splats, rng};
use serde::{Deserialize, Serialize};

/// Phases of algorithm 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// Densification, `t ≤ M_d`: clone, split and remove.
    Densify,
    /// Pruning, `M_d < t ≤ M_p`: pruners run every `I_p` steps.
    Prune,
    /// Fine-tuning, `t > M_p`: N is constant, masks are removed.
    Finetune,
}

impl Phase {
    /// Returns the lower-case name, as serde writes it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Densify => "densify",
            Self::Prune => "prune",
            Self::Finetune => "finetune",
        }
    }
}

/// Context of a training step for pruners. Random draws use `stream(seed, "pruner …", step)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepContext {
    /// Training step, from 1.
    pub step: u64,
    /// Phase of algorithm 1.
    pub phase: Phase,
    /// Seed of the pipeline.
    pub seed: u64,
    /// Number of this prune step in the pruning phase, from 1; 0 at all other steps.
    pub round: u64,
    /// Number of prune steps up to this step.
    pub passed: u64,
    /// Number of all prune steps.
    pub rounds: u64,
    /// Value of `training.target_count`, the number of Gaussians at the end of pruning; only for the pruner that must reach
    /// it.
    pub target: Option<usize>,
}

impl StepContext {
    /// Creates the context of a step that is not a prune step.
    pub fn new(step: u64, phase: Phase, seed: u64) -> Self {
        Self { step, phase, seed, round: 0, passed: 0, rounds: 0, target: None }
    }

    /// Returns the number of `n` Gaussians to keep at this prune step: each step removes an equal share, and the last
    /// one leaves `target`. Returns `n` if this is not a prune step, or if `n` is at most `target`.
    pub fn quota(&self, n: usize, target: usize) -> usize {
        if self.round == 0 || n <= target {
            return n;
        }
        let rounds_left = self.rounds.saturating_sub(self.round) as f64;
        let ratio = (n as f64 / target as f64).powf(rounds_left / (rounds_left + 1.0));
        (target as f64 * ratio).round() as usize
    }

    /// Returns the number of `n` Gaussians that the next prune step keeps for [`Self::target`]: all without a target,
    /// and after the last prune step.
    pub fn next_quota(&self, n: usize) -> usize {
        let next = Self { round: self.passed + 1, ..*self };
        self.target.filter(|_| next.round <= self.rounds).map_or(n, |target| next.quota(n, target))
    }
}

/// Statistics of each Gaussian since the last densification and, at a prune step, those that the pruner requests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CloudStats {
    /// Number of renders in which it was visible, `[N]`.
    pub visible: Vec<Real>,
    /// Sum over these of ‖∂L/∂μ′‖ with μ′ in normalised device coordinates (px · 2/W, px · 2/H), `[N]`.
    pub gradient: Vec<Real>,
    /// Largest radius, px, `[N]`.
    pub radius: Vec<Real>,
    /// Sum of blending weights γ·T over pixels and renders, `[N]`.
    pub weight: Vec<Real>,
    /// Statistics of [`crate::Pruner::needs`] from a pass at this prune step; empty at all other steps.
    pub requested: PassStatistics,
}

impl CloudStats {
    /// Creates zeros for N Gaussians.
    pub fn zeros(n: usize) -> Self {
        let zeros = || vec![0.0; n];
        Self { visible: zeros(), gradient: zeros(), radius: zeros(), weight: zeros(), ..Self::default() }
    }

    /// Adds one render: the splats of the Gaussians `rows`, and the derivative `d` of a loss that is the mean over `renders`
    /// renders. Gradients are multiplied by that number, so they are those of the loss of this render alone.
    pub fn add_render(&mut self, rows: &[usize], splats: &Splats, d: &RenderVjp, plane: &ImagePlane, renders: usize) {
        let (half, renders) = ([0.5 * plane.width as Real, 0.5 * plane.height as Real], renders as Real);
        for (k, &i) in rows.iter().enumerate() {
            if splats.radii[k] > 0.0 {
                let [dx, dy] = d.splats.means2d[k];
                self.visible[i] += 1.0;
                self.gradient[i] += renders * (dx * half[0]).hypot(dy * half[1]);
                self.radius[i] = self.radius[i].max(splats.radii[k]);
                self.weight[i] += d.weights[k];
            }
        }
    }

    /// Adds the accumulated statistics of the same Gaussians from other renders.
    pub fn merge(&mut self, other: &Self) {
        for i in 0..self.visible.len() {
            self.visible[i] += other.visible[i];
            self.gradient[i] += other.gradient[i];
            self.radius[i] = self.radius[i].max(other.radius[i]);
            self.weight[i] += other.weight[i];
        }
    }

    /// Returns the listed rows of the accumulated statistics, in that order.
    pub fn select(&self, rows: &[usize]) -> Self {
        let pick = |column: &[Real]| rows.iter().map(|&i| column[i]).collect();
        let Self { visible, gradient, radius, weight, .. } = self;
        let (visible, gradient, radius, weight) = (pick(visible), pick(gradient), pick(radius), pick(weight));
        Self { visible, gradient, radius, weight, ..Self::default() }
    }

    /// Returns the four accumulated columns by name.
    pub fn columns(&self) -> [(&'static str, &[Real]); 4] {
        [("visible", &self.visible), ("gradient", &self.gradient), ("radius", &self.radius), ("weight", &self.weight)]
    }

    /// Returns the four accumulated columns by name, mutable.
    pub fn columns_mut(&mut self) -> [(&'static str, &mut Vec<Real>); 4] {
        [
            ("visible", &mut self.visible),
            ("gradient", &mut self.gradient),
            ("radius", &mut self.radius),
            ("weight", &mut self.weight),
        ]
    }
}

/// Statistic per Gaussian. Weights are blending weights γ·T; sums run over the pixels used in training and over the
/// links of the pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Statistic {
    /// [`PassStatistics::weight`].
    Weight,
    /// [`PassStatistics::largest_weight`].
    LargestWeight,
    /// [`PassStatistics::weight_per_area`].
    WeightPerArea,
    /// [`PassStatistics::signal_mean`] and [`PassStatistics::signal_max`].
    SignalWeight,
    /// [`PassStatistics::error`] and [`PassStatistics::high_error`].
    Error {
        /// Threshold of a high error, between the smallest (0) and the largest (1) error of a spectrum.
        high: Real,
    },
    /// [`PassStatistics::top`].
    Top {
        /// Number of top splats per pixel.
        count: usize,
    },
    /// [`PassStatistics::sensitivity`].
    Sensitivity,
    /// [`PassStatistics::fisher`].
    Fisher,
    /// [`PassStatistics::elimination`].
    Elimination {
        /// Maximum number of Gaussians for which it is computed: the cost grows with its square.
        most: usize,
    },
}

impl Statistic {
    /// Returns whether it uses blending weights, which not every rasterizer has: all but the elimination, which computes losses.
    pub fn requires_blending(self) -> bool {
        !matches!(self, Self::Elimination { .. })
    }
}

/// Statistics that a pruner requests from a pass.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Needs {
    /// Requested statistics; none if empty.
    pub statistics: Vec<Statistic>,
    /// Additional statistics if Gaussians are blended; methods without blending are accepted.
    pub where_blended: Vec<Statistic>,
    /// Number of training transmitters of the pass, drawn from the seed at each prune step; 0 for all.
    pub transmitters: usize,
}

impl Needs {
    /// Requests `statistics` over `transmitters` of the training set (0 for all).
    pub fn of(statistics: &[Statistic], transmitters: usize) -> Self {
        Self { statistics: statistics.to_vec(), where_blended: Vec::new(), transmitters }
    }

    /// Adds `statistics` to the request if Gaussians are blended.
    #[must_use]
    pub fn and_where_blended(mut self, statistics: &[Statistic]) -> Self {
        self.where_blended.extend(statistics);
        self
    }

    /// Returns the final request for a method that blends Gaussians or not.
    #[must_use]
    pub fn resolve_blending(mut self, blends: bool) -> Self {
        let optional = std::mem::take(&mut self.where_blended);
        self.statistics.extend(optional.into_iter().filter(|_| blends));
        self
    }

    /// Returns whether nothing is requested, after [`Self::resolve_blending`].
    pub fn is_empty(&self) -> bool {
        self.statistics.is_empty()
    }

    /// Draws the transmitters for a pass at `step`: indices below `count`, in order; all of them unless fewer are requested.
    pub fn draw_transmitters(&self, count: usize, seed: u64, step: u64) -> Vec<usize> {
        let mut transmitters: Vec<usize> = (0..count).collect();
        if self.transmitters > 0 && self.transmitters < count {
            rng::shuffle(&mut rng::stream(seed, "statistics", step), &mut transmitters);
            transmitters.truncate(self.transmitters);
            transmitters.sort_unstable();
        }
        transmitters
    }
}

/// Statistics of a pass, `[N]` each; empty if not requested.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PassStatistics {
    /// Number of links of the pass.
    pub links: usize,
    /// Sum of the weights.
    pub weight: Vec<Real>,
    /// Largest weight in any pixel of any link.
    pub largest_weight: Vec<Real>,
    /// Sum over links of the weights divided by the number of covered pixels.
    pub weight_per_area: Vec<Real>,
    /// Mean over links of Σ ‖s‖·w, with the signal s of the Gaussian for that transmitter.
    pub signal_mean: Vec<Real>,
    /// Maximum over links of Σ ‖s‖·w, which keeps Gaussians that one transmitter needs.
    pub signal_max: Vec<Real>,
    /// Sum of weights times the absolute error of the pixel.
    pub error: Vec<Real>,
    /// Sum over links of the mean absolute error of the spectrum times the number of covered high-error pixels.
    pub high_error: Vec<Real>,
    /// Whether it is among the top splats of a pixel by exp(−|‖s‖ − P|)·w, with the measured value P.
    pub top: Vec<bool>,
    /// Sum of (∂P̂/∂a)² with a factor a = 1 on γ: the sensitivity of the spectra to the strength of the Gaussian.
    pub sensitivity: Vec<Real>,
    /// Sum of J Jᵀ with J = ∂P̂/∂(mean, log scale) and constant signals: the upper triangle of a 6 × 6 matrix, row by
    /// row.
    pub fisher: Vec<[Real; 21]>,
    /// Order of backward elimination, from 0: each step removes the Gaussian whose removal gives the smallest training
    /// loss. Empty above the requested maximum.
    pub elimination: Vec<Real>,
}

impl PassStatistics {
    /// Creates zeros of the statistics in `needs`.
    pub fn zeros(needs: &Needs, n: usize) -> Self {
        let mut zeros = Self::default();
        for statistic in &needs.statistics {
            match statistic {
                Statistic::Weight => zeros.weight = vec![0.0; n],
                Statistic::LargestWeight => zeros.largest_weight = vec![0.0; n],
                Statistic::WeightPerArea => zeros.weight_per_area = vec![0.0; n],
                Statistic::SignalWeight => {
                    (zeros.signal_mean, zeros.signal_max) = (vec![0.0; n], vec![0.0; n]);
                }
                Statistic::Error { .. } => (zeros.error, zeros.high_error) = (vec![0.0; n], vec![0.0; n]),
                Statistic::Top { .. } => zeros.top = vec![false; n],
                Statistic::Sensitivity => zeros.sensitivity = vec![0.0; n],
                Statistic::Fisher => zeros.fisher = vec![[0.0; 21]; n],
                Statistic::Elimination { .. } => {}
            }
        }
        zeros
    }

    /// Adds the statistics that `other` has of other links; its row k belongs to the Gaussian `rows[k]`. The elimination is no
    /// sum and is not changed.
    pub fn merge(&mut self, rows: &[usize], other: &Self) {
        self.links += other.links;
        let sums = [
            (&mut self.weight, &other.weight),
            (&mut self.weight_per_area, &other.weight_per_area),
            (&mut self.signal_mean, &other.signal_mean),
            (&mut self.error, &other.error),
            (&mut self.high_error, &other.high_error),
            (&mut self.sensitivity, &other.sensitivity),
        ];
        for (sum, values) in sums {
            rows.iter().zip(values).for_each(|(&i, v)| sum[i] += v);
        }
        for (largest, values) in
            [(&mut self.largest_weight, &other.largest_weight), (&mut self.signal_max, &other.signal_max)]
        {
            rows.iter().zip(values).for_each(|(&i, v)| largest[i] = largest[i].max(*v));
        }
        rows.iter().zip(&other.top).for_each(|(&i, v)| self.top[i] |= v);
        for (&i, matrix) in rows.iter().zip(&other.fisher) {
            self.fisher[i].iter_mut().zip(matrix).for_each(|(sum, v)| *sum += v);
        }
    }

    /// Converts the sum over links in `signal_mean` to a mean.
    pub fn finish_means(&mut self) {
        let links = self.links.max(1) as Real;
        self.signal_mean.iter_mut().for_each(|v| *v /= links);
    }
}
