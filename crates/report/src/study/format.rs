//! One file a format.

mod csv;
mod html;
mod latex;
mod markdown;
mod text;

pub(super) use csv::csv;
pub(super) use html::html;
pub(super) use latex::{document, table as latex_table};
pub(super) use markdown::markdown;
pub(super) use text::text;

/// Width that a figure is drawn for in millimetres, as its SVG says.
fn width_mm(svg: &str) -> Option<f64> {
    let (_, rest) = svg.split_once(" width=\"")?;
    rest.split_once("mm\"")?.0.parse().ok()
}
