//! The model: a cloud, a deformation network, and the stages that turn a transmitter position into a spectrum.
//!
//! [`Prepared`] is the whole path without tape, gates or pruners: deform → activate → project → rasterize → read
//! out. The training step in `pwrfgs-train` runs the same functions and their derivatives.

mod activate;
pub mod deform;
mod ensemble;
pub mod file;
mod model;
mod prepared;
mod readout;
pub mod tensors;

pub use activate::{Activation, Calibration};
pub use ensemble::Ensemble;
pub use model::{Model, Stages};
pub use prepared::Prepared;
pub use readout::Readout;
