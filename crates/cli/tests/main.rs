//! Tests of the program as a user calls it. One binary, because linking it takes longer than most of them.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // helpers of tests may fail and print, as tests do

mod bad_input;
mod claims;
mod commands;
mod common;
mod corrupt_files;
mod ensemble;
mod experiments;
mod export;
mod failure;
mod faults;
mod golden;
mod gpu;
mod import;
mod init_scores;
mod inspect;
mod links;
mod locate;
mod maps;
mod members;
mod model_format;
mod my_pruner;
mod paths;
mod planning;
mod predicting;
mod prose;
mod pruning;
mod races;
mod reference;
mod report;
mod residuals;
mod resume;
mod scoring;
mod shipped;
mod shipped_models;
mod simulate;
mod slurm;
mod sweep;
mod tables;
mod tasks;
mod tensors;
mod versions;
mod view;
mod warnings;
