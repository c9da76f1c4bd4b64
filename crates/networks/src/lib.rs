//! Deformations `D_Θ` of eq. (5): what the transmitter's position changes.
//!
//! [`Mlp`] is the network of P-WRFGS, [`Wrfgs`] the one of its ancestor, [`Factored`] runs once a transmitter and not once
//! a Gaussian, [`Fixed`] is none. The networks share the layers of `layers`: `dense` multiplies, `linear` is a layer
//! in the weight vector, `plan` says where weights lie and divides the work, `trunk` is the ReLU stack.
//! Nothing is kept between calls: the derivative recomputes each chunk's activations while they fit the cache.

mod factored;
mod factored_network;
mod fixed;
pub mod layers;
mod mlp;
mod mlp_network;
#[cfg(test)]
mod oracle;
#[cfg(test)]
mod tests;
mod waves;
mod whiten;
mod wrfgs;
mod wrfgs_branch;
mod wrfgs_network;

pub use factored::Factored;
pub use fixed::Fixed;
pub use mlp::Mlp;
pub use mlp_network::Outputs;
pub use waves::Encoding;
pub use wrfgs::Wrfgs;
