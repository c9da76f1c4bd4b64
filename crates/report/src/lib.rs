//! What people look at: the page of one run, and tables and figures that compare many.
//!
//! [`page()`] makes the page of a run from its [`Record`](pwrfgs_experiment::Record), [`write()`] compares the records of a
//! [`Study`]. Both draw with `draw`.
#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

pub mod canvas;
pub mod draw;
pub mod live;
mod run_page;
mod study;
mod templates;

pub use run_page::page;
pub use study::{Setting, Study, Variant, figures, write};
