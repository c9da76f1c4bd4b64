//! Selection of sample pairs for comparison.

use pwrfgs_core::neighbours::Nearest;
use pwrfgs_core::statistics::{median, sorted};
use pwrfgs_core::{Dataset, End, evenly, rng};
use rayon::prelude::*;
use std::ops::Range;

/// Largest difference of ids that counts as near in time.
pub const NEAR_IDS: u32 = 3;
/// Difference of ids above which samples are far apart in time.
pub const FAR_IDS: u32 = 30;
/// Largest number of samples for which neighbours in space are searched.
const ASKED: usize = 8_192;
/// Number of neighbours in space and far apart in time per sample; more are searched, since some neighbours may be near
/// in time.
const NEIGHBOURS: usize = 16;
/// Number of random pairs for larger distances.
const DRAWN: usize = 20_000;
/// Number of random pairs for the agreement of unrelated spectra.
const UNRELATED: usize = 200;

/// Kind of sample pairs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairLag {
    /// Near in time: at most [`NEAR_IDS`] ids apart.
    Near,
    /// Far apart in time: more than [`FAR_IDS`] ids apart.
    Far,
    /// Any two samples, for data with few pairs of the other kinds, such as repeated readings in a table.
    Any,
}

impl PairLag {
    /// Describes the pairs of this kind, for messages.
    pub fn describe(self) -> String {
        match self {
            Self::Near => format!("near in time (at most {NEAR_IDS} ids apart)"),
            Self::Far => format!("far apart in time (more than {FAR_IDS} ids)"),
            Self::Any => "at any times".into(),
        }
    }
}

/// Two samples, the earlier one first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SamplePair {
    pub(super) earlier: usize,
    pub(super) later: usize,
    /// Distance between the transmitters, metres; between the poses of a moving receiver as in `NearestNeighbours`.
    pub(super) distance: f64,
}

impl SamplePair {
    /// Creates the pair of two samples in any order.
    fn of(data: &Dataset, a: usize, b: usize) -> Self {
        let (earlier, later) = (a.min(b), a.max(b));
        let coordinates = |i: usize| match data.scene.moving {
            End::Receiver => data.sample(i).pose.coordinates().to_vec(),
            End::Transmitter => data.sample(i).position().to_vec(),
        };
        let squares = coordinates(earlier).into_iter().zip(coordinates(later)).map(|(p, q)| (p - q).powi(2));
        let distance = squares.sum::<f64>().sqrt();
        // Rounded to a nanometre, so that positions in whole millimetres have whole distances.
        Self { earlier, later, distance: (distance * 1e9).round() / 1e9 }
    }

    /// Returns the difference of the ids of both samples, which are in the order of ids.
    fn id_gap(&self, data: &Dataset) -> u32 {
        data.sample(self.later).id - data.sample(self.earlier).id
    }
}

/// Finds the pairs of one kind, the closest first. Near in time: all pairs. Otherwise: all close pairs (of [`ASKED`] samples
/// with any other), and a random part of the distant ones.
pub(super) fn find_pairs(data: &Dataset, lag: PairLag) -> Vec<SamplePair> {
    let receivers = data.group_by_receiver(0..data.len());
    let mut pairs = Vec::new(); // the largest list of an evaluation, so it is not copied
    for links in &receivers {
        match lag {
            PairLag::Near => pairs.extend(near_pairs(data, links)),
            PairLag::Far => add_far_pairs(&mut pairs, data, links, receivers.len(), FAR_IDS),
            PairLag::Any => add_far_pairs(&mut pairs, data, links, receivers.len(), 0),
        }
    }
    pairs.sort_unstable_by_key(|pair| (pair.earlier, pair.later));
    pairs.dedup();
    // Equal distances, common for positions in whole millimetres, are not ordered by id.
    rng::shuffle(&mut rng::stream(0, "repeatability order", 0), &mut pairs);
    pairs.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    pairs
}

/// Lists all pairs near in time among the `links` of one receiver, which are in the order of ids.
fn near_pairs(data: &Dataset, links: &[usize]) -> impl Iterator<Item = SamplePair> {
    let later_pairs = move |(k, &i): (usize, &usize)| {
        let last = data.sample(i).id.saturating_add(NEAR_IDS);
        let next = links[k + 1..].iter().copied().take_while(move |&j| data.sample(j).id <= last);
        next.map(move |j| SamplePair::of(data, i, j))
    };
    links.iter().enumerate().flat_map(later_pairs)
}

/// Adds pairs more than `gap` ids apart among the `links` of one receiver: all pairs of some samples up to a horizon, and
/// random pairs beyond. The limits on samples and random pairs are divided by the number of `receivers`.
fn add_far_pairs(far_pairs: &mut Vec<SamplePair>, data: &Dataset, links: &[usize], receivers: usize, gap: u32) {
    let position = |i: usize| data.sample(i).position();
    let sampled = evenly(links, ASKED.div_ceil(receivers));
    let nearest = Nearest::new(links, 3, position);
    let count = 2 * FAR_IDS as usize + 1 + NEIGHBOURS;
    let neighbours: Vec<Vec<(f64, usize)>> = sampled.par_iter().map(|&i| nearest.find(&position(i), count).1).collect();
    // Within the horizon, nine of ten lists are complete; beyond it, those that are not would bias the pairs.
    let ends = sorted(neighbours.iter().filter_map(|list| list.last()).map(|(distance, _)| *distance));
    let complete = neighbours.iter().any(|list| list.len() == links.len());
    let horizon = if complete { f64::INFINITY } else { ends.get(ends.len() / 10).copied().unwrap_or(0.0) };
    let is_far = |pair: &SamplePair| pair.id_gap(data) > gap;
    far_pairs.reserve(neighbours.iter().map(Vec::len).sum());
    for (&i, list) in sampled.iter().zip(neighbours) {
        let pairs = list.into_iter().map(|(_, j)| SamplePair::of(data, i, j));
        far_pairs.extend(pairs.filter(|pair| pair.distance <= horizon && is_far(pair)));
    }
    let drawn = draw_pairs(data, links, DRAWN.div_ceil(receivers));
    far_pairs.extend(drawn.filter(|pair| pair.distance > horizon && is_far(pair)));
}

/// Draws `count` random pairs of `links`, without those of a link with itself; none if there are fewer than two links.
fn draw_pairs(data: &Dataset, links: &[usize], count: usize) -> impl Iterator<Item = SamplePair> {
    let samples = links.len();
    let mut random = rng::stream(0, "repeatability pairs", 0);
    let mut draw_link = move || links[rng::below(&mut random, samples)];
    let mut draw_pair = move || SamplePair::of(data, draw_link(), draw_link());
    let count = if samples < 2 { 0 } else { count };
    (0..count).map(move |_| draw_pair()).filter(|pair| pair.earlier != pair.later)
}

/// Returns whether samples are in order of time, as those of a walk or scan: successive ones, at the receiver with the most,
/// are less than half as far apart as unrelated ones, by the median.
pub fn is_in_time_order(data: &Dataset) -> bool {
    let median = |pairs: Vec<SamplePair>| median(pairs.iter().map(|pair| pair.distance));
    let links = data.group_by_receiver(0..data.len()).into_iter().max_by_key(Vec::len).unwrap_or_default();
    let next = links.windows(2).map(|pair| SamplePair::of(data, pair[0], pair[1])).collect();
    median(next) < 0.5 * median(draw_unrelated_pairs(data))
}

/// Draws random pairs of any two samples of one receiver, about [`UNRELATED`] in all.
pub(super) fn draw_unrelated_pairs(data: &Dataset) -> Vec<SamplePair> {
    let receivers = data.group_by_receiver(0..data.len());
    let each = UNRELATED.div_ceil(receivers.len());
    receivers.iter().flat_map(|links| draw_pairs(data, links, each)).collect()
}

/// Returns ranges of distances at one, two, three, five and seven times a power of ten, metres, with the indices of
/// their pairs in `pairs` of ascending distances, without empty ranges. The first range is from 0 to a tenth of a
/// millimetre.
pub(super) fn distance_bins(pairs: &[SamplePair]) -> Vec<([f64; 2], Range<usize>)> {
    let edges = (-4..9).flat_map(|power| [1.0, 2.0, 3.0, 5.0, 7.0].map(|step| bin_edge(step, power)));
    let edges: Vec<f64> = [0.0].into_iter().chain(edges).collect();
    let first_pair = |edge: f64| pairs.partition_point(|pair| pair.distance < edge);
    let bin = |edge: &[f64]| ([edge[0], edge[1]], first_pair(edge[0])..first_pair(edge[1]));
    edges.windows(2).map(bin).filter(|(_, range)| !range.is_empty()).collect()
}

/// Computes `step` times ten to the `power`, rounded once: the number nearest to its decimal form.
fn bin_edge(step: f64, power: i32) -> f64 {
    if power < 0 { step / 10f64.powi(-power) } else { step * 10f64.powi(power) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};
    use std::collections::BTreeSet;

    fn data(places: impl Iterator<Item = (u32, f64)>) -> Dataset {
        let samples: Vec<Sample> = places.map(|(id, x)| Sample::new(id, [x, 0.0, 0.0])).collect();
        let spectra = Spectra::grey((1, 1), vec![0; samples.len()]).unwrap();
        Dataset::new("line", Pose::IDENTITY, vec![], samples, spectra).unwrap()
    }

    #[test]
    fn pairs_are_near_or_far_by_id_difference() {
        // There and back: ids 0 to 39 go out, 40 to 79 return over the same positions.
        let data = data((0..80).map(|id| (id, f64::from(id.min(79 - id)) * 0.01)));
        let near = find_pairs(&data, PairLag::Near);
        assert_eq!(near.len(), 79 + 78 + 77);
        assert!(near.iter().all(|pair| pair.later - pair.earlier <= 3));
        let turn = near.iter().filter(|pair| pair.distance == 0.0).map(|pair| pair.earlier);
        assert_eq!(turn.collect::<BTreeSet<_>>(), BTreeSet::from([38, 39]), "39 with 40, and 38 with 41");
        let far = find_pairs(&data, PairLag::Far);
        let zero: BTreeSet<_> = far.iter().filter(|pair| pair.distance == 0.0).map(|pair| pair.earlier).collect();
        assert_eq!(zero, (0..25).collect(), "79 - 2 i ids apart, more than 30");
        assert!(far.iter().all(|pair| pair.later - pair.earlier > 30) && far.is_sorted_by_key(|pair| pair.distance));
    }

    #[test]
    fn missing_ids_count_as_elapsed_time() {
        let data = data([(1, 0.0), (2, 0.0), (50, 0.0), (53, 0.0)].into_iter());
        let ends = |lag| find_pairs(&data, lag).iter().map(|pair| (pair.earlier, pair.later)).collect::<BTreeSet<_>>();
        assert_eq!(ends(PairLag::Near), BTreeSet::from([(0, 1), (2, 3)]));
        assert_eq!(ends(PairLag::Far), BTreeSet::from([(0, 2), (0, 3), (1, 2), (1, 3)]));
    }

    /// The closest pairs equal those of brute force, for more samples than the neighbour lists hold.
    #[test]
    fn finds_closest_pairs_far_apart_in_time() {
        let mut random = rng::stream(3, "places", 0);
        let data = data((0..900).map(|id| (id, f64::from(rng::uniform(&mut random) as f32))));
        let mut all: Vec<SamplePair> = Vec::new();
        for a in 0..900 {
            all.extend((a + 31..900).map(|b| SamplePair::of(&data, a, b)));
        }
        all.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        let distances = |pairs: &[SamplePair]| pairs[..400].iter().map(|pair| pair.distance).collect::<Vec<_>>();
        assert_eq!(distances(&find_pairs(&data, PairLag::Far)), distances(&all));
    }

    #[test]
    fn distance_bins_use_whole_millimetres() {
        let data = data([(0, 0.0), (40, 0.002), (80, 0.005), (120, 0.1), (160, 0.1)].into_iter());
        let pairs = find_pairs(&data, PairLag::Far);
        let counts: Vec<_> =
            distance_bins(&pairs).into_iter().map(|([low, high], range)| (low, high, range.len())).collect();
        let expected =
            [(0.0, 0.0001, 1), (0.002, 0.003, 1), (0.003, 0.005, 1), (0.005, 0.007, 1), (0.07, 0.1, 4), (0.1, 0.2, 2)];
        assert_eq!(counts, expected);
    }

    #[test]
    fn zero_and_one_sample_give_no_pairs() {
        for count in 0..2 {
            let one = data((0..count).map(|id| (id, 0.0)).chain((count == 0).then_some((9, 1.0))));
            assert!(
                find_pairs(&one, PairLag::Near).is_empty()
                    && find_pairs(&one, PairLag::Far).is_empty()
                    && draw_unrelated_pairs(&one).is_empty()
            );
        }
    }
}
