//! How a line looks: colour, stroke and marker, each enough to tell it from others, so that greyscale does.

use plotters::coord::Shift;
use plotters::prelude::*;

/// A place on the picture, SVG units.
pub(crate) type Pixel = (i32, i32);
/// The picture.
pub(crate) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Outcome of drawing.
pub(crate) type Drawn = Result<(), Box<dyn std::error::Error>>;

/// How a line is stroked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Stroke {
    /// Without gaps.
    #[default]
    Full,
    /// Dashes.
    Dashed,
    /// Dots.
    Dotted,
    /// Dashes and dots in turn.
    DashDotted,
    /// Not at all: its points enclose a shaded area.
    Area,
    /// Not at all: only marks are drawn.
    None,
}

impl Stroke {
    /// Lengths of strokes and gaps in turn; nothing for a full line.
    fn pattern(self) -> &'static [f64] {
        match self {
            Self::Dashed => &[6.0, 4.0],
            Self::Dotted => &[1.6, 2.6],
            Self::DashDotted => &[8.0, 3.0, 1.6, 3.0],
            Self::Full | Self::Area | Self::None => &[],
        }
    }
}

/// The shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // shapes by name
pub(crate) enum Marker {
    Circle,
    Square,
    Triangle,
    Diamond,
    Wedge,
    Cross,
    Plus,
    Star,
}

impl Marker {
    /// All of them.
    pub(crate) const ALL: [Self; 8] =
        [Self::Circle, Self::Square, Self::Triangle, Self::Diamond, Self::Wedge, Self::Plus, Self::Star, Self::Cross];

    /// Corners about the middle, radius about 1, y downwards.
    fn corners(self) -> Vec<(f64, f64)> {
        let ring = |n: usize, first_deg: f64, radii: &[f64]| -> Vec<(f64, f64)> {
            let corner = |k: usize| {
                let (sin, cos) = (first_deg + 360.0 * k as f64 / n as f64).to_radians().sin_cos();
                let r = radii[k % radii.len()];
                (r * cos, -r * sin)
            };
            (0..n).map(corner).collect()
        };
        let arms = [(0.34, 0.34), (1.0, 0.34), (1.0, -0.34), (0.34, -0.34)];
        let plus: Vec<(f64, f64)> = (0..4)
            .flat_map(|turn| {
                let turned = move |(x, y): (f64, f64)| (0..turn).fold((x, y), |(x, y), _| (y, -x));
                arms[..3].iter().map(move |&p| turned(p))
            })
            .collect();
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

/// How a line and its marks look.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Style {
    /// Colour.
    pub(crate) colour: RGBColor,
    /// Width of the stroke.
    pub(crate) width: u32,
    /// Its pattern.
    pub(crate) stroke: Stroke,
    /// Shape of its marks.
    pub(crate) marker: Option<Marker>,
    /// Whether marks are empty.
    pub(crate) hollow: bool,
}

impl Style {
    /// A line without marks.
    pub(crate) fn line(colour: RGBColor, width: u32, stroke: Stroke) -> Self {
        Self { colour, width, stroke, marker: None, hollow: false }
    }

    /// Draws the line through `points`, or the area within them; one unit of width is `unit` SVG units.
    pub(crate) fn draw_line(&self, root: &Area<'_>, points: &[Pixel], unit: u32) -> Drawn {
        let stroke = self.colour.stroke_width(self.width * unit);
        match self.stroke {
            Stroke::None => {}
            Stroke::Area => root.draw(&Polygon::new(points.to_vec(), self.colour.mix(0.2).filled()))?,
            Stroke::Full => root.draw(&PathElement::new(points.to_vec(), stroke))?,
            dashed => {
                let pattern: Vec<f64> = dashed.pattern().iter().map(|length| length * f64::from(unit)).collect();
                for dash in dashes(points, &pattern) {
                    root.draw(&PathElement::new(dash, stroke))?;
                }
            }
        }
        Ok(())
    }

    /// Draws a mark at `at`.
    pub(crate) fn draw_mark(&self, root: &Area<'_>, at: Pixel, unit: u32) -> Drawn {
        let Some(marker) = self.marker else { return Ok(()) };
        let radius = 3.6 * f64::from(unit);
        let corner = |(x, y): (f64, f64)| (at.0 + (radius * x).round() as i32, at.1 + (radius * y).round() as i32);
        let mut corners: Vec<Pixel> = marker.corners().into_iter().map(corner).collect();
        let (inside, outline) = if self.hollow { (WHITE, self.colour) } else { (self.colour, WHITE) };
        root.draw(&Polygon::new(corners.clone(), inside.filled()))?;
        corners.extend_from_within(..2); // closed, and its first corner as sharp as the others
        root.draw(&PathElement::new(corners, outline.stroke_width(if self.hollow { unit } else { unit / 2 })))?;
        Ok(())
    }

    /// Draws a bar from `a` to `b` with a cap at each end.
    pub(crate) fn draw_bar(&self, root: &Area<'_>, [a, b]: [Pixel; 2], unit: u32) -> Drawn {
        let cap = 3 * unit as i32;
        let (dx, dy) = if a.1 == b.1 { (0, cap) } else { (cap, 0) };
        let stroke = self.colour.stroke_width(unit);
        root.draw(&PathElement::new(vec![a, b], stroke))?;
        for end in [a, b] {
            root.draw(&PathElement::new(vec![(end.0 - dx, end.1 - dy), (end.0 + dx, end.1 + dy)], stroke))?;
        }
        Ok(())
    }
}

/// The pieces of a line that `pattern` (stroke, gap, stroke, ..) leaves.
fn dashes(points: &[Pixel], pattern: &[f64]) -> Vec<Vec<Pixel>> {
    let mut pieces: Vec<Vec<Pixel>> = Vec::new();
    let (mut k, mut left) = (0, pattern[0]);
    let mut piece: Vec<Pixel> = points.first().copied().into_iter().collect();
    for (&a, &b) in points.iter().zip(points.iter().skip(1)) {
        let length = f64::from(b.0 - a.0).hypot(f64::from(b.1 - a.1));
        let at = |d: f64| {
            let along = |a: i32, b: i32| a + (f64::from(b - a) * d / length).round() as i32;
            (along(a.0, b.0), along(a.1, b.1))
        };
        let mut gone = 0.0;
        while length - gone > left {
            gone += left;
            if k % 2 == 0 {
                piece.push(at(gone));
                pieces.push(std::mem::take(&mut piece));
            } else {
                piece = vec![at(gone)];
            }
            k += 1;
            left = pattern[k % pattern.len()];
        }
        left -= length - gone;
        if k % 2 == 0 {
            piece.push(b);
        }
    }
    if piece.len() > 1 {
        pieces.push(piece);
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_go_round_corners() {
        let pieces = dashes(&[(0, 0), (10, 0), (10, 10)], &[6.0, 2.0]);
        assert_eq!(pieces, [vec![(0, 0), (6, 0)], vec![(8, 0), (10, 0), (10, 4)], vec![(10, 6), (10, 10)]]);
        assert!(dashes(&[], &[6.0, 2.0]).is_empty());
        assert!(dashes(&[(3, 3), (3, 3)], &[6.0, 2.0]).len() <= 1);
    }

    #[test]
    fn markers_are_about_the_middle_and_of_like_size() {
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
}
