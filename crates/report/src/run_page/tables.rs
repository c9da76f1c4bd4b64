//! The score table: three columns each metric of samples, one each metric that baselines share.

use minijinja::{Value, context};
use pwrfgs_experiment::scores::{Cell, MetricRow, ScoreTable};
use pwrfgs_experiment::text::number;

/// A group of columns each metric: those of samples first, then those with one number, such as the prediction's time.
pub(super) fn groups(scores: &ScoreTable) -> Vec<Value> {
    let mut metrics: Vec<&MetricRow> = scores.metrics.iter().collect();
    metrics.sort_by_key(|m| !m.is_per_sample());
    metrics.into_iter().map(|metric| group(scores, metric)).collect()
}

fn group(scores: &ScoreTable, metric: &MetricRow) -> Value {
    let (key, unit, samples) = (metric.key.clone(), metric.unit.clone(), metric.is_per_sample());
    let columns: &'static [&'static str] = if samples { &["mean", "median", "bad tail"] } else { &[""] };
    let ranks: Vec<Vec<Option<usize>>> = (0..columns.len()).map(|k| scores.ranks(metric, k)).collect();
    // A single number is no best.
    let rivals = |k: usize| ranks[k].iter().flatten().count() > 1;
    // Number, and `best` or `second`, of a predictor in a column.
    let shown = |p: usize, k: usize| match (metric.cells[p].numbers().get(k), ranks[k][p]) {
        (None, _) => ("n/a".into(), "none"),
        (Some(value), Some(0)) if rivals(k) => (number(*value), "best"),
        (Some(value), Some(1)) => (number(*value), "second"),
        (Some(value), _) => (number(*value), ""),
    };
    // The number about the whole model, or why there is none.
    let whole = metric.cells.first().filter(|_| !samples).map(|cell| match cell {
        Cell::NotApplicable(why) => format!("n/a: {why}"),
        cell => format!("{} {unit}", cell.numbers().first().map_or_else(String::new, |v| number(*v))),
    });
    let rows: Vec<Vec<(String, &str)>> =
        (0..metric.cells.len()).map(|p| (0..columns.len()).map(|k| shown(p, k)).collect()).collect();
    context! {
        // The key, or words where it stands above one narrow column.
        title => if samples { key.clone() } else { key.trim_end_matches(&format!("_{unit}")).replace('_', " ") },
        arrow => if metric.higher_is_better { "↑" } else { "↓" },
        // Whether it is a number of more predictors than one.
        shared => samples || metric.cells.iter().filter(|cell| !cell.numbers().is_empty()).count() > 1,
        columns => columns.to_vec(),
        key,
        unit,
        rows,
        whole,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_experiment::statistics::Summary;

    #[test]
    fn a_bound_is_neither_best_nor_second_and_a_single_rival_no_best() {
        let cell = |v: f64| Cell::Samples(Summary { mean: v, median: v, p10: v });
        let cells = vec![cell(0.7), cell(0.99), cell(0.8)];
        let row = MetricRow { key: "ssim".into(), unit: String::new(), higher_is_better: true, cells };
        let marks = |bounds: &[&str]| -> Vec<String> {
            let predictors = ["model", "RT exact", "1-NN"].map(str::to_owned).into();
            let bounds = bounds.iter().map(|name| (*name).to_owned()).collect();
            let table = ScoreTable { predictors, metrics: vec![row.clone()], bounds, ..ScoreTable::default() };
            let rows = groups(&table)[0].get_attr("rows").unwrap();
            let mark = |p: usize| {
                rows.get_item_by_index(p).and_then(|r| r.get_item_by_index(2)).and_then(|c| c.get_item_by_index(1))
            };
            (0..3).map(|p| mark(p).unwrap().to_string()).collect()
        };
        assert_eq!(marks(&["RT exact"]), ["second", "", "best"]);
        assert_eq!(marks(&["RT exact", "1-NN"]), ["", "", ""]);
        assert_eq!(marks(&[]), ["", "best", "second"]);
    }
}
