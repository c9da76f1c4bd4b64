//! Number of threads: the limit of `--threads`, which also applies to environment variables.

use crate::{Error, Result};
use std::ops::RangeInclusive;

/// Accepted numbers of threads, jobs or seeds.
pub const COUNTS: RangeInclusive<usize> = 1..=1024;

/// Parses a number of threads, jobs or seeds.
///
/// # Errors
/// A text that is not one of [`COUNTS`]; the message states them.
pub fn parse_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if COUNTS.contains(&count) => Ok(count),
        _ => Err(format!("expected a number from {} to {}", COUNTS.start(), COUNTS.end())),
    }
}

/// Variables that set the size of rayon's thread pool; 0 selects one thread per processor.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "RAYON_RS_NUM_CPUS"];

/// Rejects environment variables with more threads than [`COUNTS`] allows: rayon would start any number, which takes
/// minutes.
///
/// # Errors
/// [`Error::Config`] if a variable is no number, or beyond [`COUNTS`]; the message names it.
pub fn check_environment() -> Result<()> {
    VARIABLES.into_iter().try_for_each(|name| {
        let value = std::env::var_os(name).unwrap_or_default();
        let count = value.to_str().and_then(|text| text.parse::<usize>().ok());
        if value.is_empty() || count.is_some_and(|count| count == 0 || COUNTS.contains(&count)) {
            return Ok(());
        }
        let (low, high) = (COUNTS.start(), COUNTS.end());
        Err(Error::Config(format!("{name} is `{}`; give a number from {low} to {high}, or unset it", value.display())))
    })
}
