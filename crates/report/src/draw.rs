//! Pictures as SVG, shared by the report of one run and the figures of a study.

pub(crate) mod charts;
pub(crate) mod marks;
pub(crate) mod picture;
pub(crate) mod print;
pub(crate) mod room;
pub(crate) mod spectra;
pub(crate) mod steps;
pub(crate) mod ticks;
