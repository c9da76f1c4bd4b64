//! The room and the Gaussians in it as SVG.

#[cfg(test)]
mod tests;
mod view;

use pwrfgs_core::{Dataset, Evaluation, ImagePlane, Metric, ModelFacts, Partition, Plugin, Real, Values};
use pwrfgs_experiment::Snapshot;
use pwrfgs_experiment::samples::evenly;
use pwrfgs_experiment::text::{grouped, number};
use serde::Serialize;
use std::fmt::Write as _;
use view::{Point, View, line};

/// At most so many of each are drawn.
const POINTS: usize = 3_000;
const TRANSMITTERS: usize = 100;
const GAUSSIANS: usize = 3_000;
/// Up to so many Gaussians stand on stems, which show where they are above the floor.
const STEMS: usize = 80;

const INK: &str = "#174a99";
const TRAINING: &str = "#c27c00";
const TEST: &str = "#00805c";

/// One moment.
#[derive(Serialize)]
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) numbers: String,
    pub(crate) svg: String,
    /// Its height, SVG units; it is 380 wide.
    pub(crate) height: f64,
    /// What is not shown.
    pub(crate) caption: String,
}

/// A symbol and its meaning.
pub(crate) struct Symbol {
    /// Width, SVG units; it is 14 high.
    pub(crate) width: u32,
    /// What is drawn.
    pub(crate) inner: String,
    /// What it stands for.
    pub(crate) meaning: &'static str,
}

/// What all panels share: limits, cloud, transmitters and receiver.
pub(crate) struct Room {
    view: View,
    /// Axes and cloud.
    behind: String,
    /// Transmitters and receiver.
    before: String,
    /// The largest radius of a Gaussian, SVG units.
    radius: f64,
    has_test: bool,
    has_points: bool,
}

impl Room {
    /// Limits are those of the scene. Where it has no point cloud its walls are unknown, and the limits hold the middle
    /// nine tenths of each of `clouds` as well.
    /// Text on the axes is `text` SVG units high.
    pub(crate) fn new(data: &Dataset, partition: &Partition, clouds: &[&Snapshot], text: f64) -> Self {
        let (low, high) = limits(data, clouds);
        let view = View::new(low, high, text);
        let most = clouds.iter().map(|s| s.means.len()).max().unwrap_or(0);
        let radius = (90.0 / (most.max(1) as f64).sqrt()).clamp(2.4, 6.0);
        let mut behind = view.axes();
        behind += &points(&view, data);
        let mut before = String::new();
        for (part, colour, shape) in [
            (&partition.train, TRAINING, "m-1.6 0h3.2m-1.6 -1.6v3.2"),
            (&partition.test, TEST, "m-1.3 -1.3l2.6 2.6m0 -2.6l-2.6 2.6"),
        ] {
            let txs: Vec<Point> = evenly(part, TRANSMITTERS).into_iter().map(|i| data.samples[i].tx).collect();
            let path: String = txs.iter().map(|&tx| line(&[view.place(tx)]) + shape).collect();
            _ = write!(before, "<path fill=\"none\" stroke=\"{colour}\" stroke-width=\".8\" d=\"{path}\"/>");
        }
        before += &receiver(&view, data, low, high);
        Self {
            view,
            behind,
            before,
            radius,
            has_test: !partition.test.is_empty(),
            has_points: !data.scene.points.is_empty(),
        }
    }

    /// The Gaussians of one moment in the room.
    pub(crate) fn panel(&self, title: &str, snapshot: &Snapshot, data: &Dataset) -> Panel {
        let n = snapshot.means.len();
        let mut shown: Vec<(Point, f64)> = scattered(n)
            .into_iter()
            .map(|i| (snapshot.means[i].map(f64::from), f64::from(snapshot.opacities[i])))
            .filter(|(mean, _)| self.view.holds(*mean))
            .collect();
        let outside = n - shown.len();
        shown.sort_by(|a, b| b.1.total_cmp(&a.1)); // stable: equals, as at the start, are drawn from everywhere
        let inside = shown.len();
        shown.truncate(GAUSSIANS);
        let mut numbers = format!("N = {}", grouped(n as i64));
        if let Some(distance) = chamfer(data, &snapshot.means) {
            _ = write!(numbers, ", Chamfer distance {} m²", number(distance));
        }
        let mut caption = Vec::new();
        if outside > 0 {
            caption.push(format!("{} of {} lie outside the frame", grouped(outside as i64), grouped(n as i64)));
        }
        if inside > shown.len() {
            caption.push(format!("the {} most opaque are drawn", grouped(shown.len() as i64)));
        }
        Panel {
            title: title.into(),
            numbers,
            svg: self.svg(&mut shown, title),
            height: self.view.size[1],
            caption: caption.join("; "),
        }
    }

    /// Axes and cloud, then transmitters, then Gaussians from far to near.
    fn svg(&self, shown: &mut [(Point, f64)], title: &str) -> String {
        shown.sort_by(|a, b| self.view.nearness(a.0).total_cmp(&self.view.nearness(b.0)));
        let [width, height] = self.view.size;
        let mut svg = format!(
            "<svg class=\"room\" viewBox=\"0 0 {width:.0} {height:.0}\" role=\"img\" aria-label=\"{title}\">{}{}",
            self.behind, self.before
        );
        if shown.len() <= STEMS {
            let stem =
                |(p, _): &(Point, f64)| line(&[self.view.place(*p), self.view.place([p[0], p[1], self.view.floor()])]);
            let stems: String = shown.iter().map(stem).collect();
            _ = write!(
                svg,
                "<path fill=\"none\" stroke=\"{INK}\" stroke-opacity=\".35\" stroke-width=\".6\" d=\"{stems}\"/>"
            );
        }
        svg += &gaussians(shown.iter().map(|(p, opacity)| (self.view.place(*p), *opacity)), self.radius);
        svg + "</svg>"
    }

    /// Symbols with their meaning.
    pub(crate) fn legend(&self) -> Vec<Symbol> {
        let symbol = |width: u32, inner: String, meaning| Symbol { width, inner, meaning };
        let path =
            |d: &str, colour: &str| format!("<path fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.4\" d=\"{d}\"/>");
        let sizes = [(6.0, 0.1), (17.0, 0.5), (30.0, 1.0)].map(|(x, opacity)| ([x, 7.0], opacity));
        let circles = gaussians(sizes.into_iter(), self.radius);
        let mut all = vec![symbol(38, circles, "Gaussians of opacity 0.1, 0.5 and 1")];
        if self.has_points {
            let dots =
                "<path stroke=\"#aab0ba\" stroke-width=\"1.8\" stroke-linecap=\"round\" d=\"M3 5h0M9 7h0M4 10h0\"/>";
            all.push(symbol(12, dots.into(), "point cloud"));
        }
        all.push(symbol(12, path("M3 7h6m-3 -3v6", TRAINING), "training transmitters"));
        if self.has_test {
            all.push(symbol(12, path("M3.5 4.5l5 5m0 -5l-5 5", TEST), "test transmitters"));
        }
        let triangle = "<path fill=\"#101318\" d=\"M6 2l5 9.5h-10z\"/>";
        all.push(symbol(12, triangle.into(), "receiver and its boresight"));
        all
    }

    pub(crate) fn note(&self, data: &Dataset) -> String {
        let count = data.scene.points.len();
        if !self.has_points {
            return "This scene has no point cloud: where its walls are is not known.".into();
        }
        if count > POINTS {
            return format!("{} of {} points of the cloud are drawn.", grouped(POINTS as i64), grouped(count as i64));
        }
        String::new()
    }
}

/// Circles whose area is proportional to opacity, in the order given.
fn gaussians(placed: impl Iterator<Item = ([f64; 2], f64)>, radius: f64) -> String {
    let mut svg = format!("<g fill=\"{INK}\" fill-opacity=\".85\" stroke=\"#fff\" stroke-width=\".5\">");
    for ([x, y], opacity) in placed {
        let r = (radius * opacity.sqrt()).max(0.9);
        _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{r:.1}\"/>");
    }
    svg + "</g>"
}

/// The point cloud, fainter towards the eye: what lies behind shall be seen.
fn points(view: &View, data: &Dataset) -> String {
    let mut layers = [String::new(), String::new(), String::new()];
    for point in evenly(&data.scene.points, POINTS) {
        let p = point.map(f64::from);
        if view.holds(p) {
            let layer = ((3.0 * view.nearness(p)) as usize).min(2);
            layers[layer] += &line(&[view.place(p)]);
            layers[layer] += "h0";
        }
    }
    let mut svg = String::from("<g fill=\"none\" stroke=\"#8d94a1\" stroke-width=\"1.3\" stroke-linecap=\"round\">");
    for (path, opacity) in layers.iter().zip([0.7, 0.5, 0.3]) {
        _ = write!(svg, "<path stroke-opacity=\"{opacity}\" d=\"{path}\"/>");
    }
    svg + "</g>"
}

/// A triangle where the receiver stands and a line along its boresight.
fn receiver(view: &View, data: &Dataset, low: Point, high: Point) -> String {
    let pose = &data.scene.receiver;
    let boresight = pose.world_from_receiver().z_axis.to_array().map(f64::from);
    let length = 0.14 * (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
    let end = [0, 1, 2].map(|k| pose.position[k] + length * boresight[k]);
    let ([x, y], tip) = (view.place(pose.position), view.place(end));
    let ray = line(&[[x, y], tip]);
    let triangle = format!("M{x:.1} {:.1}l5 9h-10z", y - 5.5);
    format!(
        "<path stroke=\"#fff\" stroke-width=\"3.5\" d=\"{ray}\"/><path stroke=\"#101318\" stroke-width=\"1.4\" \
         d=\"{ray}\"/><path fill=\"#101318\" stroke=\"#fff\" d=\"{triangle}\"/>"
    )
}

/// The Chamfer distance to the point cloud as the metric of that name defines it, m²; `None` where it does not apply.
fn chamfer(data: &Dataset, means: &[[Real; 3]]) -> Option<f64> {
    let metric = Plugin::<dyn Metric>::parse("Chamfer()").ok()?;
    let measured = metric.evaluate(&Evaluation {
        predictions: &[],
        truths: &[],
        plane: &ImagePlane { width: data.width, height: data.height, wraps: false, angles: None },
        scene: &data.scene,
        model: Some(ModelFacts { means, gaussian_bytes: 0, network_bytes: 0 }),
        timed_prediction: None,
    });
    match measured.ok()?.pop()?.values {
        Values::Whole(distance) => Some(distance),
        _ => None,
    }
}

/// Corners of the frame, a little wider than what it must hold and never flat.
fn limits(data: &Dataset, clouds: &[&Snapshot]) -> (Point, Point) {
    let (low, high) = data.scene.bounds;
    let (mut low, mut high) = (low.map(f64::from), high.map(f64::from));
    if data.scene.points.is_empty() {
        for k in 0..3 {
            for cloud in clouds.iter().filter(|c| !c.means.is_empty()) {
                let mut places: Vec<Real> = cloud.means.iter().map(|m| m[k]).collect();
                places.sort_by(Real::total_cmp);
                let cut = places.len() / 20;
                low[k] = low[k].min(f64::from(places[cut]));
                high[k] = high[k].max(f64::from(places[places.len() - 1 - cut]));
            }
        }
    }
    let longest = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
    let longest = if longest > 0.0 { longest } else { 1.0 };
    for k in 0..3 {
        let air = if high[k] - low[k] < 0.1 * longest { 0.1 } else { 0.02 } * longest;
        (low[k], high[k]) = (low[k] - air, high[k] + air);
    }
    (low, high)
}

/// The numbers below `n` in an order whose first part is spread over all of them (Knuth's multiplicative hash).
fn scattered(n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|&i| (i as u32).wrapping_mul(2_654_435_769));
    order
}
