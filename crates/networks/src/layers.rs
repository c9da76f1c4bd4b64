//! Dense layers on chunks of points: the arithmetic that the networks of Gaussians and of rays share.
//!
//! A network is a [`plan::Plan`] of tensors in one flat vector of weights, [`linear::Linear`] layers that know where theirs lie,
//! and passes over chunks whose points lie next to each other ([`dense`]). Derivatives are written by hand.

pub mod dense;
pub mod encoding;
pub mod linear;
pub mod plan;
pub mod trunk;
