//! Server of `pwrfgs view` and of views in notebooks: a page on which the user moves a transmitter and sees predictions.
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

/// Program that shows a page: it decides who may load the page, and when the server ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageHost {
    /// Tab of a browser; the server also ends after the last page is closed.
    Browser,
    /// Frame in a notebook on this machine, in which pages close and open again; only the flag ends the server.
    Notebook,
}

/// Serves `sides` next to each other until `stop` is set or, in a browser, the last page is closed. `ready` receives
/// the address.
///
/// # Errors
/// If the sides differ in task, receivers or size of the image plane, if the scene of the first is invalid, or if the
/// system provides no port or no random numbers.
pub fn view(mut sides: Vec<ViewPane>, host: PageHost, ready: impl FnOnce(&str), stop: &AtomicBool) -> Result<()> {
    if let Some((first, others)) = sides.split_first_mut() {
        first.add_surfaces()?;
        others.iter().try_for_each(|other| other.check_comparable(first))?;
    }
    server::serve(&ServerState::new(sides), host, ready, stop)
}
