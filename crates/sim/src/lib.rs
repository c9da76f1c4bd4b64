//! A room that is known exactly: *simulated* spectra, their paths, and ray tracing as a baseline.
//!
//! Everything is in double precision, metres, hertz and radians; the time factor is e^{+jωt}.

pub mod array;
pub mod diffraction;
pub mod fresnel;
pub mod material;
pub mod mesh;
mod path;
pub mod scattering;
pub mod spectrum;
pub mod surface_points;
pub mod transmitters;

pub use path::{Interaction, Path};

/// A complex number in double precision.
pub type Complex = num_complex::Complex<f64>;

/// Speed of light in vacuum, m/s.
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;
