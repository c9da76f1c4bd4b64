//! A room that is known exactly: *simulated* spectra, their paths, and ray tracing as a baseline.
//!
//! Everything is in double precision, metres, hertz and radians; the time factor is e^{+jωt}.
//!
//! * [`Scene`] is a file, [`Simulator`] the scene made ready: paths, channel and spectrum of every transmitter.
//! * [`World`](world::World) holds faces and edges; [`ImageTree`](images::ImageTree) and [`Tracer`](tracer::Tracer) find
//!   the [`Path`]s.
//! * [`material`], [`fresnel`], [`diffraction`] and [`scattering`] are the physics, each a few functions.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

pub mod array;
pub mod cache;
mod field;
pub mod images;
pub mod kept;
mod listener;
pub mod mesh;
pub mod noise;
mod observe;
pub mod output;
mod patches;
mod path;
mod path_table;
mod perturb;
mod random;
mod ray_tracing;
mod recipe;
mod room;
pub mod scene;
mod simulated;
mod simulator;
pub mod spectrum;
pub mod surface_points;
pub mod tracer;
pub mod transmitters;
mod waves;
pub mod world;

pub use listener::Listener;
pub use observe::{Heard, Observe, Observed, SILENT_DBM};
pub use path::{Interaction, Path};
pub use ray_tracing::RayTracing;
pub use recipe::Recipe;
pub use scene::Scene;
pub use simulated::Simulated;
pub use simulator::{HEIGHT, Reception, Simulator, WIDTH, Wanted, simulate, simulate_links};
pub use wave::{Complex, SPEED_OF_LIGHT};
use waves::wave;
pub use waves::{diffraction, fresnel, material, scattering};
