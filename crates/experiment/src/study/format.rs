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
