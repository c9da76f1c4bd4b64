//! Server of `pwrfgs view`: a page on which the user moves a transmitter and sees predictions.
//!
//! `pwrfgs_report::live` contains the page. This crate answers its requests (`routes`), checks their origin (`guard`)
//! and holds the models (`ViewPane`). The server listens on the loopback interface only and writes no files.
#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod guard;
mod predictor;
mod routes;
mod server;
mod side;
mod state;

use pwrfgs_core::Result;
pub use side::ViewPane;
use state::ServerState;
use std::sync::atomic::AtomicBool;

/// Serves `sides` next to each other until `stop` is set or the last page is closed; `ready` receives the address.
///
/// # Errors
/// If the sides differ in task, receivers or size of the image plane, or if the system provides no port.
pub fn view(sides: Vec<ViewPane>, ready: impl FnOnce(&str), stop: &AtomicBool) -> Result<()> {
    if let Some((first, others)) = sides.split_first() {
        others.iter().try_for_each(|other| other.check_comparable(first))?;
    }
    server::serve(&ServerState::new(sides), ready, stop)
}
