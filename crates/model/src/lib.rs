//! The model: a cloud, a deformation network, and the stages that turn a transmitter position into a spectrum.
//!
//! [`Stages`] is the path deform → activate → project → rasterize → read out: [`Prepared`] walks it for many
//! transmitters, the training step in `pwrfgs-train` there and back.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod activate;
pub mod deform;
mod ensemble;
pub mod file;
mod model;
mod prepared;
mod readout;
mod stages;
pub mod tensors;

pub use activate::{Activation, ActivationVjp, Calibration};
pub use ensemble::Ensemble;
pub use model::Model;
pub use prepared::Prepared;
pub use readout::Readout;
pub use stages::{Drawing, Geometry, Stages};
