//! The table of scores, that of all other metrics, and table I: latency by stage.

use super::super::comparison::{Comparison, Kind, TRAINED_ON, TRAINING, is_ranked, is_time, statistics};
use super::columns::{Wanted, filled};
use super::{Table, title};
use crate::templates::sentences;
use minijinja::context;
use pwrfgs_experiment::scores::MetricRow;

/// Numbers of a whole model that are shown first.
const WHOLE: [&str; 3] = [TRAINED_ON, "gaussians", "model_bytes"];

/// Whether a metric stands beside the first of its kind.
fn is_beside(metric: &MetricRow) -> bool {
    metric.key.starts_with("eta_") || metric.key == "snr_all_db"
}

const STAGES: [&str; 6] = [
    "latency_prepare_ms",
    "latency_network_ms",
    "latency_projection_ms",
    "latency_sort_ms",
    "latency_blending_ms",
    "latency_total_ms",
];

/// What a reader looks at first: the first metric of the kind, such as SSIM and η, N, size, latency and training time.
pub(in super::super) fn scores(comparison: &Comparison<'_>, same_machine: bool) -> Option<Table> {
    let metric = |key: &str| comparison.metric(key).into_iter();
    let first = metric(comparison.setting.headline().key).flat_map(all_statistics);
    let beside = comparison.metrics.iter().filter(|m| is_beside(m)).map(first_statistic);
    let whole = WHOLE.iter().chain(&["latency_total_ms", TRAINING]);
    let wanted: Vec<Wanted<'_>> =
        first.chain(beside).chain(whole.flat_map(|key| metric(key)).map(first_statistic)).collect();
    table("scores", "Scores", comparison, &wanted, same_machine)
}

/// Metrics that the table of scores leaves out.
pub(in super::super) fn further(comparison: &Comparison<'_>, same_machine: bool) -> Option<Table> {
    let first = comparison.setting.headline().key;
    let shown = |m: &&MetricRow| m.key == first || is_beside(m) || is_time(m) || WHOLE.contains(&&*m.key);
    let left = comparison.metrics.iter().filter(|m| !shown(m));
    let wanted: Vec<Wanted<'_>> = left.map(first_statistic).collect();
    table("further", "Further metrics", comparison, &wanted, same_machine)
}

/// Milliseconds of one prediction, stage by stage.
pub(in super::super) fn latency(comparison: &Comparison<'_>, same_machine: bool) -> Option<Table> {
    let wanted: Vec<Wanted<'_>> = STAGES.iter().filter_map(|key| comparison.metric(key)).map(first_statistic).collect();
    let mut table = table("latency", "Latency of one prediction by stage", comparison, &wanted, same_machine)?;
    for column in &mut table.columns {
        if column.title == "latency" {
            "total".clone_into(&mut column.title);
        }
    }
    Some(table)
}

fn all_statistics(metric: &MetricRow) -> impl Iterator<Item = Wanted<'_>> {
    statistics(metric).iter().map(move |statistic| (metric, *statistic))
}

/// The mean over test samples, or the number of the whole model.
fn first_statistic(metric: &MetricRow) -> Wanted<'_> {
    (metric, statistics(metric)[0])
}

fn table(
    name: &'static str,
    words: &str,
    comparison: &Comparison<'_>,
    wanted: &[Wanted<'_>],
    same_machine: bool,
) -> Option<Table> {
    let (columns, lines) = filled(comparison, wanted, |metric| is_ranked(metric, same_machine));
    if columns.is_empty() {
        return None;
    }
    let mut table = Table { name, title: title(words, comparison.setting), columns, lines, legend: Vec::new() };
    let (least, most) = comparison.setting.seeds();
    let words = context! {
        name,
        observations => comparison.setting.task().counted[1],
        sampled => comparison.metrics.iter().any(MetricRow::is_per_sample),
        least,
        most,
        floors => table.has(Kind::Floor),
        marked => table.is_marked(),
        bounds => table.has(Kind::Bound),
        twins => !comparison.twins().is_empty(),
        ceiling => table.has(Kind::Ceiling),
        perfect => comparison.setting.task().ceiling.share < 1.0,
        machines_differ => !same_machine && wanted.iter().any(|w| is_time(w.0)),
    };
    table.legend = sentences("legend.txt", words);
    Some(table)
}
