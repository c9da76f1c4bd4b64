//! Tasks on data or a finished model, one function per task. Each takes loaded data or models and its settings, and returns
//! tables and arrays with names and units. Command line, Python package and viewer call these functions.
//!
//! Settings are structs with defaults. Their doc comments are the help of the command line and of the Python functions.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

pub mod compare;
pub mod compress;
pub mod init;
#[cfg(feature = "report")]
pub mod locate;
#[cfg(feature = "report")]
pub mod map;
mod models;
#[cfg(feature = "report")]
pub mod place;
#[cfg(feature = "report")]
pub mod plan;
pub mod plane;
pub mod predict;
pub mod update;

#[cfg(feature = "report")]
pub use map::{MapSettings, RadioMap, map};
pub use models::{check_positions, read_models, select_receivers};
