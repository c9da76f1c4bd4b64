//! Box in space in parallel projection, seen from above at an angle: lengths along an axis stay comparable.

use crate::canvas::{Anchor, Canvas, Colour, Paint, Point, VectorPath};
use crate::draw::axes::{few_ticks, tick_label};
use pwrfgs_core::statistics::bounds;

/// Viewing direction, degrees: azimuth from the x axis, elevation above the floor.
const AZIMUTH: f64 = -58.0;
const ELEVATION: f64 = 27.0;
/// Width of a drawing, its maximum height without axes, and margins in text heights: left, top,
/// right, bottom.
const WIDTH: f64 = 380.0;
const MOST_HEIGHT: f64 = 300.0;
const MARGINS: [f64; 4] = [3.4, 0.8, 1.9, 3.2];

/// Point in space, metres.
pub(crate) type RoomPoint = [f64; 3];

/// View of one box.
#[derive(Clone, Debug)]
pub(crate) struct RoomView {
    low: RoomPoint,
    high: RoomPoint,
    /// Origin of the numbers on the axes.
    pub(crate) origin: RoomPoint,
    /// Drawing units per metre.
    scale: f64,
    /// Position of the origin of the drawing, before scaling.
    corner: [f64; 2],
    /// Text height.
    text: f64,
    /// Width and height of the drawing.
    pub(crate) size: Point,
}

impl RoomView {
    /// Creates the view of the box from `low` to `high`, metres, with this text height.
    pub(crate) fn new(low: RoomPoint, high: RoomPoint, text: f64) -> Self {
        // The bits of `k` select the low or high end of each axis.
        let corner = |k: usize| {
            parallel_projection([0, 1, 2].map(|axis| if k >> axis & 1 == 0 { low[axis] } else { high[axis] }))
        };
        let [x, y] = [0, 1].map(|axis| bounds((0..8).map(|k| corner(k)[axis])));
        let (least, most) = ([x.0, y.0], [x.1, y.1]);
        let [left, top, right, bottom] = MARGINS.map(|m| m * text);
        let scale = ((WIDTH - left - right) / (most[0] - least[0])).min(MOST_HEIGHT / (most[1] - least[1]));
        // Narrow boxes are centred.
        let spare = WIDTH - left - right - scale * (most[0] - least[0]);
        let corner = [least[0] - (left + spare / 2.0) / scale, most[1] + top / scale];
        Self {
            low,
            high,
            origin: [0.0; 3],
            scale,
            corner,
            text,
            size: [WIDTH, top + scale * (most[1] - least[1]) + bottom],
        }
    }

    /// Returns whether the box contains `p`.
    pub(crate) fn contains(&self, p: RoomPoint) -> bool {
        (0..3).all(|k| (self.low[k]..=self.high[k]).contains(&p[k]))
    }

    /// Returns the height of the floor, metres.
    pub(crate) fn floor_height(&self) -> f64 {
        self.low[2]
    }

    /// Returns the position of a point of the room on the drawing.
    pub(crate) fn project(&self, p: RoomPoint) -> Point {
        let [x, y] = parallel_projection(p);
        [self.scale * (x - self.corner[0]), self.scale * (self.corner[1] - y)]
    }

    /// Returns the nearness to the viewer: 0 at the farthest corner of the box, 1 at the nearest.
    pub(crate) fn nearness(&self, p: RoomPoint) -> f64 {
        let eye = viewer_direction();
        let along = |k: usize| if eye[k] > 0.0 { p[k] - self.low[k] } else { p[k] - self.high[k] };
        let reach: f64 = (0..3).map(|k| (eye[k] * (self.high[k] - self.low[k])).abs()).sum();
        (0..3).map(|k| eye[k] * along(k)).sum::<f64>() / reach
    }

    /// Creates a drawing with floor, two rear walls, a grid in metres on them and numbers along
    /// three edges.
    pub(crate) fn empty_room(&self) -> Canvas {
        let mut canvas = Canvas::new(self.size[0], self.size[1]);
        canvas.letters.size = self.text;
        self.draw_faces(&mut canvas);
        let (low, high, origin) = (self.low, self.high, self.origin);
        let at = |x: f64, y: f64, z: f64| self.project([x, y, z]);
        // Larger text leaves room for fewer numbers.
        let most = ((60.0 / self.text) as usize).clamp(2, 6);
        let ticks = [0, 1, 2].map(|k| few_ticks(low[k] - origin[k], high[k] - origin[k], most));
        let mut grid = VectorPath::default();
        let mut mark = |at: Point, shift, anchor, words: &str| self.draw_label(&mut canvas, at, shift, anchor, words);
        for (x, words) in ticks[0].iter().map(|v| (v + origin[0], tick_label(*v))) {
            grid.add_line(&[at(x, low[1], low[2]), at(x, high[1], low[2]), at(x, high[1], high[2])]);
            mark(at(x, low[1], low[2]), [-0.3, 1.15], Anchor::Middle, &words);
        }
        for (y, words) in ticks[1].iter().map(|v| (v + origin[1], tick_label(*v))) {
            grid.add_line(&[at(high[0], y, low[2]), at(low[0], y, low[2]), at(low[0], y, high[2])]);
            mark(at(high[0], y, low[2]), [0.55, 1.05], Anchor::Start, &words);
        }
        for (z, words) in ticks[2].iter().map(|v| (v + origin[2], tick_label(*v))) {
            grid.add_line(&[at(low[0], low[1], z), at(low[0], high[1], z), at(high[0], high[1], z)]);
            mark(at(low[0], low[1], z), [-0.5, 0.33], Anchor::End, &words);
        }
        self.draw_titles(&mut canvas);
        canvas.path(grid, Paint::stroke(Colour::hex(0xdd_e0e6), 0.6));
        canvas
    }

    /// Draws the floor and the two rear walls.
    fn draw_faces(&self, canvas: &mut Canvas) {
        let (low, high) = (self.low, self.high);
        // The viewer is at large x and small y: the walls at small x and large y are behind.
        let at = |x: f64, y: f64, z: f64| self.project([x, y, z]);
        let [floor, top] = [low[2], high[2]]
            .map(|z| [at(low[0], low[1], z), at(high[0], low[1], z), at(high[0], high[1], z), at(low[0], high[1], z)]);
        let faces = [floor, [floor[0], floor[3], top[3], top[0]], [floor[3], floor[2], top[2], top[3]]];
        for (face, fill) in faces.iter().zip([0xf1_f2f5, 0xf8_f9fa, 0xf8_f9fa]) {
            canvas.polygon(face, Paint::fill(Colour::hex(fill)).outlined(Colour::hex(0xc9_cdd5), 0.7));
        }
    }

    /// Draws the titles of the axes, which name the origin of their numbers unless it is 0.
    fn draw_titles(&self, canvas: &mut Canvas) {
        let (low, origin) = (self.low, self.origin);
        let middle = [0, 1, 2].map(|k| f64::midpoint(low[k], self.high[k]));
        let title = |k: usize| match origin[k] {
            0.0 => format!("{} [m]", ["x", "y", "z"][k]),
            from => format!("{} − {from} [m]", ["x", "y", "z"][k]),
        };
        let at = self.project([middle[0], low[1], low[2]]);
        self.draw_label(canvas, at, [-1.3, 2.6], Anchor::Middle, &title(0));
        // A long title goes below the numbers.
        let (shift, anchor) =
            if origin[1] == 0.0 { ([2.3, 2.3], Anchor::Middle) } else { ([-0.5, 3.9], Anchor::Start) };
        self.draw_label(canvas, self.project([self.high[0], middle[1], low[2]]), shift, anchor, &title(1));
        let [x, y] = self.project([low[0], low[1], middle[2]]);
        canvas.upright_text([x - 2.5 * self.text, y], title(2));
    }

    /// Draws `words` at a point, shifted to the right and down by text heights.
    fn draw_label(&self, canvas: &mut Canvas, [x, y]: Point, [dx, dy]: Point, anchor: Anchor, words: &str) {
        canvas.text([x + dx * self.text, y + dy * self.text], anchor, words);
    }
}

/// Returns the direction to the viewer, a unit vector.
fn viewer_direction() -> RoomPoint {
    let [az, el] = [AZIMUTH, ELEVATION].map(f64::to_radians);
    [el.cos() * az.cos(), el.cos() * az.sin(), el.sin()]
}

/// Returns the cosine of the angle between a direction and the direction to the viewer.
pub(crate) fn facing_cosine(direction: RoomPoint) -> f64 {
    let (eye, length) = (viewer_direction(), direction.iter().map(|v| v * v).sum::<f64>().sqrt());
    (0..3).map(|k| eye[k] * direction[k]).sum::<f64>() / length
}

/// Projects a point in parallel along the viewing direction: coordinates to the right and upwards, metres.
fn parallel_projection(p: RoomPoint) -> Point {
    let [az, el] = [AZIMUTH, ELEVATION].map(f64::to_radians);
    let towards = az.cos() * p[0] + az.sin() * p[1];
    [az.cos() * p[1] - az.sin() * p[0], el.cos() * p[2] - el.sin() * towards]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_view_fills_image_and_keeps_lengths() {
        for (low, high) in [([0.0; 3], [8.0, 6.0, 3.0]), ([-1.0, -1.0, 0.0], [1.0, 1.0, 20.0])] {
            let view = RoomView::new(low, high, 10.0);
            let ends = (0..8).map(|k| view.project([0, 1, 2].map(|a| if k >> a & 1 == 0 { low[a] } else { high[a] })));
            for [x, y] in ends {
                assert!((10.0 * MARGINS[0] - 1e-9..=WIDTH - 10.0 * MARGINS[2] + 1e-9).contains(&x), "{x}");
                assert!((10.0 * MARGINS[1] - 1e-9..=view.size[1] - 10.0 * MARGINS[3] + 1e-9).contains(&y), "{y}");
            }
            let [a, b, c] = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]].map(|p| view.project(p));
            assert!((b[0] - a[0] - (c[0] - b[0])).abs() < 1e-9, "no perspective");
            let (behind, before) = ([low[0], high[1], low[2]], [high[0], low[1], high[2]]);
            assert!(view.nearness(behind).abs() < 1e-9 && (view.nearness(before) - 1.0).abs() < 1e-9);
        }
    }
}
