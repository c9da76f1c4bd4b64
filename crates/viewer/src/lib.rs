//! `pwrfgs view`: a page behind which a model predicts while a transmitter is dragged.
//!
//! The page is that of `pwrfgs_report::live`; here are what it asks for (`routes`), who may ask (`guard`), and what is shown
//! (`Side`). It listens on the loopback alone and writes nothing.
#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod guard;
mod routes;
mod server;
mod side;

use pwrfgs_core::Result;
use side::House;
pub use side::Side;
use std::sync::atomic::AtomicBool;

/// Shows `sides` beside each other until `stop` is set, or the last page is closed; `ready` is told the address.
///
/// # Errors
/// Sides that do not go together, or a system that gives no port.
pub fn view(sides: Vec<Side>, ready: impl FnOnce(&str), stop: &AtomicBool) -> Result<()> {
    if let Some((first, others)) = sides.split_first() {
        others.iter().try_for_each(|other| other.check_beside(first))?;
    }
    server::serve(&House::new(sides), ready, stop)
}
