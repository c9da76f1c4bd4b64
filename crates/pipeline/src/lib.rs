//! The pipeline file: its fields with their defaults, what must go together, and changes by path.
//!
//! [`Pipeline`] is the whole of a run as one RON value. This crate depends on the plugins that a pipeline takes where
//! nothing is given, so that defaults are plain values; `train` sees none of it, only the plan that
//! [`Pipeline::plan`] makes.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod changes;
pub mod defaults;
mod draft;
mod pipeline;
mod place;
mod read;
pub mod ron_tree;

pub use changes::{Change, Changes};
pub use draft::{Draft, Fault};
pub use pipeline::Pipeline;
