//! What is known and how it is divided: data sources, point clouds, splits and the predictors to be beaten.
//!
//! * [`Nerf2Spectrum`] reads measured spectra in the NeRF2 layout, [`Arrays`] arrays of NumPy; [`Teacher`] simulates some
//!   with a known answer.
//! * [`Nerf2Rssi`] reads received powers at many gateways, [`Nerf2Csi`] uplinks and downlinks of a base station, both in the
//!   NeRF2 layout; [`Channels`] channels as an array of NumPy.
//! * [`read_points`] reads a point cloud from PLY, XYZ or CSV, [`read_mesh`] triangles from OBJ or PLY.
//! * [`Official`], [`Random`], [`TimeBlock`], [`Voxel`] and [`Sparse`] divide transmitters, [`RandomLinks`] links,
//!   [`LeaveReceiverOut`] receivers.
//! * [`MeanSpectrum`], [`NearestNeighbours`], [`Kriging`], [`LogDistance`] and [`Zero`] are scored beside every model.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod arrays;
mod baselines;
mod channels;
mod checks;
mod folder;
mod geometry;
pub mod import;
mod nerf2;
mod npy;
mod ply;
mod polygons;
mod save;
mod splits;
mod teacher;
mod text;

pub use arrays::Arrays;
pub use baselines::{Kriging, LogDistance, MeanSpectrum, NearestNeighbours, Neighbours, Ridge, Zero};
pub use channels::{Channels, ReceiverPlace};
pub use checks::{Unheard, check, power_fault, shape_fault, unheard};
pub use folder::{base_station_yaml, gateway_positions_yaml, gateway_yaml};
pub use geometry::{read_mesh, read_points};
pub use nerf2::{Nerf2Csi, Nerf2Rssi, Nerf2Spectrum};
pub use polygons::Triangles;
pub use pwrfgs_core::npy::{npy_header, npy_header_as};
pub use save::save;
pub use splits::{LeaveReceiverOut, Official, Random, RandomLinks, Sparse, TimeBlock, Voxel};
pub use teacher::Teacher;
