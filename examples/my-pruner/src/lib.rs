//! Plugins of one's own for pwrfgs. `use my_pruner as _;` in a program links them.

mod gumbel_mask;

pub use gumbel_mask::GumbelMask;
