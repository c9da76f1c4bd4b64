//! The snapshots that a training left, in the order of its steps.

use crate::side::Side;
use pwrfgs_experiment::folder::snapshots;
use pwrfgs_experiment::text::grouped;
use pwrfgs_model::Snapshot;

/// Titles and snapshots; a damaged one is left out.
pub(crate) fn moments(side: &Side) -> Vec<(String, Snapshot)> {
    let Some(folder) = &side.folder else { return Vec::new() };
    let found = snapshots().filter_map(|(name, what)| {
        let snapshot = Snapshot::read(&folder.join(name)).ok().flatten()?;
        Some((format!("{what}, step {}", grouped(snapshot.step as i64)), snapshot))
    });
    let mut all: Vec<_> = found.collect();
    all.sort_by_key(|(_, snapshot)| snapshot.step);
    all
}
