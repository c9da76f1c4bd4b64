//! Orthogonal matching pursuit over the room. Each step adds the transmitter that explains most, recomputes all gains
//! and refines all positions. Held-out data select the number of transmitters.

use crate::virtual_transmitters::equations::MeasurementRows;
use crate::virtual_transmitters::field::field;
use crate::virtual_transmitters::grid::{Cell, SearchGrid, distance};
use crate::virtual_transmitters::links::{ChannelInputs, VirtualSources, snr_db};
use crate::virtual_transmitters::solve::{RefineOptions, costs_without_each, refine_positions, solve_gains};
use crate::virtual_transmitters::sweep::{compare_cells, mirror_images, score_cells, sweep_cells};
use crate::virtual_transmitters::windows::SearchLevel;
use crate::virtual_transmitters::{MatchingPursuit, VirtualTransmitters, turn};
use pwrfgs_core::{Initializer as _, Method as _, Real, evenly, rng};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The grid is swept again if the remaining peaks explain less than this share of the previous best.
const FADED: f64 = 1.0 / 3.0;

/// Number of the best candidates that are refined before one is selected.
const CLIMB: usize = 32;

/// Refinement steps of a candidate.
const CLIMB_STEPS: usize = 8;

/// Refinement steps after every addition, twice.
const STEPS: usize = 10;

/// Ridge per row that keeps equations solvable without noise.
const LEAST_RIDGE: f64 = 1e-12;

/// Log odds above which a candidate is accepted without a new sweep of the whole grid.
const BEYOND_DOUBT: f64 = 10.0;

/// Part of an addition that its sweep counts in the progress.
const SWEEP: f64 = 0.5;

/// The estimate of the search time sweeps one of this number of cells.
const SHARE: usize = 16;

/// Options of [`pursue_sources`].
#[derive(Clone, Debug)]
pub struct PursuitOptions {
    /// Grid, stop rules, ridge and candidates.
    pub settings: MatchingPursuit,
    /// Maximum number of values for the scores of the grid, for refinement after an addition, and for the last refinement.
    pub rows: [usize; 3],
    /// Maximum number of candidates that a sweep of the grid keeps.
    pub peaks: usize,
    /// Position of the fixed node, metres, if known: a candidate that needs little evidence.
    pub node: Option<[f64; 3]>,
    /// Order of the harmonics of gains over direction, at most 3; 0 for gains that are equal in all directions.
    pub order: usize,
    /// Seed of the held-out items and of the rows.
    pub seed: u64,
}

impl Default for PursuitOptions {
    fn default() -> Self {
        let settings = MatchingPursuit::default();
        Self { settings, rows: [2048, 4096, 16_384], peaks: 256, node: None, order: 0, seed: 0 }
    }
}

/// Searches for the virtual transmitters of `channel`: `[A,F]` per position.
///
/// `report_progress` receives the number of additions and removals, of at most [`MatchingPursuit::most_changes`], with the
/// part of the next addition during a sweep. Soon after `stop` is set, the search ends and returns the best sources so far.
///
/// # Errors
/// `links`, `channel` or `options` are invalid; the message names the value.
pub fn pursue_sources(
    links: &ChannelInputs<'_>,
    channel: &[&[[Real; 2]]],
    options: &PursuitOptions,
    stop: &AtomicBool,
    report_progress: &mut dyn FnMut(f64),
) -> Result<VirtualSources, String> {
    links.check_channel(channel)?;
    options.settings.check()?;
    VirtualTransmitters { order: options.order }.check()?;
    if options.rows.contains(&0) || options.peaks == 0 {
        return Err("`rows` or `peaks` has a 0; give 1 or more".into());
    }
    let items: Vec<usize> = (0..links.positions.len()).collect();
    let mut best = (f64::NEG_INFINITY, VirtualSources::new(options.order));
    let (held_out, fitted) = options.split_held_out(links);
    PursuitSearch::new((links, channel), options, stop, (&fitted, &held_out)).improve_best(&mut best, report_progress);
    let [grid, _, last] = options.rows;
    let options = &PursuitOptions { rows: [grid, last, last], ..options.clone() };
    PursuitSearch::new((links, channel), options, stop, (&items, &[])).refine_sources(&mut best.1, STEPS);
    Ok(best.1)
}

/// Returns the shortest and longest expected time of a search, seconds, from the times of a share of a sweep and of one
/// candidate.
pub(crate) fn expected_pursuit_seconds(
    links: &ChannelInputs<'_>,
    channel: &[&[[Real; 2]]],
    options: &PursuitOptions,
) -> [f64; 2] {
    let stop = AtomicBool::new(false);
    let (held_out, fitted) = options.split_held_out(links);
    let search = PursuitSearch::new((links, channel), options, &stop, (&fitted, &held_out));
    let (none, start) = (VirtualSources::new(options.order), Instant::now());
    let peaks = sweep_cells((&search.levels, &search.grid), &none, (options.peaks, SHARE), &stop, &mut |_, _| ());
    let sweep = SHARE as f64 * start.elapsed().as_secs_f64();
    let [candidate, refinement] = search.time_candidate(&peaks);
    let MatchingPursuit { most, patience, rounds, .. } = options.settings;
    // Shortest: one sweep and one success, then `patience` candidates from the remaining peaks.
    let least = sweep + candidate * (1 + patience).min(most) as f64;
    // Longest: a sweep per addition. A later round usually ends after `patience` additions without a gain, so this is an
    // estimate, not the limit of `most_changes`; every round removes half of the sources.
    let added = most + rounds * patience;
    let removed = if held_out.is_empty() { 0 } else { (1 + rounds) * most / 2 };
    // The last refinement has up to twice the sources, which is four times the work per row.
    let last = refinement * 4.0 * options.rows[2] as f64 / options.rows[1] as f64;
    [least, (sweep + candidate) * added as f64 + refinement * removed as f64 + last]
}

impl PursuitOptions {
    /// Splits the indices of the positions at random; returns those held out, and the fitted ones. None is held out if `hold_out`
    /// is below 2 or above their number.
    fn split_held_out(&self, links: &ChannelInputs<'_>) -> (Vec<usize>, Vec<usize>) {
        let mut items: Vec<usize> = (0..links.positions.len()).collect();
        let hold_out = self.settings.hold_out;
        let folds = if hold_out < 2 { 0 } else { items.len() / hold_out };
        if folds > 0 {
            rng::shuffle(&mut rng::stream(self.seed, "hold out", 0), &mut items);
        }
        let fitted = items.split_off(folds);
        (items, fitted)
    }
}

/// Candidate after refinement.
#[derive(Clone, Copy, Debug)]
struct Peak {
    position: [f64; 3],
    quat: [f64; 4],
    /// Energy that it explains with its best gain.
    explains: f64,
    /// Logarithm of its odds against noise, if it is the best of all candidates.
    log_odds: f64,
}

/// One pass of the search.
struct PursuitSearch<'a> {
    links: &'a ChannelInputs<'a>,
    channel: &'a [&'a [[Real; 2]]],
    options: &'a PursuitOptions,
    stop: &'a AtomicBool,
    held_out: &'a [usize],
    /// Rows for refinement.
    rows: MeasurementRows,
    /// Levels of the sweep, from fine to coarse.
    levels: Vec<SearchLevel>,
    grid: SearchGrid,
    positions: Vec<[f64; 3]>,
    wavelength: f64,
    /// Remaining peaks of the last sweep, and the energy that its best peak explained.
    pool: Vec<Cell>,
    strongest: f64,
}

impl<'a> PursuitSearch<'a> {
    /// Prepares a pass over the fitted items: the grid about the positions and the rows to which sources are fitted.
    fn new(
        (links, channel): (&'a ChannelInputs<'a>, &'a [&'a [[Real; 2]]]),
        options: &'a PursuitOptions,
        stop: &'a AtomicBool,
        (fitted, held_out): (&[usize], &'a [usize]),
    ) -> Self {
        let positions: Vec<[f64; 3]> = links.positions.iter().map(|p| p.map(f64::from)).collect();
        let low: [f64; 3] = std::array::from_fn(|k| positions.iter().fold(f64::MAX, |m, p| m.min(p[k])));
        let high: [f64; 3] = std::array::from_fn(|k| positions.iter().fold(f64::MIN, |m, p| m.max(p[k])));
        let wavelength = links.shortest_wavelength();
        // At least a wavelength, because a single position has no extent.
        let side = (0..3).fold(wavelength, |side, k| side.max(high[k] - low[k]));
        let antennas: Vec<[f64; 3]> = links.antennas.iter().map(|r| r.map(f64::from)).collect();
        let grid = SearchGrid {
            centre: [0, 1, 2].map(|k| f64::midpoint(low[k], high[k])),
            side,
            half: (0.5 + options.settings.reach) * side,
            step: options.settings.step * wavelength,
            quats: turn::mirror_rotations(&antennas),
        };
        let values: Vec<usize> = (0..links.antennas.len() * links.frequencies.len()).collect();
        let [most, most_refined, _] = options.rows;
        Self {
            links,
            channel,
            options,
            stop,
            held_out,
            rows: MeasurementRows::new(links, channel, (fitted, &values), most_refined, options.seed),
            levels: SearchLevel::create_levels(links, channel, (fitted, most), &grid, options.seed),
            grid,
            positions,
            wavelength,
            pool: Vec::new(),
            strongest: f64::INFINITY,
        }
    }

    /// Returns whether the caller has stopped the search.
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Adds sources to the best set, then, if items are held out, removes the least important ones; repeats both up to
    /// `rounds` times while the score improves. `best` is the best score (dB) with its sources.
    fn improve_best(mut self, best: &mut (f64, VirtualSources), report_progress: &mut dyn FnMut(f64)) {
        let (&MatchingPursuit { most, rounds, .. }, mut done) = (&self.options.settings, 0);
        let replaced = self.options.settings.most_removals();
        for round in 0..=rounds {
            let (before, first) = (best.0, best.1.len() as f64);
            // Counted as in `MatchingPursuit::most_changes`.
            let additions = if round == 0 { most } else { replaced };
            let added = |sources: f64| done as f64 + (sources - first).clamp(0.0, additions as f64);
            self.add_sources(best, &mut |sources| report_progress(added(sources)));
            done += additions;
            if !self.held_out.is_empty() {
                self.remove_sources(best, &mut |removed| report_progress((done + removed) as f64));
                done += replaced;
            }
            if best.0 <= before || self.is_stopped() {
                break;
            }
        }
    }

    /// Measures the expected time to refine `peaks` and add the best, and that of the addition alone, seconds, with half the
    /// maximum number of sources.
    fn time_candidate(&self, peaks: &[Cell]) -> [f64; 2] {
        let PursuitOptions { order, settings, .. } = self.options;
        let (none, mut sources) = (VirtualSources::new(*order), VirtualSources::new(*order));
        for peak in evenly(peaks, settings.most.div_ceil(2)) {
            sources.push(peak.centre, self.grid.quats[peak.q], [0.0; 2]);
        }
        let begun = Instant::now();
        // All peaks of a sweep take about twice as long.
        _ = self.best_refined(&self.rows.residual(&none), peaks.to_vec(), 1, &none);
        let refined = 2.0 * begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        _ = refine_positions(&self.rows, &mut sources, self.refine_options(1, self.smallest_ridge()));
        let added = (2 * STEPS) as f64 * begun.elapsed().as_secs_f64(); // as `refine_sources`
        [refined + added, added]
    }

    /// Adds candidates to the best set until it has `most` sources, until patience ends, or until stopped; replaces `best`
    /// whenever the score improves.
    fn add_sources(&mut self, best: &mut (f64, VirtualSources), report_progress: &mut dyn FnMut(f64)) {
        let MatchingPursuit { most, patience, .. } = self.options.settings;
        let (mut sources, mut failures) = (best.1.clone(), 0);
        while sources.len() < most && failures < patience && !self.is_stopped() {
            let Some(peak) = self.next_candidate(&sources, report_progress) else { break };
            sources.push(peak.position, peak.quat, [0.0; 2]);
            self.refine_sources(&mut sources, STEPS);
            let score = self.score(&sources);
            failures += 1;
            if score > best.0 {
                (*best, failures) = ((score, sources.clone()), 0);
            }
            report_progress(sources.len() as f64);
        }
    }

    /// Removes half of the best sources, one after the other, each time that with the smallest loss of fit; replaces
    /// `best` whenever the score improves.
    fn remove_sources(&self, best: &mut (f64, VirtualSources), report_progress: &mut dyn FnMut(usize)) {
        let (mut sources, before) = (best.1.clone(), best.1.len());
        while sources.len() > (before / 2).max(1) && !self.is_stopped() {
            let costs = costs_without_each(&self.rows, &sources, self.smallest_ridge());
            let weakest = (0..costs.len()).fold(0, |w, g| if costs[g] < costs[w] { g } else { w });
            sources = sources.without(weakest);
            self.refine_sources(&mut sources, STEPS);
            let score = self.score(&sources);
            if score > best.0 {
                *best = (score, sources.clone());
            }
            report_progress(before - sources.len());
        }
    }

    /// Refines all sources twice, each time with a ridge from the noise-to-signal ratio of the previous fit. Ends early if
    /// the equations have no unique solution.
    fn refine_sources(&self, sources: &mut VirtualSources, steps: usize) {
        let Some(mut cost) = solve_gains(&self.rows, sources, self.smallest_ridge()) else { return };
        for _ in 0..2 {
            let noise = cost / self.rows.len() as f64;
            let signal = self.rows.mean_signal_power(sources) / sources.harmonic_count() as f64;
            let noise_to_signal = self.options.settings.ridge * noise / signal.max(f64::MIN_POSITIVE);
            let options = self.refine_options(steps, noise_to_signal + LEAST_RIDGE * self.rows.len() as f64);
            let Some(refined) = refine_positions(&self.rows, sources, options) else { return };
            cost = refined;
        }
    }

    /// Returns the candidate with the most evidence after individual refinement; `None` without a candidate of
    /// [`Self::best_refined`].
    ///
    /// Sweeps the cells again only if neither images nor the remaining peaks are beyond doubt, or if they explain much
    /// less than the previous best: a better candidate may then exist.
    fn next_candidate(&mut self, sources: &VirtualSources, report_progress: &mut dyn FnMut(f64)) -> Option<Peak> {
        let residual = self.rows.residual(sources);
        let (mut best, apart) = (None, self.wavelength / 4.0);
        let is_apart = |node: &[f64; 3]| sources.positions.iter().all(|v| distance(v, node) > apart);
        let mut positions: Vec<[f64; 3]> = self.options.node.filter(is_apart).into_iter().collect();
        if self.options.settings.images {
            let sources = [&sources.positions[..], &positions[..]].concat();
            positions.extend(mirror_images(&sources, &self.positions, &self.grid, apart));
        }
        if !positions.is_empty() {
            let peaks = self.grid.candidates(&positions);
            let number = peaks.len();
            best = self.best_refined(&residual, peaks, number, sources);
        }
        let better = |best: Option<Peak>, other: Option<Peak>| {
            best.into_iter().chain(other).reduce(|a, b| if b.log_odds > a.log_odds { b } else { a })
        };
        let cells = self.grid.cell_count(self.grid.step);
        best = better(best, self.best_refined(&residual, self.pool.clone(), cells, sources));
        if best.is_none_or(|b| b.log_odds < BEYOND_DOUBT || b.explains < FADED * self.strongest) {
            let report = &mut |done: usize, total: usize| {
                report_progress(sources.len() as f64 + SWEEP * done as f64 / total as f64);
            };
            self.pool = sweep_cells((&self.levels, &self.grid), sources, (self.options.peaks, 1), self.stop, report);
            best = better(best, self.best_refined(&residual, self.pool.clone(), cells, sources));
            self.strongest = best.map_or(0.0, |b| b.explains);
        }
        best
    }

    /// Returns the best of `cells` after individual refinement, with its odds as the best of `number` candidates. `None` if
    /// every cell moves by more than two wavelengths times [`SearchGrid::peak_width`], or to within an eighth of a wavelength
    /// of a source.
    fn best_refined(
        &self,
        residual: &MeasurementRows,
        mut cells: Vec<Cell>,
        number: usize,
        sources: &VirtualSources,
    ) -> Option<Peak> {
        let (energy, finest) = (residual.energy(), &self.levels[0]);
        cells.sort_by_key(|cell| cell.q);
        score_cells((&finest.rows.residual(sources), &finest.ends), &self.grid, &mut cells);
        cells.sort_by(compare_cells);
        cells.truncate(CLIMB);
        let climb = |cell: &Cell| {
            let mut one = VirtualSources::default();
            one.push(cell.centre, self.grid.quats[cell.q], [0.0; 2]);
            let options = self.refine_options(CLIMB_STEPS, LEAST_RIDGE * residual.len() as f64);
            let left = refine_positions(residual, &mut one, options)?;
            let (position, most) = (one.positions[0], 2.0 * self.wavelength * self.grid.peak_width(cell.centre));
            let moved_far = (0..3).any(|k| (position[k] - cell.centre[k]).abs() > most);
            let taken = sources.positions.iter().any(|v| distance(v, &position) < self.wavelength / 8.0);
            let explains = energy - left;
            let share = (explains / energy).clamp(0.0, 1.0 - 1e-12);
            let log_odds = -(residual.len() as f64) * (1.0 - share).ln() - (number.max(1) as f64).ln();
            (!moved_far && !taken).then_some(Peak { position, quat: one.quats[0], explains, log_odds })
        };
        let peaks: Vec<Option<Peak>> = cells.par_iter().map(climb).collect();
        peaks.into_iter().flatten().reduce(|a, b| if b.explains > a.explains { b } else { a })
    }

    /// Returns a ridge that keeps equations solvable and does not affect gains.
    fn smallest_ridge(&self) -> f64 {
        1e-9 * self.rows.energy()
    }

    /// Returns the options of a refinement with `steps` and a `ridge` on the gains.
    fn refine_options(&self, steps: usize, ridge: f64) -> RefineOptions<'_> {
        RefineOptions {
            steps,
            ridge,
            farthest: self.wavelength / 8.0, // half of the basin of attraction
            turns: self.links.has_orientation(),
            grid: &self.grid,
            stop: self.stop,
        }
    }

    /// Returns the SNR on the held-out items, dB; on the fitted items if none are held out.
    fn score(&self, sources: &VirtualSources) -> f64 {
        if self.held_out.is_empty() {
            return -10.0 * (self.rows.residual(sources).energy() / self.rows.energy()).log10();
        }
        let positions: Vec<[Real; 3]> = self.held_out.iter().map(|i| self.links.positions[*i]).collect();
        let links = ChannelInputs { positions: &positions, ..*self.links };
        snr_db(&field(&sources.to_cloud(), None, &links), self.held_out.iter().flat_map(|i| self.channel[*i]))
    }
}
