//! `ascend`: positions of receivers by multi-start coordinate ascent on smoothed coverage.
//!
//! 1. Traces a few positions of a Halton sequence to a sample of the transmitters.
//! 2. Starts at the best subsets of these positions.
//! 3. Moves one receiver along one axis by a step, both ways, and halves the step if no move raises the smoothed coverage.
//! 4. Scores the end of every start on all transmitters, and returns the best end.

use crate::coverage::{combinations, coverage, soft_coverage};
use pwrfgs_core::{Result, rng};

/// Settings of the ascent. Defaults trace about 90 positions per receiver to 48 transmitters.
#[derive(Clone, Copy, Debug)]
pub struct Ascent {
    /// Number of receivers.
    pub count: usize,
    /// Positions traced before the first move, in addition to 4 per receiver.
    pub screened: usize,
    /// Number of starts.
    pub starts: usize,
    /// Largest number of transmitters in the sample.
    pub sample: usize,
    /// Number of halvings of the step.
    pub halvings: usize,
    /// Random seed of the sample.
    pub seed: u64,
}

impl Ascent {
    /// Default settings for `count` receivers.
    pub fn new(count: usize, seed: u64) -> Self {
        Self { count, screened: 12, starts: 2, sample: 48, halvings: 3, seed }
    }
}

/// Positions at the end of an ascent.
#[derive(Clone, Debug, PartialEq)]
pub struct AscentResult {
    /// Receivers in x and y, metres.
    pub receivers: Vec<[f64; 2]>,
    /// Powers in dBm `[T]` per receiver.
    pub powers: Vec<Vec<f64>>,
    /// Coverage over all transmitters, dBm.
    pub coverage: f64,
    /// Number of receiver positions traced, with a sample of the transmitters or all.
    pub positions: usize,
    /// Number of links traced.
    pub links: usize,
}

/// Searches receivers between the corners `area` (metres). `trace` returns powers in dBm of a receiver at x and y from the given
/// ones of `transmitters` transmitters; `None` if the position is not free.
///
/// # Errors
/// Errors of `trace`. The result is `None` if there are not enough free positions.
pub fn ascend(
    settings: &Ascent,
    area: [[f64; 2]; 2],
    transmitters: usize,
    trace: impl FnMut([f64; 2], &[usize]) -> Result<Option<Vec<f64>>>,
) -> Result<Option<AscentResult>> {
    let mut search = Search { sample: sample(transmitters, settings), area, trace, positions: 0, links: 0 };
    let screened = search.screen(settings.screened + 4 * settings.count)?;
    let mut starts: Vec<State> = combinations(screened.len(), settings.count)
        .unwrap_or_default()
        .iter()
        .map(|subset| State::new(subset.iter().map(|&k| screened[k].clone()).collect()))
        .collect();
    starts.sort_by(|a, b| b.value.total_cmp(&a.value));
    starts.truncate(settings.starts);
    let all: Vec<usize> = (0..transmitters).collect();
    let size = (0..2).map(|k| area[1][k] - area[0][k]).product::<f64>().sqrt();
    let first_step = 0.5 * size / (screened.len() as f64).sqrt();
    let mut best: Option<AscentResult> = None;
    for start in starts {
        let end = search.climb(start, first_step, settings.halvings)?;
        let receivers: Vec<[f64; 2]> = end.receivers.iter().map(|own| own.at).collect();
        let mut powers = Vec::new();
        for at in &receivers {
            powers.extend(search.trace(*at, &all)?);
        }
        let coverage = coverage(&slices(&powers));
        if best.as_ref().is_none_or(|best| coverage > best.coverage) {
            best = Some(AscentResult { receivers, powers, coverage, positions: 0, links: 0 });
        }
    }
    Ok(best.map(|best| AscentResult { positions: search.positions, links: search.links, ..best }))
}

/// One random transmitter of each of as many equal sections of the list.
fn sample(transmitters: usize, settings: &Ascent) -> Vec<usize> {
    let count = transmitters.min(settings.sample);
    let mut random = rng::stream(settings.seed, "sample of transmitters", 0);
    let bound = |k: usize| k * transmitters / count;
    (0..count).map(|k| bound(k) + rng::below(&mut random, bound(k + 1) - bound(k))).collect()
}

fn slices(powers: &[Vec<f64>]) -> Vec<&[f64]> {
    powers.iter().map(Vec::as_slice).collect()
}

/// Receiver with its powers from the sample.
#[derive(Clone, Debug)]
struct Traced {
    at: [f64; 2],
    powers: Vec<f64>,
}

/// Receivers with their smoothed coverage.
#[derive(Clone, Debug)]
struct State {
    receivers: Vec<Traced>,
    value: f64,
}

impl State {
    fn new(receivers: Vec<Traced>) -> Self {
        let value = soft_coverage(&receivers.iter().map(|own| &own.powers[..]).collect::<Vec<_>>());
        Self { receivers, value }
    }
}

struct Search<F> {
    sample: Vec<usize>,
    area: [[f64; 2]; 2],
    trace: F,
    positions: usize,
    links: usize,
}

impl<F: FnMut([f64; 2], &[usize]) -> Result<Option<Vec<f64>>>> Search<F> {
    fn trace(&mut self, at: [f64; 2], transmitters: &[usize]) -> Result<Option<Vec<f64>>> {
        let powers = (self.trace)(at, transmitters)?;
        if powers.is_some() {
            self.positions += 1;
            self.links += transmitters.len();
        }
        Ok(powers)
    }

    fn traced(&mut self, at: [f64; 2]) -> Result<Option<Traced>> {
        let sample = std::mem::take(&mut self.sample);
        let powers = self.trace(at, &sample);
        self.sample = sample;
        Ok(powers?.map(|powers| Traced { at, powers }))
    }

    /// Free positions of the Halton sequence, at most `count`.
    fn screen(&mut self, count: usize) -> Result<Vec<Traced>> {
        let mut found = Vec::new();
        for k in 1..=20 * count {
            let part = [2, 3].map(|base| halton(k, base));
            let at = [0, 1].map(|axis| self.area[0][axis] + part[axis] * (self.area[1][axis] - self.area[0][axis]));
            found.extend(self.traced(at)?);
            if found.len() == count {
                break;
            }
        }
        Ok(found)
    }

    /// Coordinate ascent.
    fn climb(&mut self, mut state: State, mut step: f64, halvings: usize) -> Result<State> {
        for _ in 0..=halvings {
            loop {
                let mut has_moved = false;
                for k in 0..2 * state.receivers.len() {
                    has_moved |= self.walk(&mut state, (k / 2, k % 2), step)?;
                }
                if !has_moved {
                    break;
                }
            }
            step /= 2.0;
        }
        Ok(state)
    }

    /// Moves a receiver along an axis, one way or the other, if that raises the value.
    fn walk(&mut self, state: &mut State, (receiver, axis): (usize, usize), step: f64) -> Result<bool> {
        for way in [step, -step] {
            let mut at = state.receivers[receiver].at;
            at[axis] += way;
            if !(self.area[0][axis]..=self.area[1][axis]).contains(&at[axis]) {
                continue;
            }
            let Some(moved) = self.traced(at)? else { continue };
            let mut receivers = state.receivers.clone();
            receivers[receiver] = moved;
            let next = State::new(receivers);
            if next.value > state.value {
                *state = next;
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// Element `k` of the van der Corput sequence in `base`.
fn halton(mut k: usize, base: usize) -> f64 {
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

    /// Ascent in an empty box of 8 m x 6 m: received power falls with 20 log10 of the distance.
    fn in_box(settings: &Ascent) -> AscentResult {
        let grid: Vec<[f64; 2]> =
            (0..32 * 24).map(|k| [0.125 + 0.25 * f64::from(k % 32), 0.125 + 0.25 * f64::from(k / 32)]).collect();
        let trace = |[x, y]: [f64; 2], which: &[usize]| {
            let power = |&t: &usize| -10.0 * ((x - grid[t][0]).powi(2) + (y - grid[t][1]).powi(2) + 1.0).log10();
            Ok(Some(which.iter().map(power).collect()))
        };
        ascend(settings, [[0.0, 0.0], [8.0, 6.0]], grid.len(), trace).unwrap().unwrap()
    }

    #[test]
    fn one_receiver_in_empty_box_ends_near_middle() {
        let result = in_box(&Ascent { sample: 768, ..Ascent::new(1, 0) });
        let [x, y] = result.receivers[0];
        assert!((x - 4.0).abs() < 0.3 && (y - 3.0).abs() < 0.3, "({x}, {y})");
        let sampled = in_box(&Ascent::new(1, 0));
        assert!(result.coverage - sampled.coverage < 0.5, "{} and {}", result.coverage, sampled.coverage);
        assert!(sampled.links * 90 < 768 * 768, "{}", sampled.links);
    }

    #[test]
    fn two_receivers_share_the_long_side() {
        let result = in_box(&Ascent::new(2, 0));
        let mut x = [result.receivers[0][0], result.receivers[1][0]];
        x.sort_by(f64::total_cmp);
        assert!((1.0..3.2).contains(&x[0]) && (4.8..7.0).contains(&x[1]), "{:?}", result.receivers);
        assert!(result.coverage > in_box(&Ascent::new(1, 0)).coverage + 1.0);
    }

    #[test]
    fn no_free_position_gives_no_result() {
        let found = ascend(&Ascent::new(1, 0), [[0.0; 2], [1.0; 2]], 5, |_, _| Ok(None));
        assert_eq!(found.unwrap(), None);
    }
}
