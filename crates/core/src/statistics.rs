//! `Statistics`: what a pass over training transmitters finds of each Gaussian, where a pruner asks for it.

use crate::{Real, rng};

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
