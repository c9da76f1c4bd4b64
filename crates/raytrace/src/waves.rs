//! What surfaces and edges do to a wave: a few pure functions each, from the recommendations and papers they name.
//!
//! Everything is in double precision, metres, hertz and radians; the time factor is e^{+jωt}.

pub mod diffraction;
pub mod fresnel;
pub mod material;
pub mod scattering;
pub(crate) mod wave;
