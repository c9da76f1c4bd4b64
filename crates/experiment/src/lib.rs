//! Runs from pipeline to scores: training loop, run folder, evaluation, sweeps and exports.
//!
//! This crate uses traits, not plugins; a program links the plugins it needs (`pwrfgs` links the built-in ones). A
//! [`PageBuilder`] function creates the report of a run from its folder.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod evaluate;
mod evaluation_set;
mod events;
mod facts;
pub mod folder;
mod input;
pub mod inspect;
mod intervals;
mod journal;
mod load;
mod page;
pub mod paired;
pub mod record;
pub mod repeatability;
mod residuals;
mod run_folder;
mod runner;
pub mod samples;
mod score_text;
pub mod scores;
mod session;
pub mod statistics;
mod study;
pub mod sweep;
pub mod text;
mod training;

pub use evaluate::{check_alike, evaluate};
pub use evaluation_set::EvaluationSet;
pub use facts::{Facts, FileDigest, Machine, VERSION};
pub use input::{pipeline_text, read_pipeline, rebased};
pub use inspect::{Preview, preview};
pub use load::{data_warnings, equality_warning, load, observed, position_warning};
pub use page::{rebuild_page, with_run, write_results};
pub use paired::{Paired, PairedRow};
pub use record::Record;
pub use repeatability::{NoiseCeiling, Repeatability, ceiling, repeatability};
pub use run_folder::RunFolder;
pub use runner::{RunOutcome, run, score_model};
pub use samples::TestSamples;
pub use scores::{CEILING, IntervalScores, LevelScores, ScoreTable, Scores};
pub use session::{LoadedRun, NoopObserver, Observer, PageBuilder, Session, Start, Validation, staged};
pub use statistics::Summary;
pub use study::{ParetoComparison, Setting, Study, StudyVariant, VariantFamily, distinct, one_line};
