//! Projectors and the differentiable rasterizers.
//!
//! [`Mercator`], [`Pinhole`] and [`WrfgsCompat`] are [`CameraModel`]s in one EWA projection (`ewa.rs`); [`AlphaBlending`] draws
//! their splats tile by tile (`tiles.rs`, `blend.rs`, `canvas.rs`). [`ArrayResponse`] treats the same splats as waves
//! and adds them up on an antenna array.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod alpha_blending;
mod array_response;
mod blend;
mod canvas;
mod ewa;
mod mercator;
mod pinhole;
mod survey;
mod tiles;
mod wrfgs_compat;

pub use alpha_blending::AlphaBlending;
pub use array_response::{ArrayResponse, Wavefront};
pub use ewa::{CameraModel, ViewTransform, project, project_vjp, visible_centres};
pub use mercator::Mercator;
pub use pinhole::Pinhole;
pub use tiles::Support;
pub use wrfgs_compat::{FullSphere, WrfgsCompat};
