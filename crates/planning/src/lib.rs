//! Plans of measurements: positions to measure next, and positions of receivers.
//!
//! * [`Survey`] selects the positions that lower the posterior variance of a Gaussian process most, from [`Posterior`].
//! * [`ascend`] searches positions of receivers with the largest coverage, [`best_subset`] the best of given receivers.
//! * [`learn()`] estimates the correlation of that process from measurements, and [`kriging_scores`] scores a selection.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

#[cfg(feature = "raytrace")]
mod floor;
mod learn;
mod place;
mod place_ascent;
#[cfg(feature = "raytrace")]
mod place_scene;
mod place_subset;
mod posterior;
mod survey;

#[cfg(feature = "raytrace")]
pub use floor::floor_grid;
pub use learn::{kriging_scores, learn};
pub use place::{coverage, soft_coverage, strongest};
pub use place_ascent::{Ascent, AscentResult, ascend};
#[cfg(feature = "raytrace")]
pub use place_scene::SceneCoverage;
pub use place_subset::{Subset, best_subset, combinations, coverage_of, greedy_subset, random_subsets};
pub use posterior::Posterior;
pub use survey::{Survey, SurveyPlan, default_correlation};
