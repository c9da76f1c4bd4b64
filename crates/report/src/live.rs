//! The page that moves: its scripts and style (`web`), and what it is told of room, data and Gaussians.
//!
//! `pwrfgs view` serves it with a program behind it; `report.html` holds it with everything inside. Both show the same
//! stage: a room to turn, a transmitter to drag, and what a receiver observes of it.
mod gaussians;
mod pack;
mod room;
mod web;

pub use gaussians::{contributions, gaussians, moment};
pub use pack::Pack;
pub use room::{Known, origin, room};
pub use web::{FILES, STAGE, STYLE, bundle};
