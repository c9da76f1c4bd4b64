//! The only place where N changes: a list of rows rewrites parameters, moments, statistics and IDs together.
//!
//! [`Births`] holds a persistent ID per Gaussian, independent of its row.

use crate::adam::Adam;
use pwrfgs_core::{CloudStats, Edit, GaussianCloud, Row};

/// Per-Gaussian state besides the cloud.
#[derive(Debug)]
pub(crate) struct Beside<'a> {
    pub(crate) adam: &'a mut Adam,
    pub(crate) stats: &'a mut CloudStats,
    pub(crate) births: &'a mut Births,
}

/// Rewrites cloud and moments so that new row k is old row `rows[k]`. Statistics are reset.
pub(crate) fn rewrite(rows: &[Row], cloud: &mut GaussianCloud, beside: &mut Beside<'_>) {
    let sources: Vec<usize> = rows.iter().map(|row| row.source()).collect();
    *cloud = cloud.select(&sources);
    for moments in &mut beside.adam.cloud {
        *moments = moments.select(&sources);
        for (_, width, values) in moments.columns_mut() {
            for (row, values) in rows.iter().zip(values.chunks_exact_mut(width)) {
                if matches!(row, Row::Copied(_)) {
                    values.fill(0.0);
                }
            }
        }
    }
    *beside.stats = CloudStats::zeros(rows.len());
    beside.births.rewrite(rows);
}

/// Keeps the rows with `true`.
pub(crate) fn keep(keep: &[bool], cloud: &mut GaussianCloud, beside: &mut Beside<'_>) {
    let rows: Vec<usize> = (0..keep.len()).filter(|&i| keep[i]).collect();
    if rows.len() < keep.len() {
        // Unlike densification, a prune step does not end the period of the statistics.
        let kept = beside.stats.select(&rows);
        rewrite(&rows.into_iter().map(Row::Kept).collect::<Vec<_>>(), cloud, beside);
        *beside.stats = kept;
    }
}

/// Replaces the cloud by that of a pruner. Statistics of changed Gaussians are reset.
pub(crate) fn replace(edit: Edit, cloud: &mut GaussianCloud, beside: &mut Beside<'_>) {
    let Edit { cloud: new, rows } = edit;
    let n = cloud.len();
    let fits = new.len() == rows.len() && !new.is_empty() && rows.iter().all(|row| row.source() < n);
    let columns =
        |cloud: &GaussianCloud| cloud.columns().map(|(name, width, _)| (name.to_owned(), width)).collect::<Vec<_>>();
    assert!(
        fits && columns(&new) == columns(cloud),
        "an edit names a row of the cloud for each of its own, and keeps the columns"
    );
    let mut kept = beside.stats.select(&rows.iter().map(|row| row.source()).collect::<Vec<_>>());
    rewrite(&rows, cloud, beside);
    for (_, column) in kept.columns_mut() {
        let moved = column.iter_mut().zip(&rows).filter(|(_, row)| matches!(row, Row::Copied(_)));
        moved.for_each(|(v, _)| *v = 0.0);
    }
    (*cloud, *beside.stats) = (new, kept);
}

/// Removes the columns of pruners, that is all except the `lasting` ones of the method, after the pruning phase.
pub(crate) fn drop_state(cloud: &mut GaussianCloud, lasting: &[(&str, usize)]) {
    cloud.extra.retain(|column| lasting.iter().any(|(name, _)| *name == column.name));
}

/// Persistent ID of each Gaussian, in order of creation.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Births {
    /// ID per row.
    pub(crate) of: Vec<u32>,
    /// Next unused ID.
    pub(crate) next: u32,
}

impl Births {
    /// Creates the IDs of the first `n` Gaussians.
    pub(crate) fn of(n: usize) -> Self {
        Self { of: (0..n as u32).collect(), next: n as u32 }
    }

    /// Moves IDs with the rows: a kept row keeps its ID, a copied row gets a new one.
    pub(crate) fn rewrite(&mut self, rows: &[Row]) {
        let old = std::mem::take(&mut self.of);
        let number = |row: &Row| match row {
            Row::Kept(i) => old[*i],
            Row::Copied(_) => {
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
    fn a_gaussian_keeps_its_number_and_a_copy_gets_a_new_one() {
        let mut births = Births::of(4);
        births.rewrite(&[Row::Kept(1), Row::Kept(3), Row::Copied(1)]);
        assert_eq!(births, Births { of: vec![1, 3, 4], next: 5 });
        births.rewrite(&[Row::Kept(2), Row::Copied(0)]);
        assert_eq!(births, Births { of: vec![4, 5], next: 6 });
    }
}
