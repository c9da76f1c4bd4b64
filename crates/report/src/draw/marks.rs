//! Line styles: colour, stroke and marker each distinguish lines, also in greyscale.

use crate::canvas::{Canvas, Colour, Paint, Point, VectorPath, WHITE};

/// Colours for the colour-blind (Okabe and Ito, without yellow, which is hard to see on white); neighbours differ in
/// lightness.
const COLOURS: [u32; 8] = [0x00_5aa0, 0xd5_5e00, 0x00_9e73, 0x78_286e, 0xe6_9f00, 0x10_1318, 0x56_b4e9, 0xcc_79a7];
/// Greys of baselines.
const GREYS: [u32; 2] = [0x3c_3f46, 0x8c_9098];
/// Strokes of variants, the first for the first eight.
const STROKES: [Stroke; 4] = [Stroke::FULL, Stroke::DASHED, Stroke::DASH_DOTTED, Stroke::DOTTED];
/// Strokes of baselines.
const DASHES: [Stroke; 3] = [Stroke::DASHED, Stroke::DOTTED, Stroke::DASH_DOTTED];
/// Colour of published values.
const GREY: Colour = Colour::hex(0x6e_727a);

/// Colours of four stages, from dark to light.
pub(crate) const SHADES: [u32; 4] = [0x12_3a6b, 0x3f_7fb8, 0x93_c0de, 0xe6_f0f7];

/// Approximate radius of a mark.
const RADIUS: f64 = 3.6;

/// Stroke of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stroke {
    /// Strokes and gaps of these lengths.
    Dashes(&'static [f64]),
    /// No stroke: the points enclose a shaded area.
    Area,
    /// No stroke: a dot at each point, as wide as the line.
    Dots,
    /// No stroke: only marks.
    None,
}

impl Stroke {
    /// Solid line.
    pub(crate) const FULL: Self = Self::Dashes(&[]);
    /// Dashed line.
    pub(crate) const DASHED: Self = Self::Dashes(&[6.0, 4.0]);
    /// Dotted line.
    pub(crate) const DOTTED: Self = Self::Dashes(&[1.6, 2.6]);
    /// Dash-dot line.
    pub(crate) const DASH_DOTTED: Self = Self::Dashes(&[8.0, 3.0, 1.6, 3.0]);
}

/// Shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Marker {
    /// Disc.
    Circle,
    /// Square.
    Square,
    /// Triangle pointing up.
    Triangle,
    /// Diamond.
    Diamond,
    /// Triangle pointing down.
    Wedge,
    /// Diagonal cross.
    Cross,
    /// Upright cross.
    Plus,
    /// Five-pointed star.
    Star,
}

impl Marker {
    /// All shapes.
    pub(crate) const ALL: [Self; 8] =
        [Self::Circle, Self::Square, Self::Triangle, Self::Diamond, Self::Wedge, Self::Plus, Self::Star, Self::Cross];

    /// Returns the corners around the centre, y downwards. The radii are about 1, so that all shapes look equally large.
    fn corners(self) -> Vec<(f64, f64)> {
        // Corners at equal angles from the first one; their radii alternate.
        let ring = |n: usize, first_deg: f64, radii: &[f64]| -> Vec<(f64, f64)> {
            let corner = |k: usize| {
                let (sin, cos) = (first_deg + 360.0 * k as f64 / n as f64).to_radians().sin_cos();
                let r = radii[k % radii.len()];
                (r * cos, -r * sin)
            };
            (0..n).map(corner).collect()
        };
        // The fourth corner of an arm is the first of the next.
        let arm = [(0.34, 0.34), (1.0, 0.34), (1.0, -0.34)];
        let turned = |arm: [(f64, f64); 3]| arm.map(|(x, y)| (y, -x));
        let plus: Vec<(f64, f64)> = [arm, turned(arm), turned(turned(arm)), turned(turned(turned(arm)))].concat();
        match self {
            Self::Circle => ring(24, 0.0, &[0.95]),
            Self::Square => ring(4, 45.0, &[1.2]),
            Self::Triangle => ring(3, 90.0, &[1.25]),
            Self::Diamond => ring(4, 90.0, &[1.25]),
            Self::Wedge => ring(3, 270.0, &[1.25]),
            Self::Star => ring(10, 90.0, &[1.35, 0.58]),
            Self::Plus => plus.iter().map(|(x, y)| (1.15 * x, 1.15 * y)).collect(),
            Self::Cross => plus.iter().map(|(x, y)| (0.8 * (x + y), 0.8 * (y - x))).collect(),
        }
    }
}

/// Style of a line and its marks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style {
    /// Colour of stroke and marks.
    pub(crate) colour: Colour,
    /// Width of the stroke.
    pub(crate) width: f64,
    /// Stroke of the line.
    pub(crate) stroke: Stroke,
    /// Shape of the marks.
    pub(crate) marker: Option<Marker>,
    /// Whether marks are hollow.
    pub(crate) hollow: bool,
}

impl Style {
    /// Returns the style of a line without marks.
    pub(crate) fn line(colour: Colour, width: f64, stroke: Stroke) -> Self {
        Self { colour, width, stroke, marker: None, hollow: false }
    }

    /// Returns the style of variant `k`: eight colours with eight markers, then the same dashed with
    /// hollow marks, and so on for each stroke.
    pub(crate) fn variant(k: usize) -> Self {
        Self {
            colour: Colour::hex(COLOURS[k % COLOURS.len()]),
            width: 2.0,
            stroke: STROKES[k / COLOURS.len() % STROKES.len()],
            marker: Some(Marker::ALL[k % Marker::ALL.len()]),
            hollow: k / COLOURS.len() % 2 == 1,
        }
    }

    /// Returns the style of the line that joins the variants of method `k`: colour and mark of variant `k`, with another dash
    /// pattern than neighbouring methods.
    pub(crate) fn method(k: usize) -> Self {
        Self { stroke: STROKES[(k + k / STROKES.len()) % STROKES.len()], ..Self::variant(k) }
    }

    /// Returns the style of predictions of another program, the `k`th of all lines: that of a variant without marks.
    pub(crate) fn external(k: usize) -> Self {
        Self { marker: None, ..Self::variant(k) }
    }

    /// Returns the style of baseline `k`.
    pub(crate) fn baseline(k: usize) -> Self {
        Self::line(Colour::hex(GREYS[k / DASHES.len() % GREYS.len()]), 1.0, DASHES[k % DASHES.len()])
    }

    /// Returns the style of published points: grey stars without a line.
    pub(crate) fn published(hollow: bool) -> Self {
        Self { marker: Some(Marker::Star), hollow, ..Self::line(GREY, 1.0, Stroke::None) }
    }

    /// Returns the style of a thin grey line, which joins variants without a name.
    pub(crate) fn thread() -> Self {
        Self::line(Colour::hex(0xaf_b3bb), 1.0, Stroke::FULL)
    }

    /// Draws the line through `points`, or the area within them.
    pub(crate) fn draw_line(&self, canvas: &mut Canvas, points: &[Point]) {
        match self.stroke {
            Stroke::None => {}
            Stroke::Dots => {
                let mut dots = VectorPath::default();
                points.iter().for_each(|at| dots.add_line(&[*at; 2]));
                canvas.path(dots, Paint { round: true, ..Paint::stroke(self.colour, self.width) });
            }
            Stroke::Area => canvas.polygon(points, Paint::fill(self.colour.with_opacity(0.2))),
            Stroke::Dashes(dash) => canvas.line(points, Paint { dash, ..Paint::stroke(self.colour, self.width) }),
        }
    }

    /// Draws the mark with its centre at `at`; nothing for a style without marks.
    pub(crate) fn draw_mark(&self, canvas: &mut Canvas, at: Point) {
        let Some(marker) = self.marker else { return };
        // Marks without a line show behind others.
        let radius = if self.stroke == Stroke::None { 1.5 * RADIUS } else { RADIUS };
        let corners: Vec<Point> =
            marker.corners().into_iter().map(|(x, y)| [at[0] + radius * x, at[1] + radius * y]).collect();
        let paint = if self.hollow {
            Paint::fill(WHITE).outlined(self.colour, 1.0)
        } else {
            Paint::fill(self.colour).outlined(WHITE, 0.5)
        };
        canvas.polygon(&corners, paint);
    }

    /// Draws a bar from `a` to `b` with a cap at each end.
    pub(crate) fn draw_bar(&self, canvas: &mut Canvas, [a, b]: [Point; 2]) {
        let [dx, dy] = if a[1] == b[1] { [0.0, 3.0] } else { [3.0, 0.0] };
        let mut bar = VectorPath::of(&[a, b]);
        for [x, y] in [a, b] {
            bar.add_line(&[[x - dx, y - dy], [x + dx, y + dy]]);
        }
        canvas.path(bar, Paint::stroke(self.colour, 1.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markers_are_centred_and_of_similar_size() {
        for marker in Marker::ALL {
            let corners = marker.corners();
            let twice: f64 = corners
                .iter()
                .zip(corners.iter().cycle().skip(1))
                .map(|(a, b)| a.0 * b.1 - a.1 * b.0)
                .sum::<f64>()
                .abs();
            assert!((2.4..6.4).contains(&twice), "{marker:?} has an area of {}", twice / 2.0);
            let reach = corners.iter().map(|c| c.0.hypot(c.1)).fold(0.0, f64::max);
            assert!((0.9..1.4).contains(&reach), "{marker:?} reaches {reach}");
        }
    }

    #[test]
    fn twelve_variants_differ_without_colour() {
        for style in [Style::variant, Style::method] {
            let shapes: Vec<_> = (0..12).map(style).map(|s| (s.marker, s.stroke, s.hollow)).collect();
            for (k, shape) in shapes.iter().enumerate() {
                assert!(!shapes[..k].contains(shape), "line {k}");
            }
        }
        assert!((1..12).all(|k| Style::method(k).stroke != Style::method(k - 1).stroke));
    }
}
