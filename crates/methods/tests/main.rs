//! Tests of the public interface of the crate, in one binary to save linking time.

#![allow(clippy::unwrap_used)] // helpers of tests may fail, as tests do

mod field;
mod search;
