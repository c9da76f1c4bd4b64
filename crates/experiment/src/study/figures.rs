//! Figures that compare the variants of one setting, each by itself as SVG (text as outlines) and PNG.
//!
//! A variant keeps its colour, marker and dashes in all of them; each of the three tells variants apart without the
//! others, so that greyscale does. Headings are left to the page: a figure has a title and a caption beside it.

mod distance;
mod gaussians;
mod looks;
mod published;
mod tradeoff;

use super::{Record, Setting, Study, Variant};
use crate::draw::charts::{Chart, Look};
use crate::draw::print::print;
use pwrfgs_core::{Error, Progress, Result};
use pwrfgs_model::file::write_atomically;
use std::path::Path;

/// Width of a column of print, millimetres.
const COLUMN_MM: f64 = 88.9;

/// One figure.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Stem of its files.
    pub name: String,
    /// A heading.
    pub title: String,
    /// What is drawn, for the text below it.
    pub caption: String,
    /// The figure for print, as wide as a column or a page.
    pub svg: String,
    /// The same at 300 dpi.
    pub png: Vec<u8>,
}

impl Figure {
    /// Writes `NAME.svg` and `NAME.png` into `folder`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        write_atomically(&folder.join(format!("{}.svg", self.name)), self.svg.as_bytes())?;
        write_atomically(&folder.join(format!("{}.png", self.name)), &self.png)
    }

    /// A chart in one column; nothing where there is nothing to draw.
    fn chart(name: &str, title: &str, caption: String, chart: Chart) -> Result<Option<Self>> {
        let Some(svg) = Chart { look: Look { margins: margins(&chart), ..Look::COLUMN }, ..chart }.svg()? else {
            return Ok(None);
        };
        Self::printed(name, title, caption, &svg, COLUMN_MM).map(Some)
    }

    fn printed(name: &str, title: &str, caption: String, svg: &str, width_mm: f64) -> Result<Self> {
        let print = print(name, svg, width_mm)?;
        Ok(Self { name: name.into(), title: title.into(), caption, svg: print.svg, png: print.png })
    }
}

/// Names of shaded stretches need room above.
fn margins(chart: &Chart) -> (u32, u32, u32, u32) {
    let (left, top, right, bottom) = Look::COLUMN.margins;
    (left, if chart.bands.is_empty() { top } else { 40 }, right, bottom)
}

/// Every figure there are numbers for. `progress` counts figures.
///
/// # Errors
/// Where a figure cannot be drawn.
pub fn all(study: &Study, setting: &Setting, progress: Progress<'_>) -> Result<Vec<Figure>> {
    _ = study;
    let makers = [gaussians::figure, tradeoff::ssim, tradeoff::rate_ratio, distance::figure];
    let mut figures = Vec::new();
    for (done, make) in makers.iter().enumerate() {
        figures.extend(make(setting)?);
        progress(done + 1, makers.len());
    }
    Ok(figures)
}

/// What every caption ends with: where the numbers come from.
fn source(setting: &Setting) -> String {
    let kind = if setting.simulated { " The spectra are simulated." } else { "" };
    format!("Data: {}.{kind}", setting.title)
}

/// `3 seeds`, or how many a variant has.
fn seeds(setting: &Setting) -> String {
    let counts: Vec<usize> = setting.variants.iter().map(|v| v.runs.len()).collect();
    let (least, most) = (counts.iter().min().copied().unwrap_or(0), counts.iter().max().copied().unwrap_or(0));
    match (least, most) {
        (1, 1) => "one seed".into(),
        (a, b) if a == b => format!("{a} seeds"),
        (a, b) => format!("{a} to {b} seeds"),
    }
}

/// Names of the baselines of a setting, each once.
fn floors(setting: &Setting) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    for name in runs(setting).flat_map(Record::floors) {
        if !names.iter().any(|n| n == name) {
            names.push(name.to_owned());
        }
    }
    names
}

/// All runs of a setting.
fn runs(setting: &Setting) -> impl Iterator<Item = &Record> {
    setting.variants.iter().flat_map(|v: &Variant| &v.runs)
}

/// Arithmetic mean; NaN of none.
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Sample standard deviation; nothing of less than two.
fn deviation(values: &[f64]) -> Option<f64> {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_deviation_needs_two() {
        assert_eq!((mean(&[2.0, 4.0]), deviation(&[2.0, 4.0])), (3.0, Some(2f64.sqrt())));
        assert_eq!(deviation(&[2.0]), None);
        assert!(mean(&[]).is_nan());
    }
}
