//! What symbols mean, in columns below a picture.

use crate::canvas::font::{TEXT, cut, text_width};
use crate::canvas::{Anchor, Canvas, Letters};

/// Height of text, a little less than on axes, and of a row.
const SIZE: f64 = 10.5;
const ROW: f64 = 17.0;
/// From a symbol to its meaning, between two columns, and at both sides.
const INDENT: f64 = 5.0;
const GAP: f64 = 12.0;
const MARGIN: f64 = 4.0;
/// Height of a symbol.
pub(crate) const SYMBOL: f64 = 14.0;

/// A symbol and its meaning.
pub(crate) struct Symbol {
    pub(crate) picture: Canvas,
    pub(crate) meaning: String,
}

/// Symbols in columns.
pub(crate) struct Legend {
    symbols: Vec<Symbol>,
    rows: usize,
    /// Where each column begins.
    columns: Vec<f64>,
}

impl Legend {
    /// In as few rows as fit a picture of this width.
    pub(crate) fn new(symbols: Vec<Symbol>, width: f64) -> Self {
        let wide = |s: &Symbol| s.picture.width + INDENT + text_width(&s.meaning) * SIZE / TEXT;
        let columns = |rows: usize| -> Vec<f64> {
            symbols.chunks(rows).map(|column| column.iter().map(wide).fold(0.0, f64::max)).collect()
        };
        let whole = |columns: &[f64]| columns.iter().map(|w| w + GAP).sum::<f64>() - GAP;
        let most = symbols.len().max(1);
        let rows = (1..most).find(|rows| whole(&columns(*rows)) + 2.0 * MARGIN <= width).unwrap_or(most);
        let widths = columns(rows);
        let mut x = ((width - whole(&widths)) / 2.0).max(MARGIN);
        let begin = |w: &f64| {
            x += w + GAP;
            x - w - GAP
        };
        Self { rows, columns: widths.iter().map(begin).collect(), symbols }
    }

    pub(crate) fn height(&self) -> f64 {
        if self.symbols.is_empty() { 0.0 } else { ROW * self.rows as f64 + 8.0 }
    }

    /// Draws it below `top`, column by column.
    pub(crate) fn draw(&self, canvas: &mut Canvas, top: f64) {
        canvas.letters = Letters { size: SIZE, ..canvas.letters };
        for (k, Symbol { picture, meaning }) in self.symbols.iter().enumerate() {
            let (x, middle) = (self.columns[k / self.rows], top + 4.0 + ROW * ((k % self.rows) as f64 + 0.5));
            canvas.put([x, middle - SYMBOL / 2.0], 1.0, picture);
            let left = x + picture.width + INDENT;
            let room = (canvas.width - left) * TEXT / SIZE;
            canvas.text([left, middle + 0.27 * SIZE], Anchor::Start, cut(meaning, room));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_as_few_as_fit() {
        let symbol = |meaning: String| Symbol { picture: Canvas::new(24.0, SYMBOL), meaning };
        let legend = Legend::new((0..7).map(|k| symbol(format!("no. {k}"))).collect(), 380.0);
        assert!((2..=3).contains(&legend.rows), "{} rows", legend.rows);
        assert!(legend.columns.windows(2).all(|w| w[0] < w[1]));
        let long = (0..3).map(|_| symbol("a very long name ".repeat(9))).collect();
        let legend = Legend::new(long, 380.0);
        assert_eq!(legend.columns, [MARGIN]);
        let mut canvas = Canvas::new(380.0, 100.0);
        legend.draw(&mut canvas, 0.0);
        let svg = canvas.svg("legend", "");
        assert!(svg.matches("..</text>").count() == 3 && !svg.contains(&"a very long name ".repeat(4)), "{svg}");
        assert_eq!(Legend::new(vec![], 380.0).height(), 0.0);
    }
}
