//! Training: algorithm 1 of the paper, as one loop over steps.
//!
//! [`Trainer::step`] is one screen: batch → gates → forward → loss → backward → statistics → Adam → (densify | prune).
//! N changes in one place only, `edit.rs`.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod adam;
mod batches;
mod checkpoint;
mod densify;
mod edit;
mod graph;
mod loss;
mod pipeline;
mod settings;
mod trainer;

pub use graph::{Batch, LossAndGradients, loss_and_gradients};
pub use loss::RenderingLoss;
pub use pipeline::{Pipeline, PipelineFields, PipelinePatch};
pub use settings::{
    Densify, DensifyPatch, Loss, LossPatch, Optimizer, OptimizerPatch, Schedule, Training, TrainingPatch,
};
pub use trainer::{StepReport, Trainer};
