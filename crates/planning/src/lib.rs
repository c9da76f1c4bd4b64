//! Plans of measurements: positions to measure next, and positions of receivers.
//!
//! * [`Survey`] selects the positions that lower the posterior variance of a Gaussian process most, from `Posterior`.
//! * [`select_farthest`] thins positions.
//! * [`ascend`] searches positions of receivers with the largest coverage, [`best_subset`] the best of given receivers.
//! * [`learn_correlation`] estimates the correlation of that process from measurements, and [`kriging_scores`] scores a
//!   selection.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod ascent;
mod coverage;
mod farthest;
mod learn;
mod posterior;
#[cfg(feature = "raytrace")]
mod scene;
mod survey;

pub use ascent::{AscentResult, ascend};
pub use coverage::{
    ReceiverSubset, best_subset, combinations, coverage, greedy_subset, random_subsets, soft_coverage,
    strongest_powers, subset_coverage,
};
pub use farthest::select_farthest;
pub use learn::{kriging_scores, learn_correlation, longest_length};
#[cfg(feature = "raytrace")]
pub use scene::{SceneCoverage, floor_grid};
pub use survey::{Survey, SurveyPlan, default_correlation};
