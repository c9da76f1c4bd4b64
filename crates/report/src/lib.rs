//! Pages and figures: the page of one run, and tables and figures that compare many runs.
//!
//! [`page()`] creates the page of a run from its [`Record`](pwrfgs_experiment::Record); [`write()`] compares the
//! records of a [`Study`]. Both use `draw`.
#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

pub mod canvas;
/// Drawings shared by all pages and figures, on one [`canvas`].
pub mod draw {
    pub(crate) mod axes;
    pub(crate) mod charts;
    pub mod location;
    pub(crate) mod marks;
    pub mod plan;
    pub(crate) mod room;
    pub(crate) mod spectra;
    pub mod survey;
}
pub mod live;
mod run_page;
mod study;
mod templates;

pub use pwrfgs_experiment::{Setting, Study, StudyVariant};
pub use run_page::{page, room_page};
pub use study::{ReportOptions, figures, write};
