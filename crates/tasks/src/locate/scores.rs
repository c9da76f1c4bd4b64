//! Errors of located samples beside those of baselines.

use pwrfgs_core::neighbours::distance;
use pwrfgs_core::statistics::{evenly, mean, quantile, sorted};
use pwrfgs_core::{Baseline, Dataset, Error, FittingSet, Plugin, Result};
use pwrfgs_experiment::statistics::{Blocks, Difference};
use pwrfgs_experiment::text::{align_columns, fixed, grouped};
use pwrfgs_experiment::{Observer, PairedRow, SplitData, run_stage};
use pwrfgs_localise::{Choice, Located, Locator, NearestFingerprints, Region, SHARES, mean_and_median};
use rayon::prelude::*;
use std::fmt::Write as _;

/// Largest number of validation samples that are located for the expected error.
const EXPECTED: usize = 200;
/// Name of the baseline that locates all samples at the mean of the training positions.
const CENTRE: &str = "centre of the positions";

/// Formats the table of the errors of the test samples of `split`, `located` in their order, and of the baselines, with a
/// verdict. `has_kriging` adds the errors with fingerprints of Kriging, if it supports the data.
pub(super) fn format_errors(
    located: &[&Located],
    locator: &Locator<'_>,
    split: &SplitData,
    has_kriging: bool,
    observer: &mut dyn Observer,
) -> Result<String> {
    let (data, fitting) = (&split.data, split.partition.known());
    let samples = Samples::new(locator, data, data.locations_of(&split.partition.test));
    let mut entries = vec![samples.located_entry("model", locator.choice, located)];
    let kriged = if has_kriging { samples.locate_by_kriging(fitting, observer)? } else { None };
    if let Some((choice, kriged)) = kriged {
        let entry = samples.located_entry("fingerprints of Kriging", choice, &kriged.iter().collect::<Vec<_>>());
        // Equal names: neither uses predictions, so this would repeat the row of the measured fingerprints.
        entries.extend((entry.name != entries[0].name).then_some(entry));
    }
    let nearest = NearestFingerprints::fit(data, fitting, locator.features(), locator.floor());
    let name = format!("{} nearest fingerprint{}", nearest.k, if nearest.k == 1 { "" } else { "s" });
    entries.push(samples.baseline_entry(name, |observation| nearest.locate(observation)));
    entries.push(samples.centre_entry(locator));
    let header = ["", "predicted", "median (m)", "mean (m)", "90 % (m)", "regions hold", "area (m²)"];
    let lines: Vec<_> =
        std::iter::once(header.map(String::from).to_vec()).chain(entries.iter().map(Entry::cells)).collect();
    let heading = format!("{}: {} test positions\n", data.title, grouped(located.len() as i64));
    Ok(heading + &align_columns(&lines, 1) + &samples.verdict(&entries))
}

/// Describes the errors of up to [`EXPECTED`] validation samples, with a verdict; empty without any.
pub(super) fn describe_validation(locator: &Locator<'_>, data: &Dataset, fitting: FittingSet<'_>) -> String {
    let samples = Samples::new(locator, data, evenly(&data.locations_of(fitting.validation), EXPECTED));
    if samples.transmitters.is_empty() {
        return String::new();
    }
    let located = samples.observations.par_iter().map(|observation| locator.locate(observation));
    let located: Vec<Located> = located.collect();
    let model = samples.located_entry("model", locator.choice, &located.iter().collect::<Vec<_>>());
    let [mean, median] = mean_and_median(model.errors.clone());
    let (count, median, mean) = (grouped(located.len() as i64), fixed(median, 3), fixed(mean, 3));
    let verdict = samples.verdict(&[model, samples.centre_entry(locator)]);
    format!("{count} validation samples: median error {median} m, mean {mean} m; {verdict}")
}

/// Samples at known positions.
struct Samples<'a> {
    data: &'a Dataset,
    transmitters: Vec<usize>,
    observations: Vec<Vec<f32>>,
}

/// Row of the table.
struct Entry {
    name: String,
    /// Share of predictions in the fingerprints; `None` for baselines without a model.
    share: Option<f32>,
    /// Errors, metres.
    errors: Vec<f64>,
    /// Share of regions that hold the true position, and their median area in square metres.
    region: Option<(f64, f64)>,
}

impl Samples<'_> {
    /// Collects the observations of `transmitters`.
    fn new<'a>(locator: &Locator<'_>, data: &'a Dataset, transmitters: Vec<usize>) -> Samples<'a> {
        let observations = locator.observations(data, &transmitters);
        Samples { data, transmitters, observations }
    }

    /// Returns the true position of sample `k`, metres.
    fn true_position(&self, k: usize) -> [f64; 3] {
        self.data.locations[self.transmitters[k]].position()
    }

    /// Creates the entry of the samples that were located with the fingerprints and the descent of `predictor`, as far
    /// as `choice` uses them.
    fn located_entry(&self, predictor: &str, choice: Choice, located: &[&Located]) -> Entry {
        let name = match (choice.share > 0.0, choice.descends) {
            (true, _) => predictor.into(),
            (false, true) => format!("measured fingerprints, descent along the {predictor}"),
            (false, false) => "measured fingerprints".into(),
        };
        let errors =
            located.iter().enumerate().map(|(k, result)| distance(result.position, self.true_position(k))).collect();
        let held =
            located.iter().enumerate().filter(|(k, result)| result.holds(self.true_position(*k)) == Some(true)).count();
        let areas: Vec<f64> = located.iter().filter_map(|result| result.region.as_ref()).map(Region::area).collect();
        let region = (!areas.is_empty()).then(|| (held as f64 / located.len() as f64, mean_and_median(areas)[1]));
        Entry { name, share: Some(choice.share), errors, region }
    }

    /// Creates the entry of the baseline `name`, which locates one observation at a time.
    fn baseline_entry(&self, name: String, locate: impl Fn(&[f32]) -> [f64; 3] + Sync) -> Entry {
        let error = |(k, observation): (usize, &Vec<f32>)| distance(locate(observation), self.true_position(k));
        let errors = self.observations.par_iter().enumerate().map(error).collect();
        Entry { name, share: None, errors, region: None }
    }

    /// Creates the entry of the baseline that locates all samples at the mean of the training positions.
    fn centre_entry(&self, locator: &Locator<'_>) -> Entry {
        let centre = [0, 1, 2].map(|k| mean(locator.positions().iter().map(|p| p[k])));
        self.baseline_entry(CENTRE.into(), |_| centre)
    }

    /// Locates the samples with Kriging in place of the model; `None` if Kriging does not support the data.
    fn locate_by_kriging(
        &self,
        fitting: FittingSet<'_>,
        observer: &mut dyn Observer,
    ) -> Result<Option<(Choice, Vec<Located>)>> {
        let kriging = Plugin::<dyn Baseline>::parse("Kriging()").map_err(Error::Config)?;
        if kriging.check_data(self.data).is_err() {
            return Ok(None);
        }
        let predictor = kriging.fit(self.data, fitting)?;
        let locator = run_stage(observer, "fingerprints of Kriging", |progress| {
            Locator::fit(self.data, fitting, predictor.as_ref(), &SHARES, progress)
        })?;
        let located = self.observations.par_iter().map(|observation| locator.locate(observation));
        Ok(Some((locator.choice, located.collect())))
    }

    /// States that the first entry is no better than the centre, or else compares it with the best of the other entries; empty
    /// if no difference can be computed.
    fn verdict(&self, entries: &[Entry]) -> String {
        let transmitters = self.transmitters.iter().map(|t| self.data.locations[*t]);
        let blocks = Blocks::new(&transmitters.clone().map(|tx| (tx.id, Some(tx.position()))).collect());
        let compare = |other: &Entry| {
            let differences = entries[0].errors.iter().zip(&other.errors).map(|(model, baseline)| model - baseline);
            let differences = transmitters.clone().map(|tx| tx.id).zip(differences);
            let Difference { mean, interval, .. } = Difference::of(&[blocks.block_sums(differences)])?;
            let (baseline, metric) = (other.name.clone(), "error_m".to_owned());
            let interval = interval.map(|(low, high)| [low, high]);
            Some(PairedRow { baseline, metric, higher_is_better: false, mean, interval })
        };
        let mut text = String::new();
        let centre = entries.iter().find(|entry| entry.name == CENTRE).and_then(compare);
        let mean_error = |entry: &&Entry| mean(entry.errors.iter().copied());
        let best = entries[1..].iter().min_by(|a, b| mean_error(a).total_cmp(&mean_error(b))).and_then(compare);
        let end = format!("({} minus baseline, mean error in metres ↓)", entries[0].name);
        if let Some(row) = centre.filter(|row| row.verdict() != "better") {
            _ = writeln!(text, "no better than the {CENTRE}: {} {end}", row.difference_text());
        } else if let Some(row) = best {
            _ = writeln!(text, "{} {end}", row.sentence());
        }
        text
    }
}

impl Entry {
    /// Formats the cells of the entry, in the order of the header of [`format_errors`].
    fn cells(&self) -> Vec<String> {
        let worst = quantile(&sorted(self.errors.iter().copied()), 0.9);
        let [mean, median] = mean_and_median(self.errors.clone());
        let percent = |share: f64, decimals: usize| format!("{} %", fixed(100.0 * share, decimals));
        let share = self.share.map_or_else(String::new, |share| percent(share.into(), 0));
        let [held, area] = self.region.map_or_else(Default::default, |(held, area)| [percent(held, 1), fixed(area, 4)]);
        vec![self.name.clone(), share, fixed(median, 4), fixed(mean, 4), fixed(worst, 4), held, area]
    }
}
