//! `ascend`: positions of receivers by multi-start coordinate ascent on smoothed coverage.
//!
//! 1. Traces positions of a Halton sequence to a few random transmitters.
//! 2. Starts at the best subsets of these positions. Moves one receiver along one axis by a step, both ways, and halves the
//!    step if no move raises the smoothed coverage.
//! 3. Keeps the best of all subsets traced so far and traces them to more transmitters, with fewer subsets in each round. The
//!    last round has all transmitters and the exact coverage.

use crate::coverage::{combinations, coverage, soft_coverage};
use pwrfgs_core::{Result, rng};
use std::collections::BTreeSet;

/// Number of positions traced before the first move, for any number of receivers.
const SCREENED: usize = 20;
/// Further positions per receiver.
const SCREENED_PER_RECEIVER: usize = 4;
/// Transmitters before the selection.
const SAMPLE: usize = 40;
/// Number of starts.
const STARTS: usize = 2;
/// Number of halvings of the step.
const HALVINGS: usize = 2;
/// Rounds of the selection: number of subsets that are kept, and number of transmitters that are added.
const ROUNDS: [(usize, usize); 2] = [(10, 96), (3, usize::MAX)];

/// Positions at the end of an ascent.
#[derive(Clone, Debug, PartialEq)]
pub struct AscentResult {
    /// Receivers in x and y, metres.
    pub receivers: Vec<[f64; 2]>,
    /// Powers in dBm `[T]` per receiver.
    pub powers: Vec<Vec<f64>>,
    /// Coverage over all transmitters, dBm.
    pub coverage: f64,
    /// Number of receiver positions traced, to some of the transmitters or all.
    pub positions: usize,
    /// Number of links traced.
    pub links: usize,
}

/// Searches the positions of `count` receivers with the largest coverage of `transmitters` transmitters. Returns `None` if there
/// are not enough free positions, or too many for [`combinations`], as from five receivers.
///
/// `area` has the low and the high corner, metres. `trace` returns powers in dBm of a receiver at x and y from the transmitters
/// of given indices; `None` if the position is not free. `seed` sets the order of transmitters and the screened positions. One
/// receiver takes about 50 positions.
///
/// # Errors
/// Errors of `trace`.
pub fn ascend(
    count: usize,
    seed: u64,
    area: [[f64; 2]; 2],
    transmitters: usize,
    trace: impl FnMut([f64; 2], &[usize]) -> Result<Option<Vec<f64>>>,
) -> Result<Option<AscentResult>> {
    let random = &mut rng::stream(seed, "ascent", 0);
    let mut order: Vec<usize> = (0..transmitters).collect();
    rng::shuffle(random, &mut order);
    let shift = [(); 2].map(|()| rng::uniform_f64(random));
    let traced = SAMPLE.min(transmitters);
    let mut search = Search { order, traced, area, trace, candidates: Vec::new(), subsets: Vec::new(), links: 0 };
    search.screen(SCREENED + SCREENED_PER_RECEIVER * count, shift)?;
    let screened = search.candidates.len();
    for subset in combinations(screened, count).unwrap_or_default() {
        search.assess(subset);
    }
    search.subsets.sort_by(Subset::compare_values);
    let size = (0..2).map(|k| area[1][k] - area[0][k]).product::<f64>().sqrt();
    // Half the mean distance between screened positions, metres.
    let first_step = 0.5 * size / (screened as f64).sqrt();
    for start in search.subsets.iter().take(STARTS).cloned().collect::<Vec<_>>() {
        search.climb(start, first_step)?;
    }
    for (kept, added) in ROUNDS {
        search.select_best(kept, added)?;
    }
    Ok(search.best_result())
}

/// Receiver position with its powers from the traced transmitters.
#[derive(Clone, Debug)]
struct TracedPosition {
    at: [f64; 2],
    powers: Vec<f64>,
}

/// Receivers, as sorted indices of traced positions, with their coverage.
#[derive(Clone, Debug)]
struct Subset {
    receivers: Vec<usize>,
    value: f64,
}

impl Subset {
    /// Orders subsets by falling value, then by receivers, so that equal subsets are adjacent.
    fn compare_values(&self, other: &Self) -> std::cmp::Ordering {
        other.value.total_cmp(&self.value).then_with(|| self.receivers.cmp(&other.receivers))
    }
}

/// State of the search.
struct Search<F> {
    /// Random order of the transmitters.
    order: Vec<usize>,
    /// Number of transmitters, from the start of this order, that are traced.
    traced: usize,
    area: [[f64; 2]; 2],
    trace: F,
    candidates: Vec<TracedPosition>,
    subsets: Vec<Subset>,
    links: usize,
}

/// Steps of the search. They return the errors of `trace`.
impl<F: FnMut([f64; 2], &[usize]) -> Result<Option<Vec<f64>>>> Search<F> {
    /// Traces the first free positions of the Halton sequence, at most `count`; `shift` moves the sequence, as parts of the
    /// area.
    fn screen(&mut self, count: usize, shift: [f64; 2]) -> Result<()> {
        let [low, high] = self.area;
        // Ends also if less than a twentieth of the area is free.
        for k in 1..=20 * count {
            let part = [0, 1].map(|axis| (van_der_corput(k, [2, 3][axis]) + shift[axis]).fract());
            self.candidate_at([0, 1].map(|axis| low[axis] + part[axis] * (high[axis] - low[axis])))?;
            if self.candidates.len() == count {
                break;
            }
        }
        Ok(())
    }

    /// Returns the index of the position `at`, traced at the first call; `None` if it is not free or outside.
    fn candidate_at(&mut self, at: [f64; 2]) -> Result<Option<usize>> {
        // Steps there and back differ by rounding.
        let is_here = |candidate: &TracedPosition| (0..2).all(|k| (candidate.at[k] - at[k]).abs() < 1e-6);
        let index = self.candidates.iter().position(is_here);
        if index.is_some() || (0..2).any(|k| !(self.area[0][k]..=self.area[1][k]).contains(&at[k])) {
            return Ok(index);
        }
        let Some(powers) = (self.trace)(at, &self.order[..self.traced])? else { return Ok(None) };
        self.links += powers.len();
        self.candidates.push(TracedPosition { at, powers });
        Ok(Some(self.candidates.len() - 1))
    }

    /// Computes the coverage of a subset over the traced transmitters: exact if `is_exact`, otherwise smoothed.
    fn subset_coverage(&self, receivers: &[usize], is_exact: bool) -> f64 {
        let powers: Vec<&[f64]> = receivers.iter().map(|&k| &self.candidates[k].powers[..]).collect();
        if is_exact { coverage(&powers) } else { soft_coverage(&powers) }
    }

    /// Computes the smoothed coverage of the subset of `receivers`, and returns and stores the subset.
    fn assess(&mut self, mut receivers: Vec<usize>) -> Subset {
        receivers.sort_unstable();
        let subset = Subset { value: self.subset_coverage(&receivers, false), receivers };
        self.subsets.push(subset.clone());
        subset
    }

    /// Climbs from `subset` by coordinate ascent, with a `step` in metres that is halved at each maximum; all assessed
    /// subsets are stored.
    fn climb(&mut self, mut subset: Subset, mut step: f64) -> Result<()> {
        for _ in 0..=HALVINGS {
            loop {
                let mut has_moved = false;
                for k in 0..2 * subset.receivers.len() {
                    has_moved |= self.try_move(&mut subset, (k / 2, k % 2), step)?;
                }
                if !has_moved {
                    break;
                }
            }
            step /= 2.0;
        }
        Ok(())
    }

    /// Moves a receiver along an axis, forwards or backwards, if that raises the value; returns whether it moved.
    fn try_move(&mut self, subset: &mut Subset, (receiver, axis): (usize, usize), step: f64) -> Result<bool> {
        for shift in [step, -step] {
            let mut at = self.candidates[subset.receivers[receiver]].at;
            at[axis] += shift;
            let Some(moved) = self.candidate_at(at)? else { continue };
            let mut receivers = subset.receivers.clone();
            receivers[receiver] = moved;
            let next = self.assess(receivers);
            if next.value > subset.value {
                *subset = next;
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Keeps the best subsets, at most `kept`, traces them to `added` more transmitters, and orders them by their new values.
    /// These are exact if no transmitter is left.
    fn select_best(&mut self, kept: usize, added: usize) -> Result<()> {
        self.subsets.sort_by(Subset::compare_values);
        self.subsets.dedup_by(|a, b| a.receivers == b.receivers);
        self.subsets.truncate(kept);
        let end = self.traced.saturating_add(added).min(self.order.len());
        let used: BTreeSet<usize> = self.subsets.iter().flat_map(|subset| subset.receivers.iter().copied()).collect();
        let added = &self.order[self.traced..end];
        for k in used.into_iter().filter(|_| !added.is_empty()) {
            let powers = (self.trace)(self.candidates[k].at, added)?.expect("a traced position is free");
            self.links += powers.len();
            self.candidates[k].powers.extend(powers);
        }
        self.traced = end;
        for k in 0..self.subsets.len() {
            self.subsets[k].value = self.subset_coverage(&self.subsets[k].receivers, end == self.order.len());
        }
        self.subsets.sort_by(Subset::compare_values);
        Ok(())
    }

    /// Returns the best subset, after the selection, with powers in the order of transmitters; `None` without subsets.
    fn best_result(&self) -> Option<AscentResult> {
        let best = self.subsets.first()?;
        let receivers: Vec<&TracedPosition> = best.receivers.iter().map(|&k| &self.candidates[k]).collect();
        let in_order = |receiver: &&TracedPosition| {
            let mut powers = vec![0.0; self.order.len()];
            self.order.iter().zip(&receiver.powers).for_each(|(&t, power)| powers[t] = *power);
            powers
        };
        Some(AscentResult {
            receivers: receivers.iter().map(|receiver| receiver.at).collect(),
            powers: receivers.iter().map(in_order).collect(),
            coverage: best.value,
            positions: self.candidates.len(),
            links: self.links,
        })
    }
}

/// Returns the element `k` of the van der Corput sequence in `base`: the digits of `k` mirrored at the radix point.
fn van_der_corput(mut k: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0 / base as f64);
    while k > 0 {
        value += digit * (k % base) as f64;
        (k, digit) = (k / base, digit / base as f64);
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRANSMITTERS: usize = 32 * 24;

    /// Returns the powers in an empty box of 8 m x 6 m: they fall with 20 log10 of the distance.
    fn powers([x, y]: [f64; 2], which: &[usize]) -> Vec<f64> {
        let at = |t: usize| [(t % 32) as f64, (t / 32) as f64].map(|k| 0.125 + 0.25 * k);
        let power = |[a, b]: [f64; 2]| -10.0 * ((x - a).powi(2) + (y - b).powi(2) + 1.0).log10();
        which.iter().map(|&t| power(at(t))).collect()
    }

    /// Searches `count` receivers in the box.
    fn in_box(count: usize, seed: u64) -> AscentResult {
        let trace = |at: [f64; 2], which: &[usize]| Ok(Some(powers(at, which)));
        ascend(count, seed, [[0.0, 0.0], [8.0, 6.0]], TRANSMITTERS, trace).unwrap().unwrap()
    }

    #[test]
    fn one_receiver_in_empty_box_ends_near_middle() {
        let all: Vec<usize> = (0..TRANSMITTERS).collect();
        let middle = coverage(&[&powers([4.0, 3.0], &all)]);
        for seed in 0..4 {
            let result = in_box(1, seed);
            assert_eq!(result.powers[0], powers(result.receivers[0], &all));
            assert_eq!(result.coverage, coverage(&[&result.powers[0]]));
            assert!(result.coverage > middle - 0.5, "{} and {middle}", result.coverage);
            assert!(result.links * 100 < TRANSMITTERS * TRANSMITTERS, "{}", result.links);
        }
    }

    #[test]
    fn two_receivers_share_the_long_side() {
        let result = in_box(2, 0);
        let mut x = [result.receivers[0][0], result.receivers[1][0]];
        x.sort_by(f64::total_cmp);
        assert!((1.0..3.2).contains(&x[0]) && (4.8..7.0).contains(&x[1]), "{:?}", result.receivers);
        assert!(result.coverage > in_box(1, 0).coverage + 1.0);
    }

    #[test]
    fn no_free_position_gives_no_result() {
        let result = ascend(1, 0, [[0.0; 2], [1.0; 2]], 5, |_, _| Ok(None));
        assert_eq!(result.unwrap(), None);
    }
}
