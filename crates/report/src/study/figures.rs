//! Figures that compare the variants of one setting, each by itself as SVG (text as outlines) and PNG.
//!
//! A variant keeps its colour, marker and dashes in all of them; each of the three tells variants apart without the
//! others, so that greyscale does. Headings are left to the page: a figure has a title and a caption beside it.

mod distance;
mod gaussians;
mod latency;
mod loaded;
mod looks;
mod published;
mod rate;
mod room;
mod sheet;
mod spectra;
mod tradeoff;

use super::{Record, Setting, Study, Variant};
use crate::draw::charts::{Chart, Look};
use crate::draw::print::print;
use loaded::Loaded;
use pwrfgs_core::files::write_atomically;
use pwrfgs_core::{Error, Progress, Result};
use sheet::Sheet;
use std::path::Path;

/// Width of a column of print and of a page, millimetres.
const COLUMN_MM: f64 = 88.9;
const PAGE_MM: f64 = 181.9;

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

    /// A picture put together from pieces.
    fn sheet(name: &str, title: &str, caption: String, sheet: &Sheet) -> Result<Self> {
        Self::printed(name, title, caption, &sheet.svg(), sheet.width_mm)
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
/// Those that show more than scores need the data and the models. Where these cannot be read any more they are left out,
/// with a warning in the log.
///
/// # Errors
/// Where a figure cannot be drawn.
pub fn all(_study: &Study, setting: &Setting, progress: Progress<'_>) -> Result<Vec<Figure>> {
    let from_scores = [gaussians::figure, tradeoff::ssim, tradeoff::rate_ratio, latency::figure, distance::figure];
    let from_data = [room::figure, spectra::figure, rate::figure];
    let count = from_scores.len() + from_data.len();
    let mut figures = Vec::new();
    for (done, make) in from_scores.iter().enumerate() {
        figures.extend(make(setting)?);
        progress(done + 1, count);
    }
    let drawn = Loaded::of(setting).and_then(|loaded| {
        let mut drawn = Vec::new();
        for (done, make) in from_data.iter().enumerate() {
            drawn.extend(make(setting, &loaded)?);
            progress(from_scores.len() + done + 1, count);
        }
        Ok(drawn)
    });
    match drawn {
        Ok(drawn) => figures.extend(drawn),
        Err(e) => tracing::warn!("no figures of the room, the spectra and the rate ratio for {}: {e}", setting.title),
    }
    Ok(figures)
}

/// What every caption ends with: where the numbers come from.
fn source(setting: &Setting) -> String {
    format!("{} data: {}.", if setting.simulated { "Simulated" } else { "Measured" }, setting.title)
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
