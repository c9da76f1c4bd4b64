//! `--record`: a walk of the transmitter as an animated picture, drawn by the report's own drawings.

use crate::side::{Predictor, Side};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, RgbaImage};
use pwrfgs_core::files::{check_new_file, write_atomically};
use pwrfgs_core::{Error, Image, Query, Real, Result, Task, evenly};
use pwrfgs_experiment::Observer;
use pwrfgs_report::draw::canvas::{Anchor, Canvas, Colour, Paint, Point};
use pwrfgs_report::draw::charts::{Axis, Chart, Line, Look};
use pwrfgs_report::draw::marks::{Marker, Stroke, Style};
use pwrfgs_report::draw::plan::Plan;
use pwrfgs_report::draw::spectra::{self, Mark, Scale};
use std::path::Path;
use std::time::Duration;

/// Pixels a unit of the drawing.
const SCALE: f64 = 1.0;
/// How long a frame stays.
const FRAME: Duration = Duration::from_millis(100);
/// Surface points that a frame shows.
const POINTS: usize = 2_000;
/// The longest walk: a GIF of more is larger than anybody sends.
const MOST: usize = 2_000;
const ROOM: f64 = 300.0;
const HEAD: f64 = 26.0;
const WALK: Colour = Colour::hex(0xc2_7c00);
const PREDICTED: Colour = Colour::hex(0xd5_5e00);

/// Draws a frame for each position (metres, world frame) into a new GIF at `out`, and gives their number.
///
/// # Errors
/// A file that exists, too long a walk, a run without a model yet, or one that is not asked by position.
pub fn record(sides: &[Side], walk: &[[f64; 3]], out: &Path, observer: &mut dyn Observer) -> Result<usize> {
    check_new_file(out)?;
    if walk.len() > MOST {
        return Err(Error::Config(format!("{} positions: give {MOST} at most, ten are a second", walk.len())));
    }
    let mut predictors = Vec::new();
    for side in sides {
        let none = || Error::Config(format!("{}: there is no model before the first checkpoint", side.name));
        let predictor = side.predictor().ok_or_else(none)?;
        if !predictor.by_position() {
            let what = "the model takes features in place of a transmitter position; score it with `pwrfgs evaluate`";
            return Err(Error::Config(format!("{}: {what}", side.name)));
        }
        predictors.push(predictor);
    }
    let mut gif = Vec::new();
    {
        let mut encoder = GifEncoder::new_with_speed(&mut gif, 10);
        let failed = |e: image::ImageError| Error::Config(format!("cannot make the GIF: {e}"));
        encoder.set_repeat(Repeat::Infinite).map_err(failed)?;
        for (k, tx) in walk.iter().enumerate() {
            let (width, height, bytes) = frame(sides, &predictors, &walk[..=k], *tx).rgba(SCALE);
            let picture = RgbaImage::from_raw(width, height, bytes).expect("four bytes a pixel");
            let delay = Delay::from_saturating_duration(FRAME);
            encoder.encode_frame(Frame::from_parts(picture, 0, 0, delay)).map_err(failed)?;
            observer.on_stage("recording", k + 1, walk.len());
        }
    }
    write_atomically(out, &gif)?;
    Ok(walk.len())
}

/// The room seen from above beside what each side predicts.
fn frame(sides: &[Side], predictors: &[std::sync::Arc<Predictor>], walk: &[[f64; 3]], tx: [f64; 3]) -> Canvas {
    let room = room(&sides[0], walk, tx);
    let parts: Vec<Canvas> = predictors.iter().zip(sides).map(|(p, side)| part(side, p, tx)).collect();
    let width = room.width + parts.iter().map(|part| part.width + 12.0).sum::<f64>();
    let height = parts.iter().map(|part| part.height).fold(room.height, f64::max) + HEAD;
    let mut canvas = Canvas::new(width, height);
    let known = sides[0].known.as_ref();
    let data = known.map_or_else(String::new, |known| {
        let word = if known.data.is_simulated() { "simulated data" } else { "measured data" };
        format!("{}: {word}", known.data.title)
    });
    canvas.text([12.0, 17.0], Anchor::Start, data);
    canvas.put([0.0, HEAD], 1.0, &room);
    let mut left = room.width + 12.0;
    for part in parts {
        canvas.put([left, HEAD], 1.0, &part);
        left += part.width + 12.0;
    }
    canvas
}

fn flat(place: [f64; 3]) -> Point {
    [place[0], place[1]]
}

fn room(side: &Side, walk: &[[f64; 3]], tx: [f64; 3]) -> Canvas {
    let receivers =
        side.frame.receivers.iter().map(|r| flat(side.frame.origin.world(r.pose.position.map(|v| v as Real))));
    let receivers: Vec<Point> = receivers.collect();
    let mut places: Vec<Point> = receivers.iter().copied().chain(walk.iter().copied().map(flat)).collect();
    let mut points: Vec<Point> = Vec::new();
    if let Some(known) = &side.known {
        let scene = &known.data.scene;
        let all: Vec<usize> = (0..scene.points.len()).collect();
        points = evenly(&all, POINTS).into_iter().map(|i| flat(scene.origin.world(scene.points[i]))).collect();
        places.extend([scene.bounds.0, scene.bounds.1].map(|corner| flat(scene.origin.world(corner))));
    }
    let plan = Plan::new(Plan::corners(places), ["x", "y"], ROOM, ROOM);
    let mut canvas = plan.canvas();
    plan.points(&mut canvas, points);
    let trail: Vec<Point> = walk.iter().map(|place| plan.place(flat(*place))).collect();
    canvas.line(&trail, Paint::stroke(WALK.faint(0.6), 1.4));
    receivers.iter().for_each(|at| plan.receiver(&mut canvas, *at));
    canvas.circle(plan.place(flat(tx)), 5.0, Paint::fill(WALK).outlined(Colour::hex(0x10_1318), 1.0));
    plan.axes(&mut canvas);
    canvas
}

/// What is predicted of a transmitter, as its kind is shown.
fn part(side: &Side, predictor: &Predictor, tx: [f64; 3]) -> Canvas {
    let heard = |receiver: usize| predictor.predict(Query::at(tx, receiver)).image;
    let picture = match side.frame.task {
        Task::Spectrum => sky(side, &heard(0)),
        Task::Power => {
            let all = (0..side.frame.receivers.len()).map(|r| (r as f64 + 1.0, f64::from(heard(r).pixels[0] as f32)));
            lines("receiver", "received power, dBm", all.collect(), true)
        }
        Task::Channel => {
            let image = heard(0);
            let level = |k: usize| {
                let (re, im) = (image.pixels[k], image.pixels[image.width + k]);
                (k as f64, f64::from((10.0 * (re * re + im * im).log10()) as f32))
            };
            lines("subcarrier", "first antenna, dB", (0..image.width).map(level).collect(), false)
        }
    };
    let [x, y, z] = tx.map(|v| format!("{v:.2}"));
    let mut canvas = Canvas::new(picture.width, picture.height + 18.0);
    canvas.text([12.0, 12.0], Anchor::Start, format!("{}, transmitter at ({x}, {y}, {z}) m", side.name));
    canvas.put([0.0, 18.0], 1.0, &picture);
    canvas
}

fn sky(side: &Side, image: &Image) -> Canvas {
    let (plane, marks) = (&side.frame.plane, [Mark::Predicted(image.argmax())]);
    let clamped = image.clamped();
    let map = spectra::map(&clamped, plane, Scale::Power, &marks);
    let mut canvas = Canvas::new(map.width, map.height + 260.0);
    canvas.put([0.0, 0.0], 1.0, &map);
    if let Some(sky) = spectra::sky(&clamped, plane, Scale::Power, &marks) {
        canvas.put([(map.width - sky.width) / 2.0 + 12.0, map.height], 1.0, &sky);
    }
    Scale::Power.draw(&mut canvas, [(map.width - 200.0) / 2.0 + 12.0, map.height + 230.0], 200.0);
    canvas
}

fn lines(x: &str, y: &str, points: Vec<(f64, f64)>, alone: bool) -> Canvas {
    let style = Style { marker: alone.then_some(Marker::Circle), ..Style::line(PREDICTED, 1.6, Stroke::FULL) };
    let marks = if alone { points.clone() } else { Vec::new() };
    let lines = vec![Line { marks, ..Line::new(points, style) }];
    let axis = |name: &str| Axis { name: name.into(), ..Axis::default() };
    let look = Look { size: [420.0, 260.0], margins: [56.0, 10.0, 16.0, 38.0] };
    let chart = Chart { look, x: axis(x), y: axis(y), lines, ..Chart::default() };
    chart.draw().unwrap_or_else(|| Canvas::new(420.0, 260.0))
}
