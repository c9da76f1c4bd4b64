//! A sweep: many runs from one experiment file.

mod listing;

pub use listing::{LISTING, ListedRun, Listing};
