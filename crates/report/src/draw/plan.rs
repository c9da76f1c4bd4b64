//! A flat map in metres: a floor plan, the side of a room, a plane. A metre is as long across as upwards.

use super::ticks::{label, linear_ticks};
use crate::canvas::font::LINE;
use crate::canvas::{Anchor, BLACK, Canvas, Colour, INK, Paint, Path, Point, WHITE};

/// The shorter side of a frame has at least this share of the longer one: a corridor stays visible.
const FLATTEST: f64 = 0.12;
/// Room for names and numbers: left, top, right, bottom.
const MARGINS: [f64; 4] = [44.0, 8.0, 10.0, 36.0];
/// Of a receiver.
const RECEIVER: f64 = 5.4;

/// Where places lie on the picture.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    low: Point,
    high: Point,
    /// Names of the axes, such as x and y.
    names: [&'static str; 2],
    /// Units of the picture a metre.
    scale: f64,
    /// Width and height of the whole picture.
    pub(crate) size: Point,
}

impl Plan {
    /// Of what lies between two corners, in metres, within a picture so wide and a map so high at most.
    pub(crate) fn new([low, high]: [Point; 2], names: [&'static str; 2], width: f64, most_height: f64) -> Self {
        let [low, high] = no_line(low, high);
        let [left, top, right, bottom] = MARGINS;
        let [across, up] = [high[0] - low[0], high[1] - low[1]];
        let scale = ((width - left - right) / across).min(most_height / up);
        Self { low, high, names, scale, size: [left + scale * across + right, top + scale * up + bottom] }
    }

    /// The smallest frame with some air around `places`; of nothing a square metre.
    pub(crate) fn corners(places: impl IntoIterator<Item = Point>) -> [Point; 2] {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for place in places.into_iter().filter(|place| place.iter().all(|v| v.is_finite())) {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(place[k]), high[k].max(place[k]));
            }
        }
        if low[0] > high[0] {
            return [[-0.5; 2], [0.5; 2]];
        }
        let air = 0.04 * (high[0] - low[0]).max(high[1] - low[1]).max(0.5);
        [low.map(|v| v - air), high.map(|v| v + air)]
    }

    /// Where a place lies on the picture.
    pub(crate) fn place(&self, [x, y]: Point) -> Point {
        let [left, top, ..] = MARGINS;
        [left + self.scale * (x - self.low[0]), top + self.scale * (self.high[1] - y)]
    }

    /// Whether a place is on the map.
    pub(crate) fn holds(&self, place: Point) -> bool {
        (0..2).all(|k| (self.low[k]..=self.high[k]).contains(&place[k]))
    }

    /// Corner, width and height of the map on the picture.
    pub(crate) fn area(&self) -> (Point, Point) {
        let [a, b] = [self.place([self.low[0], self.high[1]]), self.place([self.high[0], self.low[1]])];
        (a, [b[0] - a[0], b[1] - a[1]])
    }

    /// An empty map.
    pub(crate) fn canvas(&self) -> Canvas {
        let mut canvas = Canvas::new(self.size[0], self.size[1]);
        canvas.letters.size = 10.0;
        let (at, size) = self.area();
        canvas.rect(at, size, Paint::fill(Colour::hex(0xfa_fbfc)));
        canvas
    }

    /// The frame with numbers in metres, drawn last: it lies on what is mapped. Map coordinates, which are too long for an
    /// axis, count from a round number that its name says.
    pub(crate) fn axes(&self, canvas: &mut Canvas) {
        let (at, size) = self.area();
        canvas.rect(at, size, Paint::stroke(INK, 0.7));
        let [left, bottom] = [at[0], at[1] + size[1]];
        let [x, y] = [0, 1].map(|k| Marked::new(self.low[k], self.high[k], self.scale, self.names[k]));
        for (value, words) in &x.ticks {
            let [px, _] = self.place([*value, self.low[1]]);
            canvas.line(&[[px, bottom], [px, bottom + 3.0]], Paint::stroke(INK, 0.7));
            canvas.text([px, bottom + LINE], Anchor::Middle, words);
        }
        for (value, words) in &y.ticks {
            let [_, py] = self.place([self.low[0], *value]);
            canvas.line(&[[left - 3.0, py], [left, py]], Paint::stroke(INK, 0.7));
            canvas.text([left - 5.0, py + 3.5], Anchor::End, words);
        }
        canvas.text([left + size[0] / 2.0, bottom + 2.0 * LINE + 1.0], Anchor::Middle, x.title);
        canvas.upright([12.0, at[1] + size[1] / 2.0], y.title);
    }

    /// The picture in the middle of one so wide: a page then scales maps of any shape alike.
    pub(crate) fn widened(canvas: &Canvas, width: f64) -> Canvas {
        let mut wide = Canvas::new(width.max(canvas.width), canvas.height);
        wide.put([(wide.width - canvas.width) / 2.0, 0.0], 1.0, canvas);
        wide
    }

    /// A receiver: a square with a dot, told from all round marks.
    pub(crate) fn receiver(&self, canvas: &mut Canvas, place: Point) {
        if self.holds(place) {
            draw_receiver(canvas, self.place(place));
        }
    }

    /// Surface points, faint.
    pub(crate) fn points(&self, canvas: &mut Canvas, points: impl IntoIterator<Item = Point>) {
        let mut path = Path::default();
        points.into_iter().filter(|p| self.holds(*p)).for_each(|p| path.add(&[self.place(p); 2]));
        canvas.path(path, Paint { round: true, ..Paint::stroke(Colour::hex(0x8d_94a1).faint(0.6), 1.5) });
    }
}

/// The mark of a receiver.
pub(crate) fn draw_receiver(canvas: &mut Canvas, [x, y]: Point) {
    let r = RECEIVER;
    canvas.rect([x - r, y - r], [2.0 * r; 2], Paint::fill(WHITE).outlined(BLACK, 1.6));
    canvas.circle([x, y], 2.0, Paint::fill(BLACK));
}

/// Corners that are apart along both axes.
fn no_line(mut low: Point, mut high: Point) -> [Point; 2] {
    let longest = (high[0] - low[0]).max(high[1] - low[1]);
    let least = if longest > 0.0 { FLATTEST * longest } else { 1.0 };
    for k in 0..2 {
        let missing = (least - (high[k] - low[k])).max(0.0) / 2.0;
        (low[k], high[k]) = (low[k] - missing, high[k] + missing);
    }
    [low, high]
}

/// Numbers along an axis and its title.
struct Marked {
    ticks: Vec<(f64, String)>,
    title: String,
}

impl Marked {
    fn new(low: f64, high: f64, scale: f64, name: &str) -> Self {
        let far = low.abs().max(high.abs()) > 9_999.0;
        let from = if far { ((low + high) / 2e3).round() * 1e3 } else { 0.0 };
        let ticks = linear_ticks(low - from, high - from);
        let wanted = (((high - low) * scale / 34.0) as usize).max(2);
        let stride = ticks.len().div_ceil(wanted).max(1);
        let inside = ticks.into_iter().filter(|v| (low - from..=high - from).contains(v));
        let ticks = inside.step_by(stride).map(|v| (v + from, label(v))).collect();
        let title = if far { format!("{name} − {from} [m]") } else { format!("{name} [m]") };
        Self { ticks, title }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_metre_is_as_long_across_as_upwards() {
        let plan = Plan::new([[0.0, 0.0], [8.0, 4.0]], ["x", "y"], 300.0, 400.0);
        let [o, x, y] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|p| plan.place(p));
        assert!((x[0] - o[0] - (o[1] - y[1])).abs() < 1e-9);
        assert!(plan.holds([8.0, 4.0]) && !plan.holds([8.1, 4.0]));
        let mut canvas = plan.canvas();
        plan.receiver(&mut canvas, [1.0, 1.0]);
        plan.axes(&mut canvas);
        let svg = canvas.svg("map", "");
        assert!(svg.contains("x [m]") && svg.contains("y [m]") && svg.contains(">2<"), "{svg}");
    }

    #[test]
    fn nothing_a_line_and_map_coordinates_are_drawn() {
        let far = [[5_399_990.0, 1.0], [5_399_998.0, 1.0], [f64::NAN, f64::INFINITY]];
        for (places, title) in [(vec![], "x [m]"), (vec![[1.0, 2.0]], "x [m]"), (far.to_vec(), "x − 5400000 [m]")] {
            let plan = Plan::new(Plan::corners(places), ["x", "y"], 200.0, 200.0);
            let mut canvas = plan.canvas();
            plan.axes(&mut canvas);
            let svg = canvas.svg("map", "");
            assert!(svg.contains(title) && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }
}
