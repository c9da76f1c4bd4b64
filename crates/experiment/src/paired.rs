//! `Paired`: the model less each baseline on the same test samples, with bootstrap intervals.
//!
//! A table of means says which number is larger. Whether that is more than chance is told from pairs: easy and hard places
//! cancel, and far smaller differences can be told from nothing.

use crate::blocks::Blocks;
use crate::headline::headline;
use crate::scores::{MODEL, Scores};
use crate::statistics::{CONFIDENCE, Difference};
use pwrfgs_core::{Goal, Kind};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Fewer cubes than this give rough intervals.
const ENOUGH: usize = 10;

/// Differences of a model from its baselines.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Paired {
    /// Edge of the cubes of space that the bootstrap draws, metres.
    pub edge_m: f64,
    /// How many of them hold test transmitters.
    pub cubes: usize,
    /// One for each baseline and metric, baselines in the order of the scores.
    pub rows: Vec<PairedRow>,
}

/// The model less one baseline by one metric.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairedRow {
    /// As `scores.csv` calls it.
    pub baseline: String,
    /// Key of the metric.
    pub metric: String,
    /// Whether larger is better.
    pub higher_is_better: bool,
    /// Mean over test samples.
    pub mean: f64,
    /// Ends of the 95 % interval; `None` where all test transmitters lie in one cube.
    pub interval: Option<[f64; 2]>,
}

impl Paired {
    /// Of the first metric of the kind and every rate ratio; `places` are those of the test transmitters, metres, by id.
    /// `None` where there is no baseline, or no such metric.
    pub(crate) fn of(scores: &Scores, places: &BTreeMap<u32, [f64; 3]>) -> Option<Self> {
        let blocks = Blocks::new(places);
        let first = headline(scores.kind).key;
        let (_, own) = scores.predictors.first()?;
        let wanted = own.iter().filter(|m| m.key == first || m.key.starts_with("eta_"));
        let baselines = scores.predictors.iter().filter(|(name, _)| name != MODEL && !scores.members.contains(name));
        let row = |baseline: &str, key: &str, goal: Goal| {
            let pairs = scores.samples(MODEL, key)?.iter().zip(scores.samples(baseline, key)?);
            let differences = scores.ids.iter().zip(pairs).map(|(id, (model, floor))| (*id, model - floor));
            let Difference { mean, interval, .. } = Difference::of(&[blocks.cells(differences)])?;
            let (baseline, metric, higher_is_better) = (baseline.to_owned(), key.to_owned(), goal == Goal::Higher);
            Some(PairedRow { baseline, metric, higher_is_better, mean, interval: interval.map(|(a, b)| [a, b]) })
        };
        let rows: Vec<PairedRow> =
            baselines.flat_map(|(name, _)| wanted.clone().filter_map(move |m| row(name, &m.key, m.goal))).collect();
        (!rows.is_empty()).then_some(Self { edge_m: blocks.edge_m, cubes: blocks.count, rows })
    }

    /// A table: a line of heads, then a line for each baseline, with the number and the verdict of each metric.
    pub fn lines(&self, bounds: &[String]) -> Vec<Vec<String>> {
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
        let head = ["model less".to_owned()].into_iter().chain(heads).collect();
        let line = |baseline: &&str| {
            let find = |key: &str| self.rows.iter().find(|row| row.baseline == *baseline && row.metric == key);
            let cells = metrics.iter().flat_map(|(key, _)| match find(key) {
                Some(row) => [row.number(), row.verdict().to_owned()],
                None => ["n/a".to_owned(), String::new()],
            });
            let dagger = if bounds.iter().any(|bound| bound == baseline) { " †" } else { "" };
            [format!("{baseline}{dagger}")].into_iter().chain(cells).collect()
        };
        [head].into_iter().chain(baselines.iter().map(line)).collect()
    }

    /// How to read it, in one sentence.
    pub fn note(&self, kind: Kind) -> String {
        let Self { edge_m, cubes, .. } = self;
        let rough = if *cubes < ENOUGH { "; with fewer than ten cubes it is a rough guide" } else { "" };
        format!(
            "differences are means over the same test {}, with the {:.0} % bootstrap interval of this run over {cubes} \
             cubes of {edge_m:.2} m{rough}; level: the interval covers 0",
            kind.counted(),
            100.0 * CONFIDENCE
        )
    }
}

impl PairedRow {
    /// Mean and interval.
    pub fn number(&self) -> String {
        let interval =
            self.interval.map_or_else(String::new, |[low, high]| format!(" [{}, {}]", signed(low), signed(high)));
        signed(self.mean) + &interval
    }

    /// `better`, `worse`, or `level` where the interval covers 0; nothing without an interval.
    pub fn verdict(&self) -> &'static str {
        match self.interval {
            None => "",
            Some([low, high]) if low <= 0.0 && 0.0 <= high => "level",
            Some(_) if (self.mean > 0.0) == self.higher_is_better => "better",
            Some(_) => "worse",
        }
    }
}

/// Four decimals with a sign; what is rounded to 0 has none.
fn signed(value: f64) -> String {
    let text = format!("{:.4}", value.abs());
    let sign = match value {
        _ if text.bytes().all(|b| matches!(b, b'0' | b'.')) => "",
        v if v > 0.0 => "+",
        _ => "−",
    };
    format!("{sign}{text}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Measurement, Values};

    /// 64 test samples on a grid of a metre; the model is `ahead` of the baseline, give or take `noise`.
    fn paired(ahead: f64, noise: f64, goal: Goal) -> PairedRow {
        let values = |of: &dyn Fn(u32) -> f64| {
            let (key, values) = ("ssim".to_owned(), Values::PerSample((0..64).map(of).collect()));
            vec![Measurement { key, unit: "", goal, values }]
        };
        let place = |id: u32| f64::from(id * 37 % 64) / 64.0;
        let scores = Scores {
            kind: Kind::Spectrum,
            ids: (0..64).collect(),
            predictors: vec![
                (MODEL.into(), values(&|id| place(id) + ahead + noise * (f64::from(id % 3) - 1.0))),
                ("1-NN".into(), values(&place)),
            ],
            ..Scores::default()
        };
        let places = (0..64).map(|id| (id, [f64::from(id % 8), f64::from(id / 8), 0.0])).collect();
        let mut found = Paired::of(&scores, &places).unwrap();
        assert!(found.cubes >= 30 && found.note(Kind::Spectrum).contains("95 %"), "{found:?}");
        assert_eq!(found.lines(&["1-NN".into()])[1][0], "1-NN †");
        found.rows.remove(0)
    }

    #[test]
    fn verdict_follows_from_interval_and_direction() {
        assert_eq!(paired(0.05, 0.02, Goal::Higher).verdict(), "better");
        assert_eq!(paired(0.05, 0.02, Goal::Lower).verdict(), "worse");
        assert_eq!(paired(-0.05, 0.02, Goal::Lower).verdict(), "better");
        let level = paired(0.001, 0.02, Goal::Higher);
        assert_eq!(level.verdict(), "level", "{level:?}");
        assert!((level.mean - 0.001).abs() < 1e-3 && level.number().starts_with("+0.00"), "{level:?}");
    }

    #[test]
    fn numbers_carry_their_sign() {
        assert_eq!([0.002_84, -0.0027, 0.0, -1e-9].map(signed), ["+0.0028", "−0.0027", "0.0000", "0.0000"]);
    }
}
