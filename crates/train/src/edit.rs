//! The only place where N changes: a list of rows rewrites parameters, moments, statistics and IDs together.
//!
//! [`GaussianIds`] holds a persistent ID per Gaussian, independent of its row.

use crate::adam::Adam;
use pwrfgs_core::{CloudEdit, CloudStats, GaussianCloud, RowOrigin};

/// Per-Gaussian state besides the cloud.
#[derive(Debug)]
pub(crate) struct PerGaussianState<'a> {
    pub(crate) adam: &'a mut Adam,
    pub(crate) stats: &'a mut CloudStats,
    pub(crate) gaussian_ids: &'a mut GaussianIds,
}

/// Rewrites cloud and moments so that new row k is old row `rows[k]`. Statistics are reset.
pub(crate) fn rewrite(rows: &[RowOrigin], cloud: &mut GaussianCloud, per_gaussian: &mut PerGaussianState<'_>) {
    let sources: Vec<usize> = rows.iter().map(|row| row.source()).collect();
    *cloud = cloud.select(&sources);
    for moments in &mut per_gaussian.adam.cloud {
        *moments = moments.select(&sources);
        for (_, width, values) in moments.columns_mut() {
            for (row, values) in rows.iter().zip(values.chunks_exact_mut(width)) {
                if matches!(row, RowOrigin::Copied(_)) {
                    values.fill(0.0);
                }
            }
        }
    }
    *per_gaussian.stats = CloudStats::zeros(rows.len());
    per_gaussian.gaussian_ids.rewrite(rows);
}

/// Keeps the rows with `true`.
pub(crate) fn keep(keep: &[bool], cloud: &mut GaussianCloud, per_gaussian: &mut PerGaussianState<'_>) {
    let rows: Vec<usize> = (0..keep.len()).filter(|&i| keep[i]).collect();
    if rows.len() < keep.len() {
        // Unlike densification, a prune step does not end the period of the statistics.
        let kept = per_gaussian.stats.select(&rows);
        rewrite(&rows.into_iter().map(RowOrigin::Kept).collect::<Vec<_>>(), cloud, per_gaussian);
        *per_gaussian.stats = kept;
    }
}

/// Replaces the cloud by that of a pruner. Statistics of changed Gaussians are reset.
pub(crate) fn replace(edit: CloudEdit, cloud: &mut GaussianCloud, per_gaussian: &mut PerGaussianState<'_>) {
    let CloudEdit { cloud: new, rows } = edit;
    let n = cloud.len();
    let fits = new.len() == rows.len() && !new.is_empty() && rows.iter().all(|row| row.source() < n);
    let columns =
        |cloud: &GaussianCloud| cloud.columns().map(|(name, width, _)| (name.to_owned(), width)).collect::<Vec<_>>();
    assert!(
        fits && columns(&new) == columns(cloud),
        "an edit names a row of the cloud for each of its own, and keeps the columns"
    );
    let mut kept = per_gaussian.stats.select(&rows.iter().map(|row| row.source()).collect::<Vec<_>>());
    rewrite(&rows, cloud, per_gaussian);
    for (_, column) in kept.columns_mut() {
        let moved = column.iter_mut().zip(&rows).filter(|(_, row)| matches!(row, RowOrigin::Copied(_)));
        moved.for_each(|(v, _)| *v = 0.0);
    }
    (*cloud, *per_gaussian.stats) = (new, kept);
}

/// Removes the columns of pruners, that is all except the `lasting` ones of the method, after the pruning phase.
pub(crate) fn drop_state(cloud: &mut GaussianCloud, lasting: &[(&str, usize)]) {
    cloud.extra.retain(|column| lasting.iter().any(|(name, _)| *name == column.name));
}

/// Persistent ID of each Gaussian, in order of creation.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct GaussianIds {
    /// ID per row.
    pub(crate) of: Vec<u32>,
    /// Next unused ID.
    pub(crate) next: u32,
}

impl GaussianIds {
    /// Creates the IDs of the first `n` Gaussians.
    pub(crate) fn of(n: usize) -> Self {
        Self { of: (0..n as u32).collect(), next: n as u32 }
    }

    /// Moves IDs with the rows: a kept row keeps its ID, a copied row gets a new one.
    pub(crate) fn rewrite(&mut self, rows: &[RowOrigin]) {
        let old = std::mem::take(&mut self.of);
        let number = |row: &RowOrigin| match row {
            RowOrigin::Kept(i) => old[*i],
            RowOrigin::Copied(_) => {
                self.next += 1;
                self.next - 1
            }
        };
        self.of = rows.iter().map(number).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaussian_keeps_id_and_copy_gets_new_id() {
        let mut gaussian_ids = GaussianIds::of(4);
        gaussian_ids.rewrite(&[RowOrigin::Kept(1), RowOrigin::Kept(3), RowOrigin::Copied(1)]);
        assert_eq!(gaussian_ids, GaussianIds { of: vec![1, 3, 4], next: 5 });
        gaussian_ids.rewrite(&[RowOrigin::Kept(2), RowOrigin::Copied(0)]);
        assert_eq!(gaussian_ids, GaussianIds { of: vec![4, 5], next: 6 });
    }
}
