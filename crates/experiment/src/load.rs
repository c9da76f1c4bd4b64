//! Loads and splits the data of a pipeline, describes their size, and warns about wrong units or order that readers
//! cannot detect.

use crate::session::{Observer, staged};
use crate::text::grouped;
use pwrfgs_core::neighbours::nearest_other_squared;
use pwrfgs_core::statistics::median;
use pwrfgs_core::{Dataset, Error, Partition, Real, Result};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;

/// Largest plausible site and spacing of transmitters in metres; positions beyond both are probably in another unit.
const SITE_M: f64 = 100.0;
const SPACING_M: f64 = 3.0;
/// Median received power above which values are probably in another unit, dBm.
const STRONG_DBM: f64 = 30.0;
/// Absolute value below which all powers are probably in milliwatts.
const FAINT_MW: f64 = 0.1;

/// Loads the data of a pipeline and splits them.
///
/// # Errors
/// Invalid data, or a split without training or test samples.
pub fn load(pipeline: &Pipeline, base: &Path, observer: &mut dyn Observer) -> Result<(Dataset, Partition)> {
    let data = staged(observer, "spectra", |progress| pipeline.data.load(base, progress))?;
    let partition = pipeline.partition(&data)?;
    for (part, name) in [(&partition.train, "training"), (&partition.test, "test")] {
        if part.is_empty() {
            return Err(Error::Config(format!("split: no sample is left for the {name} set; change `split`")));
        }
    }
    let judged = (!pipeline.split.is_sparse()).then_some(&partition);
    data_warnings(&data, judged).iter().for_each(|warning| observer.on_warning(warning));
    Ok((data, partition))
}

/// `33,600 received powers at 21 receivers`, `1,000 channels of 16 antennas x 16 subcarriers`, `980 spectra of 360 x 90 pixels`.
pub fn observed(data: &Dataset) -> String {
    let (task, receivers) = (data.task(), data.scene.receivers.len());
    let of = task.size_text((data.width, data.height)).map_or_else(String::new, |size| format!(" of {size}"));
    let at = if receivers > 1 { format!(" at {receivers} receivers") } else { String::new() };
    format!("{} {}{of}{at}", grouped(data.len() as i64), task.plural)
}

/// Warnings about implausible but readable data, with advice; one sentence each.
pub fn data_warnings(data: &Dataset, partition: Option<&Partition>) -> Vec<String> {
    let positions: Vec<[f64; 3]> = data.transmitters.iter().map(|transmitter| transmitter.position).collect();
    let first = data.observations.raw(0);
    let are_equal = (1..data.len()).all(|i| data.observations.raw(i) == first);
    let mut all: Vec<String> = Vec::new();
    if data.placed {
        all.extend(position_warning(&positions));
    }
    if let Some(powers) = data.observations.powers() {
        all.extend(power_warning(powers));
    }
    all.extend(partition.and_then(|partition| split_warning(data, partition)));
    all.extend(equality_warning(data.task().plural, data.len(), are_equal));
    all
}

/// Warning for positions that are not in metres, or all equal.
pub fn position_warning(positions: &[[f64; 3]]) -> Option<String> {
    let (first, count) = (*positions.first()?, positions.len());
    if count > 1 && positions.iter().all(|position| *position == first) {
        return Some(format!(
            "positions: all {count} transmitters are at {first:?}; give each transmitter its own position"
        ));
    }
    let side = |k: usize| {
        let ends = |pick: fn(f64, f64) -> f64| positions.iter().map(|p| p[k]).fold(first[k], pick);
        ends(f64::max) - ends(f64::min)
    };
    let site = (0..3).map(side).fold(0.0, f64::max);
    if site <= SITE_M {
        return None;
    }
    let local = |position: &[f64; 3]| [0, 1, 2].map(|k| (position[k] - first[k]) as Real);
    let squared = nearest_other_squared(&positions.iter().map(local).collect::<Vec<_>>());
    let spacing = median(squared.into_iter().map(|d| (d as f64).sqrt()));
    (spacing > SPACING_M).then(|| {
        format!(
            "positions: the site is {site:.0} m long and the median distance to the nearest transmitter is {spacing:.1} m; \
             if these are centimetres, millimetres or degrees, convert them to metres"
        )
    })
}

/// Warning for powers that are not in dBm.
fn power_warning(powers: &[Real]) -> Option<String> {
    let powers: Vec<f64> = powers.iter().map(|dbm| *dbm as f64).collect();
    let what = if powers.iter().all(|dbm| dbm.abs() <= FAINT_MW) {
        format!("all lie within {FAINT_MW} of zero")
    } else if powers.iter().all(|dbm| *dbm >= 0.0) {
        "none is below 0 dBm, which is a milliwatt".to_owned()
    } else {
        let median = median(powers);
        if median <= STRONG_DBM {
            return None;
        }
        format!("the median is {median:.1} dBm")
    };
    Some(format!("received powers: {what}; if these are milliwatts, give 10 * log10(mW)"))
}

/// Warning for training and test sets that were probably swapped.
fn split_warning(data: &Dataset, partition: &Partition) -> Option<String> {
    let (known, test) = (partition.train.len() + partition.validation.len(), partition.test.len());
    let advice = if data.official.as_ref().is_some_and(|(_, official)| *official == partition.test) {
        "if the two are swapped, exchange train_index.txt and test_index.txt"
    } else {
        "if that is not meant, give the split a smaller test share"
    };
    let things = data.task().counted[1];
    (test > known).then(|| format!("split: {test} test {things}, but only {known} to learn from; {advice}"))
}

/// Warning for observations that are all equal.
pub fn equality_warning(things: &str, count: usize, are_equal: bool) -> Option<String> {
    (count > 1 && are_equal).then(|| {
        format!(
            "{things}: all {count} are equal, so nothing depends on the transmitter; check the files they came from"
        )
    })
}
