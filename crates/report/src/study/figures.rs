//! Figures that compare the variants of one setting, each by itself as SVG, PDF (text as outlines in both) and PNG.
//!
//! A variant keeps its colour, marker and dashes in all of them; each of the three tells variants apart without the
//! others, so that greyscale does. Headings are left to the page: a figure has a title and a caption beside it.

mod errors;
mod gaussians;
mod latency;
mod panels;
mod rate;
mod tradeoff;

use crate::canvas::Canvas;
use crate::draw::charts::{Chart, Look};
use crate::templates::sentences;
use minijinja::{Value, context};
use pwrfgs_core::{Dataset, Error, Progress, Result, files::write_atomically};
use pwrfgs_experiment::{Setting, Silent};
use serde::Serialize;
use std::path::Path;

/// Width of a column of print, and of two with the gap between them.
const COLUMN: f64 = Look::COLUMN.size[0];
const PAGE: f64 = COLUMN * 181.9 / 88.9;
/// What a unit of them is on paper.
const MM: f64 = 88.9 / COLUMN;

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Stem of its files.
    pub name: String,
    /// A heading.
    pub title: String,
    /// What is drawn, for the text below it.
    pub caption: String,
    /// Width on paper: that of a column or a page.
    pub width_mm: f64,
    /// The figure for print.
    pub svg: String,
    /// The same for LaTeX and the like.
    #[serde(skip)]
    pub pdf: Vec<u8>,
    /// The same at 300 dpi.
    #[serde(skip)]
    pub png: Vec<u8>,
}

impl Figure {
    /// Writes `NAME.svg`, `NAME.pdf` and `NAME.png` into `folder`.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        for (kind, bytes) in [("svg", self.svg.as_bytes()), ("pdf", &self.pdf), ("png", &self.png)] {
            write_atomically(&folder.join(format!("{}.{kind}", self.name)), bytes)?;
        }
        Ok(())
    }

    /// A chart in one column; nothing where there is nothing to draw. What `words` say is for its caption.
    fn chart(name: &str, setting: &Setting, words: Value, chart: Chart) -> Option<Self> {
        let mut look = Look::COLUMN;
        if !chart.bands.is_empty() {
            look.margins[1] = 40.0; // for their names
        }
        Chart { look, ..chart }.draw().map(|canvas| Self::new(name, setting, words, &canvas))
    }

    fn new(name: &str, setting: &Setting, words: Value, canvas: &Canvas) -> Self {
        let (least, most) = setting.seeds();
        let words = sentences("figures.txt", context! { name, least, most, ..words });
        let kind = if setting.simulated { "Simulated" } else { "Measured" };
        let caption = format!("{} {kind} data: {}.", words[1], setting.title);
        let width_mm = (10.0 * canvas.width * MM).round() / 10.0;
        let (svg, pdf, png) = (canvas.svg_for_print(width_mm), canvas.pdf(width_mm), canvas.png(width_mm));
        Self { name: name.into(), title: words[0].clone(), caption, width_mm, svg, pdf, png }
    }
}

/// Figures, and why some are missing.
#[derive(Clone, Debug, Default)]
pub struct Drawn {
    /// All that could be drawn.
    pub figures: Vec<Figure>,
    /// Why those of the room, the spectra and the rate ratio could not, in a sentence; they need the data and the models.
    pub left_out: Option<String>,
}

/// A figure that needs the data and the models.
type FromData = fn(&Setting, &Dataset) -> Result<Option<Figure>>;

/// Every figure there are numbers for. `progress` counts figures.
pub fn all(setting: &Setting, progress: Progress<'_>) -> Drawn {
    let from_scores = [
        gaussians::figure,
        tradeoff::first_metric,
        tradeoff::rate_ratio,
        tradeoff::race::<0>,
        tradeoff::race::<1>,
        tradeoff::race::<2>,
        latency::figure,
        errors::distribution,
        errors::distance,
    ];
    let of_spectra: &[FromData] = &[panels::room, panels::spectra, rate::figure];
    let from_data = if setting.task().has_pixels { of_spectra } else { &of_spectra[..1] };
    let count = from_scores.len() + from_data.len();
    let mut figures = Vec::new();
    for (done, make) in from_scores.iter().enumerate() {
        figures.extend(make(setting));
        progress(done + 1, count);
    }
    let drawn = setting.variants[0].runs[0].load_data(&mut Silent).and_then(|data| {
        let mut drawn = Vec::new();
        for (done, make) in from_data.iter().enumerate() {
            drawn.extend(make(setting, &data)?);
            progress(from_scores.len() + done + 1, count);
        }
        Ok(drawn)
    });
    let left_out = drawn.map(|drawn| figures.extend(drawn)).err();
    let missing = if setting.task().has_pixels {
        "are no figures of the room, the spectra and the rate ratio"
    } else {
        "is no figure of the room"
    };
    let left_out = left_out.map(|e| format!("There {missing}: {e}."));
    Drawn { figures, left_out }
}
