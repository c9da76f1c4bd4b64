//! `NearestNeighbours`: mean of the nearest training samples. `NearestCarrier`: the observation at the nearest carrier.

use super::{ByReceiver, ReceiverPredictor, fitting_samples, weighted_mean};
use pwrfgs_core::neighbours::Nearest;
use pwrfgs_core::{
    Baseline, Dataset, End, FittingSet, Image, JsonSchema, Predict, Query, Real, Requirement, Result, SiteSize,
    block_of, evenly,
};
use rayon::prelude::*;
use ron::value::RawValue;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Default of k; also that of `Auto` if there is nothing to compare.
const DEFAULT: usize = 3;
/// Candidate values of k for `Auto`, also in the docs of [`NearestNeighbours`].
const CHOICES: [usize; 13] = [1, 2, 3, 5, 8, 12, 20, 30, 40, 60, 80, 120, 160];
/// Largest number of observations used to choose k.
const CHOSEN_ON: usize = 120;
/// Largest number of received powers used to choose k.
const CHOSEN_ON_NUMBERS: usize = 2_400;

/// Mean of the spectra of the k nearest training transmitters, weighted by inverse distance.
///
/// At the exact position of training transmitters it is the mean of their spectra. Powers and channels are averaged in
/// the same way, per receiver; a receiver without training links uses those of all receivers. If links have features,
/// such as an uplink channel, distance is measured between features. For a moving receiver, the square of the distance
/// includes those between the ends of its x axes and between those of its z axes, each 1 m long.
///
/// `k: Auto` selects the k from 1, 2, 3, 5, 8, 12, 20, 30, 40, 60, 80, 120 and 160 that best predicts known samples from
/// those in other blocks: mean SSIM over at most 120 samples (channels: squared error; powers: absolute error over at
/// most 2,400). All receivers share k. Blocks are cubes of three spacings of the samples, or of a twentieth of the site if
/// this is more. Without positions it predicts the validation set from the training set. A note under the table reports
/// k.
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
    /// Number of neighbours to average, at least 1, or `Auto`; capped at the number of training samples.
    pub k: Neighbours,
}

/// Number of neighbours: a number, or `Auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema)]
#[schemars(inline, with = "usize", title = "whole number or Auto", extend("type" = ["integer", "string"]))]
pub enum Neighbours {
    /// Number with the best score on held-out blocks, the same for all receivers.
    Auto,
    /// Fixed number of neighbours.
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
        // Serialised as text, since a bare word and a number have no common type.
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
        Self { k: Neighbours::Number(DEFAULT) }
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

    fn requires(&self) -> &'static [Requirement] {
        &[Requirement::Inputs]
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let (k, chosen) = match self.k {
            Neighbours::Number(k) => (k, false),
            Neighbours::Auto => (best_neighbour_count(data, fitting)?, true),
        };
        let fit = |fitting: FittingSet<'_>| Ok(Lookup { chosen, ..Lookup::new(data, &fitting_samples(fitting)?, k) });
        Ok(Box::new(ByReceiver::fit(data, fitting, fit)?))
    }

    fn check(&self) -> Result<(), String> {
        if self.k == Neighbours::Number(0) {
            return Err("`k` is 0; use at least 1 neighbour".into());
        }
        Ok(())
    }
}

/// Returns the k of all receivers that best predicts known links from those of their receiver in other blocks, the smallest
/// in a tie; [`DEFAULT`] if there is nothing to compare. Without positions, it predicts the validation links from the
/// training links. Returns an error if an observation cannot be read, or if the flag of `fitting` ends the search.
fn best_neighbour_count(data: &Dataset, fitting: FittingSet<'_>) -> Result<usize> {
    let samples = fitting_samples(fitting)?;
    let (train, held_out) = if data.placed { (samples.clone(), samples) } else { selection_sets(fitting) };
    let most = if data.task().is_scalar { CHOSEN_ON_NUMBERS } else { CHOSEN_ON };
    let edge = SiteSize::new(train.iter().map(|&i| data.sample(i).position())).block_edge();
    let block = |i: usize| data.placed.then(|| block_of(data.sample(i).position(), edge));
    let by_receiver = data.group_by_receiver(train);
    let lookups: Vec<Lookup<'_>> =
        by_receiver.iter().map(|links| Lookup::new(data, links, CHOICES[CHOICES.len() - 1])).collect();
    let blocks: Vec<Vec<_>> = by_receiver.iter().map(|links| links.iter().map(|&i| block(i)).collect()).collect();
    let score = |&i: &usize| {
        fitting.check_stopped()?;
        let (receiver, block) = (data.links[i].receiver, block(i));
        let is_other = |k: usize| by_receiver[receiver][k] != i && (blocks[receiver][k] != block || !data.placed);
        Ok(lookups[receiver].scores(i, is_other))
    };
    let scores = evenly(&held_out, most).par_iter().map(score).collect::<Result<Vec<Vec<f64>>>>()?;
    data.observations.check()?;
    if scores.iter().all(Vec::is_empty) {
        return Ok(DEFAULT);
    }
    let total = |c: usize| scores.iter().filter_map(|scores| scores.get(c)).sum::<f64>();
    Ok(CHOICES[(1..CHOICES.len()).fold(0, |best, c| if total(c) > total(best) { c } else { best })])
}

/// Returns the samples to choose k with: (training samples, samples to predict). If one of the two sets is empty, every
/// tenth sample of the other is held out; with fewer than two samples none is.
fn selection_sets(fitting: FittingSet<'_>) -> (Vec<usize>, Vec<usize>) {
    const EVERY: usize = 10;
    if !fitting.validation.is_empty() && !fitting.train.is_empty() {
        return (fitting.train.to_vec(), fitting.validation.to_vec());
    }
    let is_held_out = |k: usize| k % EVERY == 1; // the second, so that the first remains for training
    let (held_out, train): (Vec<_>, Vec<_>) = fitting.all().into_iter().enumerate().partition(|(k, _)| is_held_out(*k));
    let samples = |numbered: Vec<(usize, usize)>| numbered.into_iter().map(|(_, i)| i).collect::<Vec<usize>>();
    (samples(train), samples(held_out))
}

/// Nearest-neighbour lookup in the training samples.
struct Lookup<'a> {
    data: &'a Dataset,
    nearest: Nearest,
    k: usize,
    /// Whether k was selected by its score.
    chosen: bool,
}

impl<'a> Lookup<'a> {
    /// Creates a lookup of the `k` nearest among `samples`.
    fn new(data: &'a Dataset, samples: &[usize], k: usize) -> Self {
        // The number of coordinates that `link_coordinates` returns.
        let pose_width = if data.scene.moving.is_receiver() { 9 } else { 3 };
        let width = data.features.as_ref().map_or(pose_width, |features| features.width);
        Self {
            data,
            nearest: Nearest::new(samples, width, |i| link_coordinates(data.scene.moving, data.query(i))),
            k,
            chosen: false,
        }
    }

    /// Returns whether samples are exactly at `coordinates`, and the samples to average with their weights: all that are there,
    /// else the k nearest. Only those whose index in the list of samples `is_wanted`.
    fn weighted_neighbours(&self, coordinates: &[f64], is_wanted: impl Fn(usize) -> bool) -> (bool, Vec<(usize, f64)>) {
        let (exact, near) = self.nearest.find_where(coordinates, self.k, is_wanted);
        if exact.is_empty() {
            (false, near.into_iter().map(|(distance, i)| (i, 1.0 / distance)).collect())
        } else {
            (true, exact.into_iter().map(|i| (i, 1.0)).collect())
        }
    }

    /// Returns the score of the prediction of sample `i` from those whose index in the list of samples `is_other`, for each k of
    /// [`CHOICES`]; higher is better. Empty without others.
    fn scores(&self, i: usize, is_other: impl Fn(usize) -> bool) -> Vec<f64> {
        let truth = self.data.image(i);
        // For any k, all samples at the exact position count.
        let (is_exact, neighbours) =
            self.weighted_neighbours(&link_coordinates(self.data.scene.moving, self.data.query(i)), is_other);
        if neighbours.is_empty() {
            return Vec::new();
        }
        let (mut sum, mut total, mut taken) = (vec![0.0; truth.pixels.len()], 0.0, 0);
        let mut scores = Vec::with_capacity(CHOICES.len());
        for k in CHOICES {
            let until = if is_exact { neighbours.len() } else { k.min(neighbours.len()) };
            for (j, weight) in &neighbours[taken..until] {
                self.data.observations.add(*j, *weight, &mut sum);
                total += weight;
            }
            taken = until;
            let scale = self.data.observations.full_scale() * total;
            let pixels = sum.iter().map(|s| (s / scale) as Real).collect();
            scores.push(self.data.task().likeness(&Image { pixels, ..truth }, &truth));
        }
        scores
    }
}

/// Returns the coordinates in which the distance of links is measured: the features, else the transmitter position `[3]`, or
/// the position and axes of a moving receiver `[9]`, metres.
fn link_coordinates(moving: End, query: Query<'_>) -> Vec<f64> {
    match query.features {
        Some(features) => features.iter().map(|v| *v as f64).collect(),
        None if moving.is_receiver() => query.pose.coordinates().to_vec(),
        None => query.position().to_vec(),
    }
}

impl Predict for Lookup<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let coordinates = link_coordinates(self.data.scene.moving, query);
        let (_, weighted) = self.weighted_neighbours(&coordinates, |_| true);
        weighted_mean(self.data, &weighted)
    }
}

impl ReceiverPredictor for Lookup<'_> {
    fn combined_note(predictors: &[(&str, &Self)]) -> Option<String> {
        let (_, first) = predictors.first().filter(|(_, lookup)| lookup.chosen)?;
        let held_out = if first.data.placed { "held-out blocks" } else { "the validation set" };
        Some(format!("k-NN uses k = {}, best on {held_out}", first.k))
    }
}

/// Observation of the same transmitter at the nearest training carrier, for data with several carriers.
///
/// Carriers are compared by the logarithm of their frequency. If no training carrier was observed at the position, the
/// prediction is the observation at the nearest position of the nearest carrier. It copies one carrier
/// and does not interpolate between carriers.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("NearestCarrier()").unwrap().name(), "nearest carrier");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NearestCarrier {}

#[typetag::serde]
impl Baseline for NearestCarrier {
    fn name(&self) -> String {
        "nearest carrier".into()
    }

    fn requires(&self) -> &'static [Requirement] {
        &[Requirement::Carriers]
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let lookup = |links: &[usize]| Nearest::new(links, 3, |i| data.sample(i).position().to_vec());
        let links = data.group_by_receiver(fitting_samples(fitting)?).into_iter().enumerate();
        let carriers = links.filter(|(_, links)| !links.is_empty()).map(|(carrier, links)| (carrier, lookup(&links)));
        Ok(Box::new(CarrierLookup { data, carriers: carriers.collect() }))
    }
}

/// Training links of each carrier that has some, by position.
struct CarrierLookup<'a> {
    data: &'a Dataset,
    /// Receivers, one per carrier, and their links.
    carriers: Vec<(usize, Nearest)>,
}

impl Predict for CarrierLookup<'_> {
    /// Predicts from the nearest carrier that was observed at the position, else from the nearest position at the nearest
    /// carrier.
    fn predict(&self, query: Query<'_>) -> Image {
        let log_hz = |receiver: usize| self.data.scene.receivers[receiver].carrier_hz.unwrap_or(1.0).ln();
        let distance = |(carrier, _): &&(usize, Nearest)| (log_hz(*carrier) - log_hz(query.receiver)).abs();
        let mut carriers: Vec<_> = self.carriers.iter().collect();
        carriers.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let mut matches = carriers.iter().map(|(_, links)| links.find(&query.position(), 1)).peekable();
        let nearest: Vec<usize> = matches.peek().into_iter().flat_map(|(_, near)| near).map(|(_, i)| *i).collect();
        let same = matches.map(|(exact, _)| exact).find(|exact| !exact.is_empty());
        let weighted: Vec<(usize, f64)> = same.unwrap_or(nearest).into_iter().map(|i| (i, 1.0)).collect();
        weighted_mean(self.data, &weighted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    #[test]
    fn predicts_same_position_at_nearest_carrier() {
        // Positions 0, 1 and 2; grey values 10 c + x at carrier c; position 2 only at the first and last.
        let rows = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 0), (2, 2)];
        let sample = |(i, (x, _)): (usize, &(u8, u8))| Sample::new(i as u32 + 1, [f64::from(*x), 0.0, 0.0]);
        let grey = rows.iter().map(|(x, c)| 10 * c + x).collect();
        let carriers: Vec<f64> = rows.iter().map(|(_, c)| 2e9 + 1e8 * f64::from(*c)).collect();
        let samples = rows.iter().enumerate().map(sample).collect();
        let data = Dataset::new("room", Pose::IDENTITY, vec![], samples, Spectra::grey((1, 1), grey).unwrap()).unwrap();
        assert!(NearestCarrier {}.check_data(&data).unwrap_err().to_string().contains("needs several carriers"));
        let data = data.with_carriers(&carriers).unwrap();
        let predict = |train: &[usize], x: f64, receiver: usize| {
            let fitted = NearestCarrier {}.fit(&data, FittingSet::train(train)).unwrap();
            (255.0 * fitted.predict(Query::at([x, 0.0, 0.0], receiver)).pixels[0]).round()
        };
        // 2.1 GHz is left out: 2.2 GHz is nearer to it than 2 GHz on a logarithmic scale.
        assert_eq!(predict(&[0, 2, 3, 5, 6, 7], 1.0, 1), 21.0);
        assert_eq!(predict(&[0, 1, 3, 4, 6], 2.0, 2), 2.0, "position 2 is known at 2 GHz alone");
        assert_eq!(predict(&[0, 2, 3, 5, 6], 1.2, 1), 21.0, "an unknown position has the nearest one");
    }
}
