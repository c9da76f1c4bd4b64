//! What is known and how it is divided: data sources, point clouds, splits and the predictors to be beaten.
//!
//! * [`Nerf2Spectrum`] reads measured spectra in the NeRF2 layout, [`Teacher`] simulates some with a known answer.
//! * [`read_points`] reads a point cloud from PLY, XYZ or CSV, [`read_mesh`] triangles from OBJ, STL or PLY.
//! * [`Official`], [`Random`], [`TimeBlock`], [`Voxel`] and [`Sparse`] divide samples.
//! * [`MeanSpectrum`] and [`NearestNeighbours`] are scored beside every model.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod baselines;
mod mesh;
mod nerf2;
mod ply;
mod points;
mod polygons;
mod splits;
mod teacher;
mod text;

pub use baselines::{MeanSpectrum, NearestNeighbours};
pub use mesh::read_mesh;
pub use nerf2::Nerf2Spectrum;
pub use points::read_points;
pub use polygons::Triangles;
pub use splits::{Official, Random, Sparse, TimeBlock, Voxel};
pub use teacher::Teacher;
