//! Error type with messages for users: each names the object and the next step.

use crate::messages::{sanitize_message, sanitize_path, strip_control};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

/// Error of the toolkit. `is_input` distinguishes invalid input (exit code 2) from other failures (exit code 1).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read.
    #[error("cannot read {}: {source}", format_path(path))]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// A file or folder could not be written.
    #[error("cannot write {}: {source}", format_path(path))]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The content of a file is invalid.
    #[error("{}:{} {}", format_path(path), format_position(*at), sanitize_message(message))]
    Input {
        /// Path of the file.
        path: PathBuf,
        /// Line and column, both from 1, if known.
        at: Option<(usize, usize)>,
        /// Problem and next step.
        message: String,
    },
    /// A setting, or a combination of settings, is invalid.
    #[error("{}", sanitize_message(.0))]
    Config(String),
    /// A number is not finite.
    #[error(
        "{tensor} is not finite at step {step}; lower the learning rates in `training.optimizer`, then start again"
    )]
    NonFinite {
        /// Name of the tensor.
        tensor: String,
        /// Training step, from 1.
        step: u64,
    },
    /// One step removed all Gaussians except one, or densification nearly all.
    #[error("training: {} left at step {step}{}; {advice}", if *left == 1 { "one Gaussian is".into() } else { format!("{left} Gaussians are") }, sanitize_message(removed))]
    Collapsed {
        /// Training step, from 1.
        step: u64,
        /// Number of Gaussians left.
        left: usize,
        /// Text `, removed by` with the rules and the number that each removed; empty without rules.
        removed: String,
        /// Advice on the pipeline.
        advice: &'static str,
    },
    /// Another process uses the folder.
    #[error("{} is in use by another pwrfgs process; wait until it ends, or choose another --out", format_path(.0))]
    Busy(PathBuf),
    /// The operation was cancelled.
    #[error("stopped before completion")]
    Stopped,
    /// The GPU failed, or its memory did not suffice.
    #[error("--device: {}", sanitize_message(.0))]
    Device(String),
    /// Error of a plugin.
    #[error("{}", sanitize_message(&.0.to_string()))]
    Plugin(#[source] Box<dyn std::error::Error + Send + Sync>),
}

/// Result with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Creates an error for invalid content at a position: `line` and `column` count from 1.
    pub fn at(path: &Path, line: usize, column: usize, message: impl std::fmt::Display) -> Self {
        Self::Input { path: path.into(), at: Some((line, column)), message: message.to_string() }
    }

    /// Creates an error for invalid content of a file.
    pub fn input(path: &Path, message: impl std::fmt::Display) -> Self {
        Self::Input { path: path.into(), at: None, message: message.to_string() }
    }

    /// Creates an error for a file that cannot be read.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.into(), source }
    }

    /// Creates an error for a file that cannot be written.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.into(), source }
    }

    /// Returns whether the cause is user input rather than the machine or the arithmetic.
    pub fn is_input(&self) -> bool {
        matches!(self, Self::Read { .. } | Self::Input { .. } | Self::Config(_) | Self::Busy(_) | Self::Plugin(_))
    }
}

/// Checks whether a user or program has stopped the work.
///
/// # Errors
/// [`Error::Stopped`] once `stop` is set.
pub fn check_stopped(stop: &AtomicBool) -> Result<()> {
    if stop.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
}

/// Formats a path on one line.
fn format_path(path: &Path) -> String {
    sanitize_path(path).replace(['\n', '\t'], " ")
}

/// Formats a position in a file as `line:column:`; empty without one.
fn format_position(at: Option<(usize, usize)>) -> String {
    at.map_or_else(String::new, |(line, column)| format!("{line}:{column}:"))
}

/// Returns ``; did you mean `x`?`` for a misspelt name; empty if none of the valid `names` is similar.
pub fn did_you_mean<'a>(wrong: &str, names: impl IntoIterator<Item = &'a str>) -> String {
    if wrong.len() > 100 {
        return String::new(); // not a name, and the time of the distance grows with the squared length
    }
    let wrong = wrong.to_lowercase();
    let distance = |name: &str| strsim::damerau_levenshtein(&wrong, &name.to_lowercase());
    let nearest = names.into_iter().map(|name| (distance(name), name)).min();
    // Two typing errors, and one more per three letters.
    nearest
        .filter(|(distance, name)| *distance <= 2 + name.len() / 3)
        .map_or_else(String::new, |(_, name)| format!("; did you mean `{}`?", strip_control(name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_shows_position_if_known() {
        let path = Path::new("a.ron");
        assert_eq!(Error::at(path, 3, 7, "no").to_string(), "a.ron:3:7: no");
        assert_eq!(Error::input(path, "no").to_string(), "a.ron: no");
    }

    #[test]
    fn message_is_short_and_without_control_characters() {
        let long =
            Error::at(Path::new("a\u{7}.ron"), 1, 2, format!("`{}`; write less", "x".repeat(5_000_000))).to_string();
        assert!(long.starts_with("a\u{fffd}.ron:1:2: `xx") && long.ends_with("xx`; write less") && long.len() < 1_300);
    }

    #[test]
    fn suggests_similar_names_only() {
        assert_eq!(did_you_mean("topk", ["LearnableMask", "TopK"]), "; did you mean `TopK`?");
        assert_eq!(did_you_mean("lamda", ["lambda", "epsilon"]), "; did you mean `lambda`?");
        assert_eq!(did_you_mean("wavefront", ["ssim", "l1"]), "");
        assert_eq!(did_you_mean("x", []), "");
        assert_eq!(did_you_mean(&"lambda".repeat(1_000_000), ["lambda"]), "");
    }
}
