//! Exports: a trained model as bytes that other programs open. `docs/model-format.md` says what the fields mean.

mod npz;
mod ply;

pub use npz::npz;
pub use ply::ply;
