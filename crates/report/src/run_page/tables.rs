//! Score tables of the page, of all predictors and per receiver.

use minijinja::{Value, context};
use pwrfgs_experiment::scores::{MetricRow, ScoreCell, ScoreTable};
use pwrfgs_experiment::{LoadedRun, statistics::Summary, text::number};

/// Maximum number of columns of numbers in a further table: more leave the page at 1,200 pixels.
const COLUMNS: usize = 9;

/// Returns the score tables, each as groups of columns, one group per metric of test samples or of several predictors. The first
/// table has the main metrics of the task: of the first metric mean, median and percentile, of others the mean. Further tables
/// have all columns of the metrics of which the first leaves out a column.
pub(super) fn score_tables(scores: &ScoreTable) -> Vec<Vec<Value>> {
    let is_shared =
        |row: &&MetricRow| row.is_per_sample() || row.cells.iter().filter(|c| !c.numbers().is_empty()).count() > 1;
    let shared: Vec<&MetricRow> = scores.metrics.iter().filter(is_shared).collect();
    let main = scores.main_metrics();
    let is_main = |row: &MetricRow| main.iter().any(|other| other.key == row.key);
    let columns = |row: &MetricRow| if row.is_per_sample() { 3 } else { 1 };
    let is_first = |row: &MetricRow| row.key == scores.task.headline.key;
    let shown = |row: &MetricRow| if is_first(row) { columns(row) } else { usize::from(is_main(row)) };
    let group = |row: &&MetricRow| column_group(scores, row, shown(row));
    let first: Vec<Value> = shared.iter().filter(|row| is_main(row)).map(group).collect();
    let (mut tables, mut room) = (vec![first], 0);
    for row in shared.into_iter().filter(|row| shown(row) < columns(row)) {
        if columns(row) > room {
            tables.push(Vec::new());
            room = COLUMNS;
        }
        room -= columns(row);
        tables.last_mut().expect("not empty").push(column_group(scores, row, columns(row)));
    }
    tables.retain(|groups| !groups.is_empty());
    tables
}

/// Returns the key of each metric of whole models, and the value of the model with its unit, or why it has none.
pub(super) fn whole_values(scores: &ScoreTable) -> Vec<(String, String)> {
    let value = |row: &MetricRow| {
        let text = match row.cells.first()? {
            ScoreCell::NotApplicable(why) => format!("n/a: {why}"),
            cell => format!("{} {}", cell.numbers().first().map_or_else(String::new, |v| number(*v)), row.unit),
        };
        Some((row.key.clone(), text))
    };
    scores.metrics.iter().filter(|row| !row.is_per_sample()).filter_map(value).collect()
}

/// Returns the first `count` columns of one metric for the template, in the order of [`ScoreCell::numbers`]: titles, numbers
/// and marks.
fn column_group(scores: &ScoreTable, metric: &MetricRow, count: usize) -> Value {
    let (key, unit, samples) = (metric.key.clone(), metric.unit.clone(), metric.is_per_sample());
    let columns: &'static [&'static str] = match (samples, metric.higher_is_better) {
        (false, _) => &[""],
        (true, true) => &["mean", "median", "10th percentile"],
        (true, false) => &["mean", "median", "90th percentile"],
    };
    context! {
        // Key, or words above a single narrow column.
        title => if samples { key.clone() } else { key.trim_end_matches(&format!("_{unit}")).replace('_', " ") },
        arrow => if metric.higher_is_better { "↑" } else { "↓" },
        columns => columns[..count].to_vec(),
        unit,
        rows => marked_rows(scores, metric, count),
    }
}

/// Formats the first `columns` statistics of each predictor by one metric, each with a class of `style.css`: `best`, `second`,
/// `none` without a number, or empty. Means of the model and a baseline of which one is best are both `best` if they are
/// level.
fn marked_rows(scores: &ScoreTable, metric: &MetricRow, columns: usize) -> Vec<Vec<(String, &'static str)>> {
    let ranks: Vec<Vec<Option<usize>>> = (0..columns).map(|k| scores.ranks(metric, k)).collect();
    // A single number is not marked.
    let rivals = |k: usize| ranks[k].iter().flatten().count() > 1;
    // The pair of the model and a baseline is level if its paired interval contains 0.
    let is_level = |baseline: usize| {
        let row = scores.paired.as_ref().and_then(|pairs| pairs.row(&scores.predictors[baseline], &metric.key));
        ranks[0][baseline].is_some() && row.is_some_and(|row| row.verdict() == "level")
    };
    let is_best = |p: usize| ranks[0].get(p) == Some(&Some(0));
    let shares_best = |p: usize| match p {
        0 => (1..metric.cells.len()).any(|baseline| is_best(baseline) && is_level(baseline)),
        _ => is_best(0) && is_level(p),
    };
    let shown = |p: usize, k: usize| match (metric.cells[p].numbers().get(k), ranks[k][p]) {
        (None, _) => ("n/a".into(), "none"),
        (Some(value), _) if k == 0 && shares_best(p) => (number(*value), "best"),
        (Some(value), Some(0)) if rivals(k) => (number(*value), "best"),
        (Some(value), Some(1)) => (number(*value), "second"),
        (Some(value), _) => (number(*value), ""),
    };
    (0..metric.cells.len()).map(|p| (0..columns).map(|k| shown(p, k)).collect()).collect()
}

/// Maximum number of rows; others are counted.
const ROWS: usize = 60;

/// Returns the mean and median of the first metric over the test links of each receiver; `None` for a single receiver,
/// without test links, or if no predictor has per-sample values.
pub(super) fn receiver_table(run: &LoadedRun<'_>) -> Option<Value> {
    let (data, scores) = (run.data, &run.record.scores);
    let headline = data.task().headline;
    let receivers = &data.scene.receivers;
    if receivers.len() < 2 {
        return None;
    }
    let mut per_receiver: Vec<Vec<usize>> = vec![Vec::new(); receivers.len()];
    for (k, &i) in run.partition.test.iter().enumerate() {
        per_receiver[data.links[i].receiver].push(k);
    }
    let predictors: Vec<(&String, &[f64])> = scores
        .predictors
        .iter()
        .filter_map(|(name, _)| Some((name, scores.sample_values(name, headline.key)?)))
        .collect();
    let receiving: Vec<usize> = (0..receivers.len()).filter(|&r| !per_receiver[r].is_empty()).collect();
    let row = |&r: &usize| {
        let cells = receiver_cells(&predictors, &per_receiver[r], headline.higher);
        context! { name => receivers[r].name.clone(), links => per_receiver[r].len(), cells }
    };
    (!predictors.is_empty() && !receiving.is_empty()).then(|| {
        context! {
            metric => headline.name,
            predictors => predictors.iter().map(|(name, _)| (*name).clone()).collect::<Vec<_>>(),
            rows => receiving.iter().take(ROWS).map(row).collect::<Vec<_>>(),
            unshown => receiving.len().saturating_sub(ROWS),
            silent => receivers.len() - receiving.len(),
        }
    })
}

/// Formats mean and median of each of `predictors` (name and values per test sample) over `samples`, indices of these values,
/// each with the mark of the best. `higher`: larger is better.
fn receiver_cells(predictors: &[(&String, &[f64])], samples: &[usize], higher: bool) -> Vec<(String, &'static str)> {
    let summary = |(_, values): &(&String, &[f64])| {
        let scores: Vec<f64> = samples.iter().filter_map(|&k| values.get(k).copied()).collect();
        Summary::of(&scores, higher)
    };
    let summaries: Vec<Summary> = predictors.iter().map(summary).collect();
    let cells = |summary: &Summary| {
        [
            marked_number(summary.mean, summaries.iter().map(|other| other.mean), higher),
            marked_number(summary.median, summaries.iter().map(|other| other.median), higher),
        ]
    };
    summaries.iter().flat_map(cells).collect()
}

/// Formats `value` with the mark `best` if it is finite and none of `values` is better, otherwise no mark.
fn marked_number(value: f64, mut values: impl Iterator<Item = f64>, higher: bool) -> (String, &'static str) {
    let is_best = value.is_finite() && values.all(|other| !(if higher { other > value } else { other < value }));
    (number(value), if is_best { "best" } else { "" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_experiment::paired::{Paired, PairedRow};

    #[test]
    fn oracle_is_unranked_and_single_predictor_is_not_best() {
        let cell = |v: f64| ScoreCell::Samples(Summary { mean: v, median: v, tail10: v });
        let cells = vec![cell(0.7), cell(0.99), cell(0.8)];
        let row = MetricRow { key: "ssim".into(), unit: String::new(), higher_is_better: true, cells };
        let marks_of = |oracles: &[&str], rows: &[PairedRow]| -> Vec<String> {
            let predictors = ["model", "RT exact", "1-NN"].map(str::to_owned).into();
            let paired = Some(Paired { rows: rows.to_vec(), ..Paired::default() });
            let oracles = oracles.iter().map(|name| (*name).to_owned()).collect();
            let table = ScoreTable { predictors, metrics: vec![row.clone()], oracles, paired, ..ScoreTable::default() };
            let rows = score_tables(&table)[0][0].get_attr("rows").unwrap();
            let mark = |p: usize| {
                rows.get_item_by_index(p).and_then(|r| r.get_item_by_index(0)).and_then(|c| c.get_item_by_index(1))
            };
            (0..3).map(|p| mark(p).unwrap().to_string()).collect()
        };
        let marks = |oracles: &[&str]| marks_of(oracles, &[]);
        assert_eq!(marks(&["RT exact"]), ["second", "", "best"]);
        assert_eq!(marks(&["RT exact", "1-NN"]), ["", "", ""]);
        let row = |baseline: &str, interval| PairedRow {
            baseline: baseline.into(),
            metric: "ssim".into(),
            higher_is_better: true,
            mean: -0.1,
            interval: Some(interval),
        };
        let mut pairs = vec![row("RT exact", [-0.3, 0.1]), row("1-NN", [-0.2, 0.1])];
        assert_eq!(marks_of(&["RT exact"], &pairs), ["best", "", "best"], "level means share the mark");
        pairs[1].interval = Some([-0.2, -0.1]);
        assert_eq!(marks_of(&["RT exact"], &pairs), ["second", "", "best"]);
        assert_eq!(marks(&[]), ["", "best", "second"]);
    }

    #[test]
    fn marks_best_score_of_row() {
        assert_eq!(marked_number(2.0, [2.0, 3.0].into_iter(), false).1, "best");
        assert_eq!(marked_number(2.0, [2.0, 3.0].into_iter(), true).1, "");
        assert_eq!(marked_number(f64::NAN, [f64::NAN].into_iter(), true).1, "");
    }
}
