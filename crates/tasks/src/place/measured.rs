//! Best receivers of a data folder with received powers.

use super::{PlaceSettings, PlacedReceivers, Placement, RANDOM, check_count};
use pwrfgs_core::{Dataset, Error, Result, rng, statistics::mean};
use pwrfgs_experiment::text::{fixed, grouped};
use pwrfgs_experiment::{Observer, run_stage};
use pwrfgs_planning::{ReceiverSubset, best_subset, greedy_subset, random_subsets, strongest_powers, subset_coverage};
use pwrfgs_report::draw::survey::CoverageMap;

/// One transmitter of so many is held out if there is no official split.
const HELD_OUT: usize = 5;

/// Chooses receivers of `data` by a greedy search over the training transmitters, and by an exhaustive one unless there are
/// too many subsets. Scores the choices on held-out transmitters.
///
/// # Errors
/// Invalid settings, data without received powers, or fewer than two transmitters.
pub fn place_in_data(data: &Dataset, settings: &PlaceSettings, observer: &mut dyn Observer) -> Result<Placement> {
    check_count(settings.count)?;
    let (count, total) = (settings.count, data.scene.receivers.len());
    let refuse = |problem: &str| Err(Error::Config(problem.into()));
    let Some(matrix) = PowerMatrix::new(data) else {
        return refuse("the data have no received powers; name data with received powers, or a scene");
    };
    if count > total {
        return Err(Error::Config(format!("--count {count}: the data have {total} receivers; lower --count")));
    }
    let ([train, test], split) = split_transmitters(data, settings.seed);
    if train.is_empty() || test.is_empty() {
        return refuse("the data have fewer than two transmitters; name data with more");
    }
    let simulated = if data.is_simulated() { "simulated " } else { "" };
    let mut notes = vec![
        format!(
            "coverage: 10th percentile of the strongest {simulated}power; {} training and {} held-out transmitters ({split})",
            grouped(train.len() as i64),
            grouped(test.len() as i64)
        ),
        matrix.describe_missing(),
    ];
    let powers = MeasuredPowers { data, fitting: matrix.select(&train), held_out: matrix.select(&test) };
    let subsets = run_stage(observer, "choosing receivers", |_| search_subsets(&powers.fitting, count));
    if subsets.len() == 1 {
        notes.push("more than 100,000 subsets: greedy choice only".into()); // the limit of `best_subset`
    }
    let mut choices: Vec<PlacedReceivers> =
        subsets.iter().map(|(name, subset)| powers.score_subset(name, subset)).collect();
    choices.extend(powers.reference_choices(count, settings.seed));
    let (search, ReceiverSubset { receivers: chosen, .. }) = &subsets[0];
    let names: Vec<String> = chosen.iter().map(|&r| powers.name_and_position(r).0).collect();
    notes.push(format!("{search} choice: {}", names.join(", ")));
    let title = format!("{}: {simulated}coverage {} dBm", data.title, fixed(choices[0].coverage, 1));
    let map = powers.coverage_map(title, chosen, &test);
    // In the order of the cells of `score_subset` and `reference_choices`.
    let header = ["training (dBm)", "held-out (dBm)", "subsets"].map(str::to_owned).to_vec();
    Ok(Placement { header, choices, notes, map })
}

/// Searches the best `count` receivers for these powers, dBm `[R][T]`. Returns the name and the result of each search: the
/// exhaustive one, unless there are too many subsets, and the greedy one.
fn search_subsets(powers: &[Vec<f64>], count: usize) -> Vec<(&'static str, ReceiverSubset)> {
    let subsets = [("exhaustive", best_subset(powers, count)), ("greedy", Some(greedy_subset(powers, count)))];
    subsets.into_iter().filter_map(|(name, subset)| Some((name, subset?))).collect()
}

/// Data with their powers, dBm `[R][T]`, at the training transmitters (`fitting`) and at the held-out ones.
struct MeasuredPowers<'a> {
    data: &'a Dataset,
    fitting: Vec<Vec<f64>>,
    held_out: Vec<Vec<f64>>,
}

impl MeasuredPowers<'_> {
    /// Returns the name of receiver `r` and its position, metres, world frame.
    fn name_and_position(&self, r: usize) -> (String, [f64; 3]) {
        let receiver = &self.data.scene.receivers[r];
        (receiver.name.clone(), self.data.scene.origin.world_pose(receiver.pose).position)
    }

    /// Scores the subset of the search called `short` on the held-out transmitters.
    fn score_subset(&self, short: &'static str, subset: &ReceiverSubset) -> PlacedReceivers {
        let coverage = subset_coverage(&self.held_out, &subset.receivers);
        let cells = vec![fixed(subset.coverage, 2), fixed(coverage, 2), grouped(subset.evaluations as i64)];
        let receivers = subset.receivers.iter().map(|&r| self.name_and_position(r)).collect();
        PlacedReceivers { short, name: short.into(), receivers, coverage, cells }
    }

    /// Scores the average of [`RANDOM`] subsets of `count` receivers, and all receivers, on both sets of transmitters.
    fn reference_choices(&self, count: usize, seed: u64) -> [PlacedReceivers; 2] {
        let receivers: Vec<usize> = (0..self.data.scene.receivers.len()).collect();
        let draws = random_subsets(receivers.len(), count, RANDOM, seed);
        let mean_coverage = |powers: &[Vec<f64>]| mean(draws.iter().map(|subset| subset_coverage(powers, subset)));
        let random = (
            format!("random, mean of {RANDOM} (seed {seed})"),
            mean_coverage(&self.fitting),
            mean_coverage(&self.held_out),
        );
        let [fitting, held_out] = [&self.fitting, &self.held_out].map(|powers| subset_coverage(powers, &receivers));
        let all = (format!("all {} receivers", receivers.len()), fitting, held_out);
        [random, all].map(|(name, train, coverage)| {
            let cells = vec![fixed(train, 2), fixed(coverage, 2), String::new()];
            PlacedReceivers { short: "", name, receivers: Vec::new(), coverage, cells }
        })
    }

    /// Creates the map of the strongest power of the `chosen` receivers at the held-out transmitters `test`, of which none are
    /// drawn if the data have no positions.
    fn coverage_map(&self, title: String, chosen: &[usize], test: &[usize]) -> CoverageMap {
        let flat = |[x, y, _]: [f64; 3]| [x, y];
        let point = |&r: &usize| flat(self.name_and_position(r).1);
        let powers: Vec<&[f64]> = chosen.iter().map(|&r| &self.held_out[r][..]).collect();
        let placed = test.iter().filter(|_| self.data.placed);
        CoverageMap {
            title,
            transmitters: placed.map(|&t| flat(self.data.locations[t].position())).collect(),
            powers: strongest_powers(&powers),
            selected: chosen.iter().map(point).collect(),
            others: (0..self.held_out.len()).filter(|r| !chosen.contains(r)).map(|r| point(&r)).collect(),
        }
    }
}

/// Returns the training and the held-out transmitters, both ascending, and the name of the split: the official one if both of
/// its sets have transmitters, where those with training links are not held out; otherwise a random fifth is held out.
fn split_transmitters(data: &Dataset, seed: u64) -> ([Vec<usize>; 2], String) {
    if let Some((train, test)) = &data.official {
        let [train, test] = [train, test].map(|links| data.locations_of(links));
        let test: Vec<usize> = test.into_iter().filter(|t| train.binary_search(t).is_err()).collect();
        if !train.is_empty() && !test.is_empty() {
            return ([train, test], "official split".into());
        }
    }
    let mut shuffled: Vec<usize> = (0..data.locations.len()).collect();
    rng::shuffle(&mut rng::stream(seed, "place split", 0), &mut shuffled);
    let train = shuffled.split_off(shuffled.len().div_ceil(HELD_OUT));
    let parts = [train, shuffled].map(|mut part| {
        part.sort_unstable();
        part
    });
    (parts, format!("random split, seed {seed}"))
}

/// Powers of all pairs of receiver and transmitter.
struct PowerMatrix {
    /// Powers, dBm `[R][T]`; [`Self::weakest`] for a pair without a link.
    powers: Vec<Vec<f64>>,
    /// Weakest power of the data, dBm.
    weakest: f64,
    /// Number of pairs without a link.
    missing: usize,
}

impl PowerMatrix {
    /// Collects the received powers of `data`; `None` for other observations.
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

    /// Describes the number of pairs without a link, and their power.
    fn describe_missing(&self) -> String {
        let pairs = self.powers.iter().map(Vec::len).sum::<usize>();
        format!(
            "{} of {} links are missing and count as {} dBm, the weakest power of the data",
            grouped(self.missing as i64),
            grouped(pairs as i64),
            fixed(self.weakest, 1)
        )
    }

    /// Returns the powers of these transmitters, dBm `[R][T]`.
    fn select(&self, transmitters: &[usize]) -> Vec<Vec<f64>> {
        self.powers.iter().map(|row| transmitters.iter().map(|&t| row[t]).collect()).collect()
    }
}
