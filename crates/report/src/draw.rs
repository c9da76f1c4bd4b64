//! Pictures, shared by all pages and figures of the toolkit: all of them on one [`canvas`].

mod axes;
mod backend;
pub(crate) mod charts;
pub mod heat;
pub(crate) mod legend;
pub(crate) mod marks;
pub(crate) mod plan;
pub(crate) mod room;
pub(crate) mod ruler;
pub(crate) mod spectra;
pub(crate) mod steps;
pub(crate) mod ticks;
