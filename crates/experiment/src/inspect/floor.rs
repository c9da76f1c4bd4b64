//! Difference of observations at neighbouring positions, and the error that no map can be much below.

use crate::text::format_length;
use pwrfgs_core::neighbours::Nearest;
use pwrfgs_core::numbers::{fixed, number};
use pwrfgs_core::statistics::{mean, median};
use pwrfgs_core::{Dataset, Result, evenly};
use rayon::prelude::*;

/// Largest number of compared pairs.
const PAIRS: usize = 300;
/// Largest number of compared pairs if an observation is a single number.
const NUMBERS: usize = 6_000;
/// Smallest number of pairs for a statement.
const LEAST: usize = 20;
/// Number of neighbours among which one at another position is sought.
const SEARCHED: usize = 16;

/// Returns name and description of the difference of observations of one receiver at neighbouring positions. For received
/// powers, it also gives the mean absolute error of a perfect map: less than the difference, since both observations of a pair
/// deviate from the map. `None` without positions or with few pairs.
///
/// # Errors
/// If an observation cannot be read.
pub(super) fn describe_floor(data: &Dataset) -> Result<Option<(&'static str, String)>> {
    if !data.placed {
        return Ok(None);
    }
    let (task, pairs) = (data.task(), score_neighbours(data));
    data.observations.check()?;
    if pairs.len() < LEAST {
        return Ok(None);
    }
    let distance = format_length(median(pairs.iter().map(|(distance, _)| *distance)));
    let score = mean(pairs.iter().map(|(_, score)| *score));
    let text = if task.is_scalar {
        let floor = fixed(task.ceiling.share * score, 1);
        let differ = fixed(score, 1);
        format!(
            "neighbours {distance} apart differ by {differ} dB: no map at this spacing can be better than about {floor} dB"
        )
    } else {
        let (name, score) = (task.headline.name, number(score));
        format!("neighbours {distance} apart predict each other with a mean {name} of {score}")
    };
    Ok(Some(("floor", text)))
}

/// Compares observations of one receiver at neighbouring positions, for evenly chosen links: about [`NUMBERS`] or [`PAIRS`] in
/// all. Returns distance in metres and score of each pair, one observation as a prediction of the other.
fn score_neighbours(data: &Dataset) -> Vec<(f64, f64)> {
    let task = data.task();
    let position = |i: usize| data.sample(i).position();
    let by_receiver = data.group_by_receiver(0..data.len());
    let receivers = by_receiver.iter().filter(|links| links.len() > 1).count().max(1);
    let most = (if task.is_scalar { NUMBERS } else { PAIRS }).div_ceil(receivers);
    let pairs_of = |links: &Vec<usize>| {
        let lookup = Nearest::new(links, 3, position);
        let pair = |&i: &usize| {
            let (_, near) = lookup.find(&position(i), SEARCHED);
            let (distance, j) = near.into_iter().find(|(distance, _)| *distance > 0.0)?;
            Some((distance, task.score(&task.shown(data.image(j)), &data.image(i))))
        };
        evenly(links, most).par_iter().filter_map(pair).collect::<Vec<_>>()
    };
    by_receiver.iter().flat_map(pairs_of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Observations, Pose, Real, Receiver, Sample};

    /// Powers on a line, 2 m apart, that alternate by 4 dB; each position is measured twice.
    #[test]
    fn floor_of_powers_is_difference_of_neighbours_over_root_two() {
        let data = |count: u32| {
            let place = |id: u32| [f64::from(2 * (id / 2)), 0.0, 0.0];
            let samples: Vec<Sample> = (0..count).map(|id| Sample::new(id, place(id))).collect();
            let powers = (0..count).map(|id| -60.0 - 4.0 * Real::from(((id / 2) % 2) as u8)).collect();
            let receivers = vec![Receiver::new("a", Pose::IDENTITY)];
            Dataset::of_links("line", receivers, vec![], &samples, Observations::Powers(powers)).unwrap()
        };
        let expected =
            "neighbours 2.00 m apart differ by 4.0 dB: no map at this spacing can be better than about 2.8 dB";
        assert_eq!(describe_floor(&data(40)).unwrap(), Some(("floor", expected.into())));
        assert_eq!(describe_floor(&data(12)).unwrap(), None);
        assert_eq!(describe_floor(&Dataset { placed: false, ..data(40) }).unwrap(), None);
    }
}
