//! `NearestNeighbours`: the spectra measured closest by, found by looking at all places: 80,000 take less than a millisecond.

use super::{ByReceiver, Fitted, all_of, choosing, weighted_mean};
use pwrfgs_core::{
    Baseline, Dataset, Error, Image, JsonSchema, Known, Predict, Query, Real, Result, Task, evenly, ssim,
};
use rayon::prelude::*;
use ron::value::RawValue;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// What `Auto` chooses from.
const CHOICES: [usize; 13] = [1, 2, 3, 5, 8, 12, 20, 30, 40, 60, 80, 120, 160];
/// Samples that it is chosen on, at most.
const CHOSEN_ON: usize = 240;

/// The mean of the spectra of the k nearest training transmitters, weighted by inverse distance.
///
/// Where the transmitter stands on training transmitters, it is the mean of the spectra measured there. Powers and
/// channels are averaged alike, each receiver by itself; a receiver without training links is given those of all. Where
/// links have features, such as an uplink channel, distance is that between features.
///
/// `k: Auto` takes the k out of 1, 2, 3, 5, 8, 12, 20, 30, 40, 60, 80, 120 and 160 that predicts the validation part best
/// from the training part, by the mean SSIM of at most 240 samples (powers: the absolute error, channels: the squared
/// error), and then learns from both. Where there is no
/// validation part, every tenth training sample is left out for the choice; on a split that holds out whole stretches give
/// it a validation part, or k comes out too small. A note under the table says which.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("NearestNeighbours(k: 5)").unwrap().name(), "5-NN");
/// assert_eq!(Plugin::<dyn Baseline>::parse("NearestNeighbours(k: Auto)").unwrap().name(), "k-NN");
/// assert!(Plugin::<dyn Baseline>::parse("NearestNeighbours(k: 0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NearestNeighbours {
    /// Neighbours that are averaged, at least 1, or `Auto`; more than there are training samples means all of them.
    pub k: Neighbours,
}

/// Number of neighbours: a number, or `Auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema)]
#[schemars(inline, with = "usize", title = "whole number or Auto", extend("type" = ["integer", "string"]))]
pub enum Neighbours {
    /// The number with the best score on the validation set.
    Auto,
    /// This number of neighbours.
    Number(usize),
}

impl From<usize> for Neighbours {
    fn from(k: usize) -> Self {
        Self::Number(k)
    }
}

impl Serialize for Neighbours {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_unit_variant("Neighbours", 0, "Auto"),
            Self::Number(k) => k.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Neighbours {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // As text, since a bare word and a number have no type in common.
        let value = Box::<RawValue>::deserialize(deserializer)?;
        let text = value.get_ron().trim();
        match (text, text.replace('_', "").parse()) {
            ("Auto", _) => Ok(Self::Auto),
            (_, Ok(k)) => Ok(Self::Number(k)),
            _ => Err(de::Error::custom(format!("`k` is {text}; give a number of neighbours, such as 3, or Auto"))),
        }
    }
}

impl Default for NearestNeighbours {
    fn default() -> Self {
        Self { k: Neighbours::Number(3) }
    }
}

#[typetag::serde]
impl Baseline for NearestNeighbours {
    fn name(&self) -> String {
        match self.k {
            Neighbours::Auto => "k-NN".into(),
            Neighbours::Number(k) => format!("{k}-NN"),
        }
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if data.placed || data.features.is_some() {
            return Ok(());
        }
        let what = "does not say where the transmitters are, and NearestNeighbours looks for near ones";
        Err(Error::Config(format!("{} {what}; remove it from `baselines`", data.title)))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        ByReceiver::fit(data, known, |known| {
            let all = all_of(known)?;
            let (k, chosen) = match self.k {
                Neighbours::Number(k) => (k, false),
                Neighbours::Auto => {
                    let (train, validation) = choosing(known);
                    let k = best(data, train, &evenly(&validation, CHOSEN_ON));
                    data.observations.check()?;
                    (k, true)
                }
            };
            Ok(Lookup { chosen, ..Lookup::new(data, all, k) })
        })
    }

    fn check(&self) -> Result<(), String> {
        if self.k == Neighbours::Number(0) {
            return Err("`k` is 0; use at least 1 neighbour".into());
        }
        Ok(())
    }
}

/// The k that predicts `validation` best from `train`; of equals the smallest. 3 where there is nothing to compare.
fn best(data: &Dataset, train: Vec<usize>, validation: &[usize]) -> usize {
    let choices: Vec<usize> = CHOICES.iter().copied().filter(|k| *k <= train.len()).collect();
    let Some(most) = choices.last() else { return 3 };
    let lookup = Lookup::new(data, train, *most);
    let of_one = |&i: &usize| lookup.scores(i, &choices);
    let scores: Vec<Vec<f64>> = validation.par_iter().map(of_one).collect();
    if scores.is_empty() {
        return 3;
    }
    let totals: Vec<f64> = (0..choices.len()).map(|c| scores.iter().map(|of_one| of_one[c]).sum()).collect();
    let first_best = |best: usize, c: usize| if totals[c] > totals[best] { c } else { best };
    choices[(1..choices.len()).fold(0, first_best)]
}

/// The nearest of the samples learned from.
struct Lookup<'a> {
    data: &'a Dataset,
    nearest: Nearest,
    k: usize,
    /// Whether k was chosen on validation.
    chosen: bool,
}

impl<'a> Lookup<'a> {
    fn new(data: &'a Dataset, samples: Vec<usize>, k: usize) -> Self {
        let width = data.features.as_ref().map_or(3, |features| features.width);
        Self { data, nearest: Nearest::new(samples, width, |i| place(data.query(i))), k, chosen: false }
    }

    /// Samples with their weights, and whether they are those at `at` exactly, or else the k nearest.
    fn neighbours(&self, at: &[f64]) -> (bool, Vec<(usize, f64)>) {
        let (exact, near) = self.nearest.find(at, self.k);
        if exact.is_empty() {
            (false, near.into_iter().map(|(distance, i)| (i, 1.0 / distance)).collect())
        } else {
            (true, exact.into_iter().map(|i| (i, 1.0)).collect())
        }
    }

    /// How well sample `i` is predicted from the nearest, for each number of `choices`, ascending; more is better.
    fn scores(&self, i: usize, choices: &[usize]) -> Vec<f64> {
        let truth = self.data.image(i);
        // Those that stand at the very place all count, whatever k.
        let (exact, neighbours) = self.neighbours(&place(self.data.query(i)));
        let (mut sum, mut total, mut taken) = (vec![0.0; truth.pixels.len()], 0.0, 0);
        let score = |k: &usize| {
            let until = if exact { neighbours.len() } else { *k.min(&neighbours.len()) };
            for (j, weight) in &neighbours[taken..until] {
                self.data.observations.add(*j, *weight, &mut sum);
                total += weight;
            }
            taken = until;
            let scale = self.data.observations.full_scale() * total;
            let pixels = sum.iter().map(|s| (s / scale) as Real).collect();
            likeness(self.data.task(), &Image { pixels, ..truth }, &truth)
        };
        choices.iter().map(score).collect()
    }
}

/// Where a link is looked for: its features, or the transmitter's place.
fn place(query: Query<'_>) -> Vec<f64> {
    if query.features.is_empty() { query.tx.to_vec() } else { query.features.iter().map(|v| *v as f64).collect() }
}

/// How alike a prediction is to what was observed; more is better.
fn likeness(task: Task, predicted: &Image, truth: &Image) -> f64 {
    let errors = || predicted.pixels.iter().zip(&truth.pixels).map(|(p, t)| *p as f64 - *t as f64);
    if task.has_pixels {
        return ssim::evaluation(&predicted.clamped(), truth);
    }
    let size = |e: f64| if task.is_complex { e * e } else { e.abs() };
    -errors().map(size).sum::<f64>()
}

impl Predict for Lookup<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        weighted_mean(self.data, &self.neighbours(&place(query)).1)
    }
}

impl Fitted for Lookup<'_> {
    fn notes(each: &[(&str, &Self)]) -> Option<String> {
        let (_, first) = each.first().filter(|(_, lookup)| lookup.chosen)?;
        let what = format!("best on validation {}", first.data.task().plural.trim_start_matches("spatial "));
        if each.iter().all(|(_, lookup)| lookup.k == first.k) {
            return Some(format!("k-NN takes k = {}, which does {what}", first.k));
        }
        let list: Vec<String> = each.iter().map(|(name, lookup)| format!("{} ({name})", lookup.k)).collect();
        Some(format!("k-NN takes k = {}, each of which does {what}", list.join(", ")))
    }
}

/// Places of any dimension, and the samples that they are of.
pub(super) struct Nearest {
    /// `[S,width]`, sample by sample.
    places: Vec<f64>,
    width: usize,
    samples: Vec<usize>,
}

/// |a - b|, in the unit of both; in space it is [`pwrfgs_core::neighbours::distance`] to the bit.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Nearest {
    /// Samples with their places, metres or any other unit, all of `width` numbers.
    pub(super) fn new<P: AsRef<[f64]>>(samples: Vec<usize>, width: usize, place: impl Fn(usize) -> P) -> Self {
        let mut places = Vec::with_capacity(samples.len() * width);
        samples.iter().for_each(|&i| places.extend_from_slice(place(i).as_ref()));
        Self { places, width: width.max(1), samples }
    }

    /// The samples at `at` exactly, all of them, and the `k` nearest (all where there are fewer), nearest first, with
    /// their distances. Ties go to the lower sample.
    pub(super) fn find(&self, at: &[f64], k: usize) -> (Vec<usize>, Vec<(f64, usize)>) {
        /// Candidates that are kept beyond the k before the worst of them are dropped.
        const SPARE: usize = 1024;
        let k = k.clamp(1, self.samples.len().max(1));
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let keep_nearest = |near: &mut Vec<(f64, usize)>| {
            if near.len() > k {
                near.select_nth_unstable_by(k - 1, by_distance);
                near.truncate(k);
            }
        };
        let (mut exact, mut near, mut worst) = (Vec::new(), Vec::with_capacity(k + SPARE), f64::INFINITY);
        for (place, &sample) in self.places.chunks_exact(self.width).zip(&self.samples) {
            let distance = distance(place, at);
            if distance == 0.0 {
                exact.push(sample);
            }
            if distance <= worst {
                near.push((distance, sample));
                if near.len() == k + SPARE {
                    keep_nearest(&mut near);
                    worst = near.iter().fold(0.0, |worst, n| worst.max(n.0));
                }
            }
        }
        keep_nearest(&mut near);
        near.sort_unstable_by(by_distance);
        (exact, near)
    }
}
