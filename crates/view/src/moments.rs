//! The snapshots that a training left, in the order of its steps.

use crate::side::Side;
use pwrfgs_experiment::Snapshot;
use pwrfgs_experiment::folder::snapshots;
use pwrfgs_experiment::text::grouped;
use std::path::PathBuf;

/// What is said of a snapshot.
pub(crate) struct Moment {
    pub(crate) title: String,
    pub(crate) step: u64,
    pub(crate) gaussians: usize,
}

/// Files and what they are; a damaged one is left out.
pub(crate) fn moments(side: &Side) -> Vec<(PathBuf, Moment)> {
    let Some(folder) = &side.folder else { return Vec::new() };
    let found = snapshots().filter_map(|(name, what)| {
        let path = folder.join(name);
        let snapshot = Snapshot::read(&path).ok().flatten()?;
        let title = format!("{what}, step {}", grouped(snapshot.step as i64));
        Some((path, Moment { title, step: snapshot.step, gaussians: snapshot.means.len() }))
    });
    let mut all: Vec<_> = found.collect();
    all.sort_by_key(|(_, moment)| moment.step);
    all
}
