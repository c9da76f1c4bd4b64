//! Training steps on a device that keeps parameters, derivatives and the moments of Adam: what a trainer passes to a
//! [`DeviceStepper`] of its method.

use crate::{AdamUpdate, CloudStats, GaussianCloud, LinkInputs, MeasurementSetup, Real, Result, ssim::Window};
use std::ops::Range;

/// State of a training, which steps change.
#[derive(Debug)]
pub struct TrainingState<'a> {
    /// Gaussians, without columns of pruners.
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

/// A step with the rendering loss of eq. (9), without gates and penalties of pruners.
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
    /// Update per column of the cloud, in its order; `None` for a column that is not learned.
    pub columns: Vec<Option<AdamUpdate>>,
    /// Updates of the learned weights.
    pub weights: Vec<(Range<usize>, AdamUpdate)>,
}

/// Steps of a method on a device that keeps the parameters in between.
pub trait DeviceStepper {
    /// Runs some steps; returns the loss of each, before its update. Equal steps give equal bits, in one call or in
    /// several.
    ///
    /// # Errors
    /// The device failed or has too little memory; the state is then unchanged.
    fn run(&self, state: TrainingState<'_>, steps: &[DeviceStep]) -> Result<Vec<Real>>;
}
