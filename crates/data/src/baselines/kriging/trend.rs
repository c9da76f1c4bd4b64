//! What a process is about: nothing for pictures and channels, a law of distance for powers.

use super::super::law::{Law, log_distance, points};
use pwrfgs_core::{Dataset, Query, Real, Sampling};

/// What is taken off every observation first.
pub(super) struct Trend<'a> {
    pub(super) data: &'a Dataset,
    pub(super) law: Option<Law>,
}

impl<'a> Trend<'a> {
    /// By least squares of these links.
    pub(super) fn of(data: &'a Dataset, links: &[usize]) -> Self {
        Self { data, law: data.task().is_scalar.then(|| Law::fit(&points(data, links))) }
    }

    /// dBm that the law gives a link; 0 without one.
    pub(super) fn at(&self, query: Query<'_>) -> f64 {
        self.law.map_or(0.0, |law| law.at(log_distance(self.data, query)))
    }

    /// What is left of link `i`, every `stride`-th number of every `stride`-th row.
    pub(super) fn residual(&self, i: usize, stride: usize, out: &mut [Real]) {
        self.data.observations.sampled(i, Sampling::every(stride), out);
        if self.law.is_some() {
            out[0] -= self.at(self.data.query(i)) as Real;
        }
    }
}
