//! Tests of the crate as its users see it. One binary, because linking it takes longer than most of them.

#![allow(clippy::unwrap_used)] // helpers of tests may fail, as tests do

mod field;
mod search;
