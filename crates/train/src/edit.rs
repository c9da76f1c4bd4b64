//! The only place where training changes N: a list of rows rewrites parameters, moments, statistics and IDs together.
//!
//! [`GaussianIds`] holds a persistent ID per Gaussian, independent of its row.

use crate::adam::Adam;
use pwrfgs_core::{CloudEdit, CloudStats, GaussianCloud, RowOrigin};

/// Rules, each with the number of Gaussians that it removes.
pub(crate) type RemovalsByRule = Vec<(String, usize)>;

/// All state with a row per Gaussian: parameters, moments, statistics and IDs.
#[derive(Debug)]
pub(crate) struct PerGaussianState<'a> {
    pub(crate) cloud: &'a mut GaussianCloud,
    pub(crate) adam: &'a mut Adam,
    pub(crate) stats: &'a mut CloudStats,
    pub(crate) gaussian_ids: &'a mut GaussianIds,
}

/// Rewrites cloud, moments and IDs so that new row k is old row `rows[k]`. A copied row has a new ID and moments of 0.
/// Statistics are reset.
pub(crate) fn rewrite(rows: &[RowOrigin], state: &mut PerGaussianState<'_>) {
    let sources: Vec<usize> = rows.iter().map(|row| row.source()).collect();
    *state.cloud = state.cloud.select(&sources);
    for moments in &mut state.adam.cloud {
        *moments = moments.select(&sources);
        for (_, width, values) in moments.columns_mut() {
            for (row, values) in rows.iter().zip(values.chunks_exact_mut(width)) {
                if matches!(row, RowOrigin::Copied(_)) {
                    values.fill(0.0);
                }
            }
        }
    }
    *state.stats = CloudStats::zeros(rows.len());
    state.gaussian_ids.rewrite(rows);
}

/// Keeps the rows with `true`, with their statistics.
pub(crate) fn retain(keep: &[bool], state: &mut PerGaussianState<'_>) {
    let rows: Vec<usize> = (0..keep.len()).filter(|&i| keep[i]).collect();
    if rows.len() < keep.len() {
        // Unlike densification, a prune step does not end the period of the statistics.
        let stats = state.stats.select(&rows);
        rewrite(&rows.into_iter().map(RowOrigin::Kept).collect::<Vec<_>>(), state);
        *state.stats = stats;
    }
}

/// Replaces the cloud by that of a pruner. Statistics of copied Gaussians are reset. Panics if the edit does not fit the cloud,
/// a fault of the pruner.
pub(crate) fn replace(edit: CloudEdit, state: &mut PerGaussianState<'_>) {
    let CloudEdit { cloud, rows } = edit;
    let n = state.cloud.len();
    let fits = cloud.len() == rows.len() && !cloud.is_empty() && rows.iter().all(|row| row.source() < n);
    let columns =
        |cloud: &GaussianCloud| cloud.columns().map(|(name, width, _)| (name.to_owned(), width)).collect::<Vec<_>>();
    assert!(
        fits && columns(&cloud) == columns(state.cloud),
        "an edit of a pruner has Gaussians, an old row for each, and the same columns"
    );
    let mut stats = state.stats.select(&rows.iter().map(|row| row.source()).collect::<Vec<_>>());
    rewrite(&rows, state);
    for (_, column) in stats.columns_mut() {
        let copied = column.iter_mut().zip(&rows).filter(|(_, row)| matches!(row, RowOrigin::Copied(_)));
        copied.for_each(|(v, _)| *v = 0.0);
    }
    (*state.cloud, *state.stats) = (cloud, stats);
}

/// Removes the columns of pruners, that is all except the `lasting` ones of the method, after the pruning phase.
pub(crate) fn drop_pruner_columns(cloud: &mut GaussianCloud, lasting: &[(&str, usize)]) {
    cloud.extra.retain(|column| lasting.iter().any(|(name, _)| *name == column.name));
}

/// Persistent ID of each Gaussian, in order of creation.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct GaussianIds {
    /// ID per row.
    pub(crate) rows: Vec<u32>,
    /// Next unused ID.
    pub(crate) next: u32,
}

impl GaussianIds {
    /// Creates the IDs of the first `n` Gaussians.
    pub(crate) fn first(n: usize) -> Self {
        Self { rows: (0..n as u32).collect(), next: n as u32 }
    }

    /// Moves IDs with the rows: a kept row keeps its ID, a copied row gets a new one.
    pub(crate) fn rewrite(&mut self, rows: &[RowOrigin]) {
        let old = std::mem::take(&mut self.rows);
        let id_of = |row: &RowOrigin| match row {
            RowOrigin::Kept(i) => old[*i],
            RowOrigin::Copied(_) => {
                self.next += 1;
                self.next - 1
            }
        };
        self.rows = rows.iter().map(id_of).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_keeps_id_and_copy_gets_new_id() {
        let mut gaussian_ids = GaussianIds::first(4);
        gaussian_ids.rewrite(&[RowOrigin::Kept(1), RowOrigin::Kept(3), RowOrigin::Copied(1)]);
        assert_eq!(gaussian_ids, GaussianIds { rows: vec![1, 3, 4], next: 5 });
        gaussian_ids.rewrite(&[RowOrigin::Kept(2), RowOrigin::Copied(0)]);
        assert_eq!(gaussian_ids, GaussianIds { rows: vec![4, 5], next: 6 });
    }
}
