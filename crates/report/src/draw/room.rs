//! Room with Gaussians.

#[cfg(test)]
mod tests;
mod view;

use super::charts::{SYMBOL, Symbol};
use super::plan::draw_receiver;
use crate::canvas::{BLACK, Canvas, Colour, Paint, Point, VectorPath, WHITE};
use pwrfgs_core::{Dataset, End, Evaluation, Metric, ModelFacts, Partition, Plugin, Pose, Real, Values, evenly};
use pwrfgs_experiment::text::{grouped, number};
use pwrfgs_model::Snapshot;
use std::fmt::Write as _;
use view::{RoomPoint, RoomView, facing_cosine};

/// Maximum numbers of drawn elements.
const POINTS: usize = 3_000;
const TRANSMITTERS: usize = 100;
const GAUSSIANS: usize = 3_000;
/// Maximum number of Gaussians with stems, which show their height above the floor.
const STEMS: usize = 80;

const BLUE: Colour = Colour::hex(0x17_4a99);
const TRAINING: Colour = Colour::hex(0xc2_7c00);
const TEST: Colour = Colour::hex(0x00_805c);

/// Room with the Gaussians of one snapshot.
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) numbers: String,
    pub(crate) drawing: Canvas,
    /// Remarks about elements that are not drawn.
    pub(crate) caption: String,
}

/// Parts shared by all panels: limits, point cloud, transmitters and receiver.
pub(crate) struct RoomFigure {
    view: RoomView,
    /// Axes, point cloud, transmitters and receiver.
    behind: Canvas,
    /// Arrow of the receiver; none for several receivers, which are squares.
    receiver: Option<ReceiverArrow>,
    /// Largest radius of a Gaussian.
    radius: f64,
    has_test: bool,
    has_points: bool,
}

impl RoomFigure {
    /// Creates the background: point cloud, transmitters and receivers, in a frame that also holds the Gaussians of all `clouds`
    /// except far outliers.
    pub(crate) fn new(data: &Dataset, partition: &Partition, clouds: &[&Snapshot], text_height: f64) -> Self {
        let (low, high) = frame_corners(data, clouds);
        let mut view = RoomView::new(low, high, text_height);
        view.origin = data.scene.origin.0;
        let most = clouds.iter().map(|s| s.means.len()).max().unwrap_or(0);
        // Many Gaussians are drawn smaller, so that they do not cover the room.
        let radius = (90.0 / (most.max(1) as f64).sqrt()).clamp(2.4, 6.0);
        let mut behind = view.empty_room();
        draw_points(&mut behind, &view, data);
        let mut draw = |part: &[usize], colour, add: fn(&mut VectorPath, Point, f64), radius| {
            let mut path = VectorPath::default();
            evenly(part, TRANSMITTERS)
                .into_iter()
                .for_each(|i| add(&mut path, view.project(data.sample(i).position()), radius));
            behind.path(path, Paint::stroke(colour, 0.8));
        };
        draw(&partition.train, TRAINING, VectorPath::add_plus, 1.6);
        draw(&partition.test, TEST, VectorPath::add_cross, 1.3);
        // Estimated and unknown positions are not drawn.
        let ends = if data.scene.has_distances() { data.scene.fixed_ends() } else { Vec::new() };
        let poses: Vec<Pose> = ends.into_iter().map(|pose| data.scene.origin.world_pose(pose)).collect();
        let mut receiver = None;
        if let ([pose], End::Transmitter) = (&poses[..], data.scene.moving) {
            let arrow = ReceiverArrow::new(pose, &view, 0.14 * longest_edge(low, high));
            arrow.draw(&mut behind, view.project(pose.position));
            receiver = Some(arrow);
        } else {
            poses.iter().for_each(|pose| draw_receiver(&mut behind, view.project(pose.position)));
        }
        let (has_test, has_points) = (!partition.test.is_empty(), !data.scene.points.is_empty());
        Self { view, behind, receiver, radius, has_test, has_points }
    }

    /// Draws the panel with the most opaque Gaussians of one snapshot.
    pub(crate) fn draw_panel(&self, title: &str, snapshot: &Snapshot, data: &Dataset) -> Panel {
        let n = snapshot.means.len();
        let mut shown: Vec<(RoomPoint, f64)> = scattered_order(n)
            .into_iter()
            .map(|i| (snapshot.centre(i), f64::from(snapshot.opacities[i])))
            .filter(|(mean, _)| self.view.contains(*mean))
            .collect();
        let outside = n - shown.len();
        shown.sort_by(|a, b| b.1.total_cmp(&a.1)); // stable sort: equal opacities, as at the start, are drawn from the whole room
        let inside = shown.len();
        shown.truncate(GAUSSIANS);
        let mut numbers = format!("N = {}", grouped(n as i64));
        if let Some(distance) = chamfer_distance(data, &snapshot.means) {
            _ = write!(numbers, ", Chamfer distance {} m²", number(distance));
        }
        let mut caption = Vec::new();
        if outside > 0 {
            caption.push(format!("{} of {} are outside the frame", grouped(outside as i64), grouped(n as i64)));
        }
        if inside > shown.len() {
            caption.push(format!("only the {} most opaque are drawn", grouped(shown.len() as i64)));
        }
        Panel { title: title.into(), numbers, drawing: self.draw_gaussians(&mut shown), caption: caption.join("; ") }
    }

    /// Draws the background, then Gaussians (position and opacity) from far to near; few of them with stems to the floor.
    fn draw_gaussians(&self, shown: &mut [(RoomPoint, f64)]) -> Canvas {
        shown.sort_by(|a, b| self.view.nearness(a.0).total_cmp(&self.view.nearness(b.0)));
        let mut canvas = self.behind.clone();
        if shown.len() <= STEMS {
            let mut stems = VectorPath::default();
            for (p, _) in &*shown {
                stems.add_line(&[self.view.project(*p), self.view.project([p[0], p[1], self.view.floor_height()])]);
            }
            canvas.path(stems, Paint::stroke(BLUE.with_opacity(0.35), 0.6));
        }
        shown.iter().for_each(|(p, opacity)| self.draw_gaussian(&mut canvas, self.view.project(*p), *opacity));
        canvas
    }

    /// Draws a Gaussian as a circle with an area proportional to opacity, but never too small to see.
    fn draw_gaussian(&self, canvas: &mut Canvas, at: Point, opacity: f64) {
        let paint = Paint::fill(BLUE.with_opacity(0.85)).outlined(WHITE, 0.5);
        canvas.circle(at, (self.radius * opacity.sqrt()).max(0.9), paint);
    }

    /// Returns the symbols of the legend with their meanings.
    pub(crate) fn legend(&self) -> Vec<Symbol> {
        let symbol = |meaning: &str, path: VectorPath, paint| {
            let mut drawing = Canvas::new(12.0, SYMBOL);
            drawing.path(path, paint);
            Symbol { drawing, meaning: meaning.to_owned() }
        };
        let mut circles = Canvas::new(38.0, SYMBOL);
        for (x, opacity) in [(6.0, 0.1), (17.0, 0.5), (30.0, 1.0)] {
            self.draw_gaussian(&mut circles, [x, 7.0], opacity);
        }
        let mut symbols = vec![Symbol { drawing: circles, meaning: "Gaussians of opacity 0.1, 0.5 and 1".into() }];
        let (mut dots, mut plus, mut cross) = (VectorPath::default(), VectorPath::default(), VectorPath::default());
        [[3.0, 5.0], [9.0, 7.0], [4.0, 10.0]].iter().for_each(|dot| dots.add_line(&[*dot; 2]));
        plus.add_plus([6.0, 7.0], 3.0);
        cross.add_cross([6.0, 7.0], 2.5);
        if self.has_points {
            symbols.push(symbol(
                "point cloud",
                dots,
                Paint { round: true, ..Paint::stroke(Colour::hex(0xaa_b0ba), 1.8) },
            ));
        }
        symbols.push(symbol("training transmitters", plus, Paint::stroke(TRAINING, 1.4)));
        if self.has_test {
            symbols.push(symbol("test transmitters", cross, Paint::stroke(TEST, 1.4)));
        }
        symbols.push(self.receiver.map_or_else(
            || {
                let mut drawing = Canvas::new(14.0, SYMBOL);
                draw_receiver(&mut drawing, [7.0, SYMBOL / 2.0]);
                Symbol { drawing, meaning: "receivers".into() }
            },
            ReceiverArrow::symbol,
        ));
        symbols
    }

    /// Describes a missing or thinned point cloud in a sentence; empty if all points are drawn.
    pub(crate) fn note(&self, data: &Dataset) -> String {
        let count = data.scene.points.len();
        if !self.has_points {
            return "This scene has no point cloud, so its walls are unknown.".into();
        }
        if count > POINTS {
            return format!(
                "{} of {} points of the point cloud are drawn.",
                grouped(POINTS as i64),
                grouped(count as i64)
            );
        }
        String::new()
    }
}

/// Draws the point cloud, fainter towards the viewer, so that objects behind stay visible.
fn draw_points(canvas: &mut Canvas, view: &RoomView, data: &Dataset) {
    let mut layers = [(); 3].map(|()| VectorPath::default());
    for point in evenly(&data.scene.points, POINTS) {
        let p = data.scene.origin.world(point);
        if view.contains(p) {
            let layer = ((3.0 * view.nearness(p)) as usize).min(2);
            layers[layer].add_line(&[view.project(p); 2]);
        }
    }
    for (layer, opacity) in layers.into_iter().zip([0.7, 0.5, 0.3]) {
        let grey = Colour::hex(0x8d_94a1).with_opacity(opacity);
        canvas.path(layer, Paint { round: true, ..Paint::stroke(grey, 1.3) });
    }
}

/// Returns the chamfer distance to the point cloud, as the metric of that name, m²; `None` if not applicable.
fn chamfer_distance(data: &Dataset, means: &[[Real; 3]]) -> Option<f64> {
    let metric = Plugin::<dyn Metric>::parse("Chamfer()").ok()?;
    let model = Some(ModelFacts { means, gaussian_bytes: 0, file_bytes: 0 });
    let measured = metric.evaluate(&Evaluation { model, ..Evaluation::of(data, &data.plane()) });
    match measured.ok()?.pop()?.values {
        Values::Whole(distance) => Some(distance),
        _ => None,
    }
}

/// Returns the corners of the frame in the world frame, slightly wider than its content and never flat. It contains the
/// scene; without a point cloud also the central 90 % of each of `clouds`, because the walls are unknown; and every
/// Gaussian not farther from this box than its longest edge. Others would make the scene too small.
fn frame_corners(data: &Dataset, clouds: &[&Snapshot]) -> (RoomPoint, RoomPoint) {
    let (low, high) = data.scene.bounds;
    let [mut low, mut high] = [low, high].map(|corner| data.scene.origin.world(corner));
    if data.scene.points.is_empty() {
        for k in 0..3 {
            for cloud in clouds {
                let mut coordinates: Vec<f64> = (0..cloud.means.len()).map(|i| cloud.centre(i)[k]).collect();
                coordinates.retain(|v| v.is_finite());
                coordinates.sort_by(f64::total_cmp);
                let cut = (coordinates.len() / 20).max(usize::from(coordinates.len() > 2)); // at least one of more than two
                low[k] = coordinates.get(cut).map_or(low[k], |v| low[k].min(*v));
                high[k] = coordinates.iter().rev().nth(cut).map_or(high[k], |v| high[k].max(*v));
            }
        }
    }
    let (scene, reach) = ((low, high), longest_edge(low, high));
    for mean in clouds.iter().flat_map(|cloud| (0..cloud.means.len()).map(|i| cloud.centre(i))) {
        if (0..3).all(|k| (scene.0[k] - reach..=scene.1[k] + reach).contains(&mean[k])) {
            for k in 0..3 {
                (low[k], high[k]) = (low[k].min(mean[k]), high[k].max(mean[k]));
            }
        }
    }
    let longest = longest_edge(low, high);
    for k in 0..3 {
        let share = if high[k] - low[k] < 0.1 * longest { 0.1 } else { 0.02 };
        let margin = share * longest;
        (low[k], high[k]) = (low[k] - margin, high[k] + margin);
    }
    (low, high)
}

/// Returns the longest edge of the box between two corners; 1 if it has no extent.
fn longest_edge(low: RoomPoint, high: RoomPoint) -> f64 {
    let longest = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
    if longest > 0.0 { longest } else { 1.0 }
}

/// Returns the numbers below `n` in an order whose start is spread over all of them (Knuth's multiplicative hash).
fn scattered_order(n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|&i| (i as u32).wrapping_mul(2_654_435_769));
    order
}

/// Cosine of 20 degrees, the angle between boresight and viewing direction below which an arrow would be too short.
const HEAD_ON: f64 = 0.94;
/// Radius of the ring.
const RADIUS: f64 = 5.0;

/// Arrow along the boresight. Along the viewing direction it is drawn as in physics: a ring with a dot for an arrow towards
/// the viewer, with a cross for an arrow away from the viewer.
#[derive(Clone, Copy, Debug)]
pub(super) struct ReceiverArrow {
    /// Projection of the arrow on the drawing.
    along: Point,
    /// 1 if the boresight points to the viewer, -1 if it points away.
    facing: f64,
}

impl ReceiverArrow {
    /// Creates the arrow of a receiver, `length` metres long.
    pub(super) fn new(pose: &Pose, view: &RoomView, length: f64) -> Self {
        let boresight = pose.world_from_receiver().z_axis.to_array().map(f64::from);
        let end = [0, 1, 2].map(|k| pose.position[k] + length * boresight[k]);
        let (from, to) = (view.project(pose.position), view.project(end));
        Self { along: [to[0] - from[0], to[1] - from[1]], facing: facing_cosine(boresight) }
    }

    /// Draws the arrow, or the ring, of a receiver at `at`.
    pub(super) fn draw(self, canvas: &mut Canvas, at: Point) {
        if self.facing.abs() > HEAD_ON {
            canvas.circle(at, RADIUS, Paint::fill(WHITE).outlined(BLACK, 1.4));
            if self.facing > 0.0 {
                canvas.circle(at, 2.0, Paint::fill(BLACK));
            } else {
                let mut feathers = VectorPath::default();
                feathers.add_cross(at, RADIUS * 0.7);
                canvas.path(feathers, Paint::stroke(BLACK, 1.4));
            }
            return;
        }
        let [x, y] = self.along;
        let length = x.hypot(y);
        let [u, v] = [x / length, y / length];
        let point = |forward: f64, aside: f64| [at[0] + forward * u - aside * v, at[1] + forward * v + aside * u];
        canvas.line(&[at, point(length, 0.0)], Paint::stroke(WHITE, 3.5));
        let head = [point(7.0, 0.0), point(-4.0, 4.6), point(-4.0, -4.6)];
        canvas.polygon(&head, Paint::fill(BLACK).outlined(WHITE, 1.0));
        canvas.line(&[at, point(length, 0.0)], Paint::stroke(BLACK, 1.4));
    }

    /// Returns the symbol for the legend, with the direction of the boresight.
    pub(super) fn symbol(self) -> Symbol {
        let mut drawing = Canvas::new(21.0, SYMBOL);
        Self { along: [15.0, 0.0], ..self }.draw(&mut drawing, [6.0, SYMBOL / 2.0]);
        let meaning = match self.facing {
            f if f > HEAD_ON => "receiver, boresight towards the viewer",
            f if f < -HEAD_ON => "receiver, boresight away from the viewer",
            _ => "receiver and its boresight",
        };
        Symbol { drawing, meaning: meaning.into() }
    }
}
