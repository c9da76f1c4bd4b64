//! Correlation of measurements, and scores of Kriging from a selection of them.

use crate::survey::box_diagonal;
use pwrfgs_core::kriging::{Correlation, CorrelationKind, HeldOutCases, Mean, spatial_place};
use pwrfgs_core::{Baseline as _, Dataset, FittingSet, Result, evenly, rng};
use pwrfgs_data::{Kriging, Trend, vecchia_cases};
use rayon::prelude::*;

/// Largest number of links in the likelihood.
const CASES: usize = 320;
/// Largest number of earlier links that each is given.
const NEIGHBOURS: usize = 16;
/// Approximate number of values per observation in the likelihood.
const VALUES: usize = 500;

/// Estimates the exponential correlation of the measurements at these transmitters by maximum likelihood. `None` if fewer
/// than two links have an earlier one at their receiver, if all transmitters have one position, or if the data have no
/// positions.
///
/// The likelihood is the Vecchia approximation: the product of the densities of at most 320 links, each given the 16 nearest of
/// those before it at its receiver, in random order. All receivers and values share the correlation. Received powers are
/// residuals of a path-loss model per receiver.
pub fn learn_correlation(data: &Dataset, transmitters: &[usize]) -> Option<Correlation> {
    if !data.placed || data.features.is_some() {
        return None;
    }
    let mut sorted = transmitters.to_vec();
    sorted.sort_unstable();
    let mut links = evenly(&data.links_of(&sorted), CASES);
    rng::shuffle(&mut rng::stream(0, "plan", 0), &mut links);
    let by_receiver = data.group_by_receiver(links);
    let trends: Vec<Trend<'_>> = by_receiver.iter().map(|links| Trend::fit(data, links)).collect();
    let cases: Vec<_> = by_receiver.iter().flat_map(|links| vecchia_cases(data, links, NEIGHBOURS)).collect();
    if cases.len() < 2 {
        return None;
    }
    let position = |i: usize| spatial_place(data.sample(i).position());
    let values = |_: usize, i: usize| trends[data.links[i].receiver].residual_values(i, VALUES);
    let cases = HeldOutCases::new(&cases, Mean::Unknown, position, values);
    let reach = longest_length(data, transmitters);
    (reach > 0.0).then(|| most_likely(&cases, reach))
}

/// Returns the longest length scale that [`learn_correlation`] tries, metres: the diagonal of the smallest box around these
/// transmitters. An estimate of this length means that the measurements do not determine it.
pub fn longest_length(data: &Dataset, transmitters: &[usize]) -> f64 {
    box_diagonal(&transmitters.iter().map(|&t| data.locations[t].position()).collect::<Vec<_>>())
}

/// Returns the most likely exponential correlation with a length scale from 1/64 to once `reach` (metres), in steps of
/// a factor √2, and a noise variance from 1/1024 to 4 times the process variance, in steps of a factor 2.
///
/// Longer scales than the distances between measurements are not identified: variogram and noise stay the same if scale and
/// process variance grow together.
fn most_likely(cases: &HeldOutCases, reach: f64) -> Correlation {
    let correlation = |[length, noise]: [i32; 2]| {
        let scale = reach * (-0.5 * f64::from(length)).exp2();
        let scales = [scale, scale, scale, f64::INFINITY];
        Correlation { kind: CorrelationKind::Exponential, scales, noise: 4.0 * (-f64::from(noise)).exp2() }
    };
    let likelihood = |at: [i32; 2]| {
        let value = cases.log_likelihood(&correlation(at));
        if value.is_nan() { f64::NEG_INFINITY } else { value }
    };
    let grid = (0..=12).flat_map(|length| (0..=12).map(move |noise| [length, noise]));
    let best_point = grid.map(|at| (at, likelihood(at))).reduce(|best, next| if next.1 > best.1 { next } else { best });
    correlation(best_point.expect("the grid has points").0)
}

/// Returns the main metric of Kriging, fitted on these transmitters, for each link of `test`.
///
/// # Errors
/// Data without positions, or an observation that cannot be read.
pub fn kriging_scores(data: &Dataset, transmitters: &[usize], test: &[usize]) -> Result<Vec<f64>> {
    let mut sorted = transmitters.to_vec();
    sorted.sort_unstable();
    let (links, task) = (data.links_of(&sorted), data.task());
    let fitted = Kriging::default().fit(data, FittingSet::train(&links))?;
    let score = |&i: &usize| task.score(&task.shown(fitted.predict(data.query(i))), &data.image(i));
    let scores = test.par_iter().map(score).collect();
    data.observations.check()?;
    Ok(scores)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    /// Returns spectra of values that vary with this length along x, at random positions.
    fn waves(length: f64) -> Dataset {
        let mut random = rng::stream(2, "waves", 0);
        let samples: Vec<Sample> =
            (0..150).map(|id| Sample::new(id, [10.0 * rng::uniform_f64(&mut random), 0.0, 0.0])).collect();
        let value = |x: f64, k: usize| (0.5 + 0.4 * (x / length + k as f64).sin()) as f32;
        let pixels: Vec<f32> = samples.iter().flat_map(|s| (0..12).map(move |k| value(s.position()[0], k))).collect();
        Dataset::new("waves", Pose::IDENTITY, vec![], samples, Spectra::float((4, 3), &pixels).unwrap()).unwrap()
    }

    #[test]
    fn learned_scale_follows_data_and_two_links_give_none() {
        let all: Vec<usize> = (0..150).collect();
        let [short, long] = [0.1, 2.0].map(|length| learn_correlation(&waves(length), &all).unwrap());
        assert!(short.scales[0] < 0.5 * long.scales[0], "{short:?} and {long:?}");
        assert!(long.scales[0] <= 10.0 && long.noise < 0.1, "{long:?}");
        assert_eq!(learn_correlation(&waves(1.0), &[0, 1]), None);
    }

    #[test]
    fn scores_improve_with_measurements() {
        let data = waves(1.0);
        let test: Vec<usize> = (100..150).collect();
        let mean = |count: usize| {
            let scores = kriging_scores(&data, &(0..count).rev().collect::<Vec<_>>(), &test).unwrap();
            scores.iter().sum::<f64>() / 50.0
        };
        let [few, many] = [10, 100].map(mean);
        assert!(many > few, "{few} and {many}");
    }
}
