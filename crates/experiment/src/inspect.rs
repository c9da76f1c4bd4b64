//! What to check in a data set before training: [`DataSummary`] for `pwrfgs check`, and with all splits [`inspect`] for
//! `pwrfgs inspect`.

mod pose;
mod spectra;
mod splits;

pub use pose::{PoseCheck, Verdict};
pub use splits::{length, test_distance};

use crate::observer::{Observer, staged};
use crate::repeatability::in_order;
use crate::scores::quantile;
use crate::text::{grouped, number, wrapped};
use pwrfgs_core::{Dataset, Result, Unmatched, neighbours::distance};
use pwrfgs_pipeline::Pipeline;
use std::fmt::Write as _;

/// Most spectra that `inspect` reads.
const INSPECTED: usize = 20_000;
/// Width of lines of prose, and of the names before them.
const WIDTH: usize = 100;
const INDENT: usize = 15;

/// Positions, values and pose of a data set.
#[derive(Clone, Debug)]
pub struct DataSummary {
    /// A name and its text, one per line.
    pub facts: Vec<(&'static str, String)>,
    /// The check of the recorded pose; `None` without spectra, or with too few.
    pub pose: Option<PoseCheck>,
}

impl DataSummary {
    /// Summarizes `data`, reading at most `most` evenly chosen spectra.
    ///
    /// # Errors
    /// If a spectrum cannot be read.
    pub fn of(data: &Dataset, most: usize, observer: &mut dyn Observer) -> Result<Self> {
        let mut summary = Self { facts: Vec::new(), pose: None };
        if data.placed {
            summary.facts.extend(positions(data));
        }
        summary.facts.push(("receiver", receivers(data)));
        if !data.task().has_pixels {
            summary.facts.push(levels(data));
            return Ok(summary);
        }
        let spectra = staged(observer, "reading the spectra", |progress| spectra::summarize(data, most, progress))?;
        summary.facts.extend(spectra::facts(data, &spectra));
        if data.unmatched != Unmatched::default() {
            let Unmatched { positions, pictures } = data.unmatched;
            let text = format!("{positions} positions without a spectrum, {pictures} spectra without a position");
            summary.facts.push(("left out", text));
        }
        if spectra.len() < data.len() {
            summary.facts.push(("read", format!("{} of {} spectra, evenly chosen", spectra.len(), data.len())));
        }
        summary.pose = pose::check_pose(data, &spectra);
        Ok(summary)
    }
}

/// Text of `pwrfgs inspect`: the summary of `data`, and all splits with their baselines.
///
/// # Errors
/// If a baseline or a metric refuses, or a spectrum cannot be read.
pub fn inspect(pipeline: &Pipeline, data: &Dataset, observer: &mut dyn Observer) -> Result<String> {
    let summary = DataSummary::of(data, INSPECTED, observer)?;
    let is_marked = !data.is_simulated() || data.title.to_lowercase().contains("simulated");
    let mut text = format!("{}{}\n\n", data.title, if is_marked { "" } else { " (simulated)" });
    let ids = [data.transmitters.first(), data.transmitters.last()].map(|t| t.map_or(0, |t| t.id));
    text += &entry("samples", &format!("{}, ids {} to {}", crate::observed(data), ids[0], ids[1]));
    summary.facts.iter().for_each(|(name, words)| text += &entry(name, words));
    if let Some(pose) = &summary.pose {
        text += &entry("pose", pose.verdict.title());
        pose.sentences().iter().for_each(|sentence| text += &entry("", sentence));
    }
    Ok(text + "\n" + &splits::table(pipeline, data, observer)?)
}

/// Extent, steps from an id to the next, and positions that occur twice.
fn positions(data: &Dataset) -> Vec<(&'static str, String)> {
    let places: Vec<[f64; 3]> = data.transmitters.iter().map(|t| t.position).collect();
    let end = |k: usize, pick: fn(f64, f64) -> f64| places.iter().map(|p| p[k]).reduce(pick).unwrap_or(f64::NAN);
    let axis = |k: usize| format!("{} {:.2} to {:.2}", ["x", "y", "z"][k], end(k, f64::min), end(k, f64::max));
    let mut sorted = places.clone();
    sorted.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let shared: usize = sorted.chunk_by(|a, b| a == b).map(<[_]>::len).filter(|count| *count > 1).sum();
    let mut text = format!("{} m", [0, 1, 2].map(axis).join(", "));
    if shared > 0 {
        _ = write!(text, "; {} at the position of another", grouped(shared as i64));
    }
    let next = data.transmitters.windows(2).filter(|pair| pair[1].id == pair[0].id + 1);
    let mut steps: Vec<f64> = next.map(|pair| distance(pair[0].position, pair[1].position)).collect();
    steps.sort_by(f64::total_cmp);
    if steps.is_empty() {
        return vec![("transmitters", text)];
    }
    let [low, middle, high] = [0.05, 0.5, 0.95].map(|q| length(quantile(&steps, q)));
    let order = if in_order(data) {
        "ids follow a trajectory: a random split leaves near neighbours in training"
    } else {
        "ids follow no trajectory: a block of ids is no block of space"
    };
    let steps = format!("{middle} from an id to the next (median; {low} to {high}, 5 % to 95 %); {order}");
    vec![("transmitters", text), ("steps", steps)]
}

fn receivers(data: &Dataset) -> String {
    let names: Vec<&str> = data.scene.receivers.iter().map(|receiver| receiver.name.as_str()).collect();
    if let [first, second, rest @ ..] = &names[..] {
        return format!("{}: {first}, {second}{}", names.len(), if rest.is_empty() { "" } else { ", .." });
    }
    let list = |numbers: [f64; 3]| numbers.map(|v| format!("{}", v + 0.0)).join(", ");
    let pose = data.scene.origin.world_pose(data.scene.pose());
    let boresight = pose.world_from_receiver().z_axis.to_array().map(|v| (f64::from(v) * 1e3).round() / 1e3);
    format!("at ({}) m, boresight ({})", list(pose.position), list(boresight))
}

/// Median and range of the levels of all links.
fn levels(data: &Dataset) -> (&'static str, String) {
    let [name, unit] = data.task().level_name;
    let level = |link: usize| data.task().level(&data.image(link));
    let mut all: Vec<f64> = (0..data.len()).map(level).filter(|level| level.is_finite()).collect();
    all.sort_by(f64::total_cmp);
    let [low, tenth, middle, last, high] = [0.0, 0.1, 0.5, 0.9, 1.0].map(|q| number(quantile(&all, q)));
    ("level", format!("{name} {middle} {unit} (median; {tenth} to {last}, 10 % to 90 %; {low} to {high} in all)"))
}

/// Words in lines, the first with `name` before it and the others as far in.
fn entry(name: &str, words: &str) -> String {
    wrapped(words, [&format!("{name:<INDENT$}"), &" ".repeat(INDENT)], WIDTH)
}
