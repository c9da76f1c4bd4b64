//! Tests of projection and drawing together, in one binary to save linking time.

#![allow(clippy::unwrap_used)] // helpers of tests may fail, as tests do

mod array;
mod common;
mod gradients;
mod laws;
mod tiles;
