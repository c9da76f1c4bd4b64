//! Figures of a setting.

use super::{Setting, Study};
use pwrfgs_core::{Progress, Result};

/// A figure in both formats.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Stem of its files.
    pub name: String,
    /// A few words.
    pub title: String,
    /// What it shows.
    pub caption: String,
    /// As SVG text.
    pub svg: String,
    /// As PNG.
    pub png: Vec<u8>,
}

/// All figures of a setting.
#[allow(clippy::missing_errors_doc, clippy::unnecessary_wraps)] // replaced at the merge
pub fn all(_study: &Study, _setting: &Setting, _progress: Progress<'_>) -> Result<Vec<Figure>> {
    Ok(Vec::new())
}
