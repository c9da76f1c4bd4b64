//! The model: a cloud, weights, and the stages that turn a transmitter position into what a receiver observes.
//!
//! [`Stages`] is a method and its frame. [`Splatting`] is the method deform → activate → project → rasterize → read out.
//! [`Prepared`] walks it for many links, the training step in `pwrfgs-train` there and back.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod activate;
pub mod deform;
mod deformed;
mod ensemble;
pub mod file;
mod groups;
mod model;
mod prepared;
mod readout;
mod splatted_channel;
mod splatting;
mod stages;
pub mod tensors;
mod trained;

pub use activate::{Activation, ActivationVjp, Calibration};
pub use ensemble::Ensemble;
pub use model::Model;
pub use prepared::Prepared;
pub use readout::Readout;
pub use splatted_channel::SplattedChannel;
pub use splatting::{Drawing, Gates, Geometry, Splatting, View, check_kind, check_together};
pub use stages::Stages;
pub use trained::Trained;
