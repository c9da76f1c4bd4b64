//! The receiver on a picture of the room, and where it looks.

use super::view::{View, facing};
use crate::canvas::{BLACK, Canvas, Paint, Path, Point, WHITE};
use crate::draw::legend::{SYMBOL, Symbol};
use pwrfgs_core::Pose;

/// Beyond this an arrow would be too short to show a direction: it looks along the line of sight within 20 degrees.
const HEAD_ON: f64 = 0.94;
/// Of the ring.
const RADIUS: f64 = 5.0;

/// An arrow along the boresight as the picture shows it. Along the line of sight it is what physics draws: a ring with a
/// dot where the arrow's tip would be seen, with a cross where its feathers would.
#[derive(Clone, Copy, Debug)]
pub(super) struct Receiver {
    /// From the receiver to the end of its arrow, on the picture.
    along: Point,
    /// 1 where it looks straight at the eye, -1 where straight away from it.
    facing: f64,
}

impl Receiver {
    /// With an arrow so long, metres.
    pub(super) fn new(pose: &Pose, view: &View, length: f64) -> Self {
        let boresight = pose.world_from_receiver().z_axis.to_array().map(f64::from);
        let end = [0, 1, 2].map(|k| pose.position[k] + length * boresight[k]);
        let (from, to) = (view.place(pose.position), view.place(end));
        Self { along: [to[0] - from[0], to[1] - from[1]], facing: facing(boresight) }
    }

    /// Draws it where it stands.
    pub(super) fn draw(self, canvas: &mut Canvas, at: Point) {
        if self.facing.abs() > HEAD_ON {
            canvas.circle(at, RADIUS, Paint::fill(WHITE).outlined(BLACK, 1.4));
            if self.facing > 0.0 {
                canvas.circle(at, 2.0, Paint::fill(BLACK));
            } else {
                let mut feathers = Path::default();
                feathers.add_cross(at, RADIUS * 0.7);
                canvas.path(feathers, Paint::stroke(BLACK, 1.4));
            }
            return;
        }
        let [x, y] = self.along;
        let length = x.hypot(y);
        let [u, v] = [x / length, y / length];
        let place = |forward: f64, aside: f64| [at[0] + forward * u - aside * v, at[1] + forward * v + aside * u];
        canvas.line(&[at, place(length, 0.0)], Paint::stroke(WHITE, 3.5));
        let head = [place(7.0, 0.0), place(-4.0, 4.6), place(-4.0, -4.6)];
        canvas.polygon(&head, Paint::fill(BLACK).outlined(WHITE, 1.0));
        canvas.line(&[at, place(length, 0.0)], Paint::stroke(BLACK, 1.4));
    }

    /// What it looks like, for the legend: an arrow lies there.
    pub(super) fn symbol(self) -> Symbol {
        let mut picture = Canvas::new(21.0, SYMBOL);
        Self { along: [15.0, 0.0], ..self }.draw(&mut picture, [6.0, SYMBOL / 2.0]);
        let meaning = match self.facing {
            f if f > HEAD_ON => "receiver, looking out of the picture",
            f if f < -HEAD_ON => "receiver, looking into the picture",
            _ => "receiver and its boresight",
        };
        Symbol { picture, meaning: meaning.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canvas::{Shape, Step};

    /// A receiver whose boresight is turned by an angle, degrees, about an axis of the world.
    fn turned(axis: [f64; 3], degrees: f64) -> Pose {
        let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
        Pose { position: [2.0, 1.0, 1.0], orientation: [axis[0] * sin, axis[1] * sin, axis[2] * sin, cos] }
    }

    #[test]
    fn the_arrow_points_where_the_receiver_looks() {
        let view = View::new([0.0; 3], [4.0, 3.0, 2.0], 10.0);
        // Up, down, along x, against x, along y, against y.
        let poses =
            [([1.0, 0.0, 0.0], 0.0), ([1.0, 0.0, 0.0], 180.0), ([0.0, 1.0, 0.0], 90.0), ([0.0, 1.0, 0.0], -90.0)];
        let sides = [([1.0, 0.0, 0.0], -90.0), ([1.0, 0.0, 0.0], 90.0)];
        let ahead =
            [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]];
        for ((axis, degrees), ahead) in poses.into_iter().chain(sides).zip(ahead) {
            let pose = turned(axis, degrees);
            let at = view.place(pose.position);
            let [x, y] = view.place([0, 1, 2].map(|k| pose.position[k] + ahead[k]));
            let mut canvas = Canvas::new(10.0, 10.0);
            Receiver::new(&pose, &view, 0.5).draw(&mut canvas, at);
            let Shape::Path(head, _) = &canvas.shapes[1] else { panic!("no arrow for {ahead:?}") };
            let Step::Move(tip) = head.0[0] else { panic!("{head:?}") };
            let (wanted, found) = ((y - at[1]).atan2(x - at[0]), (tip[1] - at[1]).atan2(tip[0] - at[0]));
            assert!((wanted - found).abs() < 1e-5, "{ahead:?}: {wanted} {found}");
        }
    }

    #[test]
    fn along_the_line_of_sight_it_is_a_ring() {
        let view = View::new([0.0; 3], [4.0, 3.0, 2.0], 10.0);
        // From straight up, turned by 63 degrees in the vertical plane of the eye.
        let axis = [58f64.to_radians().sin(), 58f64.to_radians().cos(), 0.0];
        for (degrees, shapes, meaning) in [(63.0, 2, "out of"), (63.0 - 180.0, 2, "into"), (20.0, 3, "boresight")] {
            let receiver = Receiver::new(&turned(axis, degrees), &view, 0.5);
            let mut canvas = Canvas::new(10.0, 10.0);
            receiver.draw(&mut canvas, [5.0, 5.0]);
            assert_eq!(canvas.shapes.len(), shapes, "{degrees}: {receiver:?}");
            assert!(receiver.symbol().meaning.contains(meaning), "{degrees}: {receiver:?}");
        }
    }
}
