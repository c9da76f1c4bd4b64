//! NeRF2 (Zhao et al., MobiCom 2023) as a method: no Gaussians, rays through a network.
//!
//! ```text
//! receiver ── rays, samples ─► trunk ─► attenuation ─► what is left of the light at each sample ─┐
//!                                └────► feature ──┐                                              ├─► Σ over samples ─► observation
//! transmitter, view ──────────────────────────────┴─► signal net ─► what each sample emits ──────┘
//! ```
//!
//! [`Nerf2`] is the method, `rays` says which rays a receiver has, `network` holds the layers, `path` is what lies between a
//! sample and the receiver, `emission` what the samples emit, `walk` takes a chunk of rays through all of it and back, `group`
//! all links that see the same rays.
//! The trunk does not know the transmitter: it is worked out once for all transmitters of a call, and kept for predictions.

mod emission;
mod group;
mod method;
mod network;
mod path;
mod rays;
mod walk;

#[cfg(test)]
mod oracle;

pub use method::Nerf2;
