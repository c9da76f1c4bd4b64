//! Pictures, shared by the page of one run and the figures of a study: all of them on one [`canvas`].

mod axes;
mod backend;
pub(crate) mod canvas;
pub(crate) mod charts;
pub(crate) mod font;
pub(crate) mod legend;
pub(crate) mod marks;
mod png;
pub(crate) mod room;
pub(crate) mod ruler;
pub(crate) mod spectra;
pub(crate) mod steps;
mod svg;
pub(crate) mod ticks;
