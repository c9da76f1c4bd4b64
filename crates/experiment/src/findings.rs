//! [`collect_findings`]: what is implausible about readable data, such as a wrong pose, unit or frame, with what mends it.

pub(crate) mod channels;
pub(crate) mod cloud;
mod directions;
mod finding;
pub(crate) mod pose;
mod positions;
mod powers;
mod relation;
mod rotation;
pub(crate) mod spectra;

pub use finding::{Finding, reject_findings};
pub use powers::check_observed;

use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Dataset, Partition, Result};
use std::collections::BTreeSet;

/// Share of test samples at training positions above which they are a finding.
const REPEATED: f64 = 0.05;
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
        findings.extend(positions::check_positions(data));
        // The cloud of a camera is of the same reconstruction, without a unit, and cameras may stand around it.
        findings.extend(cloud::check_cloud(data).filter(|_| data.camera().is_none()));
    }
    if let Some(powers) = data.observations.powers() {
        findings.extend(powers::check_powers(data, powers));
        // Powers with codes or in another unit do not fall with the distance.
        if findings.iter().all(|finding| !finding.is_error()) {
            findings.extend(relation::check_levels(data).or_else(|| relation::check_power_rows(data)));
        }
    }
    findings.extend(partition.and_then(|partition| check_split(data, partition)));
    findings.extend(partition.and_then(|partition| check_repeated(data, partition)));
    findings.extend(check_equal_observations(data));
    findings.extend(check_estimated(data));
    findings.extend(channels::check_channels(data));
    if data.observations.spectra().is_some() && data.camera().is_none() {
        let summaries = spectra::summarise(data, SAMPLED, &|_, _| {})?;
        findings.extend(check_constant_spectra(&summaries));
        // Positions that are wrong do not fit the spectra.
        let is_right = findings.iter().all(|finding| !finding.is_error());
        let pose = if is_right { pose::check_pose(data, &summaries) } else { None };
        findings.extend(
            pose.and_then(|pose| directions::check_directions(data, &summaries, &pose).or_else(|| pose.finding(data))),
        );
    }
    Ok(findings)
}

/// Finds a test set larger than the training and validation sets together: swapped index files, or too large a test
/// share. `None` if it is not larger.
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

/// Finds test samples exactly at the positions of training samples, such as repeated readings. `None` for at most the share
/// [`REPEATED`], without positions, or if all training samples are at one.
fn check_repeated(data: &Dataset, partition: &Partition) -> Option<Finding> {
    let at = |i: &usize| (data.sample(*i).pose.coordinates().map(f64::to_bits), data.sample(*i).receiver);
    let trained: BTreeSet<_> = partition.train.iter().map(at).collect();
    let (count, total) = (partition.test.iter().filter(|i| trained.contains(&at(i))).count(), partition.test.len());
    let problem = format!("{count} of {total} test samples are exactly where training samples are");
    let mend = "use `split: Voxel()`, which keeps a position in one set";
    let has_positions = data.placed && trained.len() > data.scene.receivers.len(); // not all at one position
    (has_positions && count as f64 > REPEATED * total as f64)
        .then(|| Finding::new("repeated-positions", count, problem, mend))
}

/// Finds receivers whose position is an estimate; `None` without any.
fn check_estimated(data: &Dataset) -> Option<Finding> {
    let estimated: Vec<&str> =
        data.scene.receivers.iter().filter(|receiver| receiver.is_estimated).map(|receiver| &*receiver.name).collect();
    let (count, first) = (estimated.len(), strip_control(estimated.first()?));
    let problem = format!(
        "the positions of {count} of {} receivers are unknown and estimated from their strongest links (for example {first})",
        data.scene.receivers.len()
    );
    let mend = "give them with `--receivers FILE` of `pwrfgs import --table` if they are known";
    Some(Finding::new("receiver-positions", count, problem, mend))
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
