//! Tests across crates, in one binary to save linking time.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests may fail and print, as tests do

mod array;
mod baselines;
mod cameras;
mod changes;
mod common;
mod derivatives;
mod determinism;
mod documentation;
mod elevations;
mod examples;
mod figures;
mod findings;
mod gates;
mod gradients;
mod inspect;
mod laws;
mod learning;
mod links;
mod maps;
mod models;
mod names;
mod nerf2;
mod own_baseline;
mod pipelines;
mod pruners;
mod reference;
mod registry;
mod repeatability;
mod robustness;
mod sampling;
mod shares;
mod stopping;
mod streaming;
mod structure;
mod supply_chain;
mod surveys;
