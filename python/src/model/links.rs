//! Links of a call of a model, from its arguments.

use super::Model;
use crate::arrays::{self, axis_count, numbers, position, positions};
use crate::border::{input_error, reject};
use pwrfgs_core::{End, Pose, Query, Real, Receiver};
use pyo3::prelude::*;
use std::ops::Range;

/// Links of a call.
pub(super) struct Links {
    /// Poses of the moving end; zero for links with features.
    pub(super) poses: Vec<Pose>,
    /// Link features, `[poses, width]`; empty for models of positions.
    pub(super) features: Vec<Real>,
    /// Indices of the receivers, all for each pose.
    pub(super) receivers: Vec<usize>,
    /// Leading axes, before those of an observation.
    pub(super) lead: Vec<usize>,
}

impl Links {
    /// Returns the query of link `k`, in the order of the observations: receivers vary fastest.
    pub(super) fn query(&self, k: usize) -> Query<'_> {
        let (i, receiver) = (k / self.receivers.len(), self.receivers[k % self.receivers.len()]);
        let width = self.features.len() / self.poses.len().max(1);
        let features = (width > 0).then(|| &self.features[i * width..][..width]);
        Query { features, ..Query::at(self.poses[i], receiver) }
    }

    /// Returns the links of the rows `rows` of several poses or features.
    pub(super) fn rows(&self, rows: Range<usize>) -> Self {
        let width = self.features.len() / self.poses.len().max(1);
        let mut lead = self.lead.clone();
        lead[0] = rows.len();
        let features = self.features[rows.start * width..rows.end * width].to_vec();
        Self { poses: self.poses[rows].to_vec(), features, receivers: self.receivers.clone(), lead }
    }
}

impl Model {
    /// Reads the links of a call from its arguments: those of one receiver, or of all. Raises an exception unless exactly the
    /// argument that the model needs is given.
    pub(super) fn read_links(
        &self,
        py: Python<'_>,
        receiver: Option<&Bound<'_, PyAny>>,
        [tx, rx_pose, features]: [Option<&Bound<'_, PyAny>>; 3],
    ) -> PyResult<Links> {
        let stages = self.stages();
        let (inputs, moving) = (stages.method.traits().inputs, stages.setup.moving);
        let reads_positions = inputs == 3; // x, y, z; otherwise the width of link features
        let (poses, features, is_single) = match (tx, rx_pose, features) {
            (Some(tx), None, None) if reads_positions && moving == End::Transmitter => {
                let is_single = axis_count(tx)? == 1;
                let positions = if is_single { vec![position("tx", tx)?] } else { positions("tx", tx)? };
                (positions.into_iter().map(Pose::from).collect(), Vec::new(), is_single)
            }
            (None, Some(rx_pose), None) if reads_positions && moving == End::Receiver => {
                let (poses, is_single) = arrays::poses("rx_pose", rx_pose)?;
                (poses, Vec::new(), is_single)
            }
            (None, None, Some(features)) if !reads_positions => {
                let is_single = axis_count(features)? == 1;
                let shape: &[Option<usize>] = if is_single { &[Some(inputs)] } else { &[None, Some(inputs)] };
                let features = numbers::<Real>("features", features, shape)?;
                (vec![Pose::IDENTITY; features.len() / inputs], features, is_single)
            }
            _ if !reads_positions => {
                return reject(py, &format!("this model uses link features; pass features=[B, {inputs}]"));
            }
            _ if moving == End::Receiver => {
                return reject(py, "the receiver of this model moves; pass rx_pose=[B, 7]: x, y, z, qx, qy, qz, qw");
            }
            _ => {
                let problem = if tx.is_none() { "tx is missing" } else { "this model takes only tx" };
                let advice = "pass positions [B, 3] of the transmitter, which moves, in metres";
                return reject(py, &format!("{problem}; {advice}"));
            }
        };
        let receivers = self.receiver_indices(receiver)?;
        let (positions, several) = ((!is_single).then_some(poses.len()), receivers.len() > 1);
        let lead = positions.into_iter().chain(several.then_some(receivers.len())).collect();
        Ok(Links { poses, features, receivers, lead })
    }

    /// Returns the indices of the receivers of a call: that of `receiver`, or all without one.
    fn receiver_indices(&self, receiver: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<usize>> {
        let receivers = &self.stages().setup.receivers;
        match receiver {
            Some(receiver) => Ok(vec![find_receiver(receiver, receivers)?]),
            None => Ok((0..receivers.len()).collect()),
        }
    }
}

/// Returns the index of a receiver, given its name or index. Raises an exception for an unknown one.
fn find_receiver(receiver: &Bound<'_, PyAny>, receivers: &[Receiver]) -> PyResult<usize> {
    let py = receiver.py();
    if let Ok(name) = receiver.extract::<String>() {
        return receivers.iter().position(|receiver| receiver.name == name).ok_or_else(|| {
            let hint = pwrfgs_core::did_you_mean(&name, receivers.iter().map(|receiver| receiver.name.as_str()));
            input_error(py, &format!("unknown receiver `{name}`{hint}"))
        });
    }
    let index: usize = receiver.extract()?;
    if index < receivers.len() {
        return Ok(index);
    }
    reject(py, &format!("invalid receiver index {index} (expected 0 to below {})", receivers.len()))
}
