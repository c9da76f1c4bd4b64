//! Ray tracing in scenes: *simulated* spectra, received powers and channels with their paths, and a baseline.
//!
//! Everything is in double precision, metres, hertz and radians; the time factor is e^{+jωt}.
//!
//! * [`SceneFile`] is a scene file, [`Simulator`] a prepared scene: paths and observation of every transmitter.
//! * [`World`](world::World) holds faces and edges; [`ImageTree`](images::ImageTree) and [`Tracer`](tracer::Tracer) find
//!   the [`PropagationPath`]s.
//! * [`material`], [`fresnel`], [`diffraction`] and [`scattering`] implement the physics in a few functions each.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

pub mod array;
mod hierarchy;
pub mod images;
pub mod mesh;
mod observe;
pub mod output;
mod patches;
mod path;
mod perturb;
mod polygon;
mod prepared_receiver;
mod ray_tracing;
mod recipe;
pub mod scene;
mod simulated;
mod simulator;
pub mod spectrum;
pub mod surface_points;
pub mod tracer;
mod waves;
pub mod world;

pub use observe::{ObservationKind, ReceiverObservation, SILENT_DBM, SimulatedObservation};
pub use output::mitsuba;
pub use path::{Interaction, PropagationPath};
pub use prepared_receiver::PreparedReceiver;
pub use ray_tracing::RayTracing;
pub use recipe::SimulationRecipe;
pub use scene::{Noise, SceneFile};
pub use simulated::{Simulated, cache_root, open_or_make};
pub use simulator::{SimulationRequest, Simulator, simulate_links};
pub use spectrum::{HEIGHT, WIDTH};
pub use waves::{Surface, diffraction, fresnel, material, scattering};

/// A complex number in double precision.
pub type Complex = num_complex::Complex<f64>;

/// Speed of light in vacuum, m/s.
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;
