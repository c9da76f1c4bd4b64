//! A run from pipeline to report: the training loop, the run folder, evaluation, `report.html` and exports.
//!
//! This crate knows traits, not plugins; a program links the plugins it wants (`pwrfgs` links the built-in ones).

pub mod clock;
mod draw;
mod evaluate;
mod events;
pub mod export;
mod facts;
pub mod folder;
mod input;
mod journal;
mod observer;
pub mod report;
mod runner;
mod samples;
pub mod scores;
mod series;
mod snapshot;
pub mod study;
pub mod sweep;
mod validation;

pub use evaluate::{Assessment, evaluate};
pub use facts::{Facts, Machine};
pub use folder::RunFolder;
pub use input::read_pipeline;
pub use observer::{Observer, Silent, Start, Validation};
pub use runner::{History, Outcome, Subject, load, rebase, run};
pub use scores::{ScoreTable, Scores, Summary};
pub use snapshot::Snapshot;
