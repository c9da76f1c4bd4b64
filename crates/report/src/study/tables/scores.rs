//! The table of scores, that of all other metrics, and table I: latency by stage.

use super::super::comparison::{Comparison, Metric, Statistic, TRAINING};
use super::columns::{Wanted, filled};
use super::{Column, Section, Table, title};

const STAGES: [&str; 5] =
    ["latency_network_ms", "latency_projection_ms", "latency_sort_ms", "latency_blending_ms", "latency_total_ms"];

/// What a reader looks at first: SSIM, η, N, size, latency and training time.
pub(in super::super) fn scores(comparison: &Comparison<'_>, same_machine: bool) -> Option<Table> {
    let metric = |key: &str| comparison.metric(key).into_iter();
    let ssim = metric("ssim").flat_map(all_statistics);
    let eta = comparison.metrics.iter().filter(|m| m.key.starts_with("eta_")).map(first_statistic);
    let whole = ["gaussians", "model_bytes", "latency_total_ms", TRAINING];
    let wanted: Vec<Wanted<'_>> =
        ssim.chain(eta).chain(whole.iter().flat_map(|key| metric(key)).map(first_statistic)).collect();
    let mut table = table("scores", "Scores", comparison, &wanted, same_machine)?;
    table.legend.splice(0..0, statistics_in_words(comparison));
    Some(table)
}

/// Metrics that the table of scores leaves out.
pub(in super::super) fn further(comparison: &Comparison<'_>, same_machine: bool) -> Option<Table> {
    let shown = |m: &&Metric| m.key == "ssim" || m.key.starts_with("eta_") || m.is_time();
    let left = comparison.metrics.iter().filter(|m| !shown(m) && !["gaussians", "model_bytes"].contains(&&*m.key));
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
    table.legend.push(
        "Each stage is the median over repeated predictions, taken by itself, so the stages need not add up to the \
         total; floors have no stages."
            .into(),
    );
    Some(table)
}

fn all_statistics(metric: &Metric) -> impl Iterator<Item = Wanted<'_>> {
    metric.statistics().iter().map(move |statistic| Wanted { metric, statistic: *statistic })
}

/// The mean over test spectra, or the number of the whole model.
fn first_statistic(metric: &Metric) -> Wanted<'_> {
    Wanted { metric, statistic: metric.statistics()[0] }
}

fn table(
    name: &'static str,
    words: &str,
    comparison: &Comparison<'_>,
    wanted: &[Wanted<'_>],
    same_machine: bool,
) -> Option<Table> {
    let (columns, lines) = filled(comparison, wanted, |metric| same_machine || !metric.is_time());
    if columns.is_empty() {
        return None;
    }
    let mut table = Table { name, title: title(words, comparison.setting), columns, lines, legend: Vec::new() };
    table.legend = legend(comparison, &table);
    if !same_machine && wanted.iter().any(|w| w.metric.is_time()) {
        table.legend.push("Times are from different machines, not comparable, and in no ranking.".into());
    }
    Some(table)
}

/// What statistics there are, in words.
fn statistics_in_words(comparison: &Comparison<'_>) -> Option<String> {
    let per_sample = |m: &Metric| m.statistics()[0] == Statistic::Mean;
    comparison.metrics.iter().any(per_sample).then(|| {
        "Mean, median and p10 (10th percentile) are over the test spectra of a run. N is the number of Gaussians; sizes \
         and times are of the whole run, and times depend on what else the machine did."
            .into()
    })
}

/// How to read numbers and marks.
fn legend(comparison: &Comparison<'_>, table: &Table) -> Vec<String> {
    let mut legend = Vec::new();
    let seeds: Vec<usize> = comparison.setting.variants.iter().map(|v| v.runs.len()).collect();
    legend.push(match (seeds.iter().min(), seeds.iter().max()) {
        (_, Some(1)) => "One run each: there is no deviation over seeds.".into(),
        (Some(least), Some(most)) if least == most => {
            format!("Mean ± sample standard deviation over {most} seeds.")
        }
        (least, most) => format!(
            "Mean ± sample standard deviation over {} to {} seeds; a single run has no deviation.",
            least.unwrap_or(&0),
            most.unwrap_or(&0)
        ),
    });
    if table.has(Section::Floors) {
        legend.push("Floors make no choices and learn from training and validation spectra together.".into());
    }
    let arrows = |column: &Column| !column.arrow.is_empty();
    if table.columns.iter().any(arrows) && table.is_marked() {
        legend.push(
            "↑ larger is better, ↓ smaller is better; best and second best of a column are marked, floors included."
                .into(),
        );
    }
    if table.has(Section::Bounds) {
        legend.push("† knows the scene that made the simulated spectra: in no ranking.".into());
    }
    legend
}
