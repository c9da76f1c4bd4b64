//! Tests of the simulator as its users call it. One binary, because linking it takes longer than most of them.

#![allow(clippy::unwrap_used)] // helpers of tests may fail, as tests do

mod arrays;
mod common;
mod contacts;
mod data_source;
mod laws;
mod limits;
mod link_data;
mod link_files;
mod links;
mod mitsuba;
mod reference_paths;
mod sheets;
