//! `Reference`: rows from which the others are subtracted.

use super::comparison::{Comparison, ComparisonRow, RowKind};
use pwrfgs_experiment::scores::MetricRow;
use pwrfgs_experiment::statistics::Difference;

/// Rows that are subtracted from the others: one for all, or one per combination of the other axes of a sweep.
#[derive(Clone, Debug)]
pub(super) struct Reference<'a> {
    pub(super) label: &'a str,
    pub(super) rows: Vec<&'a ComparisonRow<'a>>,
}

/// Differences of one row.
pub(super) struct RowDifferences<'a> {
    pub(super) row: &'a ComparisonRow<'a>,
    pub(super) reference: &'a ComparisonRow<'a>,
    /// Difference by each metric, if both rows have scores of common samples.
    pub(super) by_metric: Vec<Option<Difference>>,
}

impl<'a> Reference<'a> {
    /// Returns the rows that `label` names: the row of this label, or else the variants with this value on an axis, such as
    /// `Mine` for `pruner Mine, target_count 60`. `None` without one.
    pub(super) fn find(comparison: &'a Comparison<'a>, label: &'a str) -> Option<Self> {
        let exact: Vec<_> = comparison.rows.iter().filter(|row| row.label == label).collect();
        let with_value = || comparison.rows.iter().filter(|row| axis_of(row, label).is_some()).collect();
        let rows = if exact.is_empty() { with_value() } else { exact };
        (!rows.is_empty()).then_some(Self { label, rows })
    }

    /// Returns the first variant as the reference of all rows.
    pub(super) fn first(comparison: &'a Comparison<'a>) -> Self {
        Self { label: comparison.rows[0].label, rows: vec![&comparison.rows[0]] }
    }

    /// Returns the labels of the rows.
    pub(super) fn labels(&self) -> Vec<&'a str> {
        self.rows.iter().map(|row| row.label).collect()
    }

    /// Returns the row to subtract from `row`: of several, the variant that differs from `row` only on the axis of the label.
    /// `None` for a reference itself, and without such a variant.
    fn row_for(&self, row: &ComparisonRow<'_>) -> Option<&'a ComparisonRow<'a>> {
        let is_matching = |reference: &ComparisonRow<'_>| {
            axis_of(reference, self.label).is_some_and(|axis| other_parts(reference, axis) == other_parts(row, axis))
        };
        match &self.rows[..] {
            rows if rows.iter().any(|reference| reference.label == row.label) => None,
            [reference] => Some(reference),
            rows => rows.iter().copied().find(|reference| row.kind == RowKind::Variant && is_matching(reference)),
        }
    }

    /// Returns the differences of all rows by these metrics; omits rows without any.
    pub(super) fn differences(
        &self,
        comparison: &'a Comparison<'a>,
        metrics: &[&MetricRow],
    ) -> Vec<RowDifferences<'a>> {
        let difference = |row: &'a ComparisonRow<'a>| {
            let reference = self.row_for(row)?;
            let by_metric: Vec<_> =
                metrics.iter().map(|metric| row.difference_from(reference, metric, &comparison.blocks)).collect();
            by_metric.iter().any(Option::is_some).then_some(RowDifferences { row, reference, by_metric })
        };
        comparison.rows.iter().filter_map(difference).collect()
    }
}

/// Splits a part of a label between commas into axis and value; a part without a value is its own axis.
fn axis_and_value(part: &str) -> (&str, &str) {
    part.split_once([' ', '=']).unwrap_or((part, part))
}

/// Returns the axis on which a variant has this value, with or without the name of the axis; `None` without one.
fn axis_of<'a>(row: &ComparisonRow<'a>, value: &str) -> Option<&'a str> {
    let mut parts = row.label.split(", ").filter(|_| row.kind == RowKind::Variant);
    let part = parts.find(|part| *part == value || axis_and_value(part).1 == value)?;
    Some(axis_and_value(part).0)
}

/// Returns the parts of a label on the other axes.
fn other_parts<'a>(row: &ComparisonRow<'a>, axis: &str) -> Vec<&'a str> {
    row.label.split(", ").filter(|part| axis_and_value(part).0 != axis).collect()
}
