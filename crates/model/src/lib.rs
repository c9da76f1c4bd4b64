//! The model: a cloud, weights, and the stages that compute observations from a transmitter position.
//!
//! [`Stages`] is a method and its frame. [`Prepared`] runs it forward for many links; the training step in
//! `pwrfgs-train` runs it forward and backward.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod calibration;
pub mod compress;
mod ensemble;
pub mod export;
pub mod file;
mod model;
mod prepared;
mod residual_fit;
mod residuals;
mod snapshot;
pub mod tensors;
mod trained;
mod training_positions;

pub use calibration::{HeldOutScores, Interval, IntervalCalibration, IntervalFactors};
pub use ensemble::Ensemble;
pub use model::{MAX_PIXELS, Model, Stages};
pub use prepared::Prepared;
pub use residual_fit::KnownLinks;
pub use residuals::{Kriged, ResidualProcess, Residuals, ShareGain};
pub use snapshot::Snapshot;
pub use trained::Trained;
pub use training_positions::{TrainingDistances, TrainingPositions};
