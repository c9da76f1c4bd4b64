//! Plans of measurements: positions to measure next, and positions of receivers.
//!
//! * [`Survey`] selects the positions that lower the posterior variance of a Gaussian process most, from [`Posterior`].
//! * [`learn()`] estimates the correlation of that process from measurements, and [`kriging_scores`] scores a selection.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

#[cfg(feature = "raytrace")]
mod floor;
mod learn;
mod posterior;
mod survey;

#[cfg(feature = "raytrace")]
pub use floor::floor_grid;
pub use learn::{kriging_scores, learn};
pub use posterior::Posterior;
pub use survey::{Survey, SurveyPlan, default_correlation};
