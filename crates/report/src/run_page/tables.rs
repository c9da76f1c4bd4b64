//! The score table: a line each predictor, three columns each metric of samples, one each metric that baselines share.

use pwrfgs_experiment::scores::{Cell, MetricRow, ScoreTable};
use pwrfgs_experiment::text::number;
use serde::Serialize;

/// A column group of the score table.
#[derive(Serialize)]
pub(super) struct Group {
    key: String,
    /// The key, or words where it stands above one narrow column.
    title: String,
    unit: String,
    arrow: &'static str,
    /// Names of its columns.
    columns: &'static [&'static str],
}

/// A predictor's line.
#[derive(Serialize)]
pub(super) struct Row {
    name: String,
    cells: Vec<Shown>,
}

/// A number and whether it is `best` or `second`, and whether it begins a group.
#[derive(Serialize)]
struct Shown {
    text: String,
    class: &'static str,
    first: bool,
}

fn group(row: &MetricRow) -> Group {
    Group {
        key: row.key.clone(),
        title: if row.is_per_sample() {
            row.key.clone()
        } else {
            row.key.trim_end_matches(&format!("_{}", row.unit)).replace('_', " ")
        },
        unit: row.unit.clone(),
        arrow: if row.higher_is_better { "↑" } else { "↓" },
        columns: if row.is_per_sample() { &["mean", "median", "p10"] } else { &[""] },
    }
}

/// Whether it is a number of more predictors than one.
fn is_shared(row: &MetricRow) -> bool {
    row.is_per_sample() || row.ranks(0).iter().flatten().count() > 1
}

/// Column groups and lines: metrics of samples first, then those with one number that baselines have too, such as the
/// time of a prediction.
pub(super) fn scores(scores: &ScoreTable) -> (Vec<Group>, Vec<Row>) {
    let (samples, others): (Vec<_>, Vec<_>) =
        scores.metrics.iter().filter(|m| is_shared(m)).partition(|m| m.is_per_sample());
    let metrics = [samples, others].concat();
    let columns: Vec<(&MetricRow, usize, Vec<Option<usize>>)> =
        metrics.iter().flat_map(|m| (0..group(m).columns.len()).map(move |k| (*m, k, m.ranks(k)))).collect();
    let line = |p: usize| {
        let cell = |(m, k, ranks): &(&MetricRow, usize, Vec<Option<usize>>)| {
            let (text, class) = match (m.cells[p].numbers().get(*k), ranks[p]) {
                (None, _) => ("n/a".into(), "none"),
                (Some(value), Some(0)) => (number(*value), "best"),
                (Some(value), Some(1)) => (number(*value), "second"),
                (Some(value), _) => (number(*value), ""),
            };
            Shown { text, class, first: *k == 0 }
        };
        columns.iter().map(cell).collect()
    };
    let rows = scores.predictors.iter().enumerate().map(|(p, name)| Row { name: name.clone(), cells: line(p) });
    (metrics.iter().map(|m| group(m)).collect(), rows.collect())
}

/// The numbers about the whole model, one each metric.
pub(super) fn whole(scores: &ScoreTable) -> Vec<(Group, String)> {
    let text = |cell: &Cell, unit: &str| match cell {
        Cell::NotApplicable(why) => format!("n/a: {why}"),
        cell => format!("{} {unit}", cell.numbers().first().map_or_else(String::new, |v| number(*v))),
    };
    let rows = scores.metrics.iter().filter(|m| !m.is_per_sample());
    rows.filter_map(|m| m.cells.first().map(|cell| (group(m), text(cell, &m.unit)))).collect()
}
