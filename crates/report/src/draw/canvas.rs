//! `Canvas`: a picture as a list of a few shapes, which writes itself as SVG ([`svg`](super::svg)) and as PNG
//! ([`png`](super::png)).
//!
//! Charts, rooms, skies and sheets all draw here, and both outputs are made from the same list, so they agree.
//! Lengths are SVG units, of which a column of print has 380; y points down.

/// Across and down.
pub(crate) type Point = [f64; 2];

/// A colour and how much it covers, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Colour {
    pub(crate) rgb: [u8; 3],
    pub(crate) opacity: f64,
}

impl Colour {
    /// From `0xrrggbb`.
    pub(crate) const fn hex(rgb: u32) -> Self {
        Self { rgb: [(rgb >> 16) as u8, (rgb >> 8) as u8, rgb as u8], opacity: 1.0 }
    }

    /// The same, see-through.
    pub(crate) const fn faint(self, opacity: f64) -> Self {
        Self { opacity, ..self }
    }

    /// As CSS writes it, without its opacity.
    pub(crate) fn css(self) -> String {
        let [r, g, b] = self.rgb;
        format!("#{r:02x}{g:02x}{b:02x}")
    }
}

/// Colour of text and axes.
pub(crate) const INK: Colour = Colour::hex(0x46_4a52);
/// The darkest there is.
pub(crate) const BLACK: Colour = Colour::hex(0x10_1318);
/// Paper.
pub(crate) const WHITE: Colour = Colour::hex(0xff_ffff);

/// How a shape is filled and stroked.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Paint {
    pub(crate) fill: Option<Colour>,
    pub(crate) stroke: Option<Colour>,
    /// Of the stroke.
    pub(crate) width: f64,
    /// Lengths of strokes and gaps in turn; nothing for a full line.
    pub(crate) dash: &'static [f64],
    /// Whether strokes end round: a line without length is then a dot.
    pub(crate) round: bool,
}

impl Paint {
    /// Filled alone.
    pub(crate) fn fill(colour: Colour) -> Self {
        Self { fill: Some(colour), ..Self::default() }
    }

    /// Stroked alone.
    pub(crate) fn stroke(colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..Self::default() }
    }

    /// With this outline as well.
    pub(crate) fn outlined(self, colour: Colour, width: f64) -> Self {
        Self { stroke: Some(colour), width, ..self }
    }
}

/// A piece of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Step {
    Move(Point),
    Line(Point),
    /// A parabola by its control point: what letters are made of.
    Quad(Point, Point),
    Close,
}

/// Lines and curves that are painted together.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Path(pub(crate) Vec<Step>);

impl Path {
    /// A line through `points`.
    pub(crate) fn of(points: &[Point]) -> Self {
        let mut path = Self::default();
        path.add(points);
        path
    }

    /// One more line.
    pub(crate) fn add(&mut self, points: &[Point]) {
        let step = |(k, p): (usize, &Point)| if k == 0 { Step::Move(*p) } else { Step::Line(*p) };
        self.0.extend(points.iter().enumerate().map(step));
    }

    /// Two more lines that cross at a place, upright.
    pub(crate) fn add_plus(&mut self, [x, y]: Point, r: f64) {
        self.add(&[[x - r, y], [x + r, y]]);
        self.add(&[[x, y - r], [x, y + r]]);
    }

    /// Two more lines that cross at a place, leaning.
    pub(crate) fn add_cross(&mut self, [x, y]: Point, r: f64) {
        self.add(&[[x - r, y - r], [x + r, y + r]]);
        self.add(&[[x + r, y - r], [x - r, y + r]]);
    }

    /// Back to where it began.
    pub(crate) fn closed(mut self) -> Self {
        self.0.push(Step::Close);
        self
    }
}

/// Which part of a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// How text looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Letters {
    /// Of the em square.
    pub(crate) size: f64,
    pub(crate) colour: Colour,
}

/// Text on one line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Text {
    /// On the base line.
    pub(crate) at: Point,
    pub(crate) anchor: Anchor,
    pub(crate) letters: Letters,
    /// Whether it reads upwards.
    pub(crate) upright: bool,
    pub(crate) words: String,
}

/// A picture made of pixels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Pixels {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// Four bytes a pixel, row by row from the top.
    pub(crate) rgba: Vec<u8>,
    /// Whether one runs into the next.
    pub(crate) smooth: bool,
}

/// What a picture consists of.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Shape {
    Path(Path, Paint),
    Circle(Point, f64, Paint),
    Text(Text),
    /// Corner, width and height.
    Pixels(Point, Point, Pixels),
    /// Another picture, moved by so much after it was scaled.
    Group(Point, f64, Vec<Self>),
}

/// A picture under construction.
#[derive(Clone, Debug)]
pub(crate) struct Canvas {
    pub(crate) width: f64,
    pub(crate) height: f64,
    /// How the next text looks.
    pub(crate) letters: Letters,
    pub(crate) shapes: Vec<Shape>,
}

impl Canvas {
    /// An empty one, with text as charts have it.
    pub(crate) fn new(width: f64, height: f64) -> Self {
        let letters = Letters { size: super::font::TEXT, colour: INK };
        Self { width, height, letters, shapes: Vec::new() }
    }

    pub(crate) fn path(&mut self, path: Path, paint: Paint) {
        if path.0.len() > 1 {
            self.shapes.push(Shape::Path(path, paint));
        }
    }

    /// A line through `points`.
    pub(crate) fn line(&mut self, points: &[Point], paint: Paint) {
        self.path(Path::of(points), paint);
    }

    pub(crate) fn polygon(&mut self, corners: &[Point], paint: Paint) {
        self.path(Path::of(corners).closed(), paint);
    }

    pub(crate) fn rect(&mut self, [x, y]: Point, [width, height]: Point, paint: Paint) {
        self.polygon(&[[x, y], [x + width, y], [x + width, y + height], [x, y + height]], paint);
    }

    pub(crate) fn circle(&mut self, middle: Point, radius: f64, paint: Paint) {
        self.shapes.push(Shape::Circle(middle, radius, paint));
    }

    fn write(&mut self, at: Point, anchor: Anchor, upright: bool, words: String) {
        self.shapes.push(Shape::Text(Text { at, anchor, letters: self.letters, upright, words }));
    }

    /// Text on a base line.
    pub(crate) fn text(&mut self, at: Point, anchor: Anchor, words: impl Into<String>) {
        self.write(at, anchor, false, words.into());
    }

    /// Text that reads upwards, its middle at a place.
    pub(crate) fn upright(&mut self, at: Point, words: impl Into<String>) {
        self.write(at, Anchor::Middle, true, words.into());
    }

    /// Lines of text, the middle of all of them at the height of `at`.
    pub(crate) fn lines(&mut self, [x, y]: Point, anchor: Anchor, lines: &[String]) {
        let step = super::font::LINE;
        let first = y + 0.35 * self.letters.size - step * (lines.len() as f64 - 1.0) / 2.0;
        for (k, line) in lines.iter().enumerate() {
            self.text([x, first + step * k as f64], anchor, line);
        }
    }

    pub(crate) fn pixels(&mut self, at: Point, size: Point, pixels: Pixels) {
        self.shapes.push(Shape::Pixels(at, size, pixels));
    }

    /// Pixels with a frame round them.
    pub(crate) fn framed(&mut self, at: Point, size: Point, pixels: Pixels) {
        self.pixels(at, size, pixels);
        self.rect(at, size, Paint::stroke(INK, 0.6));
    }

    /// Another picture, moved to `at` and scaled.
    pub(crate) fn put(&mut self, at: Point, scale: f64, other: &Self) {
        self.shapes.push(Shape::Group(at, scale, other.shapes.clone()));
    }
}
