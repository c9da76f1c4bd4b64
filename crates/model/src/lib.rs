//! The model: a cloud, weights, and the stages that turn a transmitter position into what a receiver observes.
//!
//! [`Stages`] is a method and its frame.
//! [`Prepared`] walks it for many links, the training step in `pwrfgs-train` there and back.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod ensemble;
pub mod export;
pub mod file;
mod model;
mod prepared;
mod snapshot;
pub mod tensors;
mod trained;

pub use ensemble::Ensemble;
pub use model::{Model, Stages};
pub use prepared::Prepared;
pub use snapshot::Snapshot;
pub use trained::Trained;
