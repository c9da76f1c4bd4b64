//! Tests of projection and drawing together. One binary, because linking it takes longer than most of them.

#![allow(clippy::unwrap_used)] // helpers of tests may fail, as tests do

mod array;
mod common;
mod gradients;
mod laws;
mod tiles;
