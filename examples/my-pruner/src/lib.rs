//! Custom plugins for pwrfgs. `use my_pruner as _;` links them into a program.

mod gumbel_mask;

pub use gumbel_mask::GumbelMask;
