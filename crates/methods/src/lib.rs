//! Methods, which compute observations from Gaussians or rays.
//!
//! [`Splatting`] draws Gaussians as splats; [`SplattedChannel`] sums the waves of the same Gaussians. Both use a
//! deformation and an [`Activation`]. [`VirtualTransmitters`] are Gaussians that emit spherical waves; [`Nerf2`] uses
//! rays and no Gaussians.

mod activate;
mod groups;
mod nerf2;
mod readout;
mod splatted_channel;
mod splatting;
pub mod virtual_transmitters;

pub use activate::{Activation, ActivationVjp, Calibration, normalise_quat, normalise_quat_vjp};
pub use nerf2::Nerf2;
pub use readout::Readout;
pub use splatted_channel::SplattedChannel;
pub use splatting::{Geometry, ReceiverView, Splatting};
pub use virtual_transmitters::{MatchingPursuit, VirtualTransmitters};
