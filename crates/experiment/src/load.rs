//! Loads and splits the data of a pipeline, describes their size, and checks them for [findings](crate::collect_findings).

use crate::findings::{Finding, collect_findings, reject_findings};
use crate::session::{Observer, Session, run_stage};
use crate::text::grouped;
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;
use std::time::Instant;

/// Data set with its split.
#[derive(Clone, Debug)]
pub struct SplitData {
    /// The data.
    pub data: Dataset,
    /// Training, validation and test samples.
    pub partition: Partition,
}

/// Run in progress: its pipeline, data and session.
#[derive(Debug)]
pub struct ActiveRun<'a, 's> {
    /// Pipeline with absolute paths, scaled.
    pub(crate) pipeline: &'a Pipeline,
    pub(crate) split: &'a SplitData,
    pub(crate) session: &'a mut Session<'s>,
    /// Start time of the run.
    pub(crate) begun: Instant,
}

impl<'a, 's> ActiveRun<'a, 's> {
    /// Starts a run of `pipeline`, which has absolute paths and is scaled, on its data.
    pub fn new(pipeline: &'a Pipeline, split: &'a SplitData, session: &'a mut Session<'s>) -> Self {
        Self { pipeline, split, session, begun: Instant::now() }
    }
}

/// Loads the data of a pipeline with absolute paths, splits and checks them. Receivers of unknown position get an estimate from
/// the training set.
///
/// # Errors
/// Invalid data, a split without training or test samples, or findings that make results meaningless and that the pipeline
/// does not accept.
pub fn load_split_data(pipeline: &Pipeline, observer: &mut dyn Observer) -> Result<SplitData> {
    load_with_findings(pipeline, Some(&pipeline.accept), observer).map(|(split, _)| split)
}

/// Loads the data as [`load_split_data`] does, and also returns the findings on them. `accepted` are the names of accepted
/// findings; `None` accepts all, for data of a run that has begun.
///
/// # Errors
/// As [`load_split_data`].
pub fn load_with_findings(
    pipeline: &Pipeline,
    accepted: Option<&[String]>,
    observer: &mut dyn Observer,
) -> Result<(SplitData, Vec<Finding>)> {
    let mut data = run_stage(observer, "spectra", |progress| pipeline.data.load(Path::new(""), progress))?;
    let partition = pipeline.partition(&data)?;
    for (samples, name) in [(&partition.train, "training"), (&partition.test, "test")] {
        if samples.is_empty() {
            return Err(Error::Config(format!("split: no sample is left for the {name} set; change `split`")));
        }
    }
    data.estimate_receivers(&partition.train);
    // A sparse split has few training samples on purpose, so it is not checked.
    let judged = (!pipeline.split.is_sparse()).then_some(&partition);
    let findings = check_findings(&data, judged, accepted, observer)?;
    Ok((SplitData { data, partition }, findings))
}

/// Checks the data as [`collect_findings`] does, and warns of each finding. Findings that make results meaningless are errors
/// unless their names are `accepted`; `None` accepts all.
///
/// # Errors
/// As [`collect_findings`] and [`reject_findings`].
pub fn check_findings(
    data: &Dataset,
    partition: Option<&Partition>,
    accepted: Option<&[String]>,
    observer: &mut dyn Observer,
) -> Result<Vec<Finding>> {
    let findings = collect_findings(data, partition)?;
    if let Some(accepted) = accepted {
        reject_findings(&findings, &[accepted, &data.accepted].concat())?;
    }
    findings.iter().for_each(|finding| observer.on_warning(&finding.to_string()));
    Ok(findings)
}

/// Describes number and size of the observations: `33,600 received powers at 21 receivers`, `1,000 channels of 16
/// antennas x 16 subcarriers`, `980 spectra of 360 x 90 pixels`.
pub fn describe_observations(data: &Dataset) -> String {
    let (task, receivers) = (data.task(), data.scene.receivers.len());
    let size = task.size_text((data.width, data.height)).map_or_else(String::new, |size| format!(" of {size}"));
    let ends = if receivers > 1 { format!(" at {receivers} receivers") } else { String::new() };
    format!("{} {}{size}{ends}", grouped(data.len() as i64), task.plural)
}
