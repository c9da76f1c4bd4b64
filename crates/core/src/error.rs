//! What can go wrong, told to a person: each message names the thing and says what to do.

use crate::words::{clean, told};
use std::path::{Path, PathBuf};

/// Any failure of the toolkit. `is_input` separates wrong input (exit code 2) from failure (exit code 1).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file could not be read.
    #[error("cannot read {}: {source}", shown(path))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file or folder could not be written.
    #[error("cannot write {}: {source}", shown(path))]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file says something that cannot be used.
    #[error("{}:{} {}", shown(path), place(*at), told(message))]
    Input {
        /// The file.
        path: PathBuf,
        /// Line and column, both counted from 1, where the place is known.
        at: Option<(usize, usize)>,
        /// What is wrong, and what to do.
        message: String,
    },
    /// A setting, or a combination of settings, cannot work.
    #[error("{}", told(.0))]
    Config(String),
    /// A number left the finite range.
    #[error("{what} is not finite at step {step}; lower the learning rates in `training.optimizer`, then start again")]
    NonFinite {
        /// The tensor.
        what: String,
        /// The training step, counted from 1.
        step: u64,
    },
    /// Training removed all Gaussians but one.
    #[error("training: one Gaussian is left at step {step}{}; {advice}", told(removed))]
    Collapsed {
        /// The training step, counted from 1.
        step: u64,
        /// `, removed by` the rules, with how many each removed; empty if the step had none.
        removed: String,
        /// What the pipeline can do about it.
        advice: &'static str,
    },
    /// Another process is at work in a folder.
    #[error("another pwrfgs is at work in {}; wait until it ends, or choose another --out", shown(.0))]
    Busy(PathBuf),
    /// Someone asked to stop before all was done.
    #[error("stopped before all was done")]
    Stopped,
    /// Anything a plugin wants to say.
    #[error("{}", told(&.0.to_string()))]
    Plugin(#[source] Box<dyn std::error::Error + Send + Sync>),
}

/// Result with [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// A file that cannot be used, with a position: `line` and `column` count from 1.
    pub fn at(path: &Path, line: usize, column: usize, message: impl std::fmt::Display) -> Self {
        Self::Input { path: path.into(), at: Some((line, column)), message: message.to_string() }
    }

    /// A file that cannot be used.
    pub fn input(path: &Path, message: impl std::fmt::Display) -> Self {
        Self::Input { path: path.into(), at: None, message: message.to_string() }
    }

    /// A file that cannot be read.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.into(), source }
    }

    /// A file that cannot be written.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.into(), source }
    }

    /// Whether what the user gave is at fault, as against the machine or the arithmetic.
    pub fn is_input(&self) -> bool {
        matches!(self, Self::Read { .. } | Self::Input { .. } | Self::Config(_) | Self::Busy(_) | Self::Plugin(_))
    }
}

fn shown(path: &Path) -> String {
    told(&path.display().to_string()).replace(['\n', '\t'], " ")
}

fn place(at: Option<(usize, usize)>) -> String {
    at.map_or_else(String::new, |(line, column)| format!("{line}:{column}:"))
}

/// `; did you mean `x`?` for a misspelt name, or nothing where none of the `known` ones is near.
pub fn did_you_mean<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    if wrong.len() > 100 {
        return String::new(); // no name, and the distance takes time with the square of the length
    }
    let wrong = wrong.to_lowercase();
    let near = known.into_iter().map(|name| (strsim::damerau_levenshtein(&wrong, &name.to_lowercase()), name)).min();
    near.filter(|(distance, name)| *distance <= 2 + name.len() / 3)
        .map_or_else(String::new, |(_, name)| format!("; did you mean `{}`?", clean(name)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_stands_where_it_is_known() {
        let path = Path::new("a.ron");
        assert_eq!(Error::at(path, 3, 7, "no").to_string(), "a.ron:3:7: no");
        assert_eq!(Error::input(path, "no").to_string(), "a.ron: no");
    }

    #[test]
    fn a_message_is_short_and_gives_no_orders_to_the_terminal() {
        let long =
            Error::at(Path::new("a\u{7}.ron"), 1, 2, format!("`{}`; write less", "x".repeat(5_000_000))).to_string();
        assert!(long.starts_with("a\u{fffd}.ron:1:2: `xx") && long.ends_with("xx`; write less") && long.len() < 1_300);
    }

    #[test]
    fn near_names_are_suggested_and_far_ones_not() {
        assert_eq!(did_you_mean("topk", ["LearnableMask", "TopK"]), "; did you mean `TopK`?");
        assert_eq!(did_you_mean("lamda", ["lambda", "epsilon"]), "; did you mean `lambda`?");
        assert_eq!(did_you_mean("wavefront", ["ssim", "l1"]), "");
        assert_eq!(did_you_mean("x", []), "");
        assert_eq!(did_you_mean(&"lambda".repeat(1_000_000), ["lambda"]), "");
    }
}
