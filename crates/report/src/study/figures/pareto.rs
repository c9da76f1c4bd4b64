//! Ways to the same numbers of Gaussians: the first metric against N, bytes and milliseconds.

use super::tradeoff::floors;
use super::{Figure, looks};
use crate::draw::charts::{Axis, Chart, Line};
use crate::study::Setting;
use crate::study::race::{Race, Way};
use minijinja::context;
use pwrfgs_experiment::Record;
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::statistics::Spread;

/// Ways that are drawn in a colour: the best, and the last one.
const SHOWN: usize = 7;

/// What quality is paid with.
struct Price {
    name: &'static str,
    axis: &'static str,
    of: fn(&Record) -> Option<f64>,
}

const PRICES: [Price; 3] = [
    Price { name: "pareto-n", axis: "number of Gaussians N", of: |run| Some(run.facts.gaussians as f64) },
    Price { name: "pareto-bytes", axis: "size of the model [bytes]", of: |run| run.scores.value(MODEL, "model_bytes") },
    Price { name: "pareto-ms", axis: "one prediction [ms]", of: |run| run.scores.value(MODEL, "latency_total_ms") },
];

pub(super) fn by_number(setting: &Setting) -> Option<Figure> {
    figure(setting, &PRICES[0])
}

pub(super) fn by_bytes(setting: &Setting) -> Option<Figure> {
    figure(setting, &PRICES[1])
}

pub(super) fn by_time(setting: &Setting) -> Option<Figure> {
    figure(setting, &PRICES[2])
}

fn figure(setting: &Setting, price: &Price) -> Option<Figure> {
    let mut race = Race::of(setting)?;
    let headline = setting.headline();
    // What is worse than every floor wherever it was tried would take the whole axis.
    let worst = worst_floor(setting);
    let hopeless = |way: &Way<'_>| {
        let scores: Vec<f64> = way.places.iter().flatten().map(|(score, _)| score.mean).collect();
        let below =
            |score: &f64| worst.is_some_and(|worst| if headline.higher { *score < worst } else { *score > worst });
        !scores.is_empty() && scores.iter().all(below)
    };
    let (left_out, ways): (Vec<_>, Vec<_>) = race.ways.into_iter().partition(hopeless);
    race.ways = ways;
    let left_out: Vec<String> = left_out.into_iter().map(|way| way.name).collect();
    if race.ways.is_empty() {
        return None;
    }
    let last = race.ways.len() - 1;
    let mut lines: Vec<Line> = Vec::new();
    let (mut shown, mut others) = (Vec::new(), Vec::new());
    for (k, way) in race.ways.iter().enumerate() {
        if let Some(line) = line(way, k, price, headline.key, k < SHOWN || k == last) {
            if k < SHOWN || k == last { shown.push(line) } else { others.push(line) }
        }
    }
    if shown.is_empty() {
        return None;
    }
    lines.append(&mut shown);
    lines.append(&mut others);
    lines.extend(floors(setting, headline.key));
    let axis = format!("mean {}", headline.name);
    let x = Axis { name: price.axis.into(), log: true, ends: None };
    let chart = Chart { x, y: Axis { name: axis.clone(), ..Axis::default() }, lines, ..Chart::default() };
    let (ways, shown) = (race.ways.len(), SHOWN.min(last));
    Figure::chart(price.name, setting, context! { axis, ways, shown, left_out, price => price.axis }, chart)
}

/// The mean score of the floor that is easiest to beat.
fn worst_floor(setting: &Setting) -> Option<f64> {
    let headline = setting.headline();
    let of = |name: &str| setting.floor(name, headline.key);
    setting.floors().into_iter().filter_map(of).reduce(if headline.higher { f64::min } else { f64::max })
}

/// A way through its variants, with bars over seeds.
fn line(way: &Way<'_>, k: usize, price: &Price, key: &str, shown: bool) -> Option<Line> {
    let place = |variant: &&crate::study::Variant| {
        let (paid, score) = (variant.spread(price.of)?, variant.score(key)?);
        (paid.mean > 0.0).then_some((paid.mean, score))
    };
    let mut places: Vec<_> = way.variants.iter().filter_map(place).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let points: Vec<(f64, f64)> = places.iter().map(|(paid, score)| (*paid, score.mean)).collect();
    if points.is_empty() {
        return None;
    }
    if !shown {
        return Some(Line::new(points, looks::thread()));
    }
    let mut line = Line::new(points.clone(), looks::variant(k.min(SHOWN))).named(&way.name);
    line.marks = points;
    let bar =
        |(paid, score): &(f64, Spread)| score.deviation.map(|d| [(*paid, score.mean - d), (*paid, score.mean + d)]);
    line.bars = places.iter().filter_map(bar).filter(|[a, b]| a != b).collect();
    Some(line)
}
