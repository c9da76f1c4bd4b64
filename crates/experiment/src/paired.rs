//! `Paired`: paired differences between the model and each baseline on the same test samples, with bootstrap intervals.
//!
//! Means show which score is higher; paired differences show whether the difference is significant. Easy and hard
//! positions cancel, so smaller differences become detectable.

use crate::statistics::CONFIDENCE;
use crate::text::fixed;
use pwrfgs_core::Task;
use serde::{Deserialize, Serialize};

/// Decimals of a difference: one more than scores have.
const DECIMALS: usize = 4;
/// Number of cubes below which intervals are rough; [`Paired::note`] prints it as a word.
const ENOUGH: usize = 10;

/// Paired differences between a model and its baselines.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Edge of the cubes that the bootstrap resamples, metres; `None` if positions are unknown and single samples are
    /// resampled.
    pub edge_m: Option<f64>,
    /// Number of cubes with test transmitters, or of single samples.
    pub cubes: usize,
    /// One row per baseline and metric, baselines in the order of the scores.
    pub rows: Vec<PairedRow>,
}

/// Difference between the model and one baseline by one metric.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairedRow {
    /// Baseline name as in `scores.csv`.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// Whether higher is better.
    pub higher_is_better: bool,
    /// Mean over test samples.
    pub mean: f64,
    /// Ends of the 95 % interval; `None` if all test transmitters lie within one cube.
    pub interval: Option<[f64; 2]>,
}

impl Paired {
    /// Returns the difference from one baseline by one metric; `None` if they were not compared.
    pub fn row(&self, baseline: &str, key: &str) -> Option<&PairedRow> {
        self.rows.iter().find(|row| row.baseline == baseline && row.metric == key)
    }

    /// Formats table rows: a header, then one row per baseline with difference and verdict of each metric. The names in
    /// `oracles` are marked `†`.
    pub fn lines(&self, oracles: &[String]) -> Vec<Vec<String>> {
        let mut metrics: Vec<(&str, bool)> = Vec::new();
        let mut baselines: Vec<&str> = Vec::new();
        for row in &self.rows {
            if !metrics.iter().any(|(key, _)| *key == row.metric) {
                metrics.push((&row.metric, row.higher_is_better));
            }
            if !baselines.contains(&row.baseline.as_str()) {
                baselines.push(&row.baseline);
            }
        }
        let arrow = |higher: bool| if higher { "↑" } else { "↓" };
        let heads = metrics.iter().flat_map(|(key, higher)| [format!("{key} {}", arrow(*higher)), String::new()]);
        let head = ["model minus".to_owned()].into_iter().chain(heads).collect();
        let line = |baseline: &&str| {
            let cells = metrics.iter().flat_map(|(key, _)| match self.row(baseline, key) {
                Some(row) => [row.difference_text(), row.verdict().to_owned()],
                None => ["n/a".to_owned(), String::new()],
            });
            let dagger = if oracles.iter().any(|oracle| oracle == baseline) { " †" } else { "" };
            [format!("{baseline}{dagger}")].into_iter().chain(cells).collect()
        };
        [head].into_iter().chain(baselines.iter().map(line)).collect()
    }

    /// Explains the table in one sentence.
    pub fn note(&self, task: Task) -> String {
        let (count, things) = (self.cubes, task.counted[1]);
        let (drawn, blocks) = match self.edge_m {
            Some(edge) => (format!("{count} cubes of {edge:.2} m"), "cubes"),
            None => (format!("{count} single {things}, whose positions are unknown"), things),
        };
        let rough =
            if count < ENOUGH { format!("; with fewer than ten {blocks} it is a rough guide") } else { String::new() };
        format!(
            "differences are means over the same test {things}, with the {:.0} % bootstrap interval of this run over \
             {drawn}{rough}; level: the interval covers 0",
            100.0 * CONFIDENCE
        )
    }
}

impl PairedRow {
    /// Formats mean and interval: `+0.0030 [−0.0030, +0.0080]`; the mean alone without an interval.
    pub fn difference_text(&self) -> String {
        let interval =
            self.interval.map_or_else(String::new, |[low, high]| format!(" [{}, {}]", signed(low), signed(high)));
        signed(self.mean) + &interval
    }

    /// Describes the comparison in words: `level with Kriging: +0.0030 [−0.0030, +0.0080]`.
    pub fn sentence(&self) -> String {
        let relation = match self.verdict() {
            "better" => "ahead of",
            "worse" => "behind",
            "level" => "level with",
            _ => "not compared by an interval with",
        };
        format!("{relation} {}: {}", self.baseline, self.difference_text())
    }

    /// Returns `better`, `worse`, or `level` if the interval contains 0; empty without an interval.
    pub fn verdict(&self) -> &'static str {
        match self.interval {
            None => "",
            Some([low, high]) if low <= 0.0 && 0.0 <= high => "level",
            Some(_) if (self.mean > 0.0) == self.higher_is_better => "better",
            Some(_) => "worse",
        }
    }
}

/// Returns whether tables of differences include a metric: the first one of the task, every rate ratio, and those of users.
pub fn is_compared(key: &str, task: Task) -> bool {
    key == task.headline.key || is_rate_ratio(key) || is_custom(key)
}

/// Keys of the metrics of this toolkit except rate ratios, and of the columns that a comparison of runs adds.
const BUILT_IN: [&str; 20] = [
    "ssim",
    "l1",
    "psnr",
    "direction_error",
    "power_error_db",
    "snr_db",
    "snr_all_db",
    "chamfer",
    "gaussians",
    "gaussian_bytes",
    "model_bytes",
    "latency_prepare_ms",
    "latency_network_ms",
    "latency_projection_ms",
    "latency_sort_ms",
    "latency_blending_ms",
    "latency_total_ms",
    "share",
    "trained_on",
    "training_s",
];

/// Returns whether a metric is written by a user, as a plugin or in Python: tables show it beside the first one of the task.
pub fn is_custom(key: &str) -> bool {
    !BUILT_IN.contains(&key) && !is_rate_ratio(key)
}

/// Returns whether a metric is a rate ratio η.
pub fn is_rate_ratio(key: &str) -> bool {
    key.starts_with("eta_")
}

/// Formats a difference, not NaN, with its sign and four decimals, or more for a small one. Values rounded to 0 have no sign.
pub fn signed(value: f64) -> String {
    let text = fixed(value, DECIMALS);
    let is_zero = text.bytes().all(|b| matches!(b, b'0' | b'.'));
    if value > 0.0 && !is_zero { format!("+{text}") } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scores::{MODEL, Scores};
    use pwrfgs_core::{Goal, Measurement, Values};

    /// 64 test samples on a grid of 1 m; the model is `ahead` of the baseline, with noise of `noise`.
    fn paired(ahead: f64, noise: f64, goal: Goal) -> PairedRow {
        let values = |value: &dyn Fn(u32) -> f64| {
            let (key, values) = ("ssim".to_owned(), Values::PerSample((0..64).map(value).collect()));
            vec![Measurement { key, unit: String::new(), goal, values, note: None }]
        };
        let base = |id: u32| f64::from(id * 37 % 64) / 64.0;
        let predictors = vec![
            (MODEL.into(), values(&|id| base(id) + ahead + noise * (f64::from(id % 3) - 1.0))),
            ("1-NN".into(), values(&base)),
        ];
        let scores = Scores::new((0..64).collect(), predictors, crate::scores::ScoreTable::default());
        let positions = (0..64).map(|id| (id, Some([f64::from(id % 8), f64::from(id / 8), 0.0]))).collect();
        let mut paired = scores.paired_differences(&positions).unwrap();
        assert!(paired.cubes >= 30 && paired.note(Task::Spectrum).contains("95 %"), "{paired:?}");
        assert_eq!(paired.lines(&["1-NN".into()])[1][0], "1-NN †");
        paired.rows.remove(0)
    }

    #[test]
    fn verdict_follows_from_interval_and_direction() {
        assert_eq!(paired(0.05, 0.02, Goal::Higher).verdict(), "better");
        assert_eq!(paired(0.05, 0.02, Goal::Lower).verdict(), "worse");
        assert_eq!(paired(-0.05, 0.02, Goal::Lower).verdict(), "better");
        let level = paired(0.001, 0.02, Goal::Higher);
        assert_eq!(level.verdict(), "level", "{level:?}");
        assert!((level.mean - 0.001).abs() < 1e-3 && level.difference_text().starts_with("+0.00"), "{level:?}");
    }

    #[test]
    fn note_describes_bootstrap_units() {
        let pairs = Paired { edge_m: Some(0.4), cubes: 9, rows: Vec::new() };
        let words = "over 9 cubes of 0.40 m; with fewer than ten cubes";
        assert!(pairs.note(Task::Spectrum).contains(words), "{}", pairs.note(Task::Spectrum));
        let single = Paired { edge_m: None, cubes: 31, ..pairs };
        let words = "of this run over 31 single channels, whose positions are unknown; level";
        assert!(single.note(Task::Channel).contains(words), "{}", single.note(Task::Channel));
    }

    #[test]
    fn formats_numbers_with_sign() {
        let expected = ["+0.0028", "−0.0027", "+0.000052", "0.0000", "0.0000", "0.0000"];
        assert_eq!([0.002_84, -0.0027, 5.2e-5, 0.0, -1e-9, 1e-9].map(signed), expected);
    }
}
