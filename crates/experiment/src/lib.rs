//! A run from pipeline to scores: the training loop, the run folder, evaluation, sweeps and exports.
//!
//! This crate knows traits, not plugins; a program links the plugins it wants (`pwrfgs` links the built-in ones). It draws
//! nothing: the [`Page`] that it is given makes the page of a run from its folder.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod bench;
pub mod blocks;
mod ceiling;
pub mod clock;
pub mod confidence;
mod data_warnings;
mod evaluate;
mod events;
mod facts;
pub mod folder;
mod input;
pub mod inspect;
mod journal;
mod load;
mod memory;
mod observed;
mod observer;
mod page;
pub mod paired;
mod preview;
mod record;
pub mod repeatability;
mod runner;
pub mod samples;
mod score_text;
pub mod scores;
pub mod series;
mod session;
pub mod statistics;
pub mod sweep;
pub mod text;
mod trainer;
mod training;
mod validation;

pub use bench::Bench;
pub use ceiling::{CEILING, Ceiling, ceiling, lapse_of};
pub use data_warnings::{data_warnings, equality_warning, position_warning};
pub use evaluate::{check_alike, evaluate};
pub use facts::{Facts, Machine, Mark};
pub use folder::RunFolder;
pub use input::{read_pipeline, rebased};
pub use load::load;
pub use observed::observed;
pub use observer::{Observer, Silent, Start, Validation, staged};
pub use page::{LoadedRun, Page, rebuild_page, write_results};
pub use paired::Paired;
pub use preview::{Preview, preview};
pub use record::{Record, TestSamples};
pub use repeatability::{Repeatability, repeatability};
pub use runner::{Outcome, run};
pub use scores::{ScoreTable, Scores, Summary};
pub use session::Session;
