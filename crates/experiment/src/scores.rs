//! `Scores`: per-sample values and summaries of every predictor.
//!
//! Columns of `scores.csv`: predictor, metric, sample (a test id, or empty for a number about the whole model), value.

use crate::paired::{Paired, PairedRow, is_compared};
use crate::statistics::{Blocks, Difference, Summary, read_null_as_infinite};
use crate::text::{Lines, damaged, number, read_csv_rows};
use pwrfgs_core::messages::text_of;
use pwrfgs_core::{Goal, Measurement, Result, Task, Values};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

/// Name of the noise ceiling in every table; it is not ranked.
pub const CEILING: &str = "ceiling (repeatability)";
/// Level of the intervals in `samples.csv` and in notes, which print it as 90 %; it needs 9 blocks for calibration.
pub(crate) const LEVEL: f64 = 0.9;
/// Name of the trained model in every table.
pub const MODEL: &str = "model";

/// Scores of every predictor on the test set: all values and their summary.
///
/// `scores.csv` holds the values, `run.json` the summary; [`Self::read`] combines them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scores {
    /// Summary of all measurements.
    pub table: ScoreTable,
    /// Labels of the test samples, in the order of per-sample values.
    pub ids: Vec<u32>,
    /// Predictors with their measurements; the model comes first.
    pub predictors: Vec<(String, Vec<Measurement>)>,
    /// Interval of the model per test sample, in the order of `ids`: columns of `samples.csv`, which is not read back.
    pub intervals: Vec<Vec<f64>>,
}

/// Scores without per-sample values, as `run.json` holds them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScoreTable {
    /// Predictors, the model first; [`CEILING`] last, if it exists.
    pub predictors: Vec<String>,
    /// One entry per metric.
    pub metrics: Vec<MetricRow>,
    /// Names of the oracle baselines, which use the simulated scene itself or the time of a measurement.
    pub oracles: Vec<String>,
    /// Names of the predictors that are members of the model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub members: Vec<String>,
    /// Numbers of training samples of the model (0 if unknown), training samples of the baselines, and test samples.
    #[serde(default)]
    pub samples: [usize; 3],
    /// Whether the model may be trained on other data or another split than the baselines.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub trained_elsewhere: bool,
    /// Share b of the model in its predictions; `None` without residuals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share: Option<f64>,
    /// Paired differences between the model and each baseline.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paired: Option<Paired>,
    /// Prediction intervals of the model and of baselines that have a variance.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub intervals: Vec<IntervalScores>,
    /// Notes below the table.
    pub notes: Vec<String>,
    /// Task of the predictors.
    #[serde(default, skip_serializing_if = "is_default")]
    pub task: Task,
}

/// Returns whether `task` is the default, which `run.json` omits.
fn is_default(task: &Task) -> bool {
    *task == Task::default()
}

/// One metric of all predictors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricRow {
    /// Name, as in `scores.csv`.
    pub key: String,
    /// Unit, or empty.
    pub unit: String,
    /// Whether larger is better.
    pub higher_is_better: bool,
    /// One cell per predictor.
    pub cells: Vec<ScoreCell>,
}

/// One metric of one predictor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScoreCell {
    /// Summary over the test samples.
    Samples(Summary),
    /// One value for the whole model.
    Whole(#[serde(deserialize_with = "read_null_as_infinite")] f64),
    /// Not applicable, with the reason.
    NotApplicable(String),
}

/// Prediction intervals of one predictor on the test set. All blocks have the same weight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IntervalScores {
    /// Name of the predictor.
    pub predictor: String,
    /// Numbers of blocks of the calibration and of the test set.
    pub blocks: [usize; 2],
    /// Levels with enough blocks, ascending.
    pub levels: Vec<LevelScores>,
}

/// Prediction intervals of one level.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LevelScores {
    /// Nominal coverage.
    pub level: f64,
    /// Share of the values inside their intervals.
    pub coverage: f64,
    /// Mean width, dB or parts of the full scale.
    pub width: f64,
    /// Mean lower bound of the SSIM, and share of spectra at or above it; `None` without pixels.
    pub ssim: Option<[f64; 2]>,
}

impl IntervalScores {
    /// Returns the mean width at a measured coverage, interpolated between levels; `None` beyond them.
    pub fn width_at(&self, coverage: f64) -> Option<f64> {
        self.levels.windows(2).find_map(|ends| {
            let fraction = (coverage - ends[0].coverage) / (ends[1].coverage - ends[0].coverage);
            (0.0..=1.0).contains(&fraction).then(|| ends[0].width + fraction * (ends[1].width - ends[0].width))
        })
    }

    /// Describes the intervals of [`LEVEL`]. For a baseline, also gives their width at the coverage of those of the `model`.
    pub(crate) fn note(&self, task: Task, model: &Self) -> String {
        let Self { predictor, blocks: [calibration, test], levels } = self;
        let Some(LevelScores { coverage, width, ssim, .. }) = levels.iter().find(|scores| scores.level == LEVEL) else {
            return format!("no 90 % intervals of {predictor}: {calibration} calibration blocks, expected 9 or more");
        };
        let (values, unit) = task.intervals.as_ref().map_or(("", ""), |words| (words.values, words.unit));
        let ssim = ssim.map_or_else(String::new, |[bound, share]| {
            format!("; {:.1} % of SSIM are at or above their bound, {bound:.3} in the mean", 100.0 * share)
        });
        let of_model = model.levels.iter().find(|scores| scores.level == LEVEL && predictor != MODEL);
        let equal = of_model.and_then(|scores| self.width_at(scores.coverage)).map_or_else(String::new, |width| {
            format!(" ({}{unit} at the coverage of {})", number(width), model.predictor)
        });
        format!(
            "90 % intervals of {predictor}: {:.1} % of {values} inside, mean width {}{unit}{equal}{ssim}; blocks of equal \
             weight: {calibration} calibration, {test} test",
            100.0 * coverage,
            number(*width)
        )
    }
}

impl ScoreCell {
    /// Summarises a measurement.
    pub(crate) fn of(measurement: &Measurement) -> Self {
        match &measurement.values {
            Values::PerSample(values) => Self::Samples(Summary::of(values, measurement.goal == Goal::Higher)),
            Values::Whole(value) => Self::Whole(*value),
            Values::NotApplicable(why) => Self::NotApplicable(why.clone()),
        }
    }

    /// Returns mean, median and 10th percentile (90th for errors) of per-sample values, or the value of a whole model;
    /// empty if the metric is not applicable.
    pub fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Samples(Summary { mean, median, tail10 }) => vec![*mean, *median, *tail10],
            Self::Whole(value) => vec![*value],
            Self::NotApplicable(_) => Vec::new(),
        }
    }
}

impl MetricRow {
    /// Returns whether some predictor has per-sample values.
    pub fn is_per_sample(&self) -> bool {
        self.cells.iter().any(|c| matches!(c, ScoreCell::Samples(_)))
    }
}

impl Scores {
    /// Summarises the measurements of all predictors on the test samples `ids`; `table` holds the other fields.
    pub fn new(ids: Vec<u32>, predictors: Vec<(String, Vec<Measurement>)>, table: ScoreTable) -> Self {
        let mut metrics: Vec<MetricRow> = Vec::new();
        for (p, (_, measurements)) in predictors.iter().enumerate() {
            for m in measurements {
                let index = metrics.iter().position(|row| row.key == m.key).unwrap_or_else(|| {
                    metrics.push(MetricRow {
                        key: m.key.clone(),
                        unit: m.unit.clone(),
                        higher_is_better: m.goal == Goal::Higher,
                        cells: vec![ScoreCell::NotApplicable("not measured".into()); predictors.len()],
                    });
                    metrics.len() - 1
                });
                metrics[index].cells[p] = ScoreCell::of(m);
            }
        }
        let names = predictors.iter().map(|(name, _)| name.clone()).collect();
        Self { table: ScoreTable { predictors: names, metrics, ..table }, ids, predictors, intervals: Vec::new() }
    }

    /// Returns the values of one per-sample metric of one predictor; `None` if it has none.
    pub fn sample_values(&self, predictor: &str, key: &str) -> Option<&[f64]> {
        let (_, measurements) = self.predictors.iter().find(|(name, _)| name == predictor)?;
        match &measurements.iter().find(|m| m.key == key)?.values {
            Values::PerSample(values) => Some(values),
            _ => None,
        }
    }

    /// Returns the values of one per-sample metric of one predictor by label of the test sample; `None` if it has none.
    pub fn values_by_id(&self, predictor: &str, key: &str) -> Option<BTreeMap<u32, f64>> {
        Some(self.ids.iter().copied().zip(self.sample_values(predictor, key)?.iter().copied()).collect())
    }

    /// Computes paired differences between the model and each baseline, by the metrics that [`is_compared`] selects;
    /// `positions` are those of the test transmitters, metres, by label. `None` if there is no baseline, no such metric, or no
    /// finite difference.
    pub(crate) fn paired_differences(&self, positions: &BTreeMap<u32, Option<[f64; 3]>>) -> Option<Paired> {
        let blocks = Blocks::new(positions);
        let (_, measurements) = self.predictors.first()?;
        let compared = measurements.iter().filter(|m| is_compared(&m.key, self.table.task));
        let row = |baseline: &str, key: &str, goal: Goal| {
            let pairs = self.sample_values(MODEL, key)?.iter().zip(self.sample_values(baseline, key)?);
            let differences = self.ids.iter().zip(pairs).map(|(id, (model, baseline))| (*id, model - baseline));
            let Difference { mean, interval, .. } = Difference::of(&[blocks.block_sums(differences)])?;
            let (baseline, metric, higher_is_better) = (baseline.to_owned(), key.to_owned(), goal == Goal::Higher);
            Some(PairedRow { baseline, metric, higher_is_better, mean, interval: interval.map(|(a, b)| [a, b]) })
        };
        let rows: Vec<PairedRow> = self
            .table
            .baselines()
            .flat_map(|name| compared.clone().filter_map(move |m| row(name, &m.key, m.goal)))
            .collect();
        (!rows.is_empty()).then_some(Paired { edge_m: blocks.edge_m, cubes: blocks.count, rows })
    }

    /// Returns the value of one metric of one predictor: that of the whole model, or the mean over test samples; `None`
    /// if it has none.
    pub fn value(&self, predictor: &str, key: &str) -> Option<f64> {
        self.table.numbers(predictor, key)?.first().copied()
    }
}

impl ScoreTable {
    /// Adds the noise ceiling as the last predictor, with a cell that is not applicable for metrics without one; no
    /// predictor if `ceilings` is empty.
    pub(crate) fn add_ceiling(&mut self, ceilings: &[(String, Summary)]) {
        if ceilings.is_empty() {
            return;
        }
        self.predictors.push(CEILING.into());
        for row in &mut self.metrics {
            let ceiling = ceilings.iter().find(|(key, _)| *key == row.key);
            let cell = |(_, summary): &(String, Summary)| ScoreCell::Samples(*summary);
            row.cells.push(ceiling.map_or_else(|| ScoreCell::NotApplicable("no estimate".into()), cell));
        }
    }

    /// Returns the [`ScoreCell::numbers`] of one metric of one predictor or the noise ceiling; `None` if predictor or
    /// metric is unknown.
    pub fn numbers(&self, predictor: &str, key: &str) -> Option<Vec<f64>> {
        let index = self.predictors.iter().position(|name| name == predictor)?;
        Some(self.metrics.iter().find(|row| row.key == key)?.cells.get(index)?.numbers())
    }

    /// Lists the baselines in the order of the pipeline, without ensemble members and ceiling.
    pub fn baselines(&self) -> impl Iterator<Item = &str> {
        let is_baseline = |name: &&String| *name != MODEL && *name != CEILING && !self.members.contains(name);
        self.predictors.iter().filter(is_baseline).map(String::as_str)
    }

    /// Returns the score of the model by one metric: the mean over test samples, or the value of the whole model; `None`
    /// without one.
    pub fn model_score(&self, key: &str) -> Option<f64> {
        self.numbers(MODEL, key)?.first().copied()
    }

    /// Ranks each predictor (0 is best) by statistic `k` of a metric (0 mean, 1 median, 2 percentile); `None` for
    /// oracle baselines, the ceiling, and missing values. Equal values share a rank.
    pub fn ranks(&self, metric: &MetricRow, k: usize) -> Vec<Option<usize>> {
        let value = |(name, cell): (&String, &ScoreCell)| {
            cell.numbers().get(k).copied().filter(|v| !v.is_nan() && self.is_ranked(name))
        };
        let values: Vec<Option<f64>> = self.predictors.iter().zip(&metric.cells).map(value).collect();
        let better = |a: f64, b: f64| if metric.higher_is_better { a > b } else { a < b };
        let rank = |v: f64| values.iter().flatten().filter(|other| better(**other, v)).count();
        values.iter().map(|v| v.map(rank)).collect()
    }

    /// Returns whether a predictor is ranked: all are, except oracle baselines and the noise ceiling.
    fn is_ranked(&self, name: &str) -> bool {
        name != CEILING && !self.oracles.iter().any(|oracle| oracle == name)
    }
}

impl Scores {
    /// Formats the content of `scores.csv`.
    pub fn to_csv(&self) -> String {
        let mut lines = Lines::new(["predictor", "metric", "sample", "value"]);
        for (predictor, measurements) in &self.predictors {
            for m in measurements {
                let mut line = |sample: &str, value: &str| lines.put([predictor, &m.key, sample, value]);
                match &m.values {
                    Values::PerSample(values) => {
                        let rows = self.ids.iter().zip(values);
                        rows.for_each(|(id, value)| line(&id.to_string(), &value.to_string()));
                    }
                    Values::Whole(value) => line("", &value.to_string()),
                    Values::NotApplicable(_) => line("", "n/a"),
                }
            }
        }
        lines.text()
    }

    /// Reads `scores.csv` in `path` with its summary `table`.
    ///
    /// # Errors
    /// [`pwrfgs_core::Error::Read`]; [`pwrfgs_core::Error::Input`] with the line if the file is damaged, or `table` belongs to
    /// other scores.
    pub fn read(path: &Path, table: ScoreTable) -> Result<Self> {
        let mut scores = Self { table, ..Self::default() };
        let (rows, mut line) = (read_csv_rows::<ScoreRow>(path)?, 2); // line 1 is the header
        for group in rows.chunk_by(|a, b| (&a.predictor, &a.metric) == (&b.predictor, &b.metric)) {
            // A metric that is listed twice has its samples twice.
            let again = group[1..].iter().position(|row| row.sample == group[0].sample);
            for rows in group.chunks(again.map_or(group.len(), |k| k + 1)) {
                scores.add_rows(rows).map_err(|problem| damaged(path, line, &problem))?;
                line += rows.len();
            }
        }
        Ok(scores)
    }

    /// Adds the rows of one metric of one predictor, and summarises them in the table. The first rows per sample also
    /// define the `ids`.
    ///
    /// # Errors
    /// The rows do not fit the table or earlier rows; the message gives the difference.
    fn add_rows(&mut self, rows: &[ScoreRow]) -> Result<(), String> {
        let ScoreRow { predictor, metric, sample, value } = &rows[0];
        let (predictor, key) = (text_of(predictor), text_of(metric));
        let index = self.table.predictors.iter().position(|name| name == predictor);
        let row = self.table.metrics.iter_mut().find(|row| row.key == key);
        let (Some(index), Some(row)) = (index, row) else {
            return Err(format!("run.json has no {key} of {predictor}"));
        };
        let values = match (sample, value, row.cells.get(index)) {
            (Some(_), Some(_), _) => {
                let ids: Vec<u32> = rows.iter().filter_map(|row| row.sample).collect();
                if self.ids.is_empty() {
                    self.ids.clone_from(&ids);
                }
                let values: Vec<f64> = rows.iter().filter_map(|row| row.value).collect();
                if ids != self.ids || values.len() != ids.len() {
                    return Err(format!("{key} of {predictor} has other samples than the first metric"));
                }
                Values::PerSample(values)
            }
            (None, Some(value), _) => Values::Whole(*value),
            (_, None, Some(ScoreCell::NotApplicable(why))) => Values::NotApplicable(why.clone()),
            (_, None, _) => return Err(format!("run.json has a value of {key} of {predictor}")),
        };
        let goal = if row.higher_is_better { Goal::Higher } else { Goal::Lower };
        let measurement = Measurement { key: key.to_owned(), unit: row.unit.clone(), goal, values, note: None };
        // JSON has neither infinity nor NaN: the summary is computed from the values.
        if let Some(cell) = row.cells.get_mut(index) {
            *cell = ScoreCell::of(&measurement);
        }
        match self.predictors.last_mut().filter(|(name, _)| name == predictor) {
            Some((_, measured)) => measured.push(measurement),
            None => self.predictors.push((predictor.to_owned(), vec![measurement])),
        }
        Ok(())
    }
}

/// Row of `scores.csv`.
#[derive(Deserialize)]
struct ScoreRow {
    predictor: String,
    metric: String,
    #[serde(deserialize_with = "read_unless_empty")]
    sample: Option<u32>,
    /// `None` if the metric does not apply.
    #[serde(deserialize_with = "read_unless_not_applicable")]
    value: Option<f64>,
}

/// Reads an integer; `None` if the field is empty. Returns an error for other text.
fn read_unless_empty<'de, D: Deserializer<'de>>(field: D) -> Result<Option<u32>, D::Error> {
    parse_unless("", &String::deserialize(field)?)
}

/// Reads a number; `None` for `n/a`. Returns an error for other text.
fn read_unless_not_applicable<'de, D: Deserializer<'de>>(field: D) -> Result<Option<f64>, D::Error> {
    parse_unless("n/a", &String::deserialize(field)?)
}

/// Parses a number; `None` if `text` equals `none`. Returns an error for other text that is not a number.
fn parse_unless<T: FromStr, E: serde::de::Error>(none: &str, text: &str) -> Result<Option<T>, E> {
    (text != none).then(|| text.parse().ok().ok_or_else(|| E::custom(format!("`{text}` is not a number")))).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores() -> Scores {
        let measure =
            |key: &str, goal, values| Measurement { key: key.into(), unit: String::new(), goal, values, note: None };
        let notes = vec!["k, far has seen the test spectra".into()];
        Scores::new(
            vec![3, 7],
            vec![
                (
                    MODEL.into(),
                    vec![
                        measure("ssim", Goal::Higher, Values::PerSample(vec![0.5, 0.7])),
                        measure("gaussians", Goal::Lower, Values::Whole(2613.0)),
                    ],
                ),
                (
                    "k, far".into(),
                    vec![
                        measure("ssim", Goal::Higher, Values::PerSample(vec![0.75, 0.25])),
                        measure("gaussians", Goal::Lower, Values::NotApplicable("no Gaussians".into())),
                    ],
                ),
            ],
            ScoreTable { notes, samples: [9, 12, 2], ..ScoreTable::default() },
        )
    }

    #[test]
    fn oracle_baseline_is_unranked() {
        let table = ScoreTable { oracles: vec![MODEL.into()], ..scores().table };
        assert_eq!(table.ranks(&table.metrics[0], 0), vec![None, Some(0)]);
        let text = table.to_text(None);
        assert!(text.contains("model †") && !text.contains('*') && text.contains("note: † oracle baseline"), "{text}");
    }

    #[test]
    fn ceiling_row_is_last_and_unranked() {
        let ceiling = Summary { mean: 0.9, median: 0.95, tail10: 0.8 };
        let mut scores = scores();
        scores.table.add_ceiling(&[("ssim".into(), ceiling)]);
        let table = &scores.table;
        assert_eq!(table.predictors, [MODEL, "k, far", CEILING]);
        assert_eq!(table.metrics[0].cells[2].numbers(), [0.9, 0.95, 0.8]);
        assert_eq!(table.metrics[1].cells[2], ScoreCell::NotApplicable("no estimate".into()));
        assert_eq!(table.ranks(&table.metrics[0], 0), vec![Some(0), Some(1), None]);
        assert!(table.to_text(None).lines().nth(1).unwrap().ends_with(CEILING), "{}", table.to_text(None));
        assert!(!scores.to_csv().contains("ceiling"), "no number a test sample");
    }

    #[test]
    fn csv_has_one_line_per_value() {
        let expected = "predictor,metric,sample,value\nmodel,ssim,3,0.5\nmodel,ssim,7,0.7\nmodel,gaussians,,2613\n\
                        \"k, far\",ssim,3,0.75\n\"k, far\",ssim,7,0.25\n\"k, far\",gaussians,,n/a\n";
        assert_eq!(scores().to_csv(), expected);
    }

    #[test]
    fn table_marks_best_and_round_trips_through_json() {
        let table = scores().table;
        let text = table.to_text(None);
        assert!(text.contains("0.6000*") && text.contains("2,613") && text.contains("n/a"), "{text}");
        let links = ScoreTable { task: Task::Power, ..table.clone() }.to_text(None);
        assert!(links.contains("2 test links") && !links.contains("spectra;"), "{links}");
        let notes: Vec<&str> = text.lines().filter(|line| line.starts_with("note: ")).collect();
        assert_eq!(notes, ["note: k, far has seen the test spectra"], "{text}");
        assert!(text.contains("10th percentile"), "{text}");
        let heading =
            "2 test spectra; the model is trained on 9; the baselines are trained on 12 (training and validation)";
        assert_eq!(text.lines().next(), Some(heading), "{text}");
        let same = ScoreTable { samples: [12, 12, 2], ..scores().table };
        assert_eq!(same.heading(), "2 test spectra; model and baselines are trained on the same 12");
        assert_eq!((table.model_score("ssim"), table.model_score("gaussians")), (Some(0.6), Some(2613.0)));
        assert_eq!(table.model_score("eta_0db"), None);
        assert_eq!(table.ranks(&table.metrics[0], 0), vec![Some(0), Some(1)]);
        assert_eq!(table.ranks(&table.metrics[1], 0), vec![Some(0), None]);
        let json = serde_json::to_string(&table).unwrap();
        assert_eq!(serde_json::from_str::<ScoreTable>(&json).unwrap(), table);
    }

    #[test]
    fn scores_round_trip_through_csv() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.csv");
        let mut measured = scores();
        // As a metric that is listed twice.
        let twice = measured.predictors[1].1[0].clone();
        measured.predictors[1].1.insert(1, twice);
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Scores::read(&path, measured.table.clone())
        };
        assert_eq!(read(&measured.to_csv()).unwrap(), measured);
        let wrong = [
            ("model,ssim,3\n", ":2:1: the row has another number of fields than the first line;"),
            ("model,ssim,x,1\n", ":2:1: `x` is not a number;"),
            ("model,ssim,3,\n", ":2:1: `` is not a number;"),
            ("model,ssim,3,1", ":2:1: the file ends before the end of a row;"),
            ("model,ssim,3,1\nmodel,psnr,3,1\n", ":3:1: run.json has no psnr of model;"),
            ("model,ssim,3,1\n1-NN,ssim,3,1\n", ":3:1: run.json has no ssim of 1-NN;"),
            ("model,ssim,3,1\n\"k, far\",ssim,4,1\n", ":3:1: ssim of k, far has other samples than the first metric;"),
            ("model,ssim,,n/a\n", ":2:1: run.json has a value of ssim of model;"),
        ];
        for (row, why) in wrong {
            let message = read(&format!("predictor,metric,sample,value\n{row}")).unwrap_err();
            assert!(message.is_input() && message.to_string().contains(why), "{message}");
        }
        assert!(read("").unwrap_err().to_string().contains("scores.csv:1:1: the file ends"));
    }

    #[test]
    fn interval_notes_compare_widths_at_equal_coverage() {
        let scores = |predictor: &str, ends: [[f64; 2]; 2]| IntervalScores {
            predictor: predictor.into(),
            blocks: [40, 8],
            levels: [(0.8, ends[0]), (0.9, ends[1])]
                .map(|(level, [coverage, width])| LevelScores { level, coverage, width, ssim: None })
                .to_vec(),
        };
        let (model, kriging) =
            (scores(MODEL, [[0.75, 10.5], [0.85, 14.5]]), scores("Kriging", [[0.8, 11.5], [0.9, 15.5]]));
        let note = |scores: &IntervalScores| scores.note(Task::Power, &model);
        let blocks = "blocks of equal weight: 40 calibration, 8 test";
        assert_eq!(
            note(&model),
            format!("90 % intervals of model: 85.0 % of links inside, mean width 14.50 dB; {blocks}")
        );
        let kriged = "90 % intervals of Kriging: 90.0 % of links inside, mean width 15.50 dB (13.50 dB at the coverage of model)";
        assert_eq!(note(&kriging), format!("{kriged}; {blocks}"));
        assert_eq!(kriging.width_at(0.95), None);
        let few = IntervalScores { blocks: [5, 8], levels: Vec::new(), ..model.clone() };
        assert_eq!(note(&few), "no 90 % intervals of model: 5 calibration blocks, expected 9 or more");
    }
}
