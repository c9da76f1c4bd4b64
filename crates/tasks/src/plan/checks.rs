//! Checks of the candidates of a plan.

use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Error, Result, evenly};
use pwrfgs_experiment::text::{grouped, number};
use std::path::Path;

/// Largest number of candidates among which positions are selected.
pub(super) const MOST: usize = 20_000;
/// Largest distance of the candidates from the known measurements, in extents of these.
const FAR: f64 = 10.0;
/// Largest number of candidates whose distance is computed, evenly chosen.
const SAMPLED: usize = 100;

/// Rejects a `count` of positions that is 0, above [`MOST`] or above `total`, the number of candidates; a model alone has none.
pub(super) fn check_count(count: usize, total: usize) -> Result<()> {
    if total == 0 {
        let problem =
            "a model has no candidates; set --candidates FILE or --floor SCENE, or give data in place of the model";
        return Err(Error::Config(problem.into()));
    }
    if (1..=total.min(MOST)).contains(&count) {
        return Ok(());
    }
    let problem = if count == 0 {
        "give at least 1".to_owned()
    } else if total > MOST {
        format!("a plan has at most {} positions; lower --count", grouped(MOST as i64))
    } else {
        format!("there are {} candidates; lower --count, or give more candidates", grouped(total as i64))
    };
    Err(Error::Config(format!("--count {count}: {problem}")))
}

/// Rejects candidates of which all are far from the known measurements: probably another frame or unit. `path` is their
/// file.
pub(super) fn check_distance(candidates: &[[f64; 3]], measured: &[[f64; 3]], path: &Path) -> Result<()> {
    let Some(first) = measured.first() else { return Ok(()) };
    let extent = measured.iter().map(|position| distance(*position, *first)).fold(0.0, f64::max).max(1.0);
    let gap =
        |position: &[f64; 3]| measured.iter().map(|near| distance(*near, *position)).fold(f64::INFINITY, f64::min);
    let nearest = evenly(candidates, SAMPLED).iter().map(gap).fold(f64::INFINITY, f64::min);
    if nearest <= FAR * extent {
        return Ok(());
    }
    let [gap, extent] = [nearest, extent].map(number);
    Err(Error::input(
        path,
        format!(
            "candidates are {gap} m from the nearest known measurement, and these extend over {extent} m; give both in metres \
             in one frame"
        ),
    ))
}
