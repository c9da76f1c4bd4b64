//! What the metrics say of pairs.

use super::pairs::Pair;
use crate::session::check_stopped;
use pwrfgs_core::{Dataset, Evaluation, Goal, Image, ImagePlane, Measurement, Metric, Plugin, Result, Scope, Values};
use rayon::prelude::*;
use std::sync::atomic::AtomicBool;

/// Pairs in memory at once, and their pixels.
const CHUNK: usize = 64;
const PIXELS: usize = 1 << 21;

/// One metric of all pairs, in their order.
pub(super) struct Measured {
    pub(super) key: String,
    pub(super) unit: String,
    pub(super) goal: Goal,
    /// What a spectrum scores as a prediction of itself.
    pub(super) best: f64,
    pub(super) values: Vec<f64>,
}

/// Takes the earlier spectrum of each pair as a prediction of the later one, by the metrics of single samples.
pub(super) fn measure(
    data: &Dataset,
    pairs: &[Pair],
    metrics: &[Plugin<dyn Metric>],
    stop: &AtomicBool,
) -> Result<Vec<Measured>> {
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
