//! What is drawn on the page: with colours that the colour-blind tell apart, and strokes that greyscale does.

mod places;

pub(super) use places::{DOTS, positions, time_bar};

use crate::{Divided, Freedom, Pictures, Pose};
use pwrfgs_core::{Dataset, ImagePlane, evenly};
use pwrfgs_experiment::repeatability::Repeatability;
use pwrfgs_report::draw::canvas::{Anchor, BLACK, Canvas, Colour, INK};
use pwrfgs_report::draw::charts::{Axis, Chart, Line, Look};
use pwrfgs_report::draw::marks::{Marker, Stroke, Style};
use pwrfgs_report::draw::spectra::{Mark, Scale, map, pixels};

/// Pictures on the contact sheet, and how many stand beside each other.
pub(super) const SHEET: usize = 24;
const ACROSS: usize = 4;
/// Most corners of a line of distances.
const CORNERS: usize = 200;
/// Most dots of directions.
const DIRECTIONS: usize = 1_500;

const BLUE: Colour = Colour::hex(0x00_5aa0);
const ORANGE: Colour = Colour::hex(0xd5_5e00);
/// Of splits.
const COLOURS: [u32; 6] = [0x00_5aa0, 0xd5_5e00, 0x00_9e73, 0x78_286e, 0xe6_9f00, 0x10_1318];
const STROKES: [Stroke; 4] = [Stroke::FULL, Stroke::DASHED, Stroke::DASH_DOTTED, Stroke::DOTTED];

/// A heading and a picture.
pub(crate) type Figure = (String, String);

fn axis(name: &str) -> Axis {
    Axis { name: name.into(), ..Axis::default() }
}

/// A chart of the usual size without room for names above it, unless it has a size of its own.
fn figure(title: &str, chart: &Chart) -> Option<Figure> {
    let mut chart = chart.clone();
    chart.look.margins[1] = 12.0;
    chart.draw().map(|canvas| (title.to_owned(), canvas.svg("chart", title)))
}

fn dots(points: Vec<(f64, f64)>, colour: Colour, width: f64) -> Line {
    Line::new(points, Style::line(colour, width, Stroke::Dots))
}

/// Spectra side by side, with their ids.
pub(super) fn sheet(data: &Dataset) -> String {
    let all: Vec<usize> = (0..data.len()).collect();
    let chosen = evenly(&all, SHEET);
    let (width, gap, text) = (196.0, 8.0, 14.0);
    let height = (width * data.height as f64 / data.width as f64).clamp(20.0, 200.0);
    let rows = chosen.len().div_ceil(ACROSS) as f64;
    let mut canvas = Canvas::new(ACROSS as f64 * (width + gap) - gap, rows * (height + text + gap));
    canvas.letters.size = 10.0;
    for (k, &i) in chosen.iter().enumerate() {
        let (x, y) = ((k % ACROSS) as f64 * (width + gap), (k / ACROSS) as f64 * (height + text + gap));
        canvas.framed([x, y + text], [width, height], pixels(&data.image(i), &data.plane(), Scale::Power));
        canvas.text([x, y + text - 4.0], Anchor::Start, format!("id {}", data.sample(i).id));
    }
    canvas.svg("sheet", "spectra side by side")
}

/// The mean picture with its colours.
pub(super) fn mean(pictures: &Pictures, plane: &ImagePlane) -> String {
    let mean = &pictures.mean;
    let mut canvas = map(mean, plane, Scale::Power, &[Mark::Measured(mean.argmax())]);
    let below = canvas.height;
    canvas.height += 30.0;
    canvas.letters.colour = INK;
    Scale::Power.draw(&mut canvas, [124.0, below], 200.0);
    canvas.svg("map", "mean spectrum")
}

/// What principal components leave.
pub(super) fn freedom(freedom: &Freedom) -> Option<String> {
    let components = freedom.components.as_ref()?;
    let left = components.residuals.iter().enumerate().map(|(k, r)| (k as f64, *r)).collect();
    let rounding = Line::level(freedom.rounding(), Style::line(INK, 1.0, Stroke::DASHED)).named("rounding");
    let chart = Chart {
        x: axis("principal components"),
        y: Axis { log: true, ..axis("RMS of what is left") },
        lines: vec![
            Line::new(left, Style::line(BLUE, 2.0, Stroke::FULL)).named("pictures that had no part in them"),
            rounding,
        ],
        ..Chart::default()
    };
    figure("how many numbers", &chart).map(|f| f.1)
}

/// Degrees from the boresight of the rings on the sky: the outer holds all there is, up to the plane of the array.
pub(super) fn rings(pose: &Pose) -> [f64; 2] {
    let far = pose.shown.iter().flatten().map(|(_, el)| 90.0 - el).fold(10.0, f64::max);
    let rim = ((far / 10.0).ceil() * 10.0).min(90.0);
    [rim, rim / 2.0]
}

/// Lines of sight and strongest directions: on the sky, azimuth against azimuth, elevation against elevation.
pub(super) fn pose(pose: &Pose) -> Vec<Figure> {
    let shown = evenly(&pose.shown, DIRECTIONS);
    let on_sky = |(az, el): (f64, f64)| {
        let ((sin, cos), radius) = (az.to_radians().sin_cos(), 90.0 - el);
        (radius * cos, radius * sin)
    };
    let [rim, inner] = rings(pose);
    let ring = |radius: f64| (0..=72).map(|k| on_sky((5.0 * f64::from(k), 90.0 - radius))).collect::<Vec<_>>();
    let rings = [rim, inner].map(|radius| Line::new(ring(radius), Style::line(INK, 0.7, Stroke::FULL)));
    let both = Some((-1.05 * rim, 1.05 * rim));
    let named = |k: usize, colour, marker, name: &str| {
        let points: Vec<(f64, f64)> =
            shown.iter().map(|pair| on_sky(pair[k])).filter(|p| p.0.hypot(p.1) <= 1.01 * rim).collect();
        let width = if k == 0 { 3.4 } else { 2.4 };
        let sample = Style { marker: Some(marker), ..Style::line(colour, 0.0, Stroke::None) };
        [dots(points, colour.faint(0.7), width), Line::new(vec![], sample).named(name)]
    };
    let mut lines: Vec<Line> = named(0, BLUE, Marker::Circle, "line of sight").into();
    lines.extend(named(1, ORANGE, Marker::Circle, "strongest direction"));
    lines.extend(rings);
    let look = Look { size: [376.0, 350.0], margins: [58.0, 12.0, 18.0, 38.0] };
    let sky = Chart {
        look,
        x: Axis { ends: both, ..axis("degrees from the boresight, along x") },
        y: Axis { ends: both, ..axis("degrees from the boresight, along y") },
        lines,
        ..Chart::default()
    };
    let against = |name: &str, pick: fn((f64, f64)) -> f64, ends: (f64, f64)| {
        let points = shown.iter().map(|[a, b]| (pick(*a), pick(*b))).collect();
        let equal = Line::new(vec![(ends.0, ends.0), (ends.1, ends.1)], Style::line(INK, 1.0, Stroke::DASHED));
        Chart {
            look,
            x: Axis { ends: Some(ends), ..axis(&format!("{name} of the line of sight [°]")) },
            y: Axis { ends: Some(ends), ..axis(&format!("{name} of the strongest direction [°]")) },
            lines: vec![dots(points, BLUE.faint(0.7), 2.4), equal.named("equal")],
            ..Chart::default()
        }
    };
    let lowest = shown.iter().flatten().map(|(_, el)| *el).fold(0.0, f64::min);
    let elevations = (if lowest < -1.0 { -90.0 } else { 0.0 }, 90.0);
    let figures = [
        figure("Seen from the receiver", &sky),
        figure("Azimuth", &against("azimuth", |d| d.0, (0.0, 360.0))),
        figure("Elevation above the array", &against("elevation", |d| d.1, elevations)),
    ];
    figures.into_iter().flatten().collect()
}

/// The share of test transmitters that have a training transmitter within a distance, for each split.
pub(super) fn distances(splits: &[Divided]) -> Option<String> {
    let outcomes = splits.iter().filter_map(|d| Some((d, d.outcome.as_ref().ok()?)));
    let line = |(k, (divided, outcome)): (usize, (&Divided, &crate::Outcome))| {
        let all = &outcome.distances;
        let share = |i: usize| (all[i], 100.0 * (i + 1) as f64 / all.len() as f64);
        let corners = evenly(&(0..all.len()).collect::<Vec<_>>(), CORNERS);
        let points = corners.into_iter().map(share).filter(|p| p.0 > 0.0).collect();
        Line::new(points, look_of(k)).named(&divided.name)
    };
    let chart = Chart {
        x: Axis { log: true, ..axis("distance to the nearest training transmitter [m]") },
        y: Axis { ends: Some((0.0, 100.0)), ..axis("test transmitters [%]") },
        lines: outcomes.enumerate().map(line).collect(),
        ..Chart::default()
    };
    figure("distance from test to training", &chart).map(|f| f.1)
}

fn look_of(k: usize) -> Style {
    Style::line(Colour::hex(COLOURS[k % COLOURS.len()]), 2.0, STROKES[k % STROKES.len()])
}

/// Similarity against distance, for pairs near in time and far: one figure a metric.
pub(crate) fn similarity(found: &Repeatability) -> Vec<Figure> {
    let kinds = [
        (&found.near, "near in time", BLUE, Stroke::FULL, Marker::Circle),
        (&found.far, "far apart in time", ORANGE, Stroke::DASHED, Marker::Diamond),
    ];
    let of_metric = |k: usize| {
        let mut lines = Vec::new();
        for (likeness, name, colour, stroke, marker) in kinds {
            let similarity = likeness.metrics.get(k)?;
            let points = similarity.bins.iter().map(|b| ((b.from_m.max(1e-4) * b.to_m).sqrt(), b.mean)).collect();
            let mut line =
                Line::new(points, Style { marker: Some(marker), ..Style::line(colour, 1.8, stroke) }).named(name);
            line.marks.clone_from(&line.points);
            lines.push(line);
            if let Ok(zero) = &similarity.at_zero {
                lines.push(Line::level(zero.mean, Style::line(colour, 1.0, Stroke::DOTTED)).named_at_end("ceiling"));
            }
        }
        let unrelated = found.near.metrics.get(k)?.unrelated;
        if unrelated.is_finite() {
            lines.push(Line::level(unrelated, Style::line(BLACK, 1.0, Stroke::DOTTED)).named_at_end("any two"));
        }
        let key = found.near.metrics[k].key.clone();
        let chart = Chart {
            x: Axis { log: true, ..axis("distance between two transmitters [m]") },
            y: axis(&format!("{key}, mean over pairs")),
            lines,
            ..Chart::default()
        };
        figure(&key, &chart)
    };
    (0..found.near.metrics.len()).filter_map(of_metric).collect()
}
