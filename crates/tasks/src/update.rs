//! New measurements for the residual process of a trained model.

use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Dataset, Error, MeasurementSetup, Receiver, Result};
use pwrfgs_experiment::{Agreement, Finding, Observer, check_alike, collect_findings, reject_findings, run_stage};
use pwrfgs_model::{Ensemble, Residuals};
use std::time::Instant;

/// Result of [`update`].
#[derive(Debug)]
pub struct UpdatedModel {
    /// Model with the new measurements.
    pub ensemble: Ensemble,
    /// Number of links that were added.
    pub added: usize,
    /// Agreement of the new data with the model, in words.
    pub agreement: String,
    /// Time per added link, milliseconds.
    pub milliseconds: f64,
}

/// Adds all links of `data` to the residual process of `model`, without training. `accepted` are the names of accepted
/// findings, such as `far-from-model`: most links lie outside the 99 % intervals of the model. `observer` receives the
/// progress and the findings on the data.
///
/// # Errors
/// A model without residual process; data of another scene, without positions, with other poses of receivers, with findings that
/// make results meaningless and are not accepted, or without a link at a receiver of the process.
pub fn update(
    model: &Ensemble,
    data: &Dataset,
    accepted: &[String],
    observer: &mut dyn Observer,
) -> Result<UpdatedModel> {
    let residuals = check_residuals(model)?;
    let ready = model.prepare();
    check_alike(&ready, data)?;
    if !data.placed || data.features.is_some() {
        return Err(Error::Config("no transmitter positions; give data with positions".into()));
    }
    check_poses(ready.setup(), data).map_err(Error::Config)?;
    let mut findings = collect_findings(data, None)?;
    let agreement = Agreement::measure(model, data, observer)?;
    let far = || Finding::far_from_model(data.len(), format!("new data are far from the model: {agreement}"));
    findings.extend(agreement.is_far().then(far));
    reject_findings(&findings, accepted)?;
    findings.iter().for_each(|finding| observer.on_warning(&finding.to_string()));
    let begun = Instant::now();
    let (updated, added) = run_stage(observer, "adding links", |_| residuals.updated(model, data))?;
    let ensemble = model.clone().with_residuals(Some(updated)).with_calibration(model.calibration().cloned());
    if added == 0 {
        return Err(Error::Config("no link at a receiver with a residual process".into()));
    }
    let milliseconds = 1e3 * begun.elapsed().as_secs_f64() / added as f64;
    Ok(UpdatedModel { ensemble, added, agreement: agreement.to_string(), milliseconds })
}

/// Returns the residual process of a model.
///
/// # Errors
/// The model has none.
pub fn check_residuals(model: &Ensemble) -> Result<&Residuals> {
    let problem = "the model has no residual process; set `residuals: Kriged()` in its pipeline and run it again";
    model.residuals().ok_or_else(|| Error::Config(problem.into()))
}

/// Rejects data in which a receiver has another pose than in the model; the error names the first one. Estimated positions
/// follow the data of each file, and the model keeps its own.
fn check_poses(setup: &MeasurementSetup, data: &Dataset) -> Result<(), String> {
    let mut pairs = setup.receivers.iter().zip(&data.scene.receivers);
    let is_moved = |(receiver, other): &(&Receiver, &Receiver)| {
        !other.is_estimated && setup.origin.world_pose(receiver.pose) != data.scene.origin.world_pose(other.pose)
    };
    pairs.find(is_moved).map_or(Ok(()), |(_, receiver)| {
        let name = strip_control(&receiver.name);
        Err(format!("receiver `{name}` has another pose than in the model; give data of the same receivers"))
    })
}
