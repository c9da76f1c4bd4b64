//! What people look at: the page of one run, and tables and figures that compare many.
//!
//! [`page()`] is the hook that a run calls with its [`Results`](pwrfgs_experiment::Results); [`Study`] reads finished runs
//! back from their folders and [`write()`] puts them side by side. Both draw with `draw`.
#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

pub mod draw;
mod run_page;
mod study;
mod templates;

pub use run_page::page;
pub use study::{Options, Record, Score, Setting, Study, Variant, figures, write};
pub use templates::fill;
