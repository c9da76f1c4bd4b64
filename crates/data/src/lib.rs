//! Data sources, point clouds, splits and baselines.
//!
//! * [`Nerf2Spectrum`] reads measured spectra in the NeRF2 layout, [`Arrays`] NumPy arrays; [`Teacher`] simulates
//!   spectra of known Gaussians.
//! * [`Colmap`] reads images of a moving camera with their poses, in the text format of COLMAP.
//! * [`Nerf2Rssi`] reads received powers at many gateways, [`Nerf2Csi`] uplink and downlink channels of a base station,
//!   both in the NeRF2 layout; [`Channels`] reads channels from a NumPy array.
//! * [`Subset`] has some links of another source.
//! * [`read_points`] reads a point cloud from PLY, XYZ or CSV, [`read_mesh`] triangles from OBJ or PLY.
//! * [`Official`], [`Random`], [`TimeBlock`], [`Voxel`] and [`Sparse`] split transmitters, [`RandomLinks`] links,
//!   [`LeaveReceiverOut`] receivers.
//! * [`MeanSpectrum`], [`NearestNeighbours`], [`NearestCarrier`], [`Kriging`], [`LogDistance`] and [`Zero`] are the baselines
//!   of each table.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod arrays;
mod baselines;
mod channels;
mod checks;
mod colmap;
mod colormap;
mod dialect;
mod folder;
mod geometry;
pub mod import;
mod nerf2;
mod npy;
mod pictures;
mod ply;
mod polygons;
mod save;
mod splits;
mod subset;
mod table;
mod teacher;
mod text;

pub use arrays::Arrays;
pub use baselines::{
    Kriging, LogDistance, MeanSpectrum, NearestCarrier, NearestNeighbours, Neighbours, Predictions, Ridge, Trend, Zero,
    vecchia_cases,
};
pub use channels::{CarrierFile, Channels, ReceiverPlace};
pub use checks::{UnlinkedNode, check_dataset, is_linear, power_fault, shape_fault, unlinked_node};
pub use colmap::Colmap;
pub use colormap::Colormap;
pub use dialect::TableFile;
pub use folder::{
    CARRIERS, base_station_yaml, gateway_positions_yaml, gateway_yaml, read_carriers, receiver_yaml, transmitter_yaml,
};
pub use geometry::{read_mesh, read_points};
pub use nerf2::{Nerf2Csi, Nerf2Rssi, Nerf2Spectrum, POSES, read_poses, read_powers, read_transmitters};
pub use npy::real_channels_fault;
pub use pictures::read_image;
pub use polygons::{MOST_TRIANGLES, Triangles};
pub use pwrfgs_core::npy::{npy_header, npy_header_as};
pub use save::{pose_row, poses_csv, save};
pub use splits::{Fold, LeaveReceiverOut, Official, Random, RandomLinks, Sparse, TimeBlock, Voxel};
pub use subset::{LINKS, Subset, write_links};
pub use table::{ColumnChoice, ImportedTable, TableImport, read_frame_positions};
pub use teacher::Teacher;
pub use text::warn_once;
