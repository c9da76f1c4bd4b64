//! Virtual transmitters of a model without splats: top and side view of the room.

use crate::canvas::{Anchor, Canvas, Colour, Paint, WHITE, text_width};
use crate::draw::plan::{FloorPlan, draw_receiver};
use minijinja::{Value, context};
use pwrfgs_core::Appearance;
use pwrfgs_core::statistics::{evenly, quantile, sorted};
use pwrfgs_experiment::{LoadedRun, text::grouped};

/// Maximum numbers of drawn transmitters, the strongest, and of surface points, evenly selected.
const SHOWN: usize = 600;
const POINTS: usize = 2_500;
/// Width of a view, and its maximum height without axes.
const WIDTH: f64 = 560.0;
const MOST_HEIGHT: f64 = 420.0;
/// Radius of the strongest transmitter.
const RADIUS: f64 = 9.0;
/// Level below the strongest at which all discs have the smallest size, dB; `channels.html` prints it.
const RANGE_DB: f64 = 40.0;
const BLUE: Colour = Colour::hex(0x17_4a99);
const WALLS: Colour = Colour::hex(0xb4_5f06);

/// Virtual transmitter: position in metres, and level in dB relative to the strongest.
struct MappedSource {
    position: [f64; 3],
    db: f64,
}

/// Draws the virtual transmitters in a top and a side view, with remarks about omitted elements; `None` for a model that is
/// not drawn as points, or has none.
pub(super) fn transmitter_views(run: &LoadedRun<'_>) -> Option<Value> {
    if !run.model.is_drawn_as(Appearance::Points) {
        return None;
    }
    let mut sources = sources_by_strength(run);
    if sources.is_empty() {
        return None;
    }
    let total = sources.len();
    sources.truncate(SHOWN);
    let [(plan, outside), (side, hidden)] = [[0, 1], [0, 2]].map(|axes| draw_view(run, &sources, axes));
    Some(context! {
        plan => plan.svg("map", "top view of the room"),
        side => side.svg("map", "side view of the room"),
        legend => draw_legend(!run.data.scene.points.is_empty()).svg("legend", "legend of the marks"),
        count => grouped(total as i64),
        shown => (total > sources.len()).then(|| grouped(sources.len() as i64)),
        outside => outside.max(hidden),
    })
}

/// Returns the virtual transmitters of all members in the world frame, strongest first, without those that are not finite.
fn sources_by_strength(run: &LoadedRun<'_>) -> Vec<MappedSource> {
    let members = run.model.members();
    let mut sources: Vec<([f64; 3], f64)> = members
        .iter()
        .flat_map(|model| {
            let origin = model.stages.origin;
            let strength = |[re, im]: &[pwrfgs_core::Real; 2]| (*re as f64).hypot(*im as f64);
            model.cloud.means.iter().zip(&model.cloud.signals).map(move |(p, s)| (origin.world(*p), strength(s)))
        })
        .filter(|(position, s)| s.is_finite() && position.iter().all(|v| v.is_finite()))
        .collect();
    sources.sort_by(|a, b| b.1.total_cmp(&a.1));
    let most = sources.first().map_or(0.0, |strongest| strongest.1);
    let db = |s: f64| if s > 0.0 && most > 0.0 { 20.0 * (s / most).log10() } else { f64::NEG_INFINITY };
    sources.into_iter().map(|(position, s)| MappedSource { position, db: db(s) }).collect()
}

/// Draws the view of two `axes`, and returns it with the number of transmitters outside its frame.
fn draw_view(run: &LoadedRun<'_>, sources: &[MappedSource], axes: [usize; 2]) -> (Canvas, usize) {
    let (scene, names) = (&run.data.scene, axes.map(|k| ["x", "y", "z"][k]));
    let flat = |p: [f64; 3]| axes.map(|k| p[k]);
    let walls = [scene.bounds.0, scene.bounds.1].map(|corner| flat(scene.origin.world(corner)));
    let positions: Vec<[f64; 2]> = sources.iter().map(|source| flat(source.position)).collect();
    let plan = FloorPlan::new(view_frame(walls, &positions), names, WIDTH, MOST_HEIGHT);
    let mut canvas = plan.empty_map();
    plan.draw_points(&mut canvas, evenly(&scene.points, POINTS).into_iter().map(|p| flat(scene.origin.world(p))));
    let [a, b] = [plan.project([walls[0][0], walls[1][1]]), plan.project([walls[1][0], walls[0][1]])];
    canvas.rect(a, [b[0] - a[0], b[1] - a[1]], wall_paint());
    let mut outside = 0;
    let paint = Paint::fill(BLUE.with_opacity(0.6)).outlined(WHITE, 0.6);
    for source in sources {
        let position = flat(source.position);
        if plan.contains(position) {
            canvas.circle(plan.project(position), disc_radius(source.db), paint);
        } else {
            outside += 1;
        }
    }
    scene.known_ends().into_iter().for_each(|position| plan.draw_receiver(&mut canvas, flat(position)));
    plan.draw_axes(&mut canvas);
    (FloorPlan::centred_in(&canvas, WIDTH), outside)
}

/// Returns the paint of the bounds of the room.
fn wall_paint() -> Paint {
    Paint { dash: &[6.0, 4.0], ..Paint::stroke(WALLS, 1.1) }
}

/// Returns the frame around the walls and the virtual transmitters at `positions`, except the outermost 2 % at each end
/// of an axis.
fn view_frame(walls: [[f64; 2]; 2], positions: &[[f64; 2]]) -> [[f64; 2]; 2] {
    let ends = |q: f64| [0, 1].map(|k| quantile(&sorted(positions.iter().map(|p| p[k])), q));
    FloorPlan::frame(walls.into_iter().chain([ends(0.02), ends(0.98)]))
}

/// Returns the radius of a disc. Its area falls linearly with the level `db` below the strongest, to 3 % at about [`RANGE_DB`].
fn disc_radius(db: f64) -> f64 {
    RADIUS * (1.0 + db.max(-RANGE_DB) / RANGE_DB).max(0.03).sqrt()
}

/// Draws the legend of the marks. The dashed frame is the bounds of the scene if the scene `has_points`, otherwise of the data.
fn draw_legend(has_points: bool) -> Canvas {
    let mut canvas = Canvas::new(0.0, 24.0);
    let (mut x, y) = (12.0, 12.0);
    let add_label = |canvas: &mut Canvas, x: &mut f64, words: &str| {
        canvas.text([*x + 13.0, y + 4.0], Anchor::Start, words);
        *x += 30.0 + text_width(words);
    };
    for (db, words) in [(0.0, "strongest"), (-10.0, "10 dB weaker"), (-20.0, "20 dB weaker")] {
        canvas.circle([x, y], disc_radius(db), Paint::fill(BLUE.with_opacity(0.6)).outlined(WHITE, 0.6));
        add_label(&mut canvas, &mut x, words);
    }
    draw_receiver(&mut canvas, [x, y]);
    add_label(&mut canvas, &mut x, "receiver");
    canvas.line(&[[x - 9.0, y], [x + 9.0, y]], wall_paint());
    add_label(&mut canvas, &mut x, if has_points { "bounds of the scene" } else { "bounds of the data" });
    canvas.width = x;
    canvas
}
