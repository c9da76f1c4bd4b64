//! Mutation tests of every file that pwrfgs reads, through its own readers.
//!
//! A case is a number: it decides which file is broken and how, so that a case which fails is tried again by its number.
//! (Three files tell the time, and so differ in these digits from one bench to the next: `run.json`, `curve.csv` and the
//! events.)
//!
//! A case passes where the reader takes the file or says what is wrong with it: no panic, no abort, no hang, no failure
//! that blames the machine, no message without end.

#![allow(clippy::disallowed_methods)] // it reads its own files

pub mod bench;
pub mod cases;
pub mod mutate;
pub mod targets;
