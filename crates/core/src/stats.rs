//! What pruners and densification may look at: `Moment`, the `CloudStats` that training gathers step by step, and the
//! `Statistics` of a pass over training transmitters, where a pruner asks for them.

use crate::{ImagePlane, Real, RenderVjp, Splats, rng};
use serde::{Deserialize, Serialize};

/// The three phases of algorithm 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// `t ≤ M_d`: clone, split and remove.
    Densify,
    /// `M_d < t ≤ M_p`: the pruners are asked every `I_p` steps.
    Prune,
    /// `t > M_p`: N is fixed, masks are gone.
    Finetune,
}

impl Phase {
    /// Lower-case name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Densify => "densify",
            Self::Prune => "prune",
            Self::Finetune => "finetune",
        }
    }
}

/// When a pruner is asked; its random draws come from `stream(seed, "pruner …", step)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// Training step, counted from 1.
    pub step: u64,
    /// Phase of algorithm 1.
    pub phase: Phase,
    /// The pipeline's seed.
    pub seed: u64,
    /// Which prune step of the pruning phase it is, from 1; 0 at any other step.
    pub round: u64,
    /// How many there are.
    pub rounds: u64,
    /// `training.target`, the number of Gaussians at the end of pruning; of all pruners only that which has to reach it has it.
    pub target: Option<usize>,
}

impl Moment {
    /// A step that is no prune step.
    pub fn new(step: u64, phase: Phase, seed: u64) -> Self {
        Self { step, phase, seed, round: 0, rounds: 0, target: None }
    }

    /// How many of `n` Gaussians stay at this prune step, so that at the last one `target` do, and each takes the same
    /// share. All of them where it is no prune step.
    pub fn quota(&self, n: usize, target: usize) -> usize {
        if self.round == 0 || n <= target {
            return n;
        }
        let left = self.rounds.saturating_sub(self.round) as f64;
        let (now, last) = (n as f64, target as f64);
        let share = (now / last).powf(left / (left + 1.0));
        (last * share).round() as usize
    }
}

/// What was seen of each Gaussian since the last densification, and at a prune step what the pruner asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CloudStats {
    /// Renders in which it reached the picture, `[N]`.
    pub visible: Vec<Real>,
    /// Sum over these of ‖∂L/∂μ′‖ with μ′ in normalised device coordinates (px · 2/W, px · 2/H), `[N]`.
    pub gradient: Vec<Real>,
    /// Largest radius, px, `[N]`.
    pub radius: Vec<Real>,
    /// Sum of blending weights γ·T over pixels and renders, `[N]`.
    pub weight: Vec<Real>,
    /// What [`crate::Pruner::needs`] names, fresh from a pass at this prune step; empty at any other.
    pub asked: Statistics,
}

impl CloudStats {
    /// Zeros for N Gaussians.
    pub fn zeros(n: usize) -> Self {
        let zeros = || vec![0.0; n];
        Self { visible: zeros(), gradient: zeros(), radius: zeros(), weight: zeros(), ..Self::default() }
    }

    /// Adds what one of `drawings` that share the mean of a loss shows of the Gaussians `rows`: their splats, and the
    /// derivative `d` of that loss. Each drawing counts with the gradient of its own loss.
    pub fn observe(&mut self, rows: &[usize], splats: &Splats, d: &RenderVjp, plane: &ImagePlane, drawings: usize) {
        let (half, drawings) = ([0.5 * plane.width as Real, 0.5 * plane.height as Real], drawings as Real);
        for (k, &i) in rows.iter().enumerate() {
            if splats.radii[k] > 0.0 {
                let [dx, dy] = d.splats.means2d[k];
                self.visible[i] += 1.0;
                self.gradient[i] += drawings * (dx * half[0]).hypot(dy * half[1]);
                self.radius[i] = self.radius[i].max(splats.radii[k]);
                self.weight[i] += d.weights[k];
            }
        }
    }

    /// Adds what was seen of the same Gaussians at another step.
    pub fn add(&mut self, seen: &Self) {
        for i in 0..self.visible.len() {
            self.visible[i] += seen.visible[i];
            self.gradient[i] += seen.gradient[i];
            self.radius[i] = self.radius[i].max(seen.radius[i]);
            self.weight[i] += seen.weight[i];
        }
    }

    /// The rows listed, in that order, of what is summed over steps.
    pub fn select(&self, rows: &[usize]) -> Self {
        let pick = |column: &[Real]| rows.iter().map(|&i| column[i]).collect();
        let Self { visible, gradient, radius, weight, .. } = self;
        let (visible, gradient, radius, weight) = (pick(visible), pick(gradient), pick(radius), pick(weight));
        Self { visible, gradient, radius, weight, ..Self::default() }
    }

    /// The four columns that are summed over steps, by name.
    pub fn columns(&self) -> [(&'static str, &[Real]); 4] {
        [("visible", &self.visible), ("gradient", &self.gradient), ("radius", &self.radius), ("weight", &self.weight)]
    }

    /// The same, to be changed.
    pub fn columns_mut(&mut self) -> [(&'static str, &mut Vec<Real>); 4] {
        [
            ("visible", &mut self.visible),
            ("gradient", &mut self.gradient),
            ("radius", &mut self.radius),
            ("weight", &mut self.weight),
        ]
    }
}

/// A number of each Gaussian. Weights are blending weights γ·T; sums run over the pixels that training looks at and over
/// the links of the pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Statistic {
    /// [`Statistics::weight`].
    Weight,
    /// [`Statistics::largest_weight`].
    LargestWeight,
    /// [`Statistics::weight_per_area`].
    WeightPerArea,
    /// [`Statistics::signal_mean`] and [`Statistics::signal_max`].
    SignalWeight,
    /// [`Statistics::error`] and [`Statistics::high_error`].
    Error {
        /// A pixel's error is high above this share of the way from the picture's smallest to its largest.
        high: Real,
    },
    /// [`Statistics::top`].
    Top {
        /// How many of each pixel.
        count: usize,
    },
    /// [`Statistics::sensitivity`].
    Sensitivity,
    /// [`Statistics::fisher`].
    Fisher,
    /// [`Statistics::elimination`].
    Elimination {
        /// The most Gaussians it is worked out for: the work grows with their square.
        most: usize,
    },
}

impl Statistic {
    /// Whether it rests on blending weights, which not every rasterizer has. The true loss does not.
    pub fn wants_blending(self) -> bool {
        !matches!(self, Self::Elimination { .. })
    }
}

/// What a pruner asks a pass for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Needs {
    /// What is computed; nothing where it is empty.
    pub statistics: Vec<Statistic>,
    /// What is computed too where Gaussians are blended; a pruner that can do without is not refused elsewhere.
    pub where_blended: Vec<Statistic>,
    /// How many training transmitters the pass looks at, drawn from the seed at each prune step; 0: all of them.
    pub transmitters: usize,
}

impl Needs {
    /// Nothing, which costs nothing.
    pub fn nothing() -> Self {
        Self::default()
    }

    /// `statistics` of `transmitters` of the training part (0: all).
    pub fn of(statistics: &[Statistic], transmitters: usize) -> Self {
        Self { statistics: statistics.to_vec(), where_blended: Vec::new(), transmitters }
    }

    /// The same, and `statistics` too where Gaussians are blended.
    #[must_use]
    pub fn and_where_blended(mut self, statistics: &[Statistic]) -> Self {
        self.where_blended.extend(statistics);
        self
    }

    /// What is computed of a method that blends, or does not.
    #[must_use]
    pub fn settled(mut self, blends: bool) -> Self {
        let more = std::mem::take(&mut self.where_blended);
        self.statistics.extend(more.into_iter().filter(|_| blends));
        self
    }

    /// Whether nothing is asked for.
    pub fn is_nothing(&self) -> bool {
        self.statistics.is_empty()
    }

    /// Which of `count` transmitters a pass at `step` looks at, in order.
    pub fn sample(&self, count: usize, seed: u64, step: u64) -> Vec<usize> {
        let mut all: Vec<usize> = (0..count).collect();
        if self.transmitters > 0 && self.transmitters < count {
            rng::shuffle(&mut rng::stream(seed, "statistics", step), &mut all);
            all.truncate(self.transmitters);
            all.sort_unstable();
        }
        all
    }
}

/// What a pass found, `[N]` each; empty where nobody asked for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Links that the pass looked at.
    pub links: usize,
    /// Sum of the weights.
    pub weight: Vec<Real>,
    /// Largest weight in any pixel of any link.
    pub largest_weight: Vec<Real>,
    /// Sum over links of the weights over the number of pixels that the Gaussian touches.
    pub weight_per_area: Vec<Real>,
    /// Mean over links of Σ ‖s‖·w, with the Gaussian's own signal s for that transmitter.
    pub signal_mean: Vec<Real>,
    /// Largest over links of Σ ‖s‖·w: what one transmitter needs survives.
    pub signal_max: Vec<Real>,
    /// Sum of weights times the absolute error of the picture there.
    pub error: Vec<Real>,
    /// Sum over links of the picture's mean absolute error times the number of pixels of high error that it touches.
    pub high_error: Vec<Real>,
    /// Whether in some pixel it is among the first by exp(−|‖s‖ − P|)·w, with P what was measured there.
    pub top: Vec<bool>,
    /// Sum of (∂P̂/∂a)² with a factor a on γ, at 1: how much the picture changes with the Gaussian's own strength.
    pub sensitivity: Vec<Real>,
    /// Sum of J Jᵀ with J = ∂P̂/∂(mean, log scale), signals held: the upper triangle of a 6 × 6 matrix, row by row.
    pub fisher: Vec<[Real; 21]>,
    /// The place at which backward elimination takes it, from 0: in turn that one goes without which the training loss is
    /// smallest. Empty above the most that was asked for.
    pub elimination: Vec<Real>,
}

impl Statistics {
    /// Zeros of what `needs` names.
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

    /// Adds what other links showed of the Gaussians `rows` (those of `other`).
    pub fn add(&mut self, rows: &[usize], other: &Self) {
        self.links += other.links;
        let sums = [
            (&mut self.weight, &other.weight),
            (&mut self.weight_per_area, &other.weight_per_area),
            (&mut self.signal_mean, &other.signal_mean),
            (&mut self.error, &other.error),
            (&mut self.high_error, &other.high_error),
            (&mut self.sensitivity, &other.sensitivity),
        ];
        for (sum, own) in sums {
            rows.iter().zip(own).for_each(|(&i, v)| sum[i] += v);
        }
        for (largest, own) in
            [(&mut self.largest_weight, &other.largest_weight), (&mut self.signal_max, &other.signal_max)]
        {
            rows.iter().zip(own).for_each(|(&i, v)| largest[i] = largest[i].max(*v));
        }
        rows.iter().zip(&other.top).for_each(|(&i, v)| self.top[i] |= v);
        for (&i, own) in rows.iter().zip(&other.fisher) {
            self.fisher[i].iter_mut().zip(own).for_each(|(sum, v)| *sum += v);
        }
    }

    /// Sums over links become means where the name says so.
    pub fn finish(&mut self) {
        let links = self.links.max(1) as Real;
        self.signal_mean.iter_mut().for_each(|v| *v /= links);
    }
}
