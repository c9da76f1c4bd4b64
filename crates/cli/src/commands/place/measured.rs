//! Best receivers of a data folder with received powers.

use super::{Choice, Outcome, Place, RANDOM};
use crate::progress::RunProgress;
use pwrfgs::experiment::staged;
use pwrfgs::experiment::text::{fixed, grouped};
use pwrfgs::planning::{Subset, best_subset, coverage_of, greedy_subset, random_subsets, strongest};
use pwrfgs::report::draw::survey::CoverageMap;
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::{DataSource, Dataset, Error, Result, rng, statistics::mean};
use std::path::Path;

/// One of so many transmitters is held out without an official split.
const HELD_OUT: usize = 5;

pub(super) fn choose(
    arguments: &Place,
    source: &Plugin<dyn DataSource>,
    progress: &mut RunProgress,
) -> Result<Outcome> {
    let (count, path) = (arguments.count, &arguments.source);
    let data = staged(progress, "data", |progress| source.load(Path::new(""), progress))?;
    let total = data.scene.receivers.len();
    let Some(matrix) = Matrix::new(&data) else {
        let what = "has no received powers; name data with received powers, or a scene";
        return Err(Error::input(path, what));
    };
    if count > total {
        return Err(Error::Config(format!("--count {count}: the data have {total} receivers; lower --count")));
    }
    let ([train, test], split) = split(&data, arguments.seed);
    if train.is_empty() || test.is_empty() {
        return Err(Error::input(path, "has fewer than two transmitters; name data with more"));
    }
    let [fitting, held_out] = [&train, &test].map(|part| matrix.part(part));
    let receiver = |&r: &usize| {
        let receiver = &data.scene.receivers[r];
        (receiver.name.clone(), data.scene.origin.world_pose(receiver.pose).position)
    };
    let line = |train: f64, test: f64, subsets: &str| vec![fixed(train, 2), fixed(test, 2), subsets.to_owned()];
    let searched = |short: &'static str, subset: &Subset| {
        let test = coverage_of(&held_out, &subset.receivers);
        let cells = line(subset.coverage, test, &grouped(subset.evaluations as i64));
        let receivers = subset.receivers.iter().map(receiver).collect();
        Choice { short, name: short.into(), receivers, coverage: test, cells }
    };
    let [best, greedy] = staged(progress, "choosing receivers", |_| {
        [best_subset(&fitting, count), Some(greedy_subset(&fitting, count))]
    });
    let found = [("exhaustive", best), ("greedy", greedy)];
    let found: Vec<(&str, Subset)> = found.into_iter().filter_map(|(name, subset)| Some((name, subset?))).collect();
    let mut choices: Vec<Choice> = found.iter().map(|(name, subset)| searched(name, subset)).collect();
    let draws = random_subsets(total, count, RANDOM, arguments.seed);
    let average = |powers: &[Vec<f64>]| mean(draws.iter().map(|subset| coverage_of(powers, subset)));
    let all: Vec<usize> = (0..total).collect();
    let further = [
        (format!("random, mean of {RANDOM} (seed {})", arguments.seed), average(&fitting), average(&held_out)),
        (format!("all {total} receivers"), coverage_of(&fitting, &all), coverage_of(&held_out, &all)),
    ];
    choices.extend(further.map(|(name, train, test)| {
        let cells = line(train, test, "");
        Choice { short: "", name, receivers: Vec::new(), coverage: test, cells }
    }));
    let simulated = if data.is_simulated() { "simulated " } else { "" };
    let mut notes = vec![
        format!(
            "coverage: 10th percentile of the strongest {simulated}power; {} training and {} held-out transmitters ({split})",
            grouped(train.len() as i64),
            grouped(test.len() as i64)
        ),
        format!(
            "{} of {} links are missing and count as {} dBm, the weakest power of the data",
            grouped(matrix.missing as i64),
            grouped((total * data.locations.len()) as i64),
            fixed(matrix.weakest, 1)
        ),
    ];
    if found.len() == 1 {
        notes.push("more than 100,000 subsets: greedy choice only".into());
    }
    let chosen = &found[0].1.receivers;
    let names: Vec<String> = chosen.iter().map(|r| receiver(r).0).collect();
    notes.push(format!("{} choice: {}", found[0].0, names.join(", ")));
    let above = |r: &usize| receiver(r).1;
    let flat = |[x, y, _]: [f64; 3]| [x, y];
    let powers: Vec<&[f64]> = chosen.iter().map(|&r| &held_out[r][..]).collect();
    let transmitters = test.iter().filter(|_| data.placed).map(|&t| flat(data.locations[t].position())).collect();
    let map = CoverageMap {
        title: format!("{}: {simulated}coverage {} dBm", data.title, fixed(choices[0].coverage, 1)),
        transmitters,
        powers: strongest(&powers),
        selected: chosen.iter().map(|r| flat(above(r))).collect(),
        others: all.iter().filter(|r| !chosen.contains(r)).map(|r| flat(above(r))).collect(),
    };
    let header = ["training (dBm)", "held-out (dBm)", "subsets"].map(str::to_owned).to_vec();
    Ok(Outcome { header, choices, notes, map })
}

/// Transmitters for the choice and for its score: the official split, otherwise a random fifth is held out.
fn split(data: &Dataset, seed: u64) -> ([Vec<usize>; 2], String) {
    if let Some((train, test)) = &data.official {
        let [train, test] = [train, test].map(|links| data.locations_of(links));
        let test: Vec<usize> = test.into_iter().filter(|t| train.binary_search(t).is_err()).collect();
        if !train.is_empty() && !test.is_empty() {
            return ([train, test], "official split".into());
        }
    }
    let mut all: Vec<usize> = (0..data.locations.len()).collect();
    rng::shuffle(&mut rng::stream(seed, "place split", 0), &mut all);
    let train = all.split_off(all.len().div_ceil(HELD_OUT));
    let parts = [train, all].map(|mut part| {
        part.sort_unstable();
        part
    });
    (parts, format!("random split, seed {seed}"))
}

/// Powers of all pairs of receiver and transmitter.
struct Matrix {
    /// dBm `[R][T]`.
    powers: Vec<Vec<f64>>,
    /// Weakest power of the data, dBm.
    weakest: f64,
    /// Number of pairs without a link.
    missing: usize,
}

impl Matrix {
    /// Collects the powers; `None` for other observations.
    fn new(data: &Dataset) -> Option<Self> {
        let values = data.observations.powers()?;
        let weakest = values.iter().map(|v| *v as f64).fold(f64::INFINITY, f64::min);
        let (receivers, transmitters) = (data.scene.receivers.len(), data.locations.len());
        let mut powers = vec![vec![weakest; transmitters]; receivers];
        for (link, power) in data.links.iter().zip(values) {
            powers[link.receiver][link.location] = *power as f64;
        }
        Some(Self { powers, weakest, missing: (receivers * transmitters).saturating_sub(data.links.len()) })
    }

    /// Powers of these transmitters, per receiver.
    fn part(&self, transmitters: &[usize]) -> Vec<Vec<f64>> {
        self.powers.iter().map(|own| transmitters.iter().map(|&t| own[t]).collect()).collect()
    }
}
