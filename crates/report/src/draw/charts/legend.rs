//! What lines mean, in columns below a chart.

use super::{INK, Line, Look, Name, text_width};
use crate::draw::marks::{Area, Drawn, Stroke};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Height of text, a little less than on the axes, and of a row.
const TEXT: u32 = 13;
const ROW: u32 = 17;
/// Length of a sample of a line, and from its begin to the name.
const SAMPLE: u32 = 24;
const INDENT: u32 = 29;
/// Between two columns, and at both sides.
const GAP: u32 = 12;
const MARGIN: u32 = 4;

/// The legend of a chart.
pub(super) struct Legend<'a> {
    entries: Vec<(&'a str, &'a Line)>,
    rows: usize,
    /// Where each column begins.
    columns: Vec<u32>,
}

impl<'a> Legend<'a> {
    /// Of those lines that stand in it, in a chart `width` wide: in as few rows as fit.
    pub(super) fn new(lines: &'a [Line], width: u32) -> Self {
        let named = |line: &'a Line| match &line.name {
            Name::Legend(name) => Some((name.as_str(), line)),
            _ => None,
        };
        let entries: Vec<(&str, &Line)> = lines.iter().filter_map(named).collect();
        let widths: Vec<u32> = entries.iter().map(|(name, _)| INDENT + text_width(name) * TEXT / super::TEXT).collect();
        let columns = |rows: usize| -> Vec<u32> {
            widths.chunks(rows).map(|column| column.iter().copied().max().unwrap_or(0)).collect()
        };
        let whole = |columns: &[u32]| columns.iter().map(|w| w + GAP).sum::<u32>().saturating_sub(GAP);
        let most = entries.len().max(1);
        let rows = (1..most).find(|rows| whole(&columns(*rows)) + 2 * MARGIN <= width).unwrap_or(most);
        let widths = columns(rows);
        let mut x = (width.saturating_sub(whole(&widths)) / 2).max(MARGIN);
        let begin = |w: &u32| {
            x += w + GAP;
            x - w - GAP
        };
        Self { rows, columns: widths.iter().map(begin).collect(), entries }
    }

    /// Its height.
    pub(super) fn height(&self) -> u32 {
        if self.entries.is_empty() { 0 } else { ROW * self.rows as u32 + 8 }
    }

    /// Draws it below the chart, column by column.
    pub(super) fn draw(&self, root: &Area<'_>, look: Look) -> Drawn {
        let unit = look.unit as i32;
        for (k, (name, line)) in self.entries.iter().enumerate() {
            let x = self.columns[k / self.rows] as i32 * unit;
            let y = (look.size.1 + ROW / 2 + 4 + (k % self.rows) as u32 * ROW) as i32 * unit;
            let end = x + SAMPLE as i32 * unit;
            let half = 4 * unit;
            let sample = if line.style.stroke == Stroke::Area {
                vec![(x, y - half), (end, y - half), (end, y + half), (x, y + half)]
            } else {
                vec![(x, y), (end, y)]
            };
            line.style.draw_line(root, &sample, look.unit)?;
            line.style.draw_mark(root, (i32::midpoint(x, end), y), look.unit)?;
            let font = ("sans-serif", TEXT * look.unit).into_font().color(&INK);
            let at = (x + INDENT as i32 * unit, y);
            root.draw(&Text::new((*name).to_owned(), at, font.pos(Pos::new(HPos::Left, VPos::Center))))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::marks::Style;

    #[test]
    fn rows_are_as_few_as_fit() {
        let line = |name: &str| {
            let mut line = Line::new(Vec::new(), Style::line(INK, 1, Stroke::Full));
            line.name = Name::Legend(name.into());
            line
        };
        let short: Vec<Line> = (0..7).map(|k| line(&format!("no. {k}"))).collect();
        let legend = Legend::new(&short, 380);
        assert!((2..=3).contains(&legend.rows), "{} rows", legend.rows);
        assert!(legend.columns.windows(2).all(|w| w[0] < w[1]));
        let long = vec![line(&"a very long name ".repeat(9)); 3];
        assert_eq!(Legend::new(&long, 380).columns, [MARGIN]);
        assert_eq!(Legend::new(&[], 380).height(), 0);
    }
}
