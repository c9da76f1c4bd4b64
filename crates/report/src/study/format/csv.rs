//! `report.csv`: a line each number, every metric of every row, as it was computed.
//!
//! Columns: setting, simulated, variant, kind (`variant`, `floor`, or `bound` for what knows the scene), metric, unit,
//! statistic (`mean`, `median`, `p10` over test spectra, the last counted from the bad end; `value` of a whole model; `difference` for the paired mean
//! difference from `reference`), value (mean over seeds), std (over seeds, empty for one), n (seeds), reference, low and
//! high (ends of the interval of a difference).

use super::super::comparison::{Comparison, Row, statistics};
use pwrfgs_experiment::scores::MetricRow;
use pwrfgs_experiment::text::Lines;

const HEADER: &str = "setting simulated variant kind metric unit statistic value std n reference low high";

/// All numbers of all settings, with the reference of each.
pub(in super::super) fn csv<'a>(comparisons: impl Iterator<Item = (&'a Comparison<'a>, &'a str)>) -> String {
    let mut names = HEADER.split(' ');
    let mut lines = Lines::<13>::new(std::array::from_fn(|_| names.next().unwrap_or_default()));
    for (comparison, reference) in comparisons {
        let setting = comparison.setting;
        let simulated = setting.simulated.to_string();
        let mut put = |row: &Row<'_>, metric: &MetricRow, rest: [&str; 7]| {
            let [statistic, value, std, n, reference, low, high] = rest;
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
        let Some(reference) = comparison.row(reference) else { continue };
        for row in comparison.rows.iter().filter(|row| row.label != reference.label) {
            for metric in comparison.metrics.iter().filter(|m| m.is_per_sample()) {
                let Some(found) = row.less(reference, metric, &comparison.blocks) else { continue };
                let ends = found.interval.map_or_else(Default::default, |(a, b)| [a.to_string(), b.to_string()]);
                let (value, n) = (found.mean.to_string(), found.seeds.to_string());
                put(row, metric, ["difference", &value, "", &n, reference.label, &ends[0], &ends[1]]);
            }
        }
    }
    lines.text()
}
