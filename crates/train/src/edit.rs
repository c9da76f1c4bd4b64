//! The one place where N changes: a list of rows rewrites parameters, moments and statistics together.

use crate::adam::Adam;
use pwrfgs_core::{CloudStats, GaussianCloud};

/// Where a row of the new cloud comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Row {
    /// The same Gaussian: it keeps its moments.
    Kept(usize),
    /// A copy of that Gaussian: its moments start at 0.
    Copied(usize),
}

/// Rewrites cloud, moments and statistics so that row k of the new is `rows[k]` of the old. Statistics start anew.
pub(crate) fn rewrite(rows: &[Row], cloud: &mut GaussianCloud, adam: &mut Adam, stats: &mut CloudStats) {
    let sources: Vec<usize> = rows
        .iter()
        .map(|row| match row {
            Row::Kept(i) | Row::Copied(i) => *i,
        })
        .collect();
    *cloud = cloud.select(&sources);
    for moments in &mut adam.cloud {
        *moments = moments.select(&sources);
        for (_, width, values) in moments.columns_mut() {
            for (row, values) in rows.iter().zip(values.chunks_exact_mut(width)) {
                if matches!(row, Row::Copied(_)) {
                    values.fill(0.0);
                }
            }
        }
    }
    *stats = CloudStats::zeros(rows.len());
}

/// Keeps the rows that are true.
pub(crate) fn keep(keep: &[bool], cloud: &mut GaussianCloud, adam: &mut Adam, stats: &mut CloudStats) {
    let rows: Vec<usize> = (0..keep.len()).filter(|&i| keep[i]).collect();
    if rows.len() < keep.len() {
        // A prune, unlike a densification, does not end the period over which statistics are summed.
        let kept = stats.select(&rows);
        rewrite(&rows.into_iter().map(Row::Kept).collect::<Vec<_>>(), cloud, adam, stats);
        *stats = kept;
    }
}

/// Removes the columns of pruners, all that are not among the method's `lasting`: after the pruning phase no mask is left.
pub(crate) fn drop_state(cloud: &mut GaussianCloud, lasting: &[(&str, usize)]) {
    cloud.extra.retain(|column| lasting.iter().any(|(name, _)| *name == column.name));
}
