//! What holds for every built-in plugin. A binary of its own: those of other tests are not among them.
#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests may fail and print, as tests do

#[allow(dead_code)] // its part is used
mod common;
mod laws;
mod registry;
