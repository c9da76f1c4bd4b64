//! Training steps on a device that keeps parameters, derivatives and the moments of Adam: what a trainer passes to a
//! [`DeviceStepper`] of its method.

use crate::{AdamUpdate, CloudStats, GaussianCloud, LinkInputs, MeasurementSetup, Real, Result, ssim::Window};
use std::ops::Range;

/// What a pruner does in a step that is no prune step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum StepRole {
    /// Only its functions know: the trainer computes the step.
    #[default]
    Unknown,
    /// Nothing: it has no gate, no penalty and no update.
    Idle,
    /// It learns a mask.
    Mask(StraightThroughMask),
}

/// Mask of column m: the gate 1[σ(m) ≥ threshold] with the derivative σ′(m), eq. (11), and the penalty λ · mean σ(m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StraightThroughMask {
    /// Name of the column of m.
    pub column: &'static str,
    /// Smallest σ(m) of an open gate.
    pub threshold: Real,
    /// Weight λ of the penalty.
    pub lambda: Real,
}

/// State of a training, which steps change.
#[derive(Debug)]
pub struct TrainingState<'a> {
    /// Gaussians, and the columns of pruners.
    pub cloud: &'a mut GaussianCloud,
    /// Weights of the network.
    pub weights: &'a mut [Real],
    /// First and second moments of the Gaussians.
    pub cloud_moments: &'a mut [GaussianCloud; 2],
    /// First and second moments of the weights.
    pub weight_moments: &'a mut [Vec<Real>; 2],
    /// Statistics since the last densification.
    pub stats: &'a mut CloudStats,
}

/// A step with the rendering loss of eq. (9).
#[derive(Debug)]
pub struct DeviceStep {
    /// Setup with the image plane of the step.
    pub setup: MeasurementSetup,
    /// Links of the batch.
    pub links: LinkInputs,
    /// Measured spectra `[L, H·W]`.
    pub truths: Vec<Real>,
    /// Weight of 1-SSIM, and its window.
    pub ssim: (Real, Window),
    /// Whether errors are squared; otherwise absolute.
    pub is_squared: bool,
    /// Learned mask, if there is one.
    pub mask: Option<StraightThroughMask>,
    /// Update per column of the cloud, in its order; `None` for a column that is not learned.
    pub columns: Vec<Option<AdamUpdate>>,
    /// Updates of the learned weights.
    pub weights: Vec<(Range<usize>, AdamUpdate)>,
}

/// Steps of a method on a device that keeps the parameters in between.
pub trait DeviceStepper {
    /// Runs some steps; returns loss and penalty of each, before its update. Equal steps give equal bits, in one call or in
    /// several.
    ///
    /// # Errors
    /// The device failed or has too little memory; the state is then unchanged.
    fn run(&self, state: TrainingState<'_>, steps: &[DeviceStep]) -> Result<Vec<[Real; 2]>>;
}
