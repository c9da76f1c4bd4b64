//! `report.csv`: a line each number, every metric of every row, as it was computed.
//!
//! Columns: setting, simulated, variant, kind (`variant`, `floor`, or `bound` for what knows the scene), metric, unit,
//! statistic (`mean`, `median`, `p10` over test spectra; `value` of a whole model; `difference` for the paired mean
//! difference from `reference`), value (mean over seeds), std (over seeds, empty for one), n (seeds), reference, low and
//! high (ends of the interval of a difference).

use super::super::comparison::{Comparison, Metric, Row};

const HEADER: [&str; 13] = [
    "setting",
    "simulated",
    "variant",
    "kind",
    "metric",
    "unit",
    "statistic",
    "value",
    "std",
    "n",
    "reference",
    "low",
    "high",
];

/// All numbers of all settings, with the reference of each.
pub(in super::super) fn csv(comparisons: &[(Comparison<'_>, &str)]) -> String {
    let mut lines = Lines(::csv::Writer::from_writer(Vec::new()));
    lines.put(HEADER.map(str::to_owned));
    for (comparison, reference) in comparisons {
        for row in &comparison.rows {
            for metric in &comparison.metrics {
                lines.scores(comparison, row, metric);
            }
        }
        let Some(reference) = comparison.row(reference) else { continue };
        for row in comparison.rows.iter().filter(|row| row.label != reference.label) {
            for metric in comparison.metrics.iter().filter(|m| m.per_sample) {
                lines.difference(comparison, row, reference, metric);
            }
        }
    }
    String::from_utf8(lines.0.into_inner().unwrap_or_default()).unwrap_or_default()
}

struct Lines(::csv::Writer<Vec<u8>>);

impl Lines {
    fn put(&mut self, fields: [String; 13]) {
        self.0.write_record(fields).expect("memory takes every line, and all have 13 fields");
    }

    fn scores(&mut self, comparison: &Comparison<'_>, row: &Row<'_>, metric: &Metric) {
        for statistic in metric.statistics() {
            if let Some(spread) = row.spread(metric, *statistic) {
                let std = spread.deviation.map_or_else(String::new, |d| d.to_string());
                let [setting, simulated, variant, kind, key, unit] = head(comparison, row, metric);
                let (value, n) = (spread.mean.to_string(), spread.n.to_string());
                let none = String::new;
                let name = statistic.name().into();
                self.put([setting, simulated, variant, kind, key, unit, name, value, std, n, none(), none(), none()]);
            }
        }
    }

    fn difference(&mut self, comparison: &Comparison<'_>, row: &Row<'_>, reference: &Row<'_>, metric: &Metric) {
        if let Some(found) = row.less(reference, metric, &comparison.blocks) {
            let [setting, simulated, variant, kind, key, unit] = head(comparison, row, metric);
            let end = |pick: fn((f64, f64)) -> f64| found.interval.map_or_else(String::new, |i| pick(i).to_string());
            let (value, n) = (found.mean.to_string(), found.seeds.to_string());
            let (name, other) = ("difference".to_owned(), reference.label.to_owned());
            let (low, high) = (end(|i| i.0), end(|i| i.1));
            let std = String::new();
            self.put([setting, simulated, variant, kind, key, unit, name, value, std, n, other, low, high]);
        }
    }
}

fn head(comparison: &Comparison<'_>, row: &Row<'_>, metric: &Metric) -> [String; 6] {
    let setting = comparison.setting;
    let simulated = setting.simulated.to_string();
    [
        setting.title.clone(),
        simulated,
        row.label.into(),
        row.kind.name().into(),
        metric.key.clone(),
        metric.unit.clone(),
    ]
}
