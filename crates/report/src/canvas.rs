//! `Canvas`: a drawing as a list of a few shapes, written as SVG, PNG and PDF.
//!
//! Charts, rooms, sky plots and tables draw on it. All formats are written from the same list, so they agree. Nothing
//! is loaded from outside: images in a drawing are pixels in memory. Lengths are SVG units; a print column is 380 wide.
//! y points down.

mod font;
mod pdf;
mod png;
mod svg;

pub use font::{text_width, truncate_text, wrap_text};
use pwrfgs_core::colour::sequential;
use pwrfgs_core::messages;
pub use svg::escape_xml;

/// Text height: 7.5 pt if a column of 380 is 3.5 in wide.
pub const TEXT: f64 = 11.3;
/// Height of the middle of small letters above the base line, as a share of the text height.
pub(crate) const LETTER_MIDDLE: f64 = 0.27;
/// Line height of text.
pub const LINE: f64 = 14.0;

/// Point: horizontal and vertical coordinate.
pub type Point = [f64; 2];

/// Colour with opacity from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colour {
    /// Red, green and blue.
    pub rgb: [u8; 3],
    /// Opacity; 0 is transparent.
    pub opacity: f64,
}

impl Colour {
    /// Creates an opaque colour from `0xrrggbb`.
    pub const fn hex(rgb: u32) -> Self {
        Self { rgb: [(rgb >> 16) as u8, (rgb >> 8) as u8, rgb as u8], opacity: 1.0 }
    }

    /// Returns the colour of a share from 0 (dark) to 1 (light) on the sequential scale.
    pub fn sequential(share: f64) -> Self {
        Self { rgb: sequential(share), opacity: 1.0 }
    }

    /// Returns the colour with another opacity, from 0 to 1.
    pub const fn with_opacity(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// Returns the CSS notation without opacity.
    pub fn css(self) -> String {
        let [r, g, b] = self.rgb;
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// Colour of text and axes.
pub const INK: Colour = Colour::hex(0x46_4a52);
/// Black.
pub const BLACK: Colour = Colour::hex(0x10_1318);
/// Colour of the paper.
pub const WHITE: Colour = Colour::hex(0xff_ffff);

/// Fill and stroke of a shape.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Paint {
    /// Fill colour, if filled.
    pub fill: Option<Colour>,
    /// Stroke colour, if stroked.
    pub stroke: Option<Colour>,
    /// Width of the stroke.
    pub width: f64,
    /// Alternating lengths of strokes and gaps; empty for a solid line.
    pub dash: &'static [f64],
    /// Whether strokes have round ends: a line of length 0 is then a dot.
    pub round: bool,
}

impl Paint {
    /// Creates a fill without stroke.
    pub fn fill(colour: Colour) -> Self {
        Self { fill: Some(colour), ..Self::default() }
    }

    /// Creates a stroke without fill.
    pub fn stroke(colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..Self::default() }
    }

    /// Adds a stroke.
    pub fn outlined(self, colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..self }
    }
}

/// Segment of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// Start of a subpath.
    Move(Point),
    /// Straight line.
    Line(Point),
    /// Quadratic curve, as in letters: control point and end.
    Quad(Point, Point),
    /// Line back to the start of the subpath.
    Close,
}

/// Lines and curves that are painted together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VectorPath(
    /// Segments in order.
    pub Vec<Step>,
);

impl VectorPath {
    /// Creates a line through `points`.
    pub fn of(points: &[Point]) -> Self {
        let mut path = Self::default();
        path.add_line(points);
        path
    }

    /// Adds a line through `points` as a new subpath.
    pub fn add_line(&mut self, points: &[Point]) {
        let step = |(k, p): (usize, &Point)| if k == 0 { Step::Move(*p) } else { Step::Line(*p) };
        self.0.extend(points.iter().enumerate().map(step));
    }

    /// Adds an upright cross with arms of length `r`.
    pub fn add_plus(&mut self, [x, y]: Point, r: f64) {
        self.add_line(&[[x - r, y], [x + r, y]]);
        self.add_line(&[[x, y - r], [x, y + r]]);
    }

    /// Adds a diagonal cross that fills a square of side 2 `r`.
    pub fn add_cross(&mut self, [x, y]: Point, r: f64) {
        self.add_line(&[[x - r, y - r], [x + r, y + r]]);
        self.add_line(&[[x + r, y - r], [x - r, y + r]]);
    }

    /// Adds an arrow centred at `[x, y]`; `[u, v]` is the vector from its centre to its tip.
    pub fn add_arrow(&mut self, [x, y]: Point, [u, v]: Point) {
        let tip = [x + u, y + v];
        // The ends of the head are 0.55 of the vector behind the tip, and 0.35 of it beside the shaft.
        let barb = |side: f64| [tip[0] - 0.55 * u + side * 0.35 * v, tip[1] - 0.55 * v - side * 0.35 * u];
        self.add_line(&[[x - u, y - v], tip]);
        self.add_line(&[barb(1.0), tip, barb(-1.0)]);
    }

    /// Returns whether all points are finite, and two of them differ; equal points are visible as a dot if the ends are
    /// round.
    fn is_visible(&self, paint: &Paint) -> bool {
        let points_of = |step: &Step| match *step {
            Step::Move(p) | Step::Line(p) => Some([p, p]),
            Step::Quad(c, p) => Some([c, p]),
            Step::Close => None,
        };
        let points: Vec<Point> = self.0.iter().filter_map(points_of).flatten().collect();
        let has_extent = paint.round || points.windows(2).any(|pair| pair[0] != pair[1]);
        self.0.len() > 1 && has_extent && points.iter().all(is_finite_point)
    }

    /// Closes the last subpath.
    pub fn closed(mut self) -> Self {
        self.0.push(Step::Close);
        self
    }
}

/// Horizontal alignment of text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Starts at the point.
    Start,
    /// Centred at the point.
    Middle,
    /// Ends at the point.
    End,
}

/// Text style.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextStyle {
    /// Height of the em square.
    pub size: f64,
    /// Colour of the text.
    pub colour: Colour,
}

/// Text on one line.
#[derive(Clone, Debug, PartialEq)]
pub struct Text {
    /// Point on the base line.
    pub at: Point,
    /// Alignment to the point.
    pub anchor: Anchor,
    /// Text style.
    pub letters: TextStyle,
    /// Whether the text reads upwards.
    pub upright: bool,
    /// Characters.
    pub words: String,
}

/// Raster image.
#[derive(Clone, Debug, PartialEq)]
pub struct RasterImage {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// RGBA bytes, row by row from the top.
    pub rgba: Vec<u8>,
    /// Whether pixels are interpolated.
    pub smooth: bool,
}

/// Element of a drawing.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Lines and curves.
    Path(VectorPath, Paint),
    /// Circle: centre and radius.
    Circle(Point, f64, Paint),
    /// Text.
    Text(Text),
    /// Image: upper left corner, then width and height.
    RasterImage(Point, Point, RasterImage),
    /// Another drawing, scaled and then moved.
    Group(Point, f64, Vec<Self>),
}

/// Drawing under construction.
#[derive(Clone, Debug)]
pub struct Canvas {
    /// Width of the drawing.
    pub width: f64,
    /// Height of the drawing.
    pub height: f64,
    /// Style of the next text.
    pub letters: TextStyle,
    /// Elements, bottom first.
    pub shapes: Vec<Shape>,
}

impl Canvas {
    /// Creates an empty drawing with the text style of charts.
    pub fn new(width: f64, height: f64) -> Self {
        let letters = TextStyle { size: TEXT, colour: INK };
        Self { width, height, letters, shapes: Vec::new() }
    }

    /// Adds a path, unless it is invisible or not finite.
    pub fn path(&mut self, path: VectorPath, paint: Paint) {
        if path.is_visible(&paint) {
            self.shapes.push(Shape::Path(path, paint));
        }
    }

    /// Adds a line through `points`.
    pub fn line(&mut self, points: &[Point], paint: Paint) {
        self.path(VectorPath::of(points), paint);
    }

    /// Adds a closed polygon.
    pub fn polygon(&mut self, corners: &[Point], paint: Paint) {
        self.path(VectorPath::of(corners).closed(), paint);
    }

    /// Adds a rectangle by its upper left corner, width and height.
    pub fn rect(&mut self, [x, y]: Point, [width, height]: Point, paint: Paint) {
        self.polygon(&[[x, y], [x + width, y], [x + width, y + height], [x, y + height]], paint);
    }

    /// Adds a circle, unless it is not finite or has no size.
    pub fn circle(&mut self, middle: Point, radius: f64, paint: Paint) {
        if is_finite_point(&middle) && radius.is_finite() && radius > 0.0 {
            self.shapes.push(Shape::Circle(middle, radius, paint));
        }
    }

    /// Adds text as one line, unless its position is not finite.
    fn add_text(&mut self, at: Point, anchor: Anchor, upright: bool, words: &str) {
        if is_finite_point(&at) {
            let words = single_line(words);
            self.shapes.push(Shape::Text(Text { at, anchor, letters: self.letters, upright, words }));
        }
    }

    /// Adds text at a point of its base line.
    pub fn text(&mut self, at: Point, anchor: Anchor, words: impl AsRef<str>) {
        self.add_text(at, anchor, false, words.as_ref());
    }

    /// Adds text that reads upwards, centred at a point.
    pub fn upright_text(&mut self, at: Point, words: impl AsRef<str>) {
        self.add_text(at, Anchor::Middle, true, words.as_ref());
    }

    /// Adds lines of text, centred vertically at `y`.
    pub fn lines(&mut self, [x, y]: Point, anchor: Anchor, lines: &[String]) {
        // Half the height of capitals is 0.35 of the text height.
        let first = y + 0.35 * self.letters.size - LINE * (lines.len() as f64 - 1.0) / 2.0;
        for (k, line) in lines.iter().enumerate() {
            self.text([x, first + LINE * k as f64], anchor, line);
        }
    }

    /// Adds an image by its upper left corner, width and height.
    pub fn pixels(&mut self, at: Point, size: Point, pixels: RasterImage) {
        self.shapes.push(Shape::RasterImage(at, size, pixels));
    }

    /// Adds an image with a thin frame, by its upper left corner, width and height.
    pub fn framed_pixels(&mut self, at: Point, size: Point, pixels: RasterImage) {
        self.pixels(at, size, pixels);
        self.rect(at, size, Paint::stroke(INK, 0.6));
    }

    /// Adds the shapes of another drawing, scaled and moved to `at`.
    pub fn add_drawing(&mut self, at: Point, scale: f64, other: &Self) {
        self.shapes.push(Shape::Group(at, scale, other.shapes.clone()));
    }
}

/// Returns text from untrusted files as one line: white space becomes blanks, and control characters `\u{fffd}`.
pub fn single_line(text: &str) -> String {
    messages::escape_control(&text.replace(char::is_whitespace, " "))
}

/// Returns whether a point is finite.
fn is_finite_point(at: &Point) -> bool {
    at.iter().all(|v| v.is_finite())
}

/// Texts that leave their canvas, in every drawing that a test writes.
#[cfg(test)]
pub(crate) mod outside {
    use super::font::outlines;
    use super::{Canvas, Point, Shape, Step};
    use std::cell::{Cell, RefCell};

    thread_local! {
        static LEAVING: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
        static WRITTEN: Cell<usize> = const { Cell::new(0) };
    }

    /// Resets and returns the number of drawings of this thread since the last call, and their texts that leave the
    /// canvas.
    pub(crate) fn take() -> (usize, Vec<String>) {
        (WRITTEN.take(), LEAVING.take())
    }

    /// Records the texts of a drawing that leave it.
    pub(super) fn record(canvas: &Canvas) {
        WRITTEN.set(WRITTEN.get() + 1);
        let mut texts = Vec::new();
        collect(&canvas.shapes, [0.0; 2], 1.0, &mut texts);
        let size = [canvas.width, canvas.height];
        // Text may touch the border.
        let is_inside = |p: &Point| (0..2).all(|k| (-0.05..=size[k] + 0.05).contains(&p[k]));
        texts.retain(|(_, points)| !points.iter().all(is_inside));
        LEAVING.with_borrow_mut(|leaving| {
            leaving.extend(texts.into_iter().map(|(words, _)| format!("{words} in {size:?}")));
        });
    }

    /// Collects all texts with the points of their outlines on the canvas.
    fn collect(shapes: &[Shape], at: Point, scale: f64, texts: &mut Vec<(String, Vec<Point>)>) {
        let to_canvas = |p: Point| [at[0] + scale * p[0], at[1] + scale * p[1]];
        for shape in shapes {
            match shape {
                Shape::Group(to, by, shapes) => collect(shapes, to_canvas(*to), scale * by, texts),
                Shape::Text(text) => {
                    let end = |step: &Step| match *step {
                        Step::Move(p) | Step::Line(p) | Step::Quad(_, p) => Some(to_canvas(p)),
                        Step::Close => None,
                    };
                    texts.push((text.words.clone(), outlines(text).0.iter().filter_map(end).collect()));
                }
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn omits_shapes_without_position_or_size() {
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
    fn label_is_one_line_without_control_characters() {
        assert_eq!(
            single_line("a\r\nb\t\u{1b}]0;x\u{7}\u{9b}1m\u{202e}c"),
            "a  b \u{fffd}]0;x\u{fffd}\u{fffd}1m\u{fffd}c"
        );
    }
}
