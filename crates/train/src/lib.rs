//! Training: algorithm 1 of the paper, as one loop over steps.
//!
//! [`Trainer::step`] is one screen: batch → gates → forward → loss → backward → statistics → Adam → (densify | prune).
//! N changes in one place only, `edit.rs`.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod adam;
mod batches;
mod births;
mod budgets;
mod checkpoint;
mod checks;
mod densify;
mod edit;
mod estimate;
mod fingerprint;
mod graph;
mod loss;
mod plan;
mod pruning;
mod settings;
mod survey;
mod trainer;
mod warnings;

pub use budgets::check_available;
pub use estimate::{Estimate, network_bytes};
pub use graph::{Batch, LossAndGradients, Places, loss_and_gradients};
pub use loss::{ChannelLoss, LinkLoss, Objective, RenderingLoss};
pub use plan::TrainingPlan;
pub use settings::{Densify, Errors, Loss, Optimizer, Rays, Schedule, Training};
pub use trainer::{Pruned, StepReport, Trainer};
