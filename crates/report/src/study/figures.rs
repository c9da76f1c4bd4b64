//! Figures that compare the variants of one setting, each as SVG, PDF (text as outlines in both) and PNG.
//!
//! A variant has the same colour, marker and dashes in all figures, and a method in the figures of N; each of the three
//! distinguishes lines, also in greyscale. A figure has no heading: its title and caption are next to it.

pub(super) mod differences;
mod errors;
mod gaussians;
mod latency;
mod panels;
mod rate;
pub(super) mod shown;
#[cfg(test)]
mod tests;
mod tradeoff;

use crate::canvas::{Anchor, Canvas, LINE};
use crate::draw::charts::{Chart, ChartStyle};
use crate::templates::render_sentences;
use minijinja::{Value, context};
use pwrfgs_core::{Dataset, Error, Progress, Result, files::write_atomically};
use pwrfgs_experiment::{NoopObserver, Setting};
use serde::Serialize;
use shown::{Selection, ShownVariants};
use std::fmt::Write as _;
use std::path::Path;

/// Widths of one print column, and of two with the gap between them.
const COLUMN: f64 = ChartStyle::COLUMN.size[0];
const PAGE: f64 = COLUMN * 181.9 / 88.9;
/// Millimetres per drawing unit.
const MM: f64 = 88.9 / COLUMN;

/// Figure of a report.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Stem of its files.
    pub name: String,
    /// Title.
    pub title: String,
    /// Caption.
    pub caption: String,
    /// Width in print: a column or a page.
    pub width_mm: f64,
    /// SVG for print.
    pub svg: String,
    /// PDF, for LaTeX.
    #[serde(skip)]
    pub pdf: Vec<u8>,
    /// PNG at 300 dpi.
    #[serde(skip)]
    pub png: Vec<u8>,
}

impl Figure {
    /// Writes `NAME.svg`, `NAME.pdf` and `NAME.png` into `folder`, which is created if missing.
    ///
    /// # Errors
    /// [`Error::Write`] if a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<()> {
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        for (kind, bytes) in [("svg", self.svg.as_bytes()), ("pdf", &self.pdf), ("png", &self.png)] {
            write_atomically(&folder.join(format!("{}.{kind}", self.name)), bytes)?;
        }
        Ok(())
    }

    /// Creates a figure of `chart` in one print column, in place of its own size; `None` if [`Chart::draw`] has nothing to draw.
    /// `words` are for its caption.
    fn from_chart(name: &str, setting: &Setting, words: Value, chart: Chart) -> Option<Self> {
        let mut style = ChartStyle::COLUMN;
        if !chart.bands.is_empty() {
            style.margins[1] = 40.0; // top: for the names of the phases
        }
        Chart { style, ..chart }.draw().map(|canvas| Self::new(name, setting, words, canvas))
    }

    /// Adds `remarks` and the number of `hidden` variants to the caption.
    fn with_remarks(mut self, remarks: &str, hidden: usize) -> Self {
        self.caption += remarks;
        if hidden > 0 {
            let advice = "`pwrfgs report --variants` selects them.";
            _ = write!(self.caption, " Variants that are not shown: {hidden}; {advice}");
        }
        self
    }

    /// Creates a figure of `canvas` in all formats; title and caption are those of `name` in `figures.txt`, which gets `words`.
    ///
    /// Marks a figure of simulated data on the drawing itself, which may be used without its caption.
    fn new(name: &str, setting: &Setting, words: Value, mut canvas: Canvas) -> Self {
        let (least, most) = setting.seed_counts();
        if setting.simulated {
            canvas.text([canvas.width - 2.0, canvas.height + 0.7 * LINE], Anchor::End, "simulated data");
            canvas.height += LINE;
        }
        let words = render_sentences("figures.txt", context! { name, least, most, ..words });
        let kind = if setting.simulated { "Simulated" } else { "Measured" };
        let caption = format!("{} {kind} data: {}.", words[1], setting.title);
        let width_mm = (10.0 * canvas.width * MM).round() / 10.0;
        let (svg, pdf, png) = (canvas.svg_for_print(width_mm), canvas.pdf(width_mm), canvas.png(width_mm));
        Self { name: name.into(), title: words[0].clone(), caption, width_mm, svg, pdf, png }
    }
}

/// Figures, and the reason why some are missing.
#[derive(Clone, Debug, Default)]
pub struct FigureSet {
    /// Figures that could be drawn.
    pub figures: Vec<Figure>,
    /// Reason why figures that need data and models (room, spectra, rate ratio) are missing.
    pub left_out: Option<String>,
}

/// Function that draws a figure from scores, and one that draws it from data and models.
type FromScores<'a> = &'a dyn Fn(&Setting) -> Option<Figure>;
type FromData = fn(&Setting, &Dataset) -> Result<Option<Figure>>;

/// Draws all figures but that of differences for which there are numbers, and notes why those that need data and models are missing. A figure has
/// at most six curves: `chosen` names their variants or methods; if empty, they are of the best methods and of the variants
/// `references`. `progress` counts figures.
pub fn draw_figures(setting: &Setting, chosen: &[String], references: &[&str], progress: Progress<'_>) -> FigureSet {
    let ShownVariants { all, methods, curves, panels, spread } = &ShownVariants::of(setting, chosen, references);
    let from_scores: [(&Selection, FromScores<'_>); 9] = [
        (spread.as_ref().unwrap_or(curves), &gaussians::figure),
        (methods, &tradeoff::first_metric_figure),
        (methods, &tradeoff::rate_ratio_figure),
        (all, &|setting| tradeoff::pareto_figure(setting, &tradeoff::NUMBER, references)),
        (all, &|setting| tradeoff::pareto_figure(setting, &tradeoff::BYTES, references)),
        (all, &|setting| tradeoff::pareto_figure(setting, &tradeoff::LATENCY, references)),
        (all, &latency::figure),
        (curves, &errors::distribution_figure),
        (curves, &errors::distance_figure),
    ];
    let from_data: [(&Selection, FromData); 3] =
        [(panels, panels::room_figure), (panels, panels::spectra_figure), (curves, rate::figure)];
    let count = from_scores.len() + from_data.len();
    let with_remarks = |shown: &Selection, figure: Figure| {
        figure.with_remarks(&shown.remarks, setting.variants.len() - shown.setting.variants.len())
    };
    let mut figures = Vec::new();
    for (done, (shown, make)) in from_scores.iter().enumerate() {
        figures.extend(make(&shown.setting).map(|figure| with_remarks(shown, figure)));
        progress(done + 1, count);
    }
    let drawn = setting.variants[0].runs[0].load_data(&mut NoopObserver).and_then(|data| {
        let mut drawn = Vec::new();
        for (done, (shown, make)) in from_data.iter().enumerate() {
            drawn.extend(make(&shown.setting, &data)?.map(|figure| with_remarks(shown, figure)));
            progress(from_scores.len() + done + 1, count);
        }
        Ok(drawn)
    });
    let left_out = drawn.map(|drawn| figures.extend(drawn)).err();
    let left_out =
        left_out.map(|e| format!("Figures that need the data, such as that of the room, are left out: {e}."));
    FigureSet { figures, left_out }
}
