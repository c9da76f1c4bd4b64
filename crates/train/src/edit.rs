//! The one place where N changes: a list of rows rewrites parameters, moments, statistics and births together.
//!
//! [`Births`] says who a Gaussian is, whatever row it stands in.

use crate::adam::Adam;
use pwrfgs_core::{CloudStats, Edit, GaussianCloud, Row};

/// What has a row a Gaussian besides the cloud.
#[derive(Debug)]
pub(crate) struct Beside<'a> {
    pub(crate) adam: &'a mut Adam,
    pub(crate) stats: &'a mut CloudStats,
    pub(crate) births: &'a mut Births,
}

/// Rewrites cloud, moments and statistics so that row k of the new is `rows[k]` of the old. Statistics start anew.
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

/// Keeps the rows that are true.
pub(crate) fn keep(keep: &[bool], cloud: &mut GaussianCloud, beside: &mut Beside<'_>) {
    let rows: Vec<usize> = (0..keep.len()).filter(|&i| keep[i]).collect();
    if rows.len() < keep.len() {
        // A prune, unlike a densification, does not end the period over which statistics are summed.
        let kept = beside.stats.select(&rows);
        rewrite(&rows.into_iter().map(Row::Kept).collect::<Vec<_>>(), cloud, beside);
        *beside.stats = kept;
    }
}

/// Puts a pruner's cloud in the place of this one. Statistics of a Gaussian that is another now start anew.
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

/// Removes the columns of pruners, all that are not among the method's `lasting`: after the pruning phase no mask is left.
pub(crate) fn drop_state(cloud: &mut GaussianCloud, lasting: &[(&str, usize)]) {
    cloud.extra.retain(|column| lasting.iter().any(|(name, _)| *name == column.name));
}

/// A number for each Gaussian, in the order in which they came to be; it stays while rows move.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Births {
    /// Of each row.
    pub(crate) of: Vec<u32>,
    /// The next number.
    pub(crate) next: u32,
}

impl Births {
    /// Of the first `n`.
    pub(crate) fn of(n: usize) -> Self {
        Self { of: (0..n as u32).collect(), next: n as u32 }
    }

    /// Row k becomes what `rows[k]` says: the same Gaussian, or a new one.
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
