//! Flat maps in metres with equal scales: a floor plan, the side view of a room, or values over a plane as a coloured
//! map with colour bar, axes and receivers.

use super::axes::{few_ticks, linear_ticks, tick_label};
use crate::canvas::{
    Anchor, BLACK, Canvas, Colour, INK, LINE, Paint, Point, RasterImage, TEXT, VectorPath, WHITE, wrap_text,
};
use pwrfgs_core::colour::{Rgb, cyclic, sequential};
use pwrfgs_core::statistics::bounds;

/// Minimum ratio of the shorter to the longer side of a frame, so that a corridor stays visible.
const FLATTEST: f64 = 0.12;
/// Margins for names and numbers: left, top, right, bottom.
const MARGINS: [f64; 4] = [44.0, 8.0, 10.0, 36.0];
/// Largest coordinate that fits on an axis, metres; numbers on axes with larger ones are relative to a whole kilometre.
const MOST_M: f64 = 9_999.0;
/// Drawing units per tick of an axis.
const TICK: f64 = 34.0;
/// Minimum width of a map with title and note.
const LEAST_WIDTH: f64 = 300.0;
/// Size of the mark of a receiver.
const RECEIVER: f64 = 5.4;

/// Mapping of metres to positions on the drawing.
#[derive(Clone, Debug)]
pub(crate) struct FloorPlan {
    low: Point,
    high: Point,
    /// Names of the axes, such as x and y.
    names: [&'static str; 2],
    /// Drawing units per metre.
    scale: f64,
    /// Width and height of the drawing.
    pub(crate) size: Point,
}

impl FloorPlan {
    /// Creates the mapping for the area between two corners, in metres, on a drawing at most `width` wide with a map
    /// at most `most_height` high; `names` are those of the axes. A flat area is widened.
    pub(crate) fn new([low, high]: [Point; 2], names: [&'static str; 2], width: f64, most_height: f64) -> Self {
        let [low, high] = with_extent(low, high);
        let [left, top, right, bottom] = MARGINS;
        let [across, up] = [high[0] - low[0], high[1] - low[1]];
        let scale = ((width - left - right) / across).min(most_height / up);
        Self { low, high, names, scale, size: [left + scale * across + right, top + scale * up + bottom] }
    }

    /// Returns the low and high corner, metres, of the smallest frame with a margin around the finite `points`; a square
    /// metre if there are none.
    pub(crate) fn frame(points: impl IntoIterator<Item = Point>) -> [Point; 2] {
        let is_finite = |point: &Point| point.iter().all(|v| v.is_finite());
        let points: Vec<Point> = points.into_iter().filter(is_finite).collect();
        if points.is_empty() {
            return [[-0.5; 2], [0.5; 2]];
        }
        let [x, y] = [0, 1].map(|k| bounds(points.iter().map(|point| point[k])));
        let margin = 0.04 * (x.1 - x.0).max(y.1 - y.0).max(0.5); // 4 % of the longer side, 2 cm at least
        [[x.0 - margin, y.0 - margin], [x.1 + margin, y.1 + margin]]
    }

    /// Returns the position of a point in metres on the drawing.
    pub(crate) fn project(&self, [x, y]: Point) -> Point {
        let [left, top, ..] = MARGINS;
        [left + self.scale * (x - self.low[0]), top + self.scale * (self.high[1] - y)]
    }

    /// Returns whether a point is on the map.
    pub(crate) fn contains(&self, point: Point) -> bool {
        (0..2).all(|k| (self.low[k]..=self.high[k]).contains(&point[k]))
    }

    /// Returns the upper left corner of the map on the drawing, and its width and height.
    pub(crate) fn map_area(&self) -> (Point, Point) {
        let [a, b] = [self.project([self.low[0], self.high[1]]), self.project([self.high[0], self.low[1]])];
        (a, [b[0] - a[0], b[1] - a[1]])
    }

    /// Creates an empty map.
    pub(crate) fn empty_map(&self) -> Canvas {
        let mut canvas = Canvas::new(self.size[0], self.size[1]);
        canvas.letters.size = SMALL;
        let (at, size) = self.map_area();
        canvas.rect(at, size, Paint::fill(Colour::hex(0xfa_fbfc)));
        canvas
    }

    /// Draws the frame with numbers in metres on top of the map. Map coordinates, which are too long for an
    /// axis, are relative to a round number in the name of the axis.
    pub(crate) fn draw_axes(&self, canvas: &mut Canvas) {
        let (at, size) = self.map_area();
        canvas.rect(at, size, Paint::stroke(INK, 0.7));
        let [left, bottom] = [at[0], at[1] + size[1]];
        let [(x_ticks, x_title), (y_ticks, y_title)] = [0, 1].map(|k| self.ticks_and_title(k));
        for (value, words) in &x_ticks {
            let [px, _] = self.project([*value, self.low[1]]);
            canvas.line(&[[px, bottom], [px, bottom + 3.0]], Paint::stroke(INK, 0.7));
            canvas.text([px, bottom + LINE], Anchor::Middle, words);
        }
        for (value, words) in &y_ticks {
            let [_, py] = self.project([self.low[0], *value]);
            canvas.line(&[[left - 3.0, py], [left, py]], Paint::stroke(INK, 0.7));
            canvas.text([left - 5.0, py + 3.5], Anchor::End, words);
        }
        canvas.text([left + size[0] / 2.0, bottom + 2.0 * LINE + 1.0], Anchor::Middle, x_title);
        canvas.upright_text([12.0, at[1] + size[1] / 2.0], y_title);
    }

    /// Returns the ticks of an axis, as metres and labels, and its title.
    fn ticks_and_title(&self, axis: usize) -> (Vec<(f64, String)>, String) {
        let (low, high, name) = (self.low[axis], self.high[axis], self.names[axis]);
        let is_far = low.abs().max(high.abs()) > MOST_M;
        // The middle of the axis, in whole kilometres.
        let start = if is_far { ((low + high) / 2e3).round() * 1e3 } else { 0.0 };
        let tick_count = (((high - low) * self.scale / TICK) as usize).max(2);
        let ticks =
            few_ticks(low - start, high - start, tick_count).into_iter().map(|v| (v + start, tick_label(v))).collect();
        (ticks, if is_far { format!("{name} − {start} [m]") } else { format!("{name} [m]") })
    }

    /// Creates a floor plan around `points`, as large as a map.
    pub(crate) fn around(points: impl IntoIterator<Item = Point>) -> Self {
        Self::of_floor(Self::frame(points))
    }

    /// Creates a floor plan between two corners, metres, as large as a map.
    pub(crate) fn of_floor(corners: [Point; 2]) -> Self {
        Self::new(corners, ["x", "y"], WIDTH, MOST_HEIGHT)
    }

    /// Adds axes, a title above the map and a note below it, wrapped to its width.
    pub(crate) fn with_title(&self, mut map: Canvas, title: &str, note: &str) -> Canvas {
        self.draw_axes(&mut map);
        let width = self.size[0].max(LEAST_WIDTH);
        let note = wrap_text(note, width * TEXT / SMALL);
        let mut canvas = Canvas::new(width, HEAD + self.size[1] + LINE * (note.len() as f64 + 0.5));
        canvas.text([width / 2.0, 15.0], Anchor::Middle, title);
        canvas.add_drawing([(width - self.size[0]) / 2.0, HEAD], 1.0, &map);
        canvas.letters.size = SMALL;
        for (k, line) in note.iter().enumerate() {
            canvas.text([width / 2.0, HEAD + self.size[1] + LINE * (k as f64 + 0.8)], Anchor::Middle, line);
        }
        canvas
    }

    /// Writes the numbers from 1 beside `points`, to the right and up by these drawing units, with a white rim.
    pub(crate) fn draw_numbers(&self, canvas: &mut Canvas, points: &[Point], size: f64, [right, up]: Point) {
        let letters = canvas.letters;
        canvas.letters.size = size;
        for (k, point) in points.iter().enumerate() {
            let ([x, y], words) = (self.project(*point), (k + 1).to_string());
            for (colour, shift) in [(WHITE, 0.8), (WHITE, -0.8), (INK, 0.0)] {
                canvas.letters.colour = colour;
                canvas.text([x + right + shift, y - up + shift], Anchor::Start, &words);
            }
        }
        canvas.letters = letters;
    }

    /// Centres the drawing in a given width, so that a page scales maps of any shape equally.
    pub(crate) fn centred_in(canvas: &Canvas, width: f64) -> Canvas {
        let mut wide = Canvas::new(width.max(canvas.width), canvas.height);
        wide.add_drawing([(wide.width - canvas.width) / 2.0, 0.0], 1.0, canvas);
        wide
    }

    /// Draws a receiver, a square with a dot, if it is on the map.
    pub(crate) fn draw_receiver(&self, canvas: &mut Canvas, position: Point) {
        if self.contains(position) {
            draw_receiver(canvas, self.project(position));
        }
    }

    /// Draws the points that are on the map as faint dots.
    pub(crate) fn draw_points(&self, canvas: &mut Canvas, points: impl IntoIterator<Item = Point>) {
        let mut path = VectorPath::default();
        points.into_iter().filter(|p| self.contains(*p)).for_each(|p| path.add_line(&[self.project(p); 2]));
        canvas.path(path, Paint { round: true, ..Paint::stroke(Colour::hex(0x8d_94a1).with_opacity(0.6), 1.5) });
    }
}

/// Draws the mark of a receiver.
pub(crate) fn draw_receiver(canvas: &mut Canvas, [x, y]: Point) {
    let r = RECEIVER;
    canvas.rect([x - r, y - r], [2.0 * r; 2], Paint::fill(WHITE).outlined(BLACK, 1.6));
    canvas.circle([x, y], 2.0, Paint::fill(BLACK));
}

/// Widens the frame between two corners so that its shorter side is at least [`FLATTEST`] of the longer one; a point becomes a
/// square metre.
fn with_extent(mut low: Point, mut high: Point) -> [Point; 2] {
    let longest = (high[0] - low[0]).max(high[1] - low[1]);
    let least = if longest > 0.0 { FLATTEST * longest } else { 1.0 };
    for k in 0..2 {
        let missing = (least - (high[k] - low[k])).max(0.0) / 2.0;
        (low[k], high[k]) = (low[k] - missing, high[k] + missing);
    }
    [low, high]
}

/// Width of the drawing and maximum height of the map.
const WIDTH: f64 = 470.0;
const MOST_HEIGHT: f64 = 420.0;
/// Heights for the title above and the colour bar below the map.
const HEAD: f64 = 22.0;
const FOOT: f64 = 44.0;
/// Size of the letters on and below the map.
const SMALL: f64 = 10.0;
/// Colour of values that are not finite.
const NOTHING: Rgb = [0xe3, 0xe5, 0xe9];
/// Drawing units between two arrows.
const ARROWS: f64 = 26.0;
/// Horizontal distance between two hatch lines.
const HATCH: f64 = 8.0;

/// Colour map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Palette {
    /// From dark (smallest) to light (largest).
    Sequential,
    /// Cyclic, for angles in degrees.
    Cyclic,
}

/// Values over a plane.
#[derive(Clone, Debug)]
pub struct Heatmap<'a> {
    /// Title above the map.
    pub title: String,
    /// Unit below the colour bar.
    pub unit: String,
    /// Names of the axes, horizontal first.
    pub names: [&'static str; 2],
    /// Position of the first value, metres.
    pub first: Point,
    /// Grid spacing, metres.
    pub step: f64,
    /// Number of columns.
    pub columns: usize,
    /// Values, row by row, lowest row first; NaN if unknown.
    pub values: &'a [f32],
    /// Colour map.
    pub colours: Palette,
    /// Positions of receivers.
    pub receivers: Vec<Point>,
    /// Vector per value, some of which are drawn as arrows; empty for none.
    pub arrows: &'a [[f32; 2]],
    /// Training positions; `None` if unknown.
    pub training: Option<&'a TrainingMap>,
}

/// Training positions of a map.
#[derive(Clone, Debug)]
pub struct TrainingMap {
    /// Whether each value is an extrapolation.
    pub is_beyond: Vec<bool>,
    /// Distance beyond which values are extrapolations, metres.
    pub limit: f64,
    /// Training positions near the plane.
    pub positions: Vec<Point>,
}

impl Heatmap<'_> {
    /// Draws the map with axes, receivers and colour bar, and explains training positions if there are any.
    pub fn draw(&self) -> Canvas {
        let rows = self.values.len() / self.columns.max(1);
        let half = self.step / 2.0;
        let end = |k: usize, count: usize| self.first[k] + self.step * (count.max(1) as f64 - 0.5);
        let corners = [self.first.map(|v| v - half), [end(0, self.columns), end(1, rows)]];
        let plan = FloorPlan::new(corners, self.names, WIDTH, MOST_HEIGHT);
        let mut map = plan.empty_map();
        let [a, b] = [plan.project([corners[0][0], corners[1][1]]), plan.project([corners[1][0], corners[0][1]])];
        let (low, high) = self.colour_range();
        map.pixels(a, [b[0] - a[0], b[1] - a[1]], self.to_raster_image(rows, low, high));
        self.draw_training(&mut map, &plan);
        self.draw_arrows(&mut map, &plan);
        self.receivers.iter().for_each(|at| plan.draw_receiver(&mut map, *at));
        plan.draw_axes(&mut map);
        let width = plan.size[0].max(LEAST_WIDTH);
        let note = self.training_note(width);
        let mut canvas = Canvas::new(width, HEAD + plan.size[1] + FOOT + LINE * note.len() as f64);
        canvas.text([width / 2.0, 15.0], Anchor::Middle, &self.title);
        canvas.add_drawing([(width - plan.size[0]) / 2.0, HEAD], 1.0, &map);
        self.draw_colour_bar(&mut canvas, HEAD + plan.size[1] + 4.0, (low, high));
        canvas.letters.size = SMALL;
        for (k, line) in note.iter().enumerate() {
            let y = HEAD + plan.size[1] + 40.0 + LINE * (k + 1) as f64;
            canvas.text([width / 2.0, y], Anchor::Middle, line);
        }
        canvas
    }

    /// Returns the lines that explain circles and hatching, at most `width` wide; none without training positions.
    fn training_note(&self, width: f64) -> Vec<String> {
        let Some(TrainingMap { limit, .. }) = self.training else { return Vec::new() };
        let note = format!("circles: training positions; hatched: farther than {limit:.2} m from all of them");
        wrap_text(&note, width * TEXT / SMALL)
    }

    /// Returns the values of the first and last colour: the finite range of values, widened if they are almost equal; 0 to 1
    /// without finite values; 0 to 360 degrees for angles.
    fn colour_range(&self) -> (f64, f64) {
        if self.colours == Palette::Cyclic {
            return (0.0, 360.0);
        }
        let finite = self.values.iter().copied().filter(|v| v.is_finite()).map(f64::from);
        let (low, high) = bounds(finite);
        match high - low {
            gap if gap > 1e-6 * high.abs().max(1e-9) => (low, high),
            _ if low.is_finite() => (low - 0.5, low + 0.5),
            _ => (0.0, 1.0),
        }
    }

    /// Returns the colour of a value between `low` and `high`, which angles ignore; [`NOTHING`] if it is not finite.
    fn colour(&self, value: f64, (low, high): (f64, f64)) -> Rgb {
        match self.colours {
            _ if !value.is_finite() => NOTHING,
            Palette::Sequential => sequential((value - low) / (high - low)),
            Palette::Cyclic => cyclic(value / 360.0),
        }
    }

    /// Returns the values as an image, highest row first.
    fn to_raster_image(&self, rows: usize, low: f64, high: f64) -> RasterImage {
        let upwards = (0..rows).rev().flat_map(|row| &self.values[row * self.columns..][..self.columns]);
        let rgba = upwards.map(|v| self.colour(f64::from(*v), (low, high))).flat_map(|[r, g, b]| [r, g, b, 255]);
        RasterImage { width: self.columns, height: rows, rgba: rgba.collect(), smooth: false }
    }

    /// Hatches extrapolations and marks training positions.
    fn draw_training(&self, canvas: &mut Canvas, plan: &FloorPlan) {
        let Some(TrainingMap { is_beyond: beyond, positions, .. }) = self.training else { return };
        let (cell, rows) = (self.step * plan.scale, beyond.len() / self.columns.max(1));
        let [left, bottom] = plan.project(self.first.map(|v| v - self.step / 2.0));
        let [width, height] = [self.columns, rows].map(|count| count as f64 * cell);
        // `x` and `y` are drawing units from the lower left corner.
        let is_beyond = |[x, y]: Point| {
            let [column, row] = [x, y].map(|v| (v / cell) as usize);
            x >= 0.0 && column < self.columns && row < rows && beyond[row * self.columns + column]
        };
        let mut lines = VectorPath::default();
        for k in 0..((width + height) / HATCH) as usize {
            // Points one unit apart along each axis; hatch lines join neighbours that are both extrapolations.
            let diagonal: Vec<Point> =
                (0..=height as usize).map(|y| [HATCH * k as f64 - height + y as f64, y as f64]).collect();
            let parts = diagonal.chunk_by(|a, b| is_beyond(*a) == is_beyond(*b)).filter(|part| is_beyond(part[0]));
            parts
                .for_each(|part| lines.add_line(&[part[0], part[part.len() - 1]].map(|[x, y]| [left + x, bottom - y])));
        }
        canvas.path(lines.clone(), Paint::stroke(WHITE.with_opacity(0.7), 2.2));
        canvas.path(lines, Paint::stroke(INK, 0.7));
        for position in positions.iter().filter(|position| plan.contains(**position)) {
            canvas.circle(plan.project(*position), 1.2, Paint::fill(WHITE).outlined(BLACK, 0.5));
        }
    }

    /// Draws some of the vectors as arrows, about [`ARROWS`] units apart. An arrow grows with its vector up to length
    /// 1; short vectors have a quarter of that, and those below 0.001 no arrow.
    fn draw_arrows(&self, canvas: &mut Canvas, plan: &FloorPlan) {
        if self.arrows.len() != self.values.len() {
            return;
        }
        let [o, x] = [self.first, [self.first[0] + self.step, self.first[1]]].map(|p| plan.project(p));
        let stride = (ARROWS / (x[0] - o[0]).max(1e-9)).ceil().max(1.0) as usize;
        let (mut lines, rows) = (VectorPath::default(), self.values.len() / self.columns);
        for row in (stride / 2..rows).step_by(stride) {
            for column in (stride / 2..self.columns).step_by(stride) {
                let [u, v] = self.arrows[row * self.columns + column].map(f64::from);
                let length = u.hypot(v);
                if !(length.is_finite() && length > 1e-3) {
                    continue;
                }
                let far = [column, row].map(|k| self.step * k as f64);
                let centre = plan.project([self.first[0] + far[0], self.first[1] + far[1]]);
                // The longest arrow is 0.72 of [`ARROWS`] long, so that arrows do not touch.
                let half = [u / length, -v / length].map(|part| part * 0.36 * ARROWS * length.clamp(0.25, 1.0));
                lines.add_arrow(centre, half);
            }
        }
        canvas.path(lines.clone(), Paint::stroke(WHITE.with_opacity(0.75), 2.6));
        canvas.path(lines, Paint::stroke(BLACK, 1.0));
    }

    /// Draws the colour bar with numbers and unit below `top`.
    fn draw_colour_bar(&self, canvas: &mut Canvas, top: f64, (low, high): (f64, f64)) {
        let width = (0.7 * canvas.width).min(300.0);
        let left = (canvas.width - width) / 2.0;
        let value = |k: i32| low + (high - low) * f64::from(k) / 255.0;
        let rgba = (0..256).map(|k| self.colour(value(k), (low, high))).flat_map(|[r, g, b]| [r, g, b, 255]).collect();
        canvas.framed_pixels([left, top], [width, 9.0], RasterImage { width: 256, height: 1, rgba, smooth: false });
        let numbers = match self.colours {
            Palette::Cyclic => vec![0.0, 90.0, 180.0, 270.0, 360.0],
            Palette::Sequential => linear_ticks(low, high),
        };
        canvas.letters.size = SMALL;
        for v in numbers.into_iter().filter(|v| (low..=high).contains(v)) {
            let x = left + width * (v - low) / (high - low);
            canvas.line(&[[x, top + 9.0], [x, top + 12.0]], Paint::stroke(INK, 0.8));
            canvas.text([x, top + 22.0], Anchor::Middle, tick_label(v));
        }
        canvas.text([canvas.width / 2.0, top + 36.0], Anchor::Middle, &self.unit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canvas::outside;

    #[test]
    fn floor_plan_has_equal_scale_on_both_axes() {
        let plan = FloorPlan::new([[0.0, 0.0], [8.0, 4.0]], ["x", "y"], 300.0, 400.0);
        let [o, x, y] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|p| plan.project(p));
        assert!((x[0] - o[0] - (o[1] - y[1])).abs() < 1e-9);
        assert!(plan.contains([8.0, 4.0]) && !plan.contains([8.1, 4.0]));
        let mut canvas = plan.empty_map();
        plan.draw_receiver(&mut canvas, [1.0, 1.0]);
        plan.draw_axes(&mut canvas);
        let svg = canvas.svg("map", "");
        assert!(svg.contains("x [m]") && svg.contains("y [m]") && svg.contains(">2<"), "{svg}");
    }

    #[test]
    fn draws_empty_and_flat_plans_and_map_coordinates() {
        let far = [[5_399_990.0, 1.0], [5_399_998.0, 1.0], [f64::NAN, f64::INFINITY]];
        for (points, title) in [(vec![], "x [m]"), (vec![[1.0, 2.0]], "x [m]"), (far.to_vec(), "x − 5400000 [m]")] {
            let plan = FloorPlan::new(FloorPlan::frame(points), ["x", "y"], 200.0, 200.0);
            let mut canvas = plan.empty_map();
            plan.draw_axes(&mut canvas);
            let svg = canvas.svg("map", "");
            assert!(svg.contains(title) && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }

    #[test]
    fn draws_heatmaps_of_constant_and_non_finite_values() {
        let flat = [3.0; 6];
        let broken = [f32::NAN, f32::INFINITY, -60.0, -61.0, -70.0, f32::NEG_INFINITY];
        let none = [f32::NAN; 6];
        for values in [&flat, &broken, &none] {
            for colours in [Palette::Sequential, Palette::Cyclic] {
                let heat = Heatmap {
                    title: "received power".into(),
                    unit: "dBm".into(),
                    names: ["x", "y"],
                    first: [0.0, 1.0],
                    step: 0.5,
                    columns: 3,
                    values,
                    colours,
                    receivers: vec![[0.5, 1.0], [99.0, 0.0]],
                    arrows: &[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [f32::NAN, 1.0], [0.5, 0.5], [-1.0, 0.0]],
                    training: None,
                };
                let svg = heat.draw().svg("map", "");
                assert!(svg.contains("dBm") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
                let marked = |limit| {
                    let is_beyond = [0.0, 0.5, 1.0, 1.5, 2.0, 2.5].map(|metres| metres > limit).to_vec();
                    let training = TrainingMap { is_beyond, limit, positions: vec![[0.5, 1.0], [99.0, 0.0]] };
                    let svg = Heatmap { training: Some(&training), ..heat.clone() }.draw().svg("map", "");
                    assert_eq!(outside::take().1, Vec::<String>::new(), "text leaves a narrow map");
                    svg
                };
                let [few, none] = [marked(1.0), marked(9.0)];
                assert!(
                    few.contains("farther than")
                        && few.contains("1.00 m")
                        && few.matches("<circle").count() > svg.matches("<circle").count()
                );
                assert!(few.len() > none.len() + 100, "hatch lines");
            }
        }
    }
}
