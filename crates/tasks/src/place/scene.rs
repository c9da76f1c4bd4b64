//! Receivers at any free position of a simulated scene.

use super::{PlaceSettings, PlacedReceivers, Placement, RANDOM, check_count};
use pwrfgs_core::{Error, Result, statistics::mean};
use pwrfgs_experiment::text::{fixed, grouped, number};
use pwrfgs_experiment::{Session, run_stage};
use pwrfgs_planning::{AscentResult, SceneCoverage, greedy_subset, random_subsets, strongest_powers, subset_coverage};
use pwrfgs_raytrace::SceneFile;
use pwrfgs_report::draw::survey::CoverageMap;

/// Largest number of receivers: an ascent compares all subsets of the positions that it traces first.
const MOST: usize = 3;

/// Chooses receivers by ascent over the floor of a scene, and from a grid unless that is omitted.
///
/// # Errors
/// Invalid settings, a scene that cannot be built or has no free positions, or [`Error::Stopped`].
pub fn place_in_scene(scene: &SceneFile, settings: &PlaceSettings, session: &mut Session<'_>) -> Result<Placement> {
    check_count(settings.count)?;
    let count = settings.count;
    if count > MOST {
        return Err(Error::Config(format!("--count {count}: a scene takes at most {MOST} receivers; lower --count")));
    }
    let floor = SceneCoverage::new(scene, settings.step, settings.height, settings.mount)?;
    let (transmitters, candidates) = (floor.transmitters.len(), floor.candidates.len());
    if !settings.no_grid {
        floor.check_grid()?;
        if candidates < count {
            return Err(Error::Config(format!(
                "--count {count}: the grid has {candidates} receiver positions; give a smaller --step"
            )));
        }
    }
    let stop = session.stop;
    let ascent = run_stage(session.observer, "ascent", |_| floor.ascend(count, settings.seed, stop))?;
    let mut choices = vec![ascent_choice(&ascent, &floor)];
    let mut notes = vec![format!(
        "coverage: 10th percentile of the strongest simulated power over {} transmitters at {} m",
        grouped(transmitters as i64),
        number(settings.height)
    )];
    if !settings.no_grid {
        let grid = run_stage(session.observer, "grid of receivers", |progress| floor.grid_powers(stop, progress))?;
        let [best, random] = grid_choices(settings, &floor, &grid);
        notes.push(format!(
            "the ascent minus the grid: {} dB, with {} links instead of {}",
            fixed(ascent.coverage - best.coverage, 2),
            grouped(ascent.links as i64),
            grouped((transmitters * candidates) as i64)
        ));
        choices.extend([best, random]);
    }
    let map = coverage_map(&scene.name, &floor, ascent);
    let header = ["coverage (dBm)", "positions traced", "links traced"].map(str::to_owned).to_vec();
    Ok(Placement { header, choices, notes, map })
}

/// Creates the choice of the ascent over `floor`.
fn ascent_choice(ascent: &AscentResult, floor: &SceneCoverage) -> PlacedReceivers {
    PlacedReceivers {
        short: "ascent",
        name: "ascent".into(),
        receivers: ascent.receivers.iter().map(|[x, y]| (String::new(), [*x, *y, floor.mount()])).collect(),
        coverage: ascent.coverage,
        cells: format_cells(ascent.coverage, ascent.positions, ascent.links),
    }
}

/// Creates the greedy choice on the grid, which is exhaustive for one receiver, and the average of random subsets. `grid`
/// holds the powers of all candidates, dBm `[C][T]`.
fn grid_choices(settings: &PlaceSettings, floor: &SceneCoverage, grid: &[Vec<f64>]) -> [PlacedReceivers; 2] {
    let PlaceSettings { count, seed, .. } = *settings;
    let (transmitters, candidates) = (floor.transmitters.len(), floor.candidates.len());
    let best = greedy_subset(grid, count);
    let subsets = random_subsets(candidates, count, RANDOM, seed);
    let mean_coverage = mean(subsets.iter().map(|subset| subset_coverage(grid, subset)));
    let best = PlacedReceivers {
        short: "grid",
        name: if count == 1 { "grid, exhaustive" } else { "grid, greedy" }.into(),
        receivers: best.receivers.iter().map(|&r| (String::new(), floor.candidates[r])).collect(),
        coverage: best.coverage,
        cells: format_cells(best.coverage, candidates, transmitters * candidates),
    };
    let random = PlacedReceivers {
        short: "",
        name: format!("random, mean of {RANDOM} (seed {seed})"),
        receivers: Vec::new(),
        coverage: mean_coverage,
        cells: format_cells(mean_coverage, count, count * transmitters),
    };
    [best, random]
}

/// Creates the map of the strongest power of the receivers of the ascent.
fn coverage_map(scene: &str, floor: &SceneCoverage, ascent: AscentResult) -> CoverageMap {
    let powers: Vec<&[f64]> = ascent.powers.iter().map(Vec::as_slice).collect();
    CoverageMap {
        title: format!("{scene}: simulated coverage {} dBm", fixed(ascent.coverage, 1)),
        transmitters: floor.transmitters.iter().map(|[x, y, _]| [*x, *y]).collect(),
        powers: strongest_powers(&powers),
        selected: ascent.receivers,
        others: Vec::new(),
    }
}

/// Formats the cells below the header of [`place_in_scene`]: coverage in dBm, numbers of traced positions and links.
fn format_cells(coverage: f64, positions: usize, links: usize) -> Vec<String> {
    vec![fixed(coverage, 2), grouped(positions as i64), grouped(links as i64)]
}
