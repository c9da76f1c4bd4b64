//! `report.csv`: all numbers of a report.

use super::comparison::{Comparison, ComparisonRow, statistics};
use super::reference::RowDifferences;
use pwrfgs_experiment::scores::MetricRow;
use pwrfgs_experiment::text::Lines;

/// Columns of `report.csv`.
const HEADER: &str = "setting simulated variant kind metric unit statistic value std n reference low high";

/// Formats `report.csv`, one line per number, from comparisons with the differences of their rows.
///
/// Columns: setting, simulated, variant, kind (`variant`, `external`, `baseline`, `oracle` for an oracle baseline,
/// `ceiling`), metric, unit, statistic (`mean`, `median`, `tail10` over test samples, the last at the worse end; `value`
/// of a whole model; `difference` for the paired mean difference from `reference`), value (mean over seeds), std (over
/// seeds; empty for one seed, and for baselines that are equal for all), n (seeds), reference, low and high (ends of the
/// interval of a difference).
pub(super) fn report_csv<'a>(
    comparisons: impl Iterator<Item = (&'a Comparison<'a>, Vec<RowDifferences<'a>>)>,
) -> String {
    let mut names = HEADER.split(' ');
    // One name per word of the header.
    let mut lines = Lines::<13>::new(std::array::from_fn(|_| names.next().unwrap_or_default()));
    for (comparison, differences) in comparisons {
        let setting = comparison.setting;
        let simulated = setting.simulated.to_string();
        let mut put = |row: &ComparisonRow<'_>, metric: &MetricRow, fields: [&str; 7]| {
            let [statistic, value, std, n, reference, low, high] = fields;
            let MetricRow { key, unit, .. } = metric;
            let (title, kind) = (&setting.title, row.kind.name());
            lines.put([title, &simulated, row.label, kind, key, unit, statistic, value, std, n, reference, low, high]);
        };
        for row in &comparison.rows {
            for metric in &comparison.metrics {
                for statistic in statistics(metric) {
                    let Some(spread) = row.spread(metric, *statistic) else { continue };
                    let std = spread.deviation.map_or_else(String::new, |d| d.to_string());
                    let (value, n) = (spread.mean.to_string(), spread.n.to_string());
                    put(row, metric, [statistic.name(), &value, &std, &n, "", "", ""]);
                }
            }
        }
        for RowDifferences { row, reference, by_key } in differences {
            for metric in &comparison.metrics {
                let Some(difference) = by_key.get(metric.key.as_str()) else { continue };
                let ends = difference.interval.map_or_else(Default::default, |(a, b)| [a.to_string(), b.to_string()]);
                let (value, n) = (difference.mean.to_string(), difference.seeds.to_string());
                put(row, metric, ["difference", &value, "", &n, reference.label, &ends[0], &ends[1]]);
            }
        }
    }
    lines.text()
}
