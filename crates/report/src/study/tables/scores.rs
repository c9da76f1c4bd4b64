//! Tables of scores, of further metrics, of latency by stage (table I), and of paired differences from a reference.

use super::{FormattedValue, RankMark, Table, TableColumn, TableLine, table_title};
use crate::study::comparison::{
    Comparison, ComparisonRow, RowKind, SHARE, SummaryStatistic, TRAINED_ON, TRAINING, has_unsteady_times, is_time,
    statistics,
};
use crate::study::reference::{Reference, RowDifferences};
use crate::templates::render_sentences;
use minijinja::context;
use pwrfgs_core::statistics::sorted;
use pwrfgs_experiment::paired::{is_compared, is_custom, is_rate_ratio, signed};
use pwrfgs_experiment::scores::MetricRow;
use pwrfgs_experiment::statistics::{CONFIDENCE, Difference, REPLICATES, Spread};
use pwrfgs_experiment::text::{fixed, grouped};

/// Requested column.
type ScoreColumn<'a> = (&'a MetricRow, SummaryStatistic);

/// Returns the printed name of a metric and its unit.
fn name_and_unit(metric: &MetricRow) -> (String, String) {
    let key = metric.key.as_str();
    let words = match key {
        "ssim" | "psnr" | "l1" => key.to_uppercase(),
        "gaussians" => "N".into(),
        "gaussian_bytes" => "size of Gaussians".into(),
        "model_bytes" => "model size".into(),
        "latency_total_ms" => "latency".into(),
        TRAINING => "training".into(),
        "chamfer" => "Chamfer".into(),
        "power_error_db" => "error".into(),
        "snr_db" => "SNR".into(),
        "snr_all_db" => "SNR over all".into(),
        _ if is_custom(key) => key.replace('_', " "),
        _ => match key.strip_prefix("eta_").and_then(|snr| snr.strip_suffix("db")) {
            Some(snr) => format!("η at {snr} dB"),
            None => key.trim_end_matches(&format!("_{}", metric.unit)).trim_start_matches("latency_").replace('_', " "),
        },
    };
    (words, metric.unit.clone())
}

/// Returns the unit in which a column is printed, and the factor to it from `unit`. Times are in minutes if the largest has ten.
fn printed_unit(unit: &str, largest: f64) -> (&str, f64) {
    match unit {
        "B" => ("kB", 1e-3),
        "s" if largest >= 600.0 => ("min", 1.0 / 60.0),
        other => (other, 1.0),
    }
}

/// Returns the number of decimals of a column: three digits of its `median` in the printed unit, at most three decimals; 0 for
/// counts.
fn column_decimals(metric: &MetricRow, median: f64) -> usize {
    if ["gaussians", TRAINED_ON].contains(&metric.key.as_str()) || median >= 100.0 {
        0
    } else if median >= 10.0 {
        1
    } else if median > 1.0 {
        2
    } else {
        3
    }
}

/// Returns head and cells of a column, one cell per row, with the best and second best marked if `ranked`; `None` without
/// numbers.
fn table_column(
    rows: &[ComparisonRow<'_>],
    (metric, statistic): ScoreColumn<'_>,
    ranked: bool,
) -> Option<(TableColumn, Vec<FormattedValue>)> {
    let spreads: Vec<Option<Spread>> = rows.iter().map(|row| row.spread(metric, statistic)).collect();
    let sizes = sorted(spreads.iter().flatten().map(|s| s.mean.abs()).filter(|m| m.is_finite()));
    // Without finite numbers, such as a perfect PSNR, the size of the others does not matter.
    let largest = sizes.last().copied().or_else(|| spreads.iter().flatten().next().map(|_| 0.0))?;
    let median = sizes.get(sizes.len() / 2).copied().unwrap_or(largest);
    let (words, unit) = name_and_unit(metric);
    let (unit, factor) = printed_unit(&unit, largest);
    let decimals = column_decimals(metric, median * factor);
    let shown = |spread: &Option<Spread>| {
        let Some(Spread { mean, deviation, .. }) = *spread else { return FormattedValue::default() };
        let value = fixed(mean * factor, decimals);
        let digits = value.rsplit_once('.').map_or(0, |(_, digits)| digits.len());
        let deviation = deviation.map(|d| d * factor).map_or_else(String::new, |d| match digits {
            0 => grouped(d.round() as i64),
            _ => format!("{d:.digits$}"),
        });
        FormattedValue { value, deviation, ..FormattedValue::default() }
    };
    let mut cells: Vec<FormattedValue> = spreads.iter().map(shown).collect();
    if ranked {
        let competes =
            |row: &ComparisonRow<'_>| ![RowKind::Oracle, RowKind::Ceiling].contains(&row.kind) && row.twin.is_none();
        mark_best(&mut cells, &spreads, &rows.iter().map(competes).collect::<Vec<_>>(), metric.higher_is_better);
    }
    let detail = match (statistic, unit) {
        (SummaryStatistic::Whole, "") => String::new(),
        (SummaryStatistic::Whole, unit) => format!("[{unit}]"),
        (statistic, "") => statistic.heading(metric.higher_is_better).into(),
        (statistic, unit) => format!("{} [{unit}]", statistic.heading(metric.higher_is_better)),
    };
    let arrow = match metric.key.as_str() {
        TRAINED_ON | SHARE => "",
        _ if metric.higher_is_better => "↑",
        _ => "↓",
    };
    Some((TableColumn { title: words, detail, arrow }, cells))
}

/// Marks the best and second best of the rows that are in competition, by their means. Means with the same printed number are
/// ties; after a tie for the best, no second best is marked. Numbers without a competitor, or all equal, have no mark.
fn mark_best(cells: &mut [FormattedValue], spreads: &[Option<Spread>], competes: &[bool], higher_is_better: bool) {
    let means: Vec<(usize, f64)> =
        (0..cells.len()).filter(|i| competes[*i]).filter_map(|i| Some((i, spreads[i]?.mean))).collect();
    if means.len() < 2 {
        return;
    }
    let printed: Vec<String> = cells.iter().map(|c| c.value.clone()).collect();
    for (i, mean) in &means {
        let better = |other: f64| if higher_is_better { other > *mean } else { other < *mean };
        let rank = means.iter().filter(|(j, other)| printed[*j] != printed[*i] && better(*other)).count();
        cells[*i].mark = [RankMark::Best, RankMark::Second].get(rank).copied().unwrap_or_default();
    }
    if means.iter().all(|(i, _)| cells[*i].mark == RankMark::Best) {
        means.iter().for_each(|(i, _)| cells[*i].mark = RankMark::None);
    }
}

/// Returns those of the columns `specs` that have a number, and the rows with a number in any of them.
fn filled_columns(comparison: &Comparison<'_>, specs: &[ScoreColumn<'_>]) -> (Vec<TableColumn>, Vec<TableLine>) {
    let rows = &comparison.rows;
    let columns: Vec<(TableColumn, Vec<FormattedValue>)> =
        specs.iter().filter_map(|spec| table_column(rows, *spec, comparison.is_ranked(spec.0))).collect();
    let line = |(i, row): (usize, &ComparisonRow<'_>)| {
        let cells: Vec<FormattedValue> = columns.iter().map(|(_, cells)| cells[i].clone()).collect();
        cells.iter().any(|c| !c.value.is_empty()).then(|| TableLine::new(row, cells))
    };
    let lines = rows.iter().enumerate().filter_map(line).collect();
    (columns.into_iter().map(|(column, _)| column).collect(), lines)
}

/// Values of the whole model in the main table, before the times.
const WHOLE: [&str; 4] = [SHARE, TRAINED_ON, "gaussians", "model_bytes"];

/// Returns whether a metric is shown beside the first metric of its task: η, SNR over all, and metrics of users.
fn is_secondary_metric(metric: &MetricRow) -> bool {
    is_rate_ratio(&metric.key) || metric.key == "snr_all_db" || is_custom(&metric.key)
}

/// Columns of the table of latency.
const STAGES: [&str; 6] = [
    "latency_prepare_ms",
    "latency_network_ms",
    "latency_projection_ms",
    "latency_sort_ms",
    "latency_blending_ms",
    "latency_total_ms",
];

/// Returns the main table: all statistics of the first metric of the task, such as SSIM; the metrics beside it
/// ([`is_secondary_metric`]); the values [`WHOLE`], latency and training time. `None` without numbers.
pub(in super::super) fn score_table(comparison: &Comparison<'_>) -> Option<Table> {
    let metric = |key: &str| comparison.metric(key).into_iter();
    let first = metric(comparison.setting.headline().key).flat_map(all_statistics);
    let secondary = comparison.metrics.iter().filter(|m| is_secondary_metric(m)).map(first_statistic);
    let whole = WHOLE.iter().chain(&["latency_total_ms", TRAINING]);
    let specs: Vec<ScoreColumn<'_>> =
        first.chain(secondary).chain(whole.flat_map(|key| metric(key)).map(first_statistic)).collect();
    build_table("scores", "Scores", comparison, &specs)
}

/// Returns the main table with these columns, see [`Comparison::column`]; `None` if none is chosen or has a number.
pub(in super::super) fn chosen_table(comparison: &Comparison<'_>, columns: &[String]) -> Option<Table> {
    let specs: Vec<ScoreColumn<'_>> = columns.iter().filter_map(|name| comparison.column(name)).collect();
    build_table("scores", "Scores", comparison, &specs)
}

/// Returns the table of metrics that the main table omits, except times; `None` without them.
pub(in super::super) fn further_table(comparison: &Comparison<'_>) -> Option<Table> {
    let first = comparison.setting.headline().key;
    let shown = |m: &&MetricRow| m.key == first || is_secondary_metric(m) || is_time(m) || WHOLE.contains(&&*m.key);
    let further = comparison.metrics.iter().filter(|m| !shown(m));
    let specs: Vec<ScoreColumn<'_>> = further.map(first_statistic).collect();
    build_table("further", "Further metrics", comparison, &specs)
}

/// Returns the table of latency by stage, milliseconds; `None` without times.
pub(in super::super) fn latency_table(comparison: &Comparison<'_>) -> Option<Table> {
    let specs: Vec<ScoreColumn<'_>> =
        STAGES.iter().filter_map(|key| comparison.metric(key)).map(first_statistic).collect();
    let mut table = build_table("latency", "Latency of one prediction by stage", comparison, &specs)?;
    // Here, the column that other tables call latency is the total of the stages beside it.
    for column in &mut table.columns {
        if column.title == "latency" {
            "total".clone_into(&mut column.title);
        }
    }
    Some(table)
}

/// Returns a column for each statistic of a metric.
fn all_statistics(metric: &MetricRow) -> impl Iterator<Item = ScoreColumn<'_>> {
    statistics(metric).iter().map(move |statistic| (metric, *statistic))
}

/// Returns the column of the mean over test samples, or of the value of the whole model.
fn first_statistic(metric: &MetricRow) -> ScoreColumn<'_> {
    (metric, statistics(metric)[0])
}

/// Creates a table with its legend; `None` without numbers.
fn build_table(
    name: &'static str,
    words: &str,
    comparison: &Comparison<'_>,
    specs: &[ScoreColumn<'_>],
) -> Option<Table> {
    let (columns, lines) = filled_columns(comparison, specs);
    if columns.is_empty() {
        return None;
    }
    let mut table = Table { name, title: table_title(words, comparison.setting), columns, lines, legend: Vec::new() };
    let (least, most) = comparison.setting.seed_counts();
    let has_times = specs.iter().any(|(metric, _)| is_time(metric));
    let words = context! {
        name,
        observations => comparison.setting.task().counted[1],
        sampled => comparison.metrics.iter().any(MetricRow::is_per_sample),
        least,
        most,
        baselines => table.has_row_of(RowKind::Baseline),
        marked => table.is_marked(),
        oracles => table.has_row_of(RowKind::Oracle),
        external => table.has_row_of(RowKind::External),
        twins => !comparison.twin_groups().is_empty(),
        ceiling => table.has_row_of(RowKind::Ceiling),
        perfect => comparison.setting.task().ceiling.share < 1.0,
        unsteady => has_unsteady_times(comparison.setting) && has_times,
        machines_differ => !comparison.has_one_machine() && has_times,
    };
    table.legend = render_sentences("legend.txt", words);
    Some(table)
}

/// Returns the metrics of the table of differences: those that [`is_compared`] selects, or all per sample if it selects none.
pub(in super::super) fn compared_metrics<'a>(comparison: &'a Comparison<'_>) -> Vec<&'a MetricRow> {
    let per_sample = || comparison.metrics.iter().filter(|m| m.is_per_sample());
    let selected: Vec<_> = per_sample().filter(|m| is_compared(&m.key, comparison.setting.task())).collect();
    if selected.is_empty() { per_sample().collect() } else { selected }
}

/// Returns the name of a metric on an axis, with its unit.
pub(in super::super) fn axis_name(metric: &MetricRow) -> String {
    match name_and_unit(metric) {
        (name, unit) if unit.is_empty() => name,
        (name, unit) => format!("{name} [{unit}]"),
    }
}

/// Returns the table of `differences` by these `metrics` from the reference; `None` without any.
pub(in super::super) fn difference_table(
    comparison: &Comparison<'_>,
    reference: &Reference<'_>,
    metrics: &[&MetricRow],
    differences: &[RowDifferences<'_>],
) -> Option<Table> {
    let by_metric =
        |d: &RowDifferences<'_>| metrics.iter().map(|m| d.by_key.get(m.key.as_str()).copied()).collect::<Vec<_>>();
    let rows: Vec<(&ComparisonRow<'_>, Vec<Option<Difference>>)> =
        differences.iter().map(|d| (d.row, by_metric(d))).collect();
    let seeds = || rows.iter().filter_map(|(_, row)| row.iter().flatten().map(|d| d.seeds).max());
    let (least, most) = (seeds().min()?, seeds().max()?);
    let line = |(row, differences): &(&ComparisonRow<'_>, Vec<Option<Difference>>)| {
        let cell = |d: &Option<Difference>| d.as_ref().map_or_else(FormattedValue::default, difference_cell);
        let has_any = differences.iter().any(Option::is_some);
        has_any.then(|| TableLine::new(row, differences.iter().map(cell).collect()))
    };
    let equal = if reference.is_by_axis { ", at equal other settings" } else { "" };
    let column = |m: &&MetricRow| {
        let (title, unit) = name_and_unit(m);
        let detail = if unit.is_empty() { String::new() } else { format!("[{unit}]") };
        TableColumn { title: format!("Δ {title}"), detail, arrow: if m.higher_is_better { "↑" } else { "↓" } }
    };
    let mut table = Table {
        name: "differences",
        title: table_title(&format!("Paired differences from {}{equal}", reference.label), comparison.setting),
        columns: metrics.iter().map(column).collect(),
        lines: rows.iter().filter_map(line).collect(),
        legend: Vec::new(),
    };
    let words = context! {
        name => table.name,
        reference => reference.label,
        is_by_axis => reference.is_by_axis,
        observations => comparison.setting.task().counted[1],
        least,
        most,
        percent => (CONFIDENCE * 100.0).round() as u32,
        replicates => REPLICATES,
        edge => comparison.blocks.edge_m.map(|edge| format!("{edge:.2}")),
        cubes => comparison.blocks.count,
        oracles => table.has_row_of(RowKind::Oracle),
        twins => !comparison.twin_groups().is_empty(),
    };
    table.legend = render_sentences("legend.txt", words);
    Some(table)
}

/// Formats a paired difference with its interval, marked if that excludes 0.
fn difference_cell(difference: &Difference) -> FormattedValue {
    FormattedValue {
        value: signed(difference.mean),
        interval: difference.interval.map(|(low, high)| (signed(low), signed(high))),
        mark: if difference.is_clear() { RankMark::Clear } else { RankMark::None },
        ..FormattedValue::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the marks of a column of printed numbers and means.
    fn marks(column: &[(&str, f64)], competes: &[bool], higher_is_better: bool) -> Vec<RankMark> {
        let mut cells: Vec<FormattedValue> = column
            .iter()
            .map(|(value, _)| FormattedValue { value: (*value).into(), ..FormattedValue::default() })
            .collect();
        let spreads: Vec<Option<Spread>> =
            column.iter().map(|(value, mean)| Spread::of(&[*mean]).filter(|_| !value.is_empty())).collect();
        mark_best(&mut cells, &spreads, competes, higher_is_better);
        cells.iter().map(|c| c.mark).collect()
    }

    #[test]
    fn marks_best_and_second_of_ranked_rows() {
        use RankMark::{Best, None, Second};
        let column = [("0.80", 0.8), ("0.70", 0.7), ("0.99", 0.99), ("0.75", 0.75), ("", 0.0)];
        let all_but_third = [true, true, false, true, true];
        assert_eq!(marks(&column, &all_but_third, true), [Best, None, None, Second, None]);
        assert_eq!(marks(&column, &all_but_third, false), [None, Best, None, Second, None]);
    }

    #[test]
    fn equally_printed_scores_share_rank() {
        use RankMark::{Best, None, Second};
        let all = [true; 3];
        assert_eq!(marks(&[("0.80", 0.801), ("0.80", 0.799), ("0.70", 0.7)], &all, true), [Best, Best, None]);
        assert_eq!(marks(&[("0.90", 0.9), ("0.80", 0.801), ("0.80", 0.799)], &all, true), [Best, Second, Second]);
        assert_eq!(marks(&[("8", 8.0), ("8", 8.0), ("8", 8.0)], &all, false), [None; 3], "no best among equals");
        assert_eq!(marks(&[("8", 8.0), ("", 0.0), ("", 0.0)], &all, false), [None; 3], "nor of one alone");
    }
}
