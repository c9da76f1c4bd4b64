//! `Repeatability`: how alike two measured spectra are whose transmitters stood at the same place.
//!
//! No function of the position can do much better than one of them does for the other. Two measurements at the very same
//! place are rare, so pairs are taken at small distances and followed to distance zero. Samples count as numbered in order
//! of time: what was measured within a moment shares more than the position (the transmitter's orientation, people, the
//! receiver), so pairs near in time and pairs far apart are kept apart.
//!
//! What is found is what two measurements have in common. The mean of all measurements at a place is a little closer to
//! each of them than they are to one another, so a perfect predictor of the mean would reach a little more.

mod extrapolate;
mod pairs;

pub use extrapolate::AtZero;
pub use pairs::{FAR_IDS, Lapse, NEAR_IDS, in_order};

use crate::session::check_stopped;
use crate::statistics::Summary;
use extrapolate::{Scale, at_zero};
use pairs::Pair;
use pwrfgs_core::{
    Dataset, Evaluation, Goal, Image, ImagePlane, Measurement, Metric, Plugin, Result, Scope, Task, Values, evenly,
};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Closest pairs that are followed to distance zero, at most.
const CLOSEST: usize = 400;
/// Fewer say nothing.
const LEAST: usize = 20;
/// They are not further apart than this, metres: spectra change over a part of a wavelength, which is 33 cm at 0.9 GHz and
/// 5 cm at 6 GHz, so what pairs further apart have in common does not lead to distance zero.
pub const REACH_M: f64 = 0.02;
/// Pairs measured in a range of distances beyond those.
const A_BIN: usize = 100;
/// Pairs in memory at once, and their pixels.
const CHUNK: usize = 64;
const PIXELS: usize = 1 << 21;

/// Likeness of pairs near in time and of pairs far apart in time.
#[derive(Clone, Debug)]
pub struct Repeatability {
    /// Pairs at most [`NEAR_IDS`] ids apart.
    pub near: Likeness,
    /// Pairs more than [`FAR_IDS`] ids apart.
    pub far: Likeness,
}

/// How alike the spectra of some pairs of samples are, by each metric of single samples.
#[derive(Clone, Debug)]
pub struct Likeness {
    /// Number of closest pairs that are followed to distance zero.
    pub closest: usize,
    /// Distance between the transmitters of the farthest of these, metres; 0 where there are none.
    pub reach_m: f64,
    /// One entry a metric.
    pub metrics: Vec<Similarity>,
}

/// One metric of pairs: what the earlier spectrum scores as a prediction of the later one.
#[derive(Clone, Debug)]
pub struct Similarity {
    /// Name, such as `ssim`.
    pub key: String,
    /// Unit, or empty.
    pub unit: String,
    /// Which way is better.
    pub goal: Goal,
    /// By distance, from small to large; ranges without pairs are left out.
    pub bins: Vec<Bin>,
    /// Mean over pairs that have nothing in common: samples drawn at random. NaN where there are none.
    pub unrelated: f64,
    /// What the closest pairs come to at distance zero, or why nobody can tell.
    pub at_zero: Result<AtZero, String>,
}

/// Pairs in a range of distances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// Distance between the transmitters, metres: at least.
    pub from_m: f64,
    /// Less than.
    pub to_m: f64,
    /// Pairs that were measured.
    pub pairs: usize,
    /// Mean over them.
    pub mean: f64,
    /// Their middle.
    pub median: f64,
}

/// Measures pairs near in time and far apart, by every metric that looks at one sample at a time. A bounded number of
/// pairs is looked at, however many samples there are; the choice depends on the data alone.
///
/// # Errors
/// Where a metric refuses or a spectrum cannot be read; [`pwrfgs_core::Error::Stopped`] once `stop` is set.
pub fn repeatability(data: &Dataset, metrics: &[Plugin<dyn Metric>], stop: &AtomicBool) -> Result<Repeatability> {
    let of = |lapse| likeness(data, lapse, true, metrics, stop);
    Ok(Repeatability { near: of(Lapse::Near)?, far: of(Lapse::Far)? })
}

/// Measures one kind of pairs: the closest, and, for the whole `curve`, some of the others.
pub(crate) fn likeness(
    data: &Dataset,
    lapse: Lapse,
    curve: bool,
    metrics: &[Plugin<dyn Metric>],
    stop: &AtomicBool,
) -> Result<Likeness> {
    let pairs = pairs::find(data, lapse);
    // What is measured: the closest, some of every range of distances, and pairs with nothing in common.
    let mut wanted = closest(&pairs);
    let closest = wanted.len();
    let mut ranges = Vec::new();
    for (edges, range) in pairs::bins(&pairs).into_iter().filter(|_| curve) {
        let first = wanted.len();
        wanted.extend(evenly(&pairs[range], A_BIN));
        ranges.push((edges, first..wanted.len()));
    }
    let related = wanted.len();
    wanted.extend(pairs::unrelated(data));
    let similarity = |measured: Measured| {
        let Measured { key, unit, goal, best, values } = measured;
        let summary = |values: &[f64]| Summary::of(values, goal == Goal::Higher);
        let bin = |([from_m, to_m], range): &([f64; 2], Range<usize>)| {
            let Summary { mean, median, .. } = summary(&values[range.clone()]);
            Bin { from_m: *from_m, to_m: *to_m, pairs: range.len(), mean, median }
        };
        let unrelated = summary(&values[related..]).mean;
        let scale = Scale { goal, best, unrelated };
        let at_zero = if closest < LEAST {
            let (words, cm) = (lapse.words(), REACH_M * 100.0);
            Err(format!("{closest} pairs of samples {words} are within {cm:.0} cm of each other; it takes {LEAST}"))
        } else {
            at_zero(&wanted[..closest], &single(data.task(), &values[..closest]), &scale)
        };
        Similarity { key, unit, goal, bins: ranges.iter().map(bin).collect(), unrelated, at_zero }
    };
    let metrics = measure(data, &wanted, metrics, stop)?.into_iter().map(similarity).collect();
    let reach_m = wanted[..closest].last().map_or(0.0, |pair| pair.distance);
    Ok(Likeness { closest, reach_m, metrics })
}

/// Scores of a perfect predictor of the mean reading, given `values` between two readings.
fn single(task: Task, values: &[f64]) -> Vec<f64> {
    values.iter().map(|v| task.ceiling.share * v).collect()
}

/// The pairs that are followed to distance zero, out of `pairs` of ascending distances. Where the closest are about equally
/// far apart, steps of a walk say, no slope is seen over them: then some of all that are close enough.
fn closest(pairs: &[Pair]) -> Vec<Pair> {
    let within = &pairs[..pairs.partition_point(|pair| pair.distance <= REACH_M)];
    let first = &within[..within.len().min(CLOSEST)];
    match first {
        [nearest, .., farthest] if nearest.distance > 0.5 * farthest.distance => evenly(within, CLOSEST),
        _ => first.to_vec(),
    }
}

/// One metric of all pairs, in their order.
struct Measured {
    key: String,
    unit: String,
    goal: Goal,
    /// What a spectrum scores as a prediction of itself.
    best: f64,
    values: Vec<f64>,
}

/// Takes the earlier spectrum of each pair as a prediction of the later one, by the metrics of single samples.
fn measure(data: &Dataset, pairs: &[Pair], metrics: &[Plugin<dyn Metric>], stop: &AtomicBool) -> Result<Vec<Measured>> {
    let metrics: Vec<&Plugin<dyn Metric>> = metrics.iter().filter(|m| m.scope() == Scope::Sample).collect();
    let plane = data.plane();
    let itself = [data.image(0)];
    let best = evaluate(data, &plane, &metrics, &itself, &itself)?;
    let started = |m: Measurement| match m.values {
        Values::PerSample(best) if best.len() == 1 => {
            Some(Measured { key: m.key, unit: m.unit, goal: m.goal, best: best[0], values: Vec::new() })
        }
        _ => None,
    };
    let mut all: Vec<Measured> = best.into_iter().filter_map(started).collect();
    let size = (PIXELS / (data.width * data.height).max(1)).clamp(1, CHUNK);
    for some in pairs.chunks(size) {
        check_stopped(stop)?;
        let images = |side: fn(&Pair) -> usize| some.par_iter().map(|pair| data.image(side(pair))).collect();
        let (earlier, later): (Vec<Image>, Vec<Image>) = (images(|pair| pair.earlier), images(|pair| pair.later));
        data.observations.check()?;
        for found in evaluate(data, &plane, &metrics, &earlier, &later)? {
            if let (Some(of), Values::PerSample(values)) = (all.iter_mut().find(|m| m.key == found.key), found.values) {
                of.values.extend(values);
            }
        }
    }
    // A metric that did not give one number a pair has said nothing of pairs.
    all.retain(|measured| measured.values.len() == pairs.len());
    Ok(all)
}

fn evaluate(
    data: &Dataset,
    plane: &ImagePlane,
    metrics: &[&Plugin<dyn Metric>],
    predictions: &[Image],
    truths: &[Image],
) -> Result<Vec<Measurement>> {
    let seen = Evaluation { predictions, truths, ..Evaluation::of(data, plane) };
    let found: Result<Vec<_>> = metrics.iter().map(|metric| metric.evaluate(&seen)).collect();
    Ok(found?.concat())
}
