//! Runs from pipeline to scores: run folder, evaluation, sweeps and comparison of runs. Training is in `pwrfgs-train`.
//!
//! This crate uses traits, not plugins; a program links the plugins it needs (`pwrfgs` links the built-in ones). A
//! [`PageBuilder`] function creates the report of a run from its folder.

#![cfg_attr(not(test), warn(clippy::disallowed_methods))] // readers go through `files`

mod agreement;
mod evaluate;
mod evaluation_set;
mod events;
mod facts;
mod findings;
pub mod folder;
mod input;
pub mod inspect;
mod intervals;
mod journal;
mod load;
mod members;
mod model_file;
mod page;
pub mod paired;
mod partial_scores;
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

pub use agreement::Agreement;
pub use evaluate::{EvaluationResult, check_alike};
pub use evaluation_set::{EvaluationSet, Predictor, ScoredPredictor, append_measurements};
pub use facts::{Facts, FileDigest, Machine, VERSION};
pub use findings::{Finding, check_observed, collect_findings, reject_findings};
pub use input::{read_pipeline, read_pipeline_text, rebased};
pub use inspect::{Preview, preview};
pub use load::{ActiveRun, SplitData, check_findings, describe_observations, load_split_data, load_with_findings};
pub use model_file::{model_file, pipeline_of_model, read_model};
pub use page::{rebuild_page, with_run};
pub use paired::{Paired, PairedRow};
pub use record::Record;
pub use repeatability::{CeilingEstimator, NoiseCeiling, Repeatability, measure_repeatability};
pub use run_folder::RunFolder;
pub use runner::{RunOutcome, run, score_model};
pub use samples::TestSamples;
pub use scores::{CEILING, IntervalScores, LevelScores, ScoreTable, Scores};
pub use session::{LoadedRun, NoopObserver, Observer, PageBuilder, Session, Start, Validation, run_stage};
pub use statistics::Summary;
pub use study::{ParetoComparison, Setting, Study, StudyVariant, VariantFamily, distinct};
