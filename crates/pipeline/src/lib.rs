//! Pipeline files: fields with defaults, consistency checks, and changes by path.
//!
//! [`Pipeline`] holds a whole run as one RON value. This crate depends on the default plugins, so that defaults are
//! plain values; the crate `train` depends only on the plan from [`Pipeline::plan`].

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod changes;
pub mod defaults;
mod pipeline;
mod pipeline_edit;
mod read;
pub mod ron_tree;
mod setting;

pub use changes::{Change, Changes};
pub use pipeline::Pipeline;
pub use pipeline_edit::{EditFault, PipelineEdit};
