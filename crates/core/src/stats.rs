//! What pruners and densification may look at: `Moment` and `CloudStats`.

use crate::{ImagePlane, Real, RenderVjp, Splats, Statistics};
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
