//! [`collect_findings`]: what is implausible about readable data, such as a wrong pose, unit or frame, with what mends it.

pub(crate) mod channels;
pub(crate) mod cloud;
mod finding;
pub(crate) mod pose;
mod rotation;
pub(crate) mod spectra;

pub use finding::Finding;

use pwrfgs_core::neighbours::nearest_other_squared;
use pwrfgs_core::statistics::median;
use pwrfgs_core::{Dataset, Partition, Real, Result};

/// Largest and smallest plausible site and largest spacing of transmitters in metres; other positions are probably in
/// another unit.
const SITE_M: f64 = 100.0;
const SPACING_M: f64 = 3.0;
const SMALL_SITE_M: f64 = 0.05;
/// Median received power above which values are probably in another unit, dBm.
const STRONG_DBM: f64 = 30.0;
/// Absolute value below which all powers are probably in milliwatts.
const FAINT_MW: f64 = 0.1;
/// Share of constant spectra above which they are a finding.
const CONSTANT: f64 = 0.05;
/// Largest number of spectra that are read.
const SAMPLED: usize = 1_000;

/// Checks data, and their split if there is one, for implausible properties. Reads at most 1,000 evenly chosen spectra.
///
/// # Errors
/// If a spectrum cannot be read.
pub fn collect_findings(data: &Dataset, partition: Option<&Partition>) -> Result<Vec<Finding>> {
    let mut findings = Vec::new();
    if data.placed {
        findings.extend(check_positions(data));
        // The cloud of a camera is of the same reconstruction, without a unit, and cameras may stand around it.
        findings.extend(cloud::check_cloud(data).filter(|_| data.camera().is_none()));
    }
    findings.extend(data.observations.powers().and_then(check_powers));
    findings.extend(partition.and_then(|partition| check_split(data, partition)));
    findings.extend(check_equal_observations(data));
    findings.extend(channels::check_channels(data));
    if data.observations.spectra().is_some() && data.camera().is_none() {
        let summaries = spectra::summarize(data, SAMPLED, &|_, _| {})?;
        findings.extend(check_constant_spectra(&summaries));
        findings.extend(pose::check_pose(data, &summaries).and_then(|pose| pose.finding(data)));
    }
    Ok(findings)
}

/// Finds positions that are probably not in metres, or that are all equal; `None` if they are plausible.
fn check_positions(data: &Dataset) -> Option<Finding> {
    let positions: Vec<[f64; 3]> = data.locations.iter().map(pwrfgs_core::Location::position).collect();
    let (first, count) = (*positions.first()?, positions.len());
    if count > 1 && positions.iter().all(|position| *position == first) {
        let problem = format!("all {count} transmitters are at {first:?}");
        return Some(Finding::new("equal-positions", count, problem, "give each transmitter its own position"));
    }
    let side = |k: usize| {
        let ends = |pick: fn(f64, f64) -> f64| positions.iter().map(|p| p[k]).fold(first[k], pick);
        ends(f64::max) - ends(f64::min)
    };
    let site = (0..3).map(side).fold(0.0, f64::max);
    let unit = |problem, units| {
        Some(Finding::new("position-unit", count, problem, format!("if these are {units}, convert them to metres")))
    };
    // The model of a camera has no unit.
    if count > 1 && site < SMALL_SITE_M && data.camera().is_none() {
        return unit(format!("the site is only {:.3} mm long", 1e3 * site), "kilometres or degrees");
    }
    if site <= SITE_M {
        return None;
    }
    let local = |position: &[f64; 3]| [0, 1, 2].map(|k| (position[k] - first[k]) as Real);
    let squared = nearest_other_squared(&positions.iter().map(local).collect::<Vec<_>>());
    let spacing = median(squared.into_iter().map(|d| (d as f64).sqrt()));
    let problem =
        format!("the site is {site:.0} m long and the median distance to the nearest transmitter is {spacing:.1} m");
    if spacing > SPACING_M { unit(problem, "centimetres, millimetres or degrees") } else { None }
}

/// Finds powers that are probably not in dBm, or codes among them; `None` if they are plausible.
fn check_powers(powers: &[Real]) -> Option<Finding> {
    let powers: Vec<f64> = powers.iter().map(|dbm| *dbm as f64).collect();
    let (count, strong) = (powers.len(), powers.iter().filter(|dbm| **dbm > STRONG_DBM).count());
    let problem = if powers.iter().all(|dbm| dbm.abs() <= FAINT_MW) {
        format!("all lie within {FAINT_MW} of zero")
    } else if powers.iter().all(|dbm| *dbm >= 0.0) {
        "none is below 0 dBm, which is a milliwatt".to_owned()
    } else {
        let median = median(powers);
        if median <= STRONG_DBM {
            let problem = format!("{strong} of {count} are above {STRONG_DBM} dBm, which is a watt");
            let mend = "if these mean that nothing was received, leave them out (-100 in gateway_rssi.csv)";
            return (strong > 0).then(|| Finding::new("power-code", strong, problem, mend));
        }
        format!("the median is {median:.1} dBm")
    };
    Some(Finding::new("power-unit", count, problem, "if these are milliwatts, give 10 * log10(mW)"))
}

/// Finds training and test sets that were probably swapped: more test samples than others; `None` if there are not.
fn check_split(data: &Dataset, partition: &Partition) -> Option<Finding> {
    let (training, test) = (partition.train.len() + partition.validation.len(), partition.test.len());
    let mend = if data.official.as_ref().is_some_and(|(_, official)| *official == partition.test) {
        "if the two are swapped, exchange train_index.txt and test_index.txt"
    } else {
        "if that is not meant, give the split a smaller test share"
    };
    let problem = format!("{test} test {}, but only {training} to learn from", data.task().counted[1]);
    (test > training).then(|| Finding::new("split", test, problem, mend))
}

/// Finds observations that are all equal; `None` if two differ, or there is only one.
fn check_equal_observations(data: &Dataset) -> Option<Finding> {
    let (count, first) = (data.len(), data.observations.raw(0));
    let are_equal = count > 1 && (1..count).all(|i| data.observations.raw(i) == first);
    let problem = format!("all {count} {} are equal, so nothing depends on the transmitter", data.task().plural);
    are_equal.then(|| Finding::new("equal-observations", count, problem, "check the files they came from"))
}

/// Finds constant spectra, such as black ones; `None` if all are constant, or at most the share [`CONSTANT`].
fn check_constant_spectra(summaries: &[spectra::SpectrumSummary]) -> Option<Finding> {
    let (count, total) = (summaries.iter().filter(|spectrum| spectrum.strongest.is_none()).count(), summaries.len());
    let problem = format!("{count} of {total} spectra have no strongest direction");
    let is_notable = count < total && count as f64 > CONSTANT * total as f64;
    is_notable.then(|| Finding::new("constant-spectra", count, problem, "leave out what was not measured"))
}
