//! A canvas as what plotters draws on.
//!
//! Three things of plotters do not suit print, and are settled here alone. It knows whole pixels only, which print
//! would show: it is told that a unit has [`GRID`] of them, and they are divided again. Its SVG writer shrinks text by
//! 1.24 and writes a root of fixed size: neither it nor plotters' fonts are compiled in, since a canvas does both.

use crate::canvas::font::TEXT;
use crate::canvas::{Anchor, Canvas, Colour, Paint, Point};
use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontTransform,
};
use std::convert::Infallible;

/// Pixels of plotters for each unit of the canvas.
pub(super) const GRID: f64 = 100.0;

/// What plotters draws with.
pub(super) struct Hand<'a>(pub(super) &'a mut Canvas);

/// Drawing into memory cannot fail.
type Drawn = Result<(), DrawingErrorKind<Infallible>>;

fn point((x, y): BackendCoord) -> Point {
    [f64::from(x) / GRID, f64::from(y) / GRID]
}

fn colour(colour: BackendColor) -> Colour {
    let (r, g, b) = colour.rgb;
    Colour { rgb: [r, g, b], opacity: colour.alpha }
}

fn stroke(style: &impl BackendStyle) -> Paint {
    Paint::stroke(colour(style.color()), f64::from(style.stroke_width()) / GRID)
}

impl DrawingBackend for Hand<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        ((self.0.width * GRID) as u32, (self.0.height * GRID) as u32)
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, at: BackendCoord, ink: BackendColor) -> Drawn {
        self.0.rect(point(at), [1.0 / GRID; 2], Paint::fill(colour(ink)));
        Ok(())
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        self.draw_path([from, to], style)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> Drawn {
        let points: Vec<Point> = path.into_iter().map(point).collect();
        self.0.line(&points, stroke(style));
        Ok(())
    }

    fn draw_text<T: BackendTextStyle>(&mut self, words: &str, style: &T, at: BackendCoord) -> Drawn {
        let [x, y] = point(at);
        // From the place that is named down to the base line; the middle is that of small letters.
        let down = TEXT
            * match style.anchor().v_pos {
                VPos::Top => 0.76,
                VPos::Center => 0.27,
                VPos::Bottom => -0.27,
            };
        let anchor = match style.anchor().h_pos {
            HPos::Left => Anchor::Start,
            HPos::Center => Anchor::Middle,
            HPos::Right => Anchor::End,
        };
        match style.transform() {
            FontTransform::None => self.0.text([x, y + down], anchor, words),
            _ => self.0.upright([x + down, y], words),
        }
        Ok(())
    }
}
