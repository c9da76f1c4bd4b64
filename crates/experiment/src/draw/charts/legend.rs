//! What lines mean, in columns below a chart.

use super::{Line, Look, Name, style, text_width};
use crate::draw::marks::{Area, Drawn, Stroke};
use plotters::element::Text;
use plotters::style::text_anchor::{HPos, VPos};

/// Height of a row.
const ROW: u32 = 18;
/// Length of a sample of a line, and from its begin to the name.
const SAMPLE: u32 = 26;
const INDENT: u32 = 32;
/// Between two columns.
const GAP: u32 = 16;

/// The legend of a chart.
pub(super) struct Legend<'a> {
    entries: Vec<(&'a str, &'a Line)>,
    columns: usize,
    /// Width of a column.
    width: u32,
    /// Where the first begins.
    left: u32,
}

impl<'a> Legend<'a> {
    /// Of those lines that stand in it, in a chart `width` wide.
    pub(super) fn new(lines: &'a [Line], width: u32) -> Self {
        let entries: Vec<(&str, &Line)> = lines
            .iter()
            .filter_map(|line| match &line.name {
                Name::Legend(name) => Some((name.as_str(), line)),
                _ => None,
            })
            .collect();
        let widest = entries.iter().map(|(name, _)| INDENT + text_width(name)).max().unwrap_or(0);
        let columns = (((width + GAP) / (widest + GAP)) as usize).clamp(1, entries.len().max(1));
        // No more columns than the rows need.
        let columns = entries.len().div_ceil(entries.len().div_ceil(columns).max(1)).max(1);
        let whole = columns as u32 * (widest + GAP) - GAP.min(columns as u32 * (widest + GAP));
        Self { entries, columns, width: widest + GAP, left: width.saturating_sub(whole) / 2 }
    }

    fn rows(&self) -> usize {
        self.entries.len().div_ceil(self.columns)
    }

    /// Its height.
    pub(super) fn height(&self) -> u32 {
        if self.entries.is_empty() { 0 } else { ROW * self.rows() as u32 + 8 }
    }

    /// Draws it below the chart, column by column.
    pub(super) fn draw(&self, root: &Area<'_>, look: Look) -> Drawn {
        let unit = look.unit as i32;
        for (k, (name, line)) in self.entries.iter().enumerate() {
            let (column, row) = (k / self.rows(), k % self.rows());
            let x = (self.left + column as u32 * self.width) as i32 * unit;
            let y = (look.size.1 + ROW / 2 + 4 + row as u32 * ROW) as i32 * unit;
            let end = x + SAMPLE as i32 * unit;
            let half = 4 * unit;
            let sample = if line.style.stroke == Stroke::Area {
                vec![(x, y - half), (end, y - half), (end, y + half), (x, y + half)]
            } else {
                vec![(x, y), (end, y)]
            };
            line.style.draw_line(root, &sample, look.unit)?;
            line.style.draw_mark(root, (i32::midpoint(x, end), y), look.unit)?;
            let at = (x + INDENT as i32 * unit, y);
            root.draw(&Text::new((*name).to_owned(), at, style(look, HPos::Left, VPos::Center)))?;
        }
        Ok(())
    }
}
