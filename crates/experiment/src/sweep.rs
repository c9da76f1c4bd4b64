//! A sweep: many runs from one experiment file, in one folder, on one machine or on many.
//!
//! `experiment.rs` reads the file, `plan.rs` works out all runs, `status.rs` looks at what is done, `check.rs` tries what
//! is left before anything starts, `execute.rs` does it, `join.rs` makes one model of all. Nothing but the run folders remembers what was done, so the
//! same command goes on after any end.

mod check;
mod execute;
mod experiment;
mod join;
mod listing;
mod plan;
pub mod slurm;
mod status;

pub use check::{check, estimate};
pub use execute::{Board, SweepEnd, execute, pool};
pub use experiment::{Axis, Experiment, Slurm, Variant};
pub use join::JOINED;
pub use listing::{LISTING, ListedRun, Listing};
pub use plan::{Plan, PlannedRun};
pub use status::State;
