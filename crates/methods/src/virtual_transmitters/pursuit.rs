//! Orthogonal matching pursuit over the room. Each step adds the transmitter that explains most, recomputes all gains
//! and refines all positions. Held-out data select the number of transmitters.

use crate::virtual_transmitters::equations::MeasurementRows;
use crate::virtual_transmitters::field::field;
use crate::virtual_transmitters::links::{ChannelInputs, VirtualSources, snr_of};
use crate::virtual_transmitters::solve::{RefineOptions, gains, refine};
use crate::virtual_transmitters::sweep::{Peak, SearchGrid, as_peaks, images, sweep, thin, timed_sweep};
use crate::virtual_transmitters::{MatchingPursuit, VirtualTransmitters, turn};
use pwrfgs_core::{Initializer as _, Method as _, Real, evenly, rng};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// The grid is swept again if the remaining peaks explain less than this share of the previous best.
const FADED: f64 = 1.0 / 3.0;

/// Number of candidates that are refined before the best is selected.
const CLIMB: usize = 32;

/// Refinement steps after every addition.
const STEPS: usize = 10;

/// Log odds above which a candidate is accepted without a new sweep of the whole grid.
const BEYOND_DOUBT: f64 = 10.0;

/// Options of [`pursue`].
#[derive(Clone, Debug)]
pub struct PursuitOptions {
    /// Grid, stop rules, ridge and candidates.
    pub settings: MatchingPursuit,
    /// Maximum number of values for the scores of the grid, and for the refinement of positions.
    pub rows: [usize; 2],
    /// Number of grid peaks that are refined before the best is selected.
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
        Self { settings, rows: [2048, 16_384], peaks: 256, node: None, order: 0, seed: 0 }
    }
}

/// Searches for the virtual transmitters of `channel` `[M,A,F]`.
///
/// `report_progress` receives the number of sources after every addition. Soon after `stop` is set, the search ends and
/// returns the sources found so far. An error describes the invalid input.
pub fn pursue(
    links: &ChannelInputs<'_>,
    channel: &[[Real; 2]],
    options: &PursuitOptions,
    stop: &AtomicBool,
    report_progress: &mut dyn FnMut(usize),
) -> Result<VirtualSources, String> {
    links.check_channel(channel)?;
    options.settings.check()?;
    VirtualTransmitters { order: options.order }.check()?;
    if options.rows.contains(&0) || options.peaks == 0 {
        return Err("`rows` or `peaks` has a 0; give 1 or more".into());
    }
    let all: Vec<usize> = (0..links.positions.len()).collect();
    let mut best = (f64::NEG_INFINITY, VirtualSources::new(options.order));
    let (held_out, fitted) = options.held_out(links);
    let parts = (&fitted[..], &held_out[..]);
    PursuitSearch::new((links, channel), options, stop, parts).grow(&mut best, report_progress);
    for level in 1..=options.settings.finer {
        let before = best.0;
        let finer = PursuitOptions { settings: options.settings.at(level), ..options.clone() };
        PursuitSearch::new((links, channel), &finer, stop, parts).grow(&mut best, report_progress);
        if best.0 <= before {
            break;
        }
    }
    if !held_out.is_empty() {
        PursuitSearch::new((links, channel), options, stop, (&all, &[])).settle(&mut best.1, 3 * STEPS);
    }
    Ok(best.1)
}

/// Returns the shortest and longest expected time of a search, seconds: it times a few layers of the grid and one
/// candidate.
pub(crate) fn expected_seconds(links: &ChannelInputs<'_>, channel: &[[Real; 2]], options: &PursuitOptions) -> [f64; 2] {
    let stop = AtomicBool::new(false);
    let (held_out, fitted) = options.held_out(links);
    let pass = |level: usize| {
        let options = PursuitOptions { settings: options.settings.at(level), ..options.clone() };
        let search = PursuitSearch::new((links, channel), &options, &stop, (&fitted, &held_out));
        let (peaks, sweep) = timed_sweep(&search.coarse, &search.grid, options.peaks);
        let [candidate, settled] = search.timed_candidate(&peaks);
        let MatchingPursuit { most, patience, rounds, .. } = options.settings;
        // Beyond the first sweep, a candidate may come from the remaining peaks.
        let least = sweep + candidate * if level == 0 { (1 + patience).min(most) as f64 } else { 1.0 };
        let added = most + rounds * patience;
        let removed = if held_out.is_empty() { 0 } else { (1 + rounds) * most / 2 };
        [least, (sweep + candidate) * added as f64 + settled * removed as f64]
    };
    let passes: Vec<[f64; 2]> = (0..=options.settings.finer).map(pass).collect();
    let second = passes.get(1).map_or(0.0, |pass| pass[0]);
    [passes[0][0] + second, passes.iter().map(|pass| pass[1]).sum()]
}

impl PursuitOptions {
    /// Returns the held-out items, and the others.
    fn held_out(&self, links: &ChannelInputs<'_>) -> (Vec<usize>, Vec<usize>) {
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

/// One pass of the search.
struct PursuitSearch<'a> {
    links: &'a ChannelInputs<'a>,
    channel: &'a [[Real; 2]],
    options: &'a PursuitOptions,
    stop: &'a AtomicBool,
    held_out: &'a [usize],
    /// Rows for the grid, and for refinement.
    coarse: MeasurementRows,
    rows: MeasurementRows,
    grid: SearchGrid,
    positions: Vec<[f64; 3]>,
    wavelength: f64,
    /// Remaining peaks of the last sweep, and the energy that its best peak explained.
    pool: Vec<Peak>,
    strongest: f64,
}

impl<'a> PursuitSearch<'a> {
    fn new(
        (links, channel): (&'a ChannelInputs<'a>, &'a [[Real; 2]]),
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
            quats: turn::mirrored(&antennas),
        };
        let [coarse, fine] = options.rows.map(|most| MeasurementRows::new(links, channel, fitted, most, options.seed));
        Self {
            links,
            channel,
            options,
            stop,
            held_out,
            coarse,
            rows: fine,
            grid,
            positions,
            wavelength,
            pool: Vec::new(),
            strongest: f64::INFINITY,
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Adds sources to the best set until `most`, until patience ends or until stopped. Then removes the least important
    /// sources and repeats this while the score improves.
    fn grow(mut self, best: &mut (f64, VirtualSources), report_progress: &mut dyn FnMut(usize)) {
        for _ in 0..=self.options.settings.rounds {
            let before = best.0;
            self.forward(best, report_progress);
            if !self.held_out.is_empty() {
                self.backward(best);
            }
            if best.0 <= before || self.stopped() {
                break;
            }
        }
    }

    /// Returns the expected time to refine `peaks` and add the best, and of the second part alone, seconds. The sources
    /// are half of the maximum.
    fn timed_candidate(&self, peaks: &[Peak]) -> [f64; 2] {
        let PursuitOptions { order, settings, .. } = self.options;
        let (none, mut sources) = (VirtualSources::new(*order), VirtualSources::new(*order));
        for peak in evenly(peaks, settings.most.div_ceil(2)) {
            sources.push(peak.place, peak.quat, [0.0; 2]);
        }
        let begun = Instant::now();
        // All peaks of a sweep take about twice as long.
        _ = self.refined(&self.rows.residual(&none), evenly(peaks, CLIMB), 1, &none);
        let refined = 2.0 * begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        let ridge = vec![1e-9 * self.rows.energy(); sources.len()];
        _ = refine(&self.rows, &mut sources, &ridge, self.walk(1));
        let settled = (2 * STEPS) as f64 * begun.elapsed().as_secs_f64();
        [refined + settled, settled]
    }

    /// Adds sources to the best set.
    fn forward(&mut self, best: &mut (f64, VirtualSources), report_progress: &mut dyn FnMut(usize)) {
        let MatchingPursuit { most, patience, .. } = self.options.settings;
        let mut sources = best.1.clone();
        let mut since = 0;
        while sources.len() < most && since < patience && !self.stopped() {
            let Some(peak) = self.next(&sources) else { break };
            sources.push(peak.place, peak.quat, [0.0; 2]);
            self.settle(&mut sources, STEPS);
            let score = self.score(&sources);
            since += 1;
            if score > best.0 {
                (*best, since) = ((score, sources.clone()), 0);
            }
            report_progress(sources.len());
        }
    }

    /// Removes one source after the other, each time that with the smallest loss of fit.
    fn backward(&self, best: &mut (f64, VirtualSources)) {
        let mut sources = best.1.clone();
        let (least, ridge) = (sources.len() / 2, 1e-9 * self.rows.energy());
        while sources.len() > least.max(1) && !self.stopped() {
            let cost = |g: usize| {
                gains(&self.rows, &mut sources.without(g), &vec![ridge; sources.len() - 1]).unwrap_or(f64::MAX)
            };
            let costs: Vec<f64> = (0..sources.len()).into_par_iter().map(cost).collect();
            let weakest = (0..costs.len()).fold(0, |w, g| if costs[g] < costs[w] { g } else { w });
            sources = sources.without(weakest);
            self.settle(&mut sources, STEPS);
            let score = self.score(&sources);
            if score > best.0 {
                *best = (score, sources.clone());
            }
        }
    }

    /// Sets the ridge of each source during its refinement.
    fn settle(&self, sources: &mut VirtualSources, steps: usize) {
        let mut ridge = vec![1e-9 * self.rows.energy(); sources.len()];
        let walk = self.walk(steps);
        let Some(mut cost) = gains(&self.rows, sources, &ridge) else { return };
        for _ in 0..2 {
            let noise = cost / self.rows.len() as f64;
            let signal = self.rows.signal(sources) / sources.terms() as f64;
            ridge.fill(
                self.options.settings.ridge * noise / signal.max(f64::MIN_POSITIVE) + 1e-12 * self.rows.len() as f64,
            );
            match refine(&self.rows, sources, &ridge, walk) {
                Some(new) => cost = new,
                None => return,
            }
        }
    }

    /// Returns the candidate with the most evidence after individual refinement.
    ///
    /// Sweeps the grid again only if neither images nor the remaining peaks are beyond doubt, or if they explain much
    /// less than the previous best: a better candidate may then exist.
    fn next(&mut self, sources: &VirtualSources) -> Option<Peak> {
        let residual = self.rows.residual(sources);
        let mut best = None;
        let apart = self.wavelength / 4.0;
        let away = |node: &[f64; 3]| sources.positions.iter().all(|v| distance(v, node) > apart);
        let mut places: Vec<[f64; 3]> = self.options.node.filter(away).into_iter().collect();
        if self.options.settings.images {
            let sources = [&sources.positions[..], &places[..]].concat();
            places.extend(images(&sources, &self.positions, |place| self.grid.holds(place), apart));
        }
        if !places.is_empty() {
            let peaks = as_peaks(&places, &self.grid.quats);
            let number = peaks.len();
            best = self.refined(&residual, peaks, number, sources);
        }
        let better = |best: Option<(Peak, f64)>, other: Option<(Peak, f64)>| match (best, other) {
            (Some(b), Some(other)) if b.1 >= other.1 => Some(b),
            (b, other) => other.or(b),
        };
        best = better(best, self.refined(&residual, self.pool.clone(), self.grid.len(), sources));
        let enough = FADED * self.strongest;
        if best.is_none_or(|b| b.1 < BEYOND_DOUBT || b.0.explains < enough) {
            let coarse = self.coarse.residual(sources);
            self.pool = sweep(&coarse, &self.grid, self.options.peaks, self.stop);
            best = better(best, self.refined(&residual, self.pool.clone(), self.grid.len(), sources));
            self.strongest = best.map_or(0.0, |b| b.0.explains);
        }
        best.map(|(peak, _)| peak)
    }

    /// Returns the best of the peaks after individual refinement, and the log of its odds against the best of `number`
    /// accidents.
    fn refined(
        &self,
        residual: &MeasurementRows,
        mut peaks: Vec<Peak>,
        number: usize,
        sources: &VirtualSources,
    ) -> Option<(Peak, f64)> {
        let energy = residual.energy();
        let climb = |peak: &mut Peak, steps: usize| {
            let walk = self.walk(steps);
            let mut one = VirtualSources::default();
            one.push(peak.place, peak.quat, [0.0; 2]);
            let left = refine(residual, &mut one, &[1e-12 * residual.len() as f64], walk);
            let most = 2.0 * self.wavelength * self.grid.width(peak.place);
            let far = (0..3).any(|k| (one.positions[0][k] - peak.place[k]).abs() > most);
            peak.explains = if far { 0.0 } else { left.map_or(0.0, |left| energy - left) };
            (peak.place, peak.quat) = (one.positions[0], one.quats[0]);
        };
        peaks.par_iter_mut().for_each(|peak| climb(peak, 0));
        thin(&mut peaks, CLIMB, |_| 0.0);
        peaks.par_iter_mut().for_each(|peak| climb(peak, 8));
        let taken = |p: &Peak| sources.positions.iter().any(|v| distance(v, &p.place) < self.wavelength / 8.0);
        peaks.retain(|p| !taken(p));
        thin(&mut peaks, 1, |_| 0.0);
        let share = |p: &Peak| (p.explains / energy).clamp(0.0, 1.0 - 1e-12);
        let odds = |p: &Peak| -(residual.len() as f64) * (1.0 - share(p)).ln() - (number.max(1) as f64).ln();
        peaks.first().map(|p| (*p, odds(p)))
    }

    fn walk(&self, steps: usize) -> RefineOptions<'_> {
        RefineOptions {
            steps,
            farthest: self.wavelength / 8.0,
            turns: self.links.turns(),
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
        let each = links.antennas.len() * links.frequencies.len();
        let truth = self.held_out.iter().flat_map(|i| &self.channel[i * each..(i + 1) * each]);
        snr_of(&field(&sources.to_cloud(), None, &links), truth)
    }
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}
