//! Positions in plan and elevation, coloured by time, and the lengths of steps.

use super::{BLUE, Figure, axis, dots, figure};
use crate::{Inspection, Trajectory};
use pwrfgs_core::{Receiver, evenly};
use pwrfgs_experiment::colour::sequential;
use pwrfgs_report::draw::canvas::{Anchor, BLACK, Canvas, Colour, Pixels};
use pwrfgs_report::draw::charts::{Axis, Chart, Line, Look};
use pwrfgs_report::draw::marks::{Marker, Stroke, Style};

/// Most transmitters drawn.
pub(crate) const DOTS: usize = 3_000;
/// Colours of time.
const COLOURS: usize = 24;
/// The lightest colours are lost on paper.
const LIGHTEST: f64 = 0.9;
/// Bars of the histogram.
const BARS: usize = 40;
/// Width of a chart within its axes.
const WIDTH: f64 = 484.0;

/// Plan, elevation and steps.
pub(crate) fn positions(found: &Inspection<'_>) -> Vec<Figure> {
    let [low, high] = found.trajectory.extent;
    let along = usize::from(high[0] - low[0] < high[1] - low[1]);
    let names = ["x [m]", "y [m]", "z [m]"];
    let view =
        |title: &str, axes: [usize; 2], all: bool| figure(title, &places(found, axes, axes.map(|k| names[k]), all));
    let elevation = format!("Elevation: {} and z", ["x", "y"][along]);
    let mut figures = vec![view("Plan: x and y", [0, 1], true), view(&elevation, [along, 2], true)];
    let receiver = found.data.scene.origin.world_pose(found.data.scene.pose()).position;
    let away = (0..2).map(|k| (low[k] - receiver[k]).max(receiver[k] - high[k])).fold(0.0, f64::max);
    if away > found.trajectory.size() {
        figures.push(view("Plan of the transmitters alone", [0, 1], false));
    }
    figures.push(steps(&found.trajectory));
    figures.into_iter().flatten().collect()
}

/// What colours mean.
pub(crate) fn time_bar(ids: [u32; 2]) -> String {
    let mut canvas = Canvas::new(372.0, 16.0);
    let colours = (0..COLOURS).flat_map(|k| {
        let [r, g, b] = time(k);
        [r, g, b, 255]
    });
    let rgba = colours.collect();
    canvas.framed([50.0, 3.0], [200.0, 8.0], Pixels { width: COLOURS, height: 1, rgba, smooth: false });
    canvas.text([0.0, 11.0], Anchor::Start, format!("id {}", ids[0]));
    canvas.text([256.0, 11.0], Anchor::Start, format!("id {}", ids[1]));
    canvas.svg("bar", "colours of time")
}

fn time(k: usize) -> [u8; 3] {
    sequential(LIGHTEST * (k as f64 + 0.5) / COLOURS as f64)
}

/// Transmitters, and the receiver too in a view of `all`, as two coordinates show them, to scale.
fn places(found: &Inspection<'_>, [a, b]: [usize; 2], names: [&str; 2], all: bool) -> Chart {
    let data = found.data;
    let arrow = 0.12 * found.trajectory.size().max(0.1);
    // Each receiver's place, and the end of its boresight.
    let receiver = |receiver: &Receiver| {
        let pose = data.scene.origin.world_pose(receiver.pose);
        let boresight = pose.world_from_receiver().z_axis.to_array().map(f64::from);
        [pose.position, [0, 1, 2].map(|k| pose.position[k] + arrow * boresight[k])]
    };
    let receivers: Vec<[[f64; 3]; 2]> =
        if all { data.scene.receivers.iter().map(receiver).collect() } else { Vec::new() };
    let samples: Vec<usize> = (0..data.len()).collect();
    let shown: Vec<[f64; 3]> = evenly(&samples, DOTS).into_iter().map(|i| data.sample(i).tx).collect();
    let known = || shown.iter().chain(receivers.as_flattened());
    let [x, y] = [a, b].map(|k| {
        let values = || known().map(|p| p[k]);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    });
    let (x, y, height) = to_scale(x, y);
    let place = |p: &[f64; 3]| (p[a], p[b]);
    let star = Style { marker: Some(Marker::Star), ..Style::line(BLACK, 1.6, Stroke::FULL) };
    let mut lines = Vec::new();
    for (k, ends) in receivers.iter().enumerate() {
        let mut own = Line::new(ends.iter().map(place).collect(), star);
        if k == 0 {
            own = own.named(if receivers.len() > 1 { "receivers and boresights" } else { "receiver and boresight" });
        }
        own.marks.push(place(&ends[0]));
        lines.push(own);
    }
    for k in 0..COLOURS {
        let part = &shown[k * shown.len() / COLOURS..(k + 1) * shown.len() / COLOURS];
        let [r, g, b] = time(k);
        lines.push(dots(part.iter().map(place).collect(), Colour { rgb: [r, g, b], opacity: 1.0 }, 2.6));
    }
    let margins = [Look::SCREEN.margins[0], 12.0, Look::SCREEN.margins[2], Look::SCREEN.margins[3]];
    let look = Look { size: [WIDTH + margins[0] + margins[2], height + margins[1] + margins[3]], margins };
    let axis = |name: &str, ends| Axis { ends: Some(ends), ..axis(name) };
    Chart { look, x: axis(names[0], x), y: axis(names[1], y), lines, ..Chart::default() }
}

/// Both axes with air, so that a metre is as long across as upwards, and the height of the picture.
fn to_scale(x: (f64, f64), y: (f64, f64)) -> ((f64, f64), (f64, f64), f64) {
    let air = 0.06 * (x.1 - x.0).max(y.1 - y.0).max(1e-3);
    let [width, tall] = [x, y].map(|(low, high)| high - low + 2.0 * air);
    let height = (WIDTH * tall / width).clamp(150.0, 430.0);
    let pixels_a_metre = (WIDTH / width).min(height / tall);
    let ends = |(low, high): (f64, f64), pixels: f64| {
        let (middle, half) = (f64::midpoint(low, high), pixels / pixels_a_metre / 2.0);
        (middle - half, middle + half)
    };
    (ends(x, WIDTH), ends(y, height), height)
}

/// How long steps from an id to the next are.
fn steps(found: &Trajectory) -> Option<Figure> {
    let longest = 1.3 * found.step(0.98);
    if found.steps.is_empty() || longest <= 0.0 {
        return None;
    }
    let mut counts = [0.0; BARS];
    for step in found.steps.iter().filter(|step| **step < longest) {
        counts[((step / longest * BARS as f64) as usize).min(BARS - 1)] += 1.0;
    }
    let edge = |k: usize| 1e3 * longest * k as f64 / BARS as f64;
    let top = counts.iter().enumerate().flat_map(|(k, n)| [(edge(k), *n), (edge(k + 1), *n)]);
    let outline: Vec<(f64, f64)> = [(0.0, 0.0)].into_iter().chain(top).chain([(edge(BARS), 0.0)]).collect();
    let beyond = found.steps.iter().filter(|step| **step >= longest).count();
    let name = if beyond > 0 { format!("step [mm]; {beyond} are longer") } else { "step [mm]".into() };
    let most = counts.iter().fold(1.0, |most: f64, n| most.max(*n));
    let chart = Chart {
        x: Axis { ends: Some((0.0, edge(BARS))), ..axis(&name) },
        y: Axis { ends: Some((0.0, 1.08 * most)), ..axis("steps") },
        lines: vec![
            Line::new(outline.clone(), Style::line(BLUE, 1.4, Stroke::FULL)),
            Line::new(outline, Style::line(BLUE, 1.4, Stroke::Area)),
        ],
        ..Chart::default()
    };
    figure("From an id to the next", &chart)
}
