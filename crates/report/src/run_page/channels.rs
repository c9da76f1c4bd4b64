//! What the page shows of channels: magnitude and phase of a few links, their power delay profiles, and where a model
//! without splats puts its transmitters.

mod curves;
mod profile;
mod virtual_map;

use super::examples::Example;
use crate::canvas::{BLACK, Colour};
use crate::draw::charts::{Axis, Chart, Line, Look};
use crate::draw::marks::{Marker, Stroke, Style};
use curves::Gains;
use minijinja::{Value, context};
use pwrfgs_core::{Image, evenly};
use pwrfgs_experiment::LoadedRun;
use pwrfgs_experiment::text::number;

/// Links on the plane of complex numbers.
const DOTS: usize = 150;
const MEASURED: Colour = BLACK;
const PREDICTED: Colour = Colour::hex(0xd5_5e00);
/// Three beside each other.
const LOOK: Look = Look { size: [380.0, 250.0], margins: [56.0, 10.0, 16.0, 38.0] };

/// Examples, and the map of virtual transmitters.
pub(super) fn section(run: &LoadedRun<'_>, chosen: &[Example]) -> Value {
    let data = run.data;
    let single = data.width == 1 && data.height == 2;
    context! {
        examples => if single { Vec::new() } else { examples(run, chosen) },
        plane => if single { plane(run) } else { None },
        over => if data.width > 1 { "subcarriers" } else { "antennas" },
        delays => profile::spacing(frequencies(run)).is_some(),
        transmitters => virtual_map::map(run),
    }
}

/// Subcarriers, Hz.
fn frequencies<'a>(run: &LoadedRun<'a>) -> &'a [f64] {
    run.data.observations.frequencies_hz()
}

/// Measured as a full dark line with dots, predicted dashed with crosses: print needs no colour.
fn pair(measured: Vec<(f64, f64)>, predicted: Vec<(f64, f64)>) -> Vec<Line> {
    vec![
        marked(predicted, PREDICTED, Stroke::DASHED, Marker::Cross, "predicted"),
        marked(measured, MEASURED, Stroke::FULL, Marker::Circle, "measured"),
    ]
}

/// A line with marks where they are few enough to be told apart, or have no line.
fn marked(points: Vec<(f64, f64)>, colour: Colour, stroke: Stroke, marker: Marker, name: &str) -> Line {
    let has_marks = points.len() <= 70 || stroke == Stroke::None;
    let style = Style { marker: has_marks.then_some(marker), ..Style::line(colour, 1.6, stroke) };
    let marks = if has_marks { points.clone() } else { Vec::new() };
    Line { marks, ..Line::new(points, style) }.named(name)
}

/// A chart of a measured and a predicted line.
fn chart(title: &str, x: &str, y: &str, lines: Vec<Line>) -> Option<Value> {
    let axis = |name: &str| Axis { name: name.into(), ..Axis::default() };
    let svg = Chart { look: LOOK, x: axis(x), y: axis(y), lines, ..Chart::default() }.draw()?.svg("chart", title);
    Some(context! { title, svg })
}

/// The best, the median and the worst test link.
fn examples(run: &LoadedRun<'_>, chosen: &[Example]) -> Vec<Value> {
    let example = |Example { which, sample, score, nearest_m, truth, prediction }: &Example| {
        let own = run.data.sample(*sample);
        let receivers = &run.data.scene.receivers;
        let frequencies = frequencies(run);
        let (measured, predicted) = (Gains::of(truth), Gains::of(prediction));
        let (lines, along, antenna) = curves::lines(&measured, &predicted, frequencies);
        let of = antenna.map(|k| format!("antenna {} of {}, the strongest", k + 1, measured.antennas));
        let mut charts = vec![
            chart("Magnitude", &along, "dB over the strongest", pair(lines[0].0.clone(), lines[0].1.clone())),
            chart("Phase", &along, "degrees, unwrapped", pair(lines[1].0.clone(), lines[1].1.clone())),
        ];
        if let Some([a, b]) = profile::profiles(&measured, &predicted, frequencies) {
            charts.push(chart("Power delay profile", "delay, ns", "dB over the measured peak", pair(a, b)));
        }
        context! {
            which => *which,
            id => own.id,
            receiver => (receivers.len() > 1).then(|| receivers[own.receiver].name.clone()),
            tx => run.data.placed.then(|| own.tx.map(|v| format!("{v:.2}")).join(", ")),
            nearest => nearest_m.map(|distance| format!("{distance:.2} m")),
            score => number(*score),
            antenna => of,
            charts => charts.into_iter().flatten().collect::<Vec<_>>(),
        }
    };
    chosen.iter().map(example).collect()
}

/// Channels of one number each, as dots on the plane of complex numbers; measured and predicted are joined.
fn plane(run: &LoadedRun<'_>) -> Option<Value> {
    let (mut measured, mut predicted) = (Vec::new(), Vec::new());
    super::predicted::each(run, &evenly(&run.partition.test, DOTS), |_, truth, prediction| {
        let place = |image: &Image| (image.pixels[0] as f64, image.pixels[1] as f64);
        measured.push(place(truth));
        predicted.push(place(prediction));
    });
    let reach = measured.iter().chain(&predicted).flat_map(|(a, b)| [a.abs(), b.abs()]).filter(|v| v.is_finite());
    let reach = 1.08 * reach.fold(0.0, f64::max);
    let mut lines = vec![
        marked(predicted.clone(), PREDICTED, Stroke::None, Marker::Cross, "predicted"),
        marked(measured.clone(), MEASURED, Stroke::None, Marker::Circle, "measured"),
    ];
    let joined = Style::line(Colour::hex(0x8d_94a1), 0.8, Stroke::FULL);
    lines.extend(measured.iter().zip(&predicted).map(|(a, b)| Line::new(vec![*a, *b], joined)));
    let axis = |name: &str| Axis { name: name.into(), ends: Some((-reach, reach)), log: false };
    let look = Look { size: [470.0, 450.0], ..LOOK };
    let chart = Chart { look, x: axis("real part"), y: axis("imaginary part"), lines, ..Chart::default() };
    if measured.is_empty() || reach <= 0.0 {
        return None;
    }
    Some(context! { svg => chart.draw()?.svg("chart", "channels on the complex plane"), links => measured.len() })
}
