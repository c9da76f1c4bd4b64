//! Checks whether observations depend on the recorded positions: level against distance, with other meanings of the positions,
//! and whether neighbours are more alike than random pairs.

use super::finding::{Finding, moving_end, name_link};
use pwrfgs_core::neighbours::{Nearest, distance};
use pwrfgs_core::statistics::{deviation, evenly, mean};
use pwrfgs_core::{Dataset, Link, Real, rng};

/// Smallest number of locations, and largest number that are compared.
const LOCATIONS: std::ops::RangeInclusive<usize> = 50..=500;
/// Largest number of receivers whose order is searched.
const RECEIVERS: usize = 40;
/// Smallest share of the variance of levels that another meaning of the positions explains, and largest share of that which
/// the recorded one explains; the latter is larger where the other meaning explains half.
const EXPLAINED: f64 = 0.15;
const RECORDED: f64 = 0.25;
const HALF: [f64; 2] = [0.5, 0.75];
/// Standard deviation of free-space loss that the distances to a receiver cause, dB: with less, noise may hide the relation.
const SPREAD_DB: f64 = 2.5;
/// Standard deviation of the levels at a receiver of unknown position above which they vary over the site, dB.
const LEVELS_DB: f64 = 6.0;
/// Largest number of receivers that a message names.
const NAMED: usize = 5;
/// Number of random pairings, and their standard deviations by which neighbours must be more alike.
const DRAWS: usize = 20;
const ALIKE: f64 = 3.0;

/// Position `[x, y, z]` in metres.
type Position = [f64; 3];
/// Another meaning of transmitter positions.
pub(super) struct Meaning {
    /// Name of the finding.
    pub(super) finding: &'static str,
    /// Name of the meaning, such as `in feet`.
    pub(super) words: &'static str,
    /// Correction of the positions.
    pub(super) mend: &'static str,
    /// Returns the corrected position.
    pub(super) position: fn(Position) -> Position,
}

impl Meaning {
    /// Creates a meaning, in the order of the fields.
    const fn new(
        finding: &'static str,
        words: &'static str,
        mend: &'static str,
        position: fn(Position) -> Position,
    ) -> Self {
        Self { finding, words, mend, position }
    }
}

/// Meanings of positions; units first.
pub(super) const MEANINGS: [Meaning; 8] = [
    Meaning::new("position-unit", "in millimetres", "divide them by 1000", |p| p.map(|v| v / 1000.0)),
    Meaning::new("position-unit", "in centimetres", "divide them by 100", |p| p.map(|v| v / 100.0)),
    Meaning::new("position-unit", "in feet", "multiply them by 0.3048", |p| p.map(|v| 0.3048 * v)),
    Meaning::new("position-unit", "in inches", "multiply them by 0.0254", |p| p.map(|v| 0.0254 * v)),
    Meaning::new("position-unit", "in kilometres", "multiply them by 1000", |p| p.map(|v| 1000.0 * v)),
    Meaning::new("axes", "y, x, z", "exchange x and y", |[x, y, z]| [y, x, z]),
    Meaning::new("axes", "x, z, y", "exchange y and z", |[x, y, z]| [x, z, y]),
    Meaning::new("axes", "z, y, x", "exchange x and z", |[x, y, z]| [z, y, x]),
];

/// Levels of links with received powers, and both ends.
pub(super) struct LevelLinks {
    /// Location, fixed end and level of each link.
    links: Vec<(usize, usize, f64)>,
    locations: Vec<Position>,
    fixed: Vec<Position>,
}

impl LevelLinks {
    /// Collects the links of evenly chosen locations, at most the end of [`LOCATIONS`]; `None` for other observations, or without
    /// distances.
    pub(super) fn of(data: &Dataset) -> Option<Self> {
        let powers = data.observations.powers().filter(|_| data.placed && data.scene.has_distances())?;
        let chosen = evenly(&(0..data.locations.len()).collect::<Vec<_>>(), *LOCATIONS.end());
        let end = |link: &Link| if data.scene.moving.is_receiver() { 0 } else { link.receiver };
        let row = |i: usize| (data.links[i].location, end(&data.links[i]), powers[i] as f64);
        let fixed = data.scene.fixed_ends().into_iter();
        Some(Self {
            links: data.links_of(&chosen).into_iter().map(row).collect(),
            locations: data.locations.iter().map(pwrfgs_core::Location::position).collect(),
            fixed: fixed.map(|pose| data.scene.origin.world_pose(pose).position).collect(),
        })
    }

    /// Fits the levels over the logarithm of the recorded distance: a mean per fixed end, and a common slope. Returns the share
    /// of the variance about the means that the slope explains, and the slope, dB per decade.
    pub(super) fn fit_recorded(&self) -> (f64, f64) {
        self.fit(&|_| true, &|location| self.locations[location], &|end| self.fixed[end])
    }

    /// Fits the levels of the links at the fixed ends that are `used` as [`Self::fit_recorded`] does, over the distance between
    /// the positions `location` and `fixed`; zeros if distances or levels do not vary.
    fn fit(
        &self,
        used: &dyn Fn(usize) -> bool,
        location: &dyn Fn(usize) -> Position,
        fixed: &dyn Fn(usize) -> Position,
    ) -> (f64, f64) {
        let mut ends = vec![[0.0; 6]; self.fixed.len()];
        for &(at, end, level) in self.links.iter().filter(|(_, end, _)| used(*end)) {
            let x = distance(location(at), fixed(end)).log10();
            let terms = if x.is_finite() { [1.0, x, level, x * x, x * level, level * level] } else { [0.0; 6] };
            terms.iter().zip(&mut ends[end]).for_each(|(term, sum)| *sum += term);
        }
        // Deviations from the mean of each end, since powers and gains differ.
        let [mut var_x, mut covariance, mut var_y, mut size] = [0.0; 4];
        for [n, x, y, xx, xy, yy] in ends.into_iter().filter(|sums| sums[0] > 0.0) {
            (var_x, covariance, var_y) = (var_x + xx - x * x / n, covariance + xy - x * y / n, var_y + yy - y * y / n);
            size += xx;
        }
        // A variance below a part of 1e-9 of the squares is a rounding error.
        if var_x <= 1e-9 * size || var_y <= 0.0 {
            return (0.0, 0.0);
        }
        (covariance * covariance / (var_x * var_y), covariance / var_x)
    }

    /// Returns the share of the variance that a line over the distance explains if it falls, otherwise 0.
    fn explained_share(&self, location: &dyn Fn(usize) -> Position, fixed: &dyn Fn(usize) -> Position) -> f64 {
        falling_share(self.fit(&|_| true, location, fixed))
    }

    /// Returns the order of the fixed ends by which levels fall with the distance: the index of the position for each end. Pairs
    /// of end and position are taken greedily, the best fit first.
    fn best_order(&self) -> Vec<usize> {
        let count = self.fixed.len();
        let mut fits = Vec::new();
        for (end, slot) in (0..count * count).map(|k| (k / count, k % count)) {
            let fit = self.fit(&|used| used == end, &|at| self.locations[at], &|_| self.fixed[slot]);
            fits.push((falling_share(fit), end, slot));
        }
        fits.sort_by(|(a, ..), (b, ..)| b.total_cmp(a));
        let (mut order, mut is_taken) = (vec![usize::MAX; count], vec![false; count]);
        for (_, end, slot) in fits {
            if order[end] == usize::MAX && !is_taken[slot] {
                (order[end], is_taken[slot]) = (slot, true);
            }
        }
        order
    }

    /// Returns the mean standard deviation of free-space loss over the links at a fixed end, dB. Distances count as at least
    /// 1e-9 m, so that the loss is finite.
    fn spread_db(&self) -> f64 {
        let spread = |end: usize| {
            let links = self.links.iter().filter(|(_, other, _)| *other == end);
            let loss = links.map(|(at, ..)| 20.0 * distance(self.locations[*at], self.fixed[end]).max(1e-9).log10());
            deviation(&loss.collect::<Vec<f64>>())
        };
        mean((0..self.fixed.len()).map(spread).filter(|spread| spread.is_finite()))
    }
}

/// Returns the share that a fit explains if its slope falls, otherwise 0.
fn falling_share((share, slope): (f64, f64)) -> f64 {
    if slope < 0.0 { share } else { 0.0 }
}

/// Finds levels that do not fall with the recorded distance, but with the distance by another meaning of the positions, or by
/// another order of rows or receivers; `None` if no alternative explains them much better.
pub(super) fn check_levels(data: &Dataset) -> Option<Finding> {
    let links = LevelLinks::of(data).filter(|_| data.locations.len() >= *LOCATIONS.start())?;
    let (location, fixed) = (|at: usize| links.locations[at], |end: usize| links.fixed[end]);
    let recorded = links.explained_share(&location, &fixed);
    let by_meaning = MEANINGS.map(|Meaning { finding, words, mend, position }| {
        let share = links.explained_share(&|at| position(location(at)), &fixed);
        (share, finding, format!("positions of the {}s {words}", moving_end(data)), mend.to_owned())
    });
    let last = links.locations.len() - 1;
    let reversed = links.explained_share(&|at| location(last - at), &fixed);
    let rows =
        (reversed, "row-order", "the rows in reverse order".to_owned(), "reverse the rows of one file".to_owned());
    let count = links.fixed.len();
    let orders = [(0..count).rev().collect(), if count <= RECEIVERS { links.best_order() } else { Vec::new() }];
    let by_order = orders.into_iter().filter(|order: &Vec<usize>| order.len() == count && count > 1).map(|order| {
        let names: Vec<&str> = order.iter().map(|slot| data.scene.receivers[*slot].name.as_str()).take(NAMED).collect();
        let words = format!("the columns of the receivers in the order {}", names.join(", "));
        let share = links.explained_share(&location, &|end| fixed(order[end]));
        (share, "receiver-order", words, "correct the header".to_owned())
    });
    let alternatives = by_meaning.into_iter().chain([rows]).chain(by_order);
    let best = alternatives.reduce(|best, other| if other.0 > best.0 { other } else { best });
    let (share, name, words, mend) = best?;
    let problem = format!(
        "the level of the links does not follow the distance (it explains {:.0} % of the variance), but does with {words} \
         ({:.0} %; for example {})",
        100.0 * recorded,
        100.0 * share,
        name_link(data, 0)
    );
    let is_wrong = share >= EXPLAINED && recorded <= share * if share >= HALF[0] { HALF[1] } else { RECORDED };
    is_wrong.then(|| Finding::new(name, links.links.len(), problem, mend))
}

/// Finds powers that are no more alike at neighbouring transmitters than at random ones. `None` if they are more alike, if
/// distances or levels differ too little to decide, or without positions or powers.
pub(super) fn check_power_rows(data: &Dataset) -> Option<Finding> {
    let powers = data.observations.powers().filter(|_| data.placed)?;
    let rows: Vec<usize> = (0..data.locations.len()).collect();
    let is_spread = match LevelLinks::of(data) {
        Some(links) => links.spread_db() >= SPREAD_DB,
        None => level_spread(data, powers) >= LEVELS_DB,
    };
    if !is_spread {
        return None;
    }
    // In the order of receivers, as links are.
    let levels: Vec<Vec<(usize, f64)>> = rows
        .iter()
        .map(|row| data.links_of(&[*row]).into_iter().map(|i| (data.links[i].receiver, powers[i] as f64)).collect())
        .collect();
    check_rows(data, &rows, &|a, b| {
        let other = |receiver: usize| levels[b].binary_search_by_key(&receiver, |(receiver, _)| *receiver).ok();
        let shared = levels[a].iter().filter_map(|(receiver, level)| {
            let (_, other) = levels[b][other(*receiver)?];
            Some((level - other).abs())
        });
        mean(shared)
    })
}

/// Returns the mean standard deviation of the levels at a receiver, dB; NaN if none has two links.
fn level_spread(data: &Dataset, powers: &[Real]) -> f64 {
    let spread = |links: Vec<usize>| deviation(&links.iter().map(|i| powers[*i] as f64).collect::<Vec<f64>>());
    let groups = data.group_by_receiver(0..data.len()).into_iter();
    mean(groups.filter(|links| links.len() > 1).map(spread))
}

/// Finds observations whose mean `difference` between neighbours is not clearly smaller than between random pairs; `rows` are
/// the locations of the observations. Differences that are not finite are left out. `None` for fewer rows than [`LOCATIONS`]
/// begins with.
pub(super) fn check_rows(data: &Dataset, rows: &[usize], difference: &dyn Fn(usize, usize) -> f64) -> Option<Finding> {
    if rows.len() < *LOCATIONS.start() {
        return None;
    }
    let positions: Vec<[f64; 3]> = rows.iter().map(|row| data.locations[*row].position()).collect();
    let chosen = evenly(&(0..rows.len()).collect::<Vec<_>>(), *LOCATIONS.end());
    let lookup = Nearest::of(&positions);
    let other = |row: &usize| {
        let (_, near) = lookup.find(&positions[*row], 2);
        near.into_iter().map(|(_, other)| other).find(|other| other != row)
    };
    let nearest: Vec<usize> = chosen.iter().filter_map(other).collect();
    let average = |other: &mut dyn FnMut(usize) -> usize| {
        mean((0..nearest.len()).map(|k| difference(chosen[k], other(k))).filter(|value| value.is_finite()))
    };
    let near = average(&mut |k| nearest[k]);
    let mut random = rng::stream(0, "findings", 0);
    let draws: Vec<f64> = (0..DRAWS).map(|_| average(&mut |_| rng::below(&mut random, rows.len()))).collect();
    let (middle, deviation) = (mean(draws.iter().copied()), deviation(&draws));
    let problem = format!(
        "observations of neighbours are no more alike than of random pairs (for example {}s {} and {})",
        moving_end(data),
        data.locations[rows[chosen[0]]].id,
        data.locations[rows[*nearest.first()?]].id
    );
    let mend = "if the rows of positions and observations have another order, give both in one order";
    let is_unrelated = near.is_finite() && near > middle - ALIKE * deviation;
    is_unrelated.then(|| Finding::new("row-order", rows.len(), problem, mend))
}
