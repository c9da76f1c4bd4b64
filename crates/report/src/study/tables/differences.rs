//! Table of paired differences from a reference.

use super::scores::words;
use super::{FormattedValue, RankMark, Table, TableColumn, TableLine, title};
use crate::study::comparison::{Comparison, ComparisonRow, RowKind};
use crate::templates::sentences;
use minijinja::context;
use pwrfgs_experiment::paired::{is_compared, signed};
use pwrfgs_experiment::scores::MetricRow;
use pwrfgs_experiment::statistics::{CONFIDENCE, Difference, REPLICATES};

/// Differences of every row from the reference, by the metrics that [`is_compared`] selects; by all if it selects none.
pub(in super::super) fn differences(comparison: &Comparison<'_>, reference: &ComparisonRow<'_>) -> Option<Table> {
    let shown = |m: &&MetricRow| m.is_per_sample() && is_compared(&m.key, comparison.setting.task());
    let mut metrics: Vec<&MetricRow> = comparison.metrics.iter().filter(shown).collect();
    if metrics.is_empty() {
        metrics = comparison.metrics.iter().filter(|m| m.is_per_sample()).collect();
    }
    let others = comparison.rows.iter().filter(|row| row.label != reference.label);
    let lines: Vec<(TableLine, usize)> = others
        .filter_map(|row| {
            let found: Vec<Option<Difference>> =
                metrics.iter().map(|m| row.less(reference, m, &comparison.blocks)).collect();
            let seeds = found.iter().flatten().map(|d| d.seeds).max()?;
            let cells = found.iter().map(|d| d.as_ref().map_or_else(FormattedValue::default, cell)).collect();
            Some((TableLine::new(row, cells), seeds))
        })
        .collect();
    let seeds = (lines.iter().map(|l| l.1).min()?, lines.iter().map(|l| l.1).max()?);
    let column = |m: &&MetricRow| {
        let (title, unit) = words(m);
        let detail = if unit.is_empty() { String::new() } else { format!("[{unit}]") };
        TableColumn { title: format!("Δ {title}"), detail, arrow: if m.higher_is_better { "↑" } else { "↓" } }
    };
    let mut table = Table {
        name: "differences",
        title: title(&format!("Paired differences from {}", reference.label), comparison.setting),
        columns: metrics.iter().map(column).collect(),
        lines: lines.into_iter().map(|l| l.0).collect(),
        legend: Vec::new(),
    };
    let words = context! {
        name => table.name,
        reference => reference.label,
        observations => comparison.setting.task().counted[1],
        least => seeds.0,
        most => seeds.1,
        percent => (CONFIDENCE * 100.0).round() as u32,
        replicates => REPLICATES,
        edge => comparison.blocks.edge_m.map(|edge| format!("{edge:.2}")),
        cubes => comparison.blocks.count,
        oracles => table.has(RowKind::Oracle),
        twins => !comparison.twins().is_empty(),
    };
    table.legend = sentences("legend.txt", words);
    Some(table)
}

fn cell(difference: &Difference) -> FormattedValue {
    FormattedValue {
        value: signed(difference.mean),
        interval: difference.interval.map(|(low, high)| (signed(low), signed(high))),
        mark: if difference.is_clear() { RankMark::Clear } else { RankMark::None },
        ..FormattedValue::default()
    }
}
