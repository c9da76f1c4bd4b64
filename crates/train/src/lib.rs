//! Training: algorithm 1 of the paper, as one loop over steps.
//!
//! [`Trainer::step`] shows the order: batch → gates → forward → loss → backward → statistics → Adam → (densify |
//! prune). N changes only in `edit.rs`.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod adam;
mod batches;
mod checkpoint;
mod densify;
mod device_steps;
mod edit;
mod estimate;
mod graph;
mod loss;
mod plan;
mod pruning;
mod settings;
mod start;
mod stepper;
mod trainer;
mod warnings;

pub use checkpoint::data_digest;
pub use estimate::{TimeEstimate, TimedSteps, network_bytes};
pub use graph::{Batch, LossAndGradients, loss_and_gradients};
pub use loss::{ChannelLoss, LinkLoss, Objective, RenderingLoss};
pub use plan::{TrainingPlan, check_available};
pub use settings::{Densify, Keep, Loss, Optimizer, PixelLoss, Rays, Schedule, Training};
pub use trainer::{PruneStepState, StepReport, Trainer};
