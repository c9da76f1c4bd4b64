//! What pruners and densification may look at: `Moment` and `CloudStats`.

use crate::Real;
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
}

/// What was seen of each Gaussian since the last densification; owned by the trainer.
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
}

impl CloudStats {
    /// Zeros for N Gaussians.
    pub fn zeros(n: usize) -> Self {
        Self { visible: vec![0.0; n], gradient: vec![0.0; n], radius: vec![0.0; n], weight: vec![0.0; n] }
    }

    /// The four columns by name.
    pub fn columns_mut(&mut self) -> [(&'static str, &mut Vec<Real>); 4] {
        [
            ("visible", &mut self.visible),
            ("gradient", &mut self.gradient),
            ("radius", &mut self.radius),
            ("weight", &mut self.weight),
        ]
    }
}
