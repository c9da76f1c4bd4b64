//! Where errors lie on the floor: a small map a receiver, with its test transmitters.

use super::Heard;
use crate::canvas::{Anchor, Canvas, Colour, INK, Paint};
use crate::draw::plan::{Plan, draw_receiver};
use crate::draw::spectra::Scale;
use minijinja::{Value, context};
use pwrfgs_core::colour::diverging;
use pwrfgs_core::evenly;
use pwrfgs_experiment::LoadedRun;
use pwrfgs_experiment::statistics::quantile;

/// Most maps, and most transmitters on each.
const MAPS: usize = 24;
const SHOWN: usize = 500;
/// Most surface points behind.
const POINTS: usize = 800;
/// Width of a map's picture, and its largest height without axes.
const WIDTH: f64 = 290.0;
const MOST_HEIGHT: f64 = 250.0;

/// Maps of as many receivers as are shown; nothing where no place is known.
pub(super) fn maps(run: &LoadedRun<'_>, heard: &[Heard]) -> Option<Value> {
    let data = run.data;
    if !data.placed || heard.is_empty() {
        return None;
    }
    let receivers = &data.scene.receivers;
    let mut of_each: Vec<Vec<Heard>> = vec![Vec::new(); receivers.len()];
    heard.iter().for_each(|own| of_each[data.links[own.link].receiver].push(*own));
    let with_links: Vec<usize> = (0..receivers.len()).filter(|&r| !of_each[r].is_empty()).collect();
    let mut sizes: Vec<f64> = heard.iter().map(|own| own.error().abs()).collect();
    sizes.sort_by(f64::total_cmp);
    // A few wild ones would make all others white.
    let limit = quantile(&sizes, 0.95).ceil().max(1.0);
    let map = |&r: &usize| {
        let name = receivers[r].name.clone();
        let svg = draw(run, r, &of_each[r], limit).svg("map", &format!("errors at {name}"));
        context! { name, svg, links => of_each[r].len() }
    };
    let scale = Scale::Error(limit);
    Some(context! {
        maps => with_links.iter().take(MAPS).map(map).collect::<Vec<_>>(),
        unshown => with_links.len().saturating_sub(MAPS),
        most => SHOWN,
        cut => of_each.iter().any(|own| own.len() > SHOWN),
        legend => legend(limit).svg("legend", "what the marks mean"),
        bar => scale.bar().svg("bar", "colours of the error, dB"),
    })
}

/// The map of one receiver, in the frame of all transmitters that it has heard.
fn draw(run: &LoadedRun<'_>, receiver: usize, heard: &[Heard], limit: f64) -> Canvas {
    let data = run.data;
    let flat = |[x, y, _]: [f64; 3]| [x, y];
    let own = data.scene.origin.world_pose(data.scene.receivers[receiver].pose).position;
    let links = || data.samples().filter(|sample| sample.receiver == receiver).map(|sample| flat(sample.tx));
    let plan = Plan::new(Plan::corners(links().chain([flat(own)])), ["x", "y"], WIDTH, MOST_HEIGHT);
    let mut canvas = plan.canvas();
    let points = evenly(&data.scene.points, POINTS);
    plan.points(&mut canvas, points.into_iter().map(|p| flat(data.scene.origin.world(p))));
    let mut shown = evenly(heard, SHOWN);
    shown.sort_by(|a, b| a.error().abs().total_cmp(&b.error().abs())); // the worst on top
    for own in &shown {
        draw_error(&mut canvas, plan.place(flat(data.sample(own.link).tx)), own.error() / limit);
    }
    plan.receiver(&mut canvas, flat(own));
    plan.axes(&mut canvas);
    Plan::widened(&canvas, WIDTH)
}

/// A triangle that points up where the model predicts too much and down where too little, the larger the farther off: its
/// sign needs no colour. `error` is in units of the scale's end.
fn draw_error(canvas: &mut Canvas, [x, y]: [f64; 2], error: f64) {
    let size = 2.0 + 3.4 * error.abs().min(1.0).sqrt();
    let up = if error < 0.0 { -1.0 } else { 1.0 };
    let [r, g, b] = diverging(error.clamp(-1.0, 1.0));
    let fill = Colour { rgb: [r, g, b], opacity: 1.0 };
    let corners = [[x, y - up * size], [x + 0.9 * size, y + 0.65 * up * size], [x - 0.9 * size, y + 0.65 * up * size]];
    canvas.polygon(&corners, Paint::fill(fill).outlined(INK.faint(0.7), 0.5));
}

/// What the marks mean.
fn legend(limit: f64) -> Canvas {
    let mut canvas = Canvas::new(560.0, 18.0);
    let mut x = 8.0;
    let half = limit / 2.0;
    for (error, words) in [
        (-1.0, format!("{limit} dB too weak")),
        (-0.5, format!("{half} dB")),
        (0.02, "right".to_owned()),
        (0.5, format!("{half} dB")),
        (1.0, format!("{limit} dB or more too strong")),
    ] {
        draw_error(&mut canvas, [x, 9.0], error);
        canvas.text([x + 9.0, 13.0], Anchor::Start, &words);
        x += 24.0 + crate::canvas::font::text_width(&words);
    }
    draw_receiver(&mut canvas, [x + 2.0, 9.0]);
    canvas.text([x + 13.0, 13.0], Anchor::Start, "receiver");
    canvas.width = x + 80.0;
    canvas
}
