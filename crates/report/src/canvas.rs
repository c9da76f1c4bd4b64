//! `Canvas`: a picture as a list of a few shapes, which writes itself as SVG, PNG and PDF.
//!
//! Charts, rooms, skies and sheets all draw here, and all outputs are made from the same list, so they agree. None of
//! them reads anything from outside: the only pictures in a picture are pixels in memory.
//! Lengths are SVG units, of which a column of print has 380; y points down.

mod font;
mod pdf;
mod png;
mod svg;

pub use font::{cut, text_width, wrapped};
use pwrfgs_core::words;
pub use svg::xml;

/// Height of text: 7.5 pt where a column of 380 is 3.5 in wide.
pub const TEXT: f64 = 11.3;
/// Height of a line of text.
pub const LINE: f64 = 14.0;

/// Across and down.
pub type Point = [f64; 2];

/// A colour and how much it covers, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    /// Red, green and blue.
    pub rgb: [u8; 3],
    /// 0 where nothing shows.
    pub opacity: f64,
}

impl Colour {
    /// From `0xrrggbb`.
    pub const fn hex(rgb: u32) -> Self {
        Self { rgb: [(rgb >> 16) as u8, (rgb >> 8) as u8, rgb as u8], opacity: 1.0 }
    }

    /// The same, see-through.
    pub const fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// As CSS writes it, without its opacity.
    pub fn css(self) -> String {
        let [r, g, b] = self.rgb;
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// Colour of text and axes.
pub const INK: Colour = Colour::hex(0x46_4a52);
/// The darkest there is.
pub const BLACK: Colour = Colour::hex(0x10_1318);
/// Paper.
pub const WHITE: Colour = Colour::hex(0xff_ffff);

/// How a shape is filled and stroked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Paint {
    /// Within, where it is filled.
    pub fill: Option<Colour>,
    /// Along its outline, where it is stroked.
    pub stroke: Option<Colour>,
    /// Of the stroke.
    pub width: f64,
    /// Lengths of strokes and gaps in turn; nothing for a full line.
    pub dash: &'static [f64],
    /// Whether strokes end round: a line without length is then a dot.
    pub round: bool,
}

impl Paint {
    /// Filled alone.
    pub fn fill(colour: Colour) -> Self {
        Self { fill: Some(colour), ..Self::default() }
    }

    /// Stroked alone.
    pub fn stroke(colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..Self::default() }
    }

    /// With this outline as well.
    pub fn outlined(self, colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..self }
    }
}

/// A piece of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Begin here.
    Move(Point),
    /// Straight on.
    Line(Point),
    /// A parabola by its control point: what letters are made of.
    Quad(Point, Point),
    /// Back to where it began.
    Close,
}

/// Lines and curves that are painted together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path(
    /// One after another.
    pub Vec<Step>,
);

impl Path {
    /// A line through `points`.
    pub fn of(points: &[Point]) -> Self {
        let mut path = Self::default();
        path.add(points);
        path
    }

    /// One more line.
    pub fn add(&mut self, points: &[Point]) {
        let step = |(k, p): (usize, &Point)| if k == 0 { Step::Move(*p) } else { Step::Line(*p) };
        self.0.extend(points.iter().enumerate().map(step));
    }

    /// Two more lines that cross at a place, upright.
    pub fn add_plus(&mut self, [x, y]: Point, r: f64) {
        self.add(&[[x - r, y], [x + r, y]]);
        self.add(&[[x, y - r], [x, y + r]]);
    }

    /// Two more lines that cross at a place, leaning.
    pub fn add_cross(&mut self, [x, y]: Point, r: f64) {
        self.add(&[[x - r, y - r], [x + r, y + r]]);
        self.add(&[[x + r, y - r], [x - r, y + r]]);
    }

    /// Whether all of it has a place, and a stroke or an area something to cover: a line without length shows only where
    /// its ends are round.
    fn shows(&self, paint: &Paint) -> bool {
        let ends = |step: &Step| match *step {
            Step::Move(p) | Step::Line(p) => Some([p, p]),
            Step::Quad(c, p) => Some([c, p]),
            Step::Close => None,
        };
        let points: Vec<Point> = self.0.iter().filter_map(ends).flatten().collect();
        let extended = paint.round || points.windows(2).any(|pair| pair[0] != pair[1]);
        self.0.len() > 1 && extended && points.iter().all(is_place)
    }

    /// Back to where it began.
    pub fn closed(mut self) -> Self {
        self.0.push(Step::Close);
        self
    }
}

/// Which part of a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// It begins there.
    Start,
    /// Its middle.
    Middle,
    /// It ends there.
    End,
}

/// How text looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Letters {
    /// Of the em square.
    pub size: f64,
    /// Of all of it.
    pub colour: Colour,
}

/// Text on one line.
#[derive(Clone, Debug, PartialEq)]
pub struct Text {
    /// On the base line.
    pub at: Point,
    /// Which part of it stands there.
    pub anchor: Anchor,
    /// How it looks.
    pub letters: Letters,
    /// Whether it reads upwards.
    pub upright: bool,
    /// What it says.
    pub words: String,
}

/// A picture made of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Pixels {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Four bytes a pixel, row by row from the top.
    pub rgba: Vec<u8>,
    /// Whether one runs into the next.
    pub smooth: bool,
}

/// What a picture consists of.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Lines and curves.
    Path(Path, Paint),
    /// Middle and radius.
    Circle(Point, f64, Paint),
    /// Words.
    Text(Text),
    /// Corner, width and height.
    Pixels(Point, Point, Pixels),
    /// Another picture, moved by so much after it was scaled.
    Group(Point, f64, Vec<Self>),
}

/// A picture under construction.
#[derive(Clone, Debug)]
pub struct Canvas {
    /// Of the whole picture.
    pub width: f64,
    /// Of the whole picture.
    pub height: f64,
    /// How the next text looks.
    pub letters: Letters,
    /// The first lies undermost.
    pub shapes: Vec<Shape>,
}

impl Canvas {
    /// An empty one, with text as charts have it.
    pub fn new(width: f64, height: f64) -> Self {
        let letters = Letters { size: TEXT, colour: INK };
        Self { width, height, letters, shapes: Vec::new() }
    }

    /// Lines and curves, unless they have no place or nothing to show.
    pub fn path(&mut self, path: Path, paint: Paint) {
        if path.shows(&paint) {
            self.shapes.push(Shape::Path(path, paint));
        }
    }

    /// A line through `points`.
    pub fn line(&mut self, points: &[Point], paint: Paint) {
        self.path(Path::of(points), paint);
    }

    /// An area within `corners`.
    pub fn polygon(&mut self, corners: &[Point], paint: Paint) {
        self.path(Path::of(corners).closed(), paint);
    }

    /// An upright box by its corner and its size.
    pub fn rect(&mut self, [x, y]: Point, [width, height]: Point, paint: Paint) {
        self.polygon(&[[x, y], [x + width, y], [x + width, y + height], [x, y + height]], paint);
    }

    /// A circle, unless it has no place or no size.
    pub fn circle(&mut self, middle: Point, radius: f64, paint: Paint) {
        if is_place(&middle) && radius.is_finite() && radius > 0.0 {
            self.shapes.push(Shape::Circle(middle, radius, paint));
        }
    }

    fn write(&mut self, at: Point, anchor: Anchor, upright: bool, words: &str) {
        if is_place(&at) {
            let words = plain(words);
            self.shapes.push(Shape::Text(Text { at, anchor, letters: self.letters, upright, words }));
        }
    }

    /// Text on a base line.
    pub fn text(&mut self, at: Point, anchor: Anchor, words: impl AsRef<str>) {
        self.write(at, anchor, false, words.as_ref());
    }

    /// Text that reads upwards, its middle at a place.
    pub fn upright(&mut self, at: Point, words: impl AsRef<str>) {
        self.write(at, Anchor::Middle, true, words.as_ref());
    }

    /// Lines of text, the middle of all of them at the height of `at`.
    pub fn lines(&mut self, [x, y]: Point, anchor: Anchor, lines: &[String]) {
        let first = y + 0.35 * self.letters.size - LINE * (lines.len() as f64 - 1.0) / 2.0;
        for (k, line) in lines.iter().enumerate() {
            self.text([x, first + LINE * k as f64], anchor, line);
        }
    }

    /// Pixels by the corner and the size of what they cover.
    pub fn pixels(&mut self, at: Point, size: Point, pixels: Pixels) {
        self.shapes.push(Shape::Pixels(at, size, pixels));
    }

    /// Pixels with a frame round them.
    pub fn framed(&mut self, at: Point, size: Point, pixels: Pixels) {
        self.pixels(at, size, pixels);
        self.rect(at, size, Paint::stroke(INK, 0.6));
    }

    /// Another picture, moved to `at` and scaled.
    pub fn put(&mut self, at: Point, scale: f64, other: &Self) {
        self.shapes.push(Shape::Group(at, scale, other.shapes.clone()));
    }
}

/// A name or a label, from files that anybody may have written: on one line, without anything that a terminal obeys.
pub fn plain(text: &str) -> String {
    words::plain(&text.replace(char::is_whitespace, " "))
}

/// Whether there is such a place.
fn is_place(at: &Point) -> bool {
    at.iter().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_place_or_no_size_is_left_out() {
        let mut canvas = Canvas::new(10.0, 10.0);
        let thin = Paint::stroke(INK, 1.0);
        canvas.line(&[[1.0, 1.0], [1.0, 1.0]], thin);
        canvas.line(&[[1.0, 1.0], [f64::NAN, 2.0]], thin);
        canvas.polygon(&[[3.0, 3.0]; 3], Paint::fill(INK).outlined(BLACK, 1.0));
        canvas.circle([1.0, f64::INFINITY], 1.0, thin);
        canvas.circle([1.0, 1.0], f64::NAN, thin);
        canvas.circle([1.0, 1.0], 0.0, thin);
        canvas.text([f64::NAN, 0.0], Anchor::Start, "nowhere");
        assert_eq!(canvas.shapes, []);
        canvas.line(&[[1.0, 1.0], [1.0, 1.0]], Paint { round: true, ..thin });
        canvas.text([1.0, 1.0], Anchor::Start, "two\nlines");
        assert_eq!(canvas.shapes.len(), 2);
        let svg = canvas.svg("x", "\"/><script>");
        assert!(svg.contains("two lines") && svg.contains("aria-label=\"&quot;/&gt;&lt;script&gt;\""), "{svg}");
    }

    #[test]
    fn a_terminal_gets_one_line_and_no_commands() {
        assert_eq!(plain("a\r\nb\t\u{1b}]0;x\u{7}\u{9b}1m\u{202e}c"), "a  b \u{fffd}]0;x\u{fffd}\u{fffd}1m\u{fffd}c");
    }
}
