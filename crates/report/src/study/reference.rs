//! `Reference`: rows from which the others are subtracted.

use super::comparison::{Comparison, ComparisonRow, RowKind};
use pwrfgs_experiment::scores::MetricRow;
use pwrfgs_experiment::statistics::Difference;
use std::collections::BTreeMap;

/// Rows that are subtracted from the others.
#[derive(Clone, Debug)]
pub(super) struct Reference<'a> {
    pub(super) label: &'a str,
    /// Whether each variant has its own row: the one that differs only on the axis of the label. Otherwise, there is one row for all.
    pub(super) is_by_axis: bool,
    rows: Vec<&'a ComparisonRow<'a>>,
}

/// Differences of one row.
pub(super) struct RowDifferences<'a> {
    pub(super) row: &'a ComparisonRow<'a>,
    pub(super) reference: &'a ComparisonRow<'a>,
    /// Difference by the key of a metric, if both rows have scores of common samples.
    pub(super) by_key: BTreeMap<&'a str, Difference>,
}

impl<'a> Reference<'a> {
    /// Returns the reference that `label` names: the row of this label, with or without its first axis, or else the variants with
    /// this value on an axis, such as `Mine` for `pruner Mine, target_count 60`. `None` without one.
    pub(super) fn find(comparison: &'a Comparison<'a>, label: &'a str) -> Option<Self> {
        let rows = &comparison.rows;
        let without_axis = |row: &&ComparisonRow<'_>| {
            row.kind == RowKind::Variant && row.label.split_once([' ', '=']).is_some_and(|(_, end)| end == label)
        };
        if let Some(row) = rows.iter().find(|row| row.label == label).or_else(|| rows.iter().find(without_axis)) {
            return Some(Self { label, is_by_axis: false, rows: vec![row] });
        }
        let rows: Vec<_> = rows.iter().filter(|row| axis_of(row, label).is_some()).collect();
        (!rows.is_empty()).then_some(Self { label, is_by_axis: true, rows })
    }

    /// Returns the first variant as the reference of all rows.
    pub(super) fn first(comparison: &'a Comparison<'a>) -> Self {
        let row = &comparison.rows[0];
        Self { label: row.label, is_by_axis: false, rows: vec![row] }
    }

    /// Returns the labels of the rows.
    pub(super) fn labels(&self) -> Vec<&'a str> {
        self.rows.iter().map(|row| row.label).collect()
    }

    /// Returns the row to subtract from `row`. `None` for such a row itself and, by axis, without a matching one.
    fn row_for(&self, row: &ComparisonRow<'_>) -> Option<&'a ComparisonRow<'a>> {
        let is_matching = |reference: &ComparisonRow<'_>| {
            axis_of(reference, self.label).is_some_and(|axis| other_axes(reference, axis) == other_axes(row, axis))
        };
        if self.rows.iter().any(|reference| std::ptr::eq(*reference, row)) {
            return None;
        }
        let mut rows = self.rows.iter().copied();
        rows.find(|reference| !self.is_by_axis || row.kind == RowKind::Variant && is_matching(reference))
    }

    /// Returns the differences of all rows by all metrics of test samples; omits rows without any.
    pub(super) fn differences(&self, comparison: &'a Comparison<'a>) -> Vec<RowDifferences<'a>> {
        let metrics = || comparison.metrics.iter().filter(|metric| metric.is_per_sample());
        let difference = |row: &'a ComparisonRow<'a>| {
            let reference = self.row_for(row)?;
            let by_metric = |metric: &'a MetricRow| {
                Some((metric.key.as_str(), row.difference_from(reference, metric, &comparison.blocks)?))
            };
            let by_key: BTreeMap<_, _> = metrics().filter_map(by_metric).collect();
            (!by_key.is_empty()).then_some(RowDifferences { row, reference, by_key })
        };
        comparison.rows.iter().filter_map(difference).collect()
    }
}

/// Returns the axis on which a row has this value, with or without the name of the axis; `None` without one.
fn axis_of<'a>(row: &ComparisonRow<'a>, value: &str) -> Option<&'a str> {
    let is_value = |(axis, own): &&(String, String)| own == value || format!("{axis} {own}") == value;
    row.axes.iter().find(is_value).map(|(axis, _)| axis.as_str())
}

/// Returns the values of a row on the other axes.
fn other_axes<'a>(row: &ComparisonRow<'a>, axis: &str) -> Vec<&'a (String, String)> {
    row.axes.iter().filter(|(name, _)| name != axis).collect()
}
