//! Coverage of receivers (the 10th percentile, over transmitters, of the power of the strongest receiver), and the best subset
//! of given receivers: exhaustive search, greedy search and random choices.

use pwrfgs_core::{rng, statistics::bounds};
use rayon::prelude::*;

/// Share of the transmitters below the coverage.
const SHARE: f64 = 0.1;
/// Smoothing of the soft maximum and of the soft percentile, dB.
const SMOOTHING_DB: f64 = 1.0;
/// Halvings in the search for the soft percentile.
const HALVINGS: usize = 60;

/// Returns the 10th percentile of the strongest power, dBm, with linear interpolation between transmitters. `powers` holds
/// one slice of powers in dBm `[T]` per receiver. NaN without transmitters or receivers.
pub fn coverage(powers: &[&[f64]]) -> f64 {
    let mut strongest = strongest_powers(powers);
    if strongest.is_empty() {
        return f64::NAN;
    }
    let rank = SHARE * (strongest.len() - 1) as f64;
    let (_, low, above) = strongest.select_nth_unstable_by(rank as usize, f64::total_cmp);
    let next = above.iter().copied().fold(f64::INFINITY, f64::min);
    if rank.fract() > 0.0 { *low + rank.fract() * (next - *low) } else { *low }
}

/// Returns the strongest power per transmitter `[T]`, dBm; `powers` holds one slice of powers `[T]` per receiver.
pub fn strongest_powers(powers: &[&[f64]]) -> Vec<f64> {
    reduce_receivers(powers, maximum)
}

/// Returns the smooth [`coverage`], dBm: the q at which the mean of 1 / (1 + exp((v − q) / 1 dB)) is 0.1, over soft maxima v
/// of the powers. NaN without transmitters or receivers.
pub fn soft_coverage(powers: &[&[f64]]) -> f64 {
    let soft = reduce_receivers(powers, |values| {
        let largest = maximum(values);
        largest + SMOOTHING_DB * values.iter().map(|v| ((v - largest) / SMOOTHING_DB).exp()).sum::<f64>().ln()
    });
    if soft.is_empty() {
        return f64::NAN;
    }
    let ends = bounds(soft.iter().copied());
    // At these ends, the mean is nearly 0 and nearly 1.
    let (mut low, mut high) = (ends.0 - 10.0 * SMOOTHING_DB, ends.1 + 10.0 * SMOOTHING_DB);
    let count_below = |q: f64| soft.iter().map(|v| 1.0 / (1.0 + ((v - q) / SMOOTHING_DB).exp())).sum::<f64>();
    for _ in 0..HALVINGS {
        let middle = f64::midpoint(low, high);
        if count_below(middle) < SHARE * soft.len() as f64 { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// Returns `reduce` of the powers of all receivers, per transmitter `[T]`.
fn reduce_receivers(powers: &[&[f64]], reduce: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    let mut values = vec![0.0; powers.len()]; // a buffer for all transmitters
    let reduced = |t: usize| {
        values.iter_mut().zip(powers).for_each(|(value, powers)| *value = powers[t]);
        reduce(&values)
    };
    (0..powers.first().map_or(0, |first| first.len())).map(reduced).collect()
}

/// Returns the largest of `values`; −∞ without values.
fn maximum(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// Largest number of subsets in an exhaustive search.
const MOST: usize = 100_000;

/// Selected receivers.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceiverSubset {
    /// Receivers: ascending after an exhaustive search, in the order of selection after a greedy search.
    pub receivers: Vec<usize>,
    /// Coverage, dBm; NaN without receivers or transmitters.
    pub coverage: f64,
    /// Number of subsets whose coverage was computed.
    pub evaluations: usize,
}

/// Returns the `count` receivers of largest coverage, the first of equal subsets; `None` if there are more than 100,000
/// subsets, or fewer receivers. `powers` holds powers in dBm `[T]` per receiver.
pub fn best_subset(powers: &[Vec<f64>], count: usize) -> Option<ReceiverSubset> {
    let subsets = combinations(powers.len(), count)?;
    let coverages: Vec<f64> = subsets.par_iter().map(|subset| subset_coverage(powers, subset)).collect();
    let pairs = coverages.into_iter().enumerate();
    let (best, coverage) = pairs.reduce(|best, next| if next.1 > best.1 { next } else { best })?;
    Some(ReceiverSubset { receivers: subsets[best].clone(), coverage, evaluations: subsets.len() })
}

/// Selects `count` receivers, or all if there are fewer, one after another, each raising the coverage most; `powers` holds
/// powers in dBm `[T]` per receiver. Between equal coverages, which occur while a tenth of the transmitters has no link, the
/// larger mean of the strongest powers decides, then the order of the receivers.
pub fn greedy_subset(powers: &[Vec<f64>], count: usize) -> ReceiverSubset {
    let mut subset = ReceiverSubset { receivers: Vec::new(), coverage: f64::NAN, evaluations: 0 };
    let mut strongest: Vec<f64> = vec![f64::NEG_INFINITY; powers.first().map_or(0, Vec::len)];
    while subset.receivers.len() < count.min(powers.len()) {
        let free: Vec<usize> = (0..powers.len()).filter(|r| !subset.receivers.contains(r)).collect();
        let value = |&r: &usize| {
            let sum: f64 = strongest.iter().zip(&powers[r]).map(|(strongest, power)| strongest.max(*power)).sum();
            (coverage(&[&strongest, &powers[r]]), sum)
        };
        let values: Vec<(f64, f64)> = free.par_iter().map(value).collect();
        subset.evaluations += free.len();
        let pairs = free.into_iter().zip(values);
        let Some((next, (value, _))) = pairs.reduce(|best, next| if next.1 > best.1 { next } else { best }) else {
            break;
        };
        subset.receivers.push(next);
        subset.coverage = value;
        strongest.iter_mut().zip(&powers[next]).for_each(|(strongest, power)| *strongest = strongest.max(*power));
    }
    subset
}

/// Returns `draws` random subsets of `count` of `total` receivers, as indices in random order.
pub fn random_subsets(total: usize, count: usize, draws: usize, seed: u64) -> Vec<Vec<usize>> {
    let draw = |k: usize| {
        let mut receivers: Vec<usize> = (0..total).collect();
        rng::shuffle(&mut rng::stream(seed, "random receivers", k as u64), &mut receivers);
        receivers.truncate(count);
        receivers
    };
    (0..draws).map(draw).collect()
}

/// Returns all subsets of `count` of `total` in lexicographic order; `None` if there are more than 100,000, or if `total` is
/// smaller than `count`.
pub fn combinations(total: usize, count: usize) -> Option<Vec<Vec<usize>>> {
    // `count` and `total - count` give equally many subsets; up to half of `total`, every factor raises the product.
    (0..count.min(total.checked_sub(count)?)).try_fold(1, |size: usize, k| {
        let next = size * (total - k) / (k + 1);
        (next <= MOST).then_some(next)
    })?;
    let mut subsets = Vec::new();
    let mut subset: Vec<usize> = (0..count).collect();
    loop {
        subsets.push(subset.clone());
        let Some(k) = (0..count).rev().find(|&k| subset[k] < total - count + k) else { return Some(subsets) };
        subset[k] += 1;
        (k + 1..count).for_each(|next| subset[next] = subset[next - 1] + 1);
    }
}

/// Returns the [`coverage`] of a subset of receivers, dBm; `powers` holds powers in dBm `[T]` per receiver.
pub fn subset_coverage(powers: &[Vec<f64>], subset: &[usize]) -> f64 {
    coverage(&subset.iter().map(|&r| &powers[r][..]).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_is_percentile_of_strongest_power() {
        let (rising, falling): (Vec<f64>, Vec<f64>) = (0..=100).map(|k| (f64::from(k), f64::from(100 - k))).unzip();
        assert!((coverage(&[&rising]) - 10.0).abs() < 1e-12);
        assert!((coverage(&[&rising, &falling]) - 55.0).abs() < 1e-12, "the strongest powers are 50, 51, 51, ..");
        assert!((coverage(&[&[0.0, 1.0]]) - 0.1).abs() < 1e-12, "interpolated");
        assert!(coverage(&[]).is_nan() && coverage(&[&[]]).is_nan() && soft_coverage(&[]).is_nan());
        assert_eq!(coverage(&[&[-3.0]]), -3.0);
    }

    #[test]
    fn soft_coverage_is_near_coverage_and_rises_with_powers() {
        let powers: Vec<f64> = (0..200).map(|k| -80.0 + 0.2 * f64::from(k)).collect();
        let soft = soft_coverage(&[&powers]);
        assert!((soft - coverage(&[&powers])).abs() < 0.5, "{soft}");
        let more: Vec<f64> = powers.iter().map(|v| v + 1.0).collect();
        assert!((soft_coverage(&[&more]) - soft - 1.0).abs() < 1e-9);
        assert!(soft_coverage(&[&powers, &powers]) > soft);
    }

    /// Returns random powers `[receivers][transmitters]`, dBm.
    fn random_powers(receivers: usize, transmitters: usize) -> Vec<Vec<f64>> {
        let mut random = rng::stream(1, "powers", 0);
        let mut receiver_powers = || (0..transmitters).map(|_| -90.0 + 40.0 * rng::uniform_f64(&mut random)).collect();
        (0..receivers).map(|_| receiver_powers()).collect()
    }

    #[test]
    fn subset_search_equals_brute_force() {
        let powers = random_powers(7, 40);
        for count in 1..=7_u32 {
            let masks = (0..1_u32 << 7).filter(|mask| mask.count_ones() == count);
            let members = |mask: u32| (0..7).filter(|r| mask >> r & 1 == 1).collect::<Vec<usize>>();
            let brute = masks.map(|mask| subset_coverage(&powers, &members(mask))).fold(f64::NEG_INFINITY, f64::max);
            let best = best_subset(&powers, count as usize).unwrap();
            assert_eq!((best.coverage, subset_coverage(&powers, &best.receivers)), (brute, brute));
            let greedy = greedy_subset(&powers, count as usize);
            assert_eq!(greedy.coverage, subset_coverage(&powers, &greedy.receivers));
            assert!(greedy.coverage <= brute && (count > 1 || greedy.receivers == best.receivers));
        }
        assert_eq!(best_subset(&powers, 3).unwrap().evaluations, 35);
        let one_far_each = vec![vec![-90.0; 4], vec![-90.0, -80.0, -90.0, -90.0], vec![-90.0, -90.0, -50.0, -90.0]];
        assert_eq!(greedy_subset(&one_far_each, 2).receivers, [2, 1], "equal coverage: largest mean");
    }

    #[test]
    fn combinations_are_limited_and_random_subsets_depend_on_seed() {
        assert_eq!(combinations(4, 2).unwrap().len(), 6);
        assert_eq!(combinations(21, 5).unwrap().len(), 20_349);
        assert_eq!((combinations(1000, 500), combinations(200, 3), combinations(2, 3)), (None, None, None));
        let draws = random_subsets(21, 5, 3, 0);
        assert!(draws == random_subsets(21, 5, 3, 0) && draws != random_subsets(21, 5, 3, 1));
    }
}
