//! Pictures, shared by the page of one run and the figures of a study: all of them on one [`canvas`].

mod axes;
mod backend;
pub(crate) mod charts;
pub(crate) mod legend;
pub(crate) mod marks;
pub(crate) mod room;
pub(crate) mod ruler;
pub(crate) mod spectra;
pub(crate) mod steps;
pub(crate) mod ticks;

pub(crate) use pwrfgs_canvas::{self as canvas, font};
