//! Maps of errors over the room, one per receiver: received powers with their sign in dB, spectra as 1 − SSIM.

use crate::canvas::{Anchor, Canvas, Colour, INK, Paint, text_width};
use crate::draw::plan::{FloorPlan, draw_receiver};
use crate::draw::spectra::ColourScale;
use minijinja::{Value, context};
use pwrfgs_core::colour::{diverging, sequential};
use pwrfgs_core::statistics::{evenly, quantile, sorted};
use pwrfgs_experiment::{LoadedRun, scores::MODEL};

/// Maximum number of maps, and of transmitters per map.
const MAPS: usize = 24;
const SHOWN: usize = 500;
/// Maximum number of surface points in the background.
const POINTS: usize = 800;
/// Width of the drawing of a map, and its maximum height without axes.
const WIDTH: f64 = 290.0;
const MOST_HEIGHT: f64 = 250.0;

/// Error of the prediction for one test link.
#[derive(Clone, Copy)]
pub(super) struct LinkError {
    pub(super) link: usize,
    pub(super) error: f64,
}

/// Colours and sizes of the marks.
#[derive(Clone, Copy)]
enum ErrorScale {
    /// Errors of both signs up to this size, dB.
    Signed(f64),
    /// 1 − SSIM from 0 to this size.
    Positive(f64),
}

/// Draws the maps of 1 − SSIM of the test spectra; `None` for other tasks, without positions, or if the pipeline lacks the
/// metric.
pub(super) fn spectrum_error_maps(run: &LoadedRun<'_>) -> Option<Value> {
    let headline = run.data.task().headline;
    let scores = run.record.scores.sample_values(MODEL, headline.key).filter(|_| run.data.task().has_pixels)?;
    let best = headline.best?;
    let error = |(&link, score): (&usize, &f64)| LinkError { link, error: best - score };
    error_maps(run, run.partition.test.iter().zip(scores).map(error).filter(|error| error.error.is_finite()).collect())
}

/// Draws a map of errors per receiver, of at most [`MAPS`] receivers, with legend; `None` without positions or errors.
pub(super) fn error_maps(run: &LoadedRun<'_>, errors: Vec<LinkError>) -> Option<Value> {
    let data = run.data;
    if !data.placed || errors.is_empty() {
        return None;
    }
    let receivers = &data.scene.receivers;
    let scale = ErrorScale::new(&errors, data.task().has_pixels);
    let mut per_receiver: Vec<Vec<LinkError>> = vec![Vec::new(); receivers.len()];
    errors.into_iter().for_each(|error| per_receiver[data.links[error.link].receiver].push(error));
    let with_links: Vec<usize> = (0..receivers.len()).filter(|&r| !per_receiver[r].is_empty()).collect();
    let map = |&r: &usize| {
        let name = receivers[r].name.clone();
        let svg = draw_map(run, r, &per_receiver[r], scale).svg("map", &format!("errors at {name}"));
        context! { name, svg, links => per_receiver[r].len() }
    };
    let (quantity, bar) = match scale {
        ErrorScale::Signed(limit) => ("predicted minus measured, dB", Some(ColourScale::Error(limit).draw_bar())),
        ErrorScale::Positive(_) => ("1 − SSIM", None),
    };
    Some(context! {
        quantity,
        maps => with_links.iter().take(MAPS).map(map).collect::<Vec<_>>(),
        unshown => with_links.len().saturating_sub(MAPS),
        most => SHOWN,
        cut => per_receiver.iter().any(|errors| errors.len() > SHOWN),
        legend => scale.draw_legend().svg("legend", "legend of the marks"),
        bar => bar.map(|bar| bar.svg("bar", "colour scale of the error, dB")),
    })
}

/// Draws the map of one receiver, in a frame around it and all transmitters that it received.
fn draw_map(run: &LoadedRun<'_>, receiver: usize, errors: &[LinkError], scale: ErrorScale) -> Canvas {
    let data = run.data;
    let flat = |[x, y, _]: [f64; 3]| [x, y];
    let ends = if data.scene.has_distances() { data.scene.fixed_ends() } else { Vec::new() };
    // If the receivers move, the only fixed end is the transmitter.
    let fixed = ends.get(receiver).or(ends.first()).map(|pose| flat(data.scene.origin.world_pose(*pose).position));
    let links = || data.samples().filter(|sample| sample.receiver == receiver).map(|sample| flat(sample.position()));
    let plan = FloorPlan::new(FloorPlan::frame(links().chain(fixed)), ["x", "y"], WIDTH, MOST_HEIGHT);
    let mut canvas = plan.empty_map();
    let points = evenly(&data.scene.points, POINTS);
    plan.draw_points(&mut canvas, points.into_iter().map(|p| flat(data.scene.origin.world(p))));
    let mut shown = evenly(errors, SHOWN);
    shown.sort_by(|a, b| a.error.abs().total_cmp(&b.error.abs())); // the worst on top
    for error in &shown {
        scale.draw(&mut canvas, plan.project(flat(data.sample(error.link).position())), error.error);
    }
    fixed.into_iter().for_each(|position| plan.draw_receiver(&mut canvas, position));
    plan.draw_axes(&mut canvas);
    FloorPlan::centred_in(&canvas, WIDTH)
}

impl ErrorScale {
    /// Creates the scale up to the 95th percentile of the absolute errors, as `maps.html` says: a few large errors would make all
    /// others white. The limit is rounded up to a multiple of 0.05 of 1 − SSIM, or of 1 dB.
    fn new(errors: &[LinkError], is_positive: bool) -> Self {
        let most = quantile(&sorted(errors.iter().map(|error| error.error.abs())), 0.95);
        if is_positive {
            Self::Positive(((20.0 * most).ceil() / 20.0).max(0.05))
        } else {
            Self::Signed(most.ceil().max(1.0))
        }
    }

    /// Draws a mark, larger for larger errors: a circle, or for signed errors a triangle that points up for too high
    /// and down for too low predictions, so that the sign needs no colour.
    fn draw(self, canvas: &mut Canvas, [x, y]: [f64; 2], error: f64) {
        let (Self::Signed(limit) | Self::Positive(limit)) = self;
        let part = (error / limit).clamp(-1.0, 1.0);
        let size = 2.0 + 3.4 * part.abs().sqrt();
        let paint = |rgb| Paint::fill(Colour { rgb, opacity: 1.0 }).outlined(INK.with_opacity(0.7), 0.5);
        if matches!(self, Self::Positive(_)) {
            return canvas.circle([x, y], size, paint(sequential(part)));
        }
        let up = if part < 0.0 { -1.0 } else { 1.0 };
        let beside = |side: f64| [x + side * 0.9 * size, y + 0.65 * up * size];
        canvas.polygon(&[[x, y - up * size], beside(1.0), beside(-1.0)], paint(diverging(part)));
    }

    /// Draws the legend of the marks.
    fn draw_legend(self) -> Canvas {
        let marks = match self {
            Self::Signed(limit) => vec![
                (-limit, format!("{limit} dB too low")),
                (-limit / 2.0, format!("{} dB", limit / 2.0)),
                (0.02 * limit, "0 dB".to_owned()), // at 0, the triangle is too small to see
                (limit / 2.0, format!("{} dB", limit / 2.0)),
                (limit, format!("{limit} dB or more too high")),
            ],
            Self::Positive(limit) => vec![
                (0.0, "1 − SSIM = 0".to_owned()),
                (limit / 2.0, format!("{:.3}", limit / 2.0)),
                (limit, format!("{limit:.2} or more")),
            ],
        };
        let mut canvas = Canvas::new(0.0, 18.0);
        let mut x = 8.0;
        for (error, words) in marks {
            self.draw(&mut canvas, [x, 9.0], error);
            canvas.text([x + 9.0, 13.0], Anchor::Start, &words);
            x += 24.0 + text_width(&words);
        }
        draw_receiver(&mut canvas, [x + 2.0, 9.0]);
        canvas.text([x + 13.0, 13.0], Anchor::Start, "receiver");
        canvas.width = x + 80.0;
        FloorPlan::centred_in(&canvas, 560.0)
    }
}
