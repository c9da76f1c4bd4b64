//! `Record`: a finished run read from its folder: scores, training series, and the confidence of an ensemble.

use crate::facts::Facts;
use crate::folder::{
    CONFIDENCE, CURVE, CURVE_GAUSSIANS, CURVE_LOSS, MODEL_FILE, PIPELINE, REPORT, SAMPLES, SCORES, VALIDATION,
};
use crate::input::read_pipeline;
use crate::samples::TestSamples;
use crate::scores::Scores;
use crate::text::{Lines, damaged, read_csv_rows};
use pwrfgs_core::files::{self, read_text};
use pwrfgs_core::statistics::{mean, sorted};
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Content of the folder of an evaluated model.
#[derive(Clone, Debug)]
pub struct Record {
    /// Run folder.
    pub folder: PathBuf,
    /// Pipeline with every default written out and absolute paths; for a joined model, the pipeline of its evaluation.
    pub pipeline: Pipeline,
    /// Facts of the run.
    pub facts: Facts,
    /// All scores.
    pub scores: Scores,
    /// Distances and positions of the test samples.
    pub test: TestSamples,
    /// Rows of `curve.csv`; empty without training, as for an ensemble.
    pub curve: Vec<Vec<Option<f64>>>,
    /// Rows of `validation.csv`; of several models, each with its own fold, their mean.
    pub validation: Vec<Vec<Option<f64>>>,
    /// Spread and error of an ensemble.
    pub confidence: Option<Confidence>,
}

impl Record {
    /// Reads the folder of a finished run; `None` if the run has not finished or started.
    ///
    /// # Errors
    /// A damaged or missing file other than `report.html`.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let Some(facts) = Facts::read(folder)?.filter(|facts| facts.finished.is_some()) else { return Ok(None) };
        let sources = facts.files.keys().filter(|name| *name != REPORT);
        sources.clone().try_for_each(|name| facts.verify_file(folder, name))?;
        Self::of(folder, &read_pipeline(&folder.join(PIPELINE), &[])?, facts).map(Some)
    }

    /// Reads the results of an evaluation of `pipeline` with `facts` from `folder`.
    ///
    /// # Errors
    /// A file is damaged or missing.
    pub fn of(folder: &Path, pipeline: &Pipeline, facts: Facts) -> Result<Self> {
        let path = |name: &str| folder.join(name);
        let trained = (facts.members.is_empty() || pipeline.members > 1) && facts.steps > 0;
        let models = model_folders(folder, &facts);
        let last = facts.steps / models.len() as u64; // `steps` is the sum over the models
        let curves = models.iter().map(|model| read_whole_series(&model.join(CURVE), last));
        let confidence = path(CONFIDENCE);
        Ok(Self {
            folder: folder.into(),
            pipeline: pipeline.clone(),
            scores: Scores::read(&path(SCORES), facts.scores.clone().unwrap_or_default())?,
            test: TestSamples::read(&path(SAMPLES))?,
            curve: if trained { mean_series(curves.collect::<Result<_>>()?) } else { Vec::new() },
            validation: if trained { read_validation(folder, &facts) } else { Vec::new() },
            confidence: confidence.is_file().then(|| Confidence::read(&confidence)).transpose()?,
            facts,
        })
    }

    /// Returns a key that is equal for runs that differ only in names and training seed, and for copies of one joined
    /// model.
    ///
    /// # Errors
    /// As [`Pipeline::to_ron`].
    pub fn variant_key(&self) -> Result<String> {
        let nameless = Pipeline { name: String::new(), seed: 0, ..self.pipeline.clone() };
        let is_joined = self.pipeline.members == 1 && !self.facts.members.is_empty();
        let joined = self.facts.files.get(MODEL_FILE).filter(|_| is_joined);
        Ok(nameless.to_ron()? + joined.map_or("", |mark| &mark.sha256))
    }

    /// Returns the pairs of step and loss in `curve.csv`.
    pub fn loss_curve(&self) -> Vec<(f64, f64)> {
        series_column(&self.curve, CURVE_LOSS)
    }

    /// Returns the pairs of step and number of Gaussians in `curve.csv`.
    pub fn gaussians_curve(&self) -> Vec<(f64, f64)> {
        series_column(&self.curve, CURVE_GAUSSIANS)
    }

    /// Splits `data` as in this run.
    ///
    /// # Errors
    /// The data have changed since the run.
    pub fn partition(&self, data: &Dataset) -> Result<Partition> {
        let partition = self.pipeline.partition(data)?;
        if partition.sizes() != self.facts.samples || data.title != self.facts.data {
            return Err(Error::input(&self.folder, "the data have changed since this run; run it again"));
        }
        Ok(partition)
    }

    /// Reads the trained model of the run, for observations like those of `data`.
    ///
    /// # Errors
    /// The model file is missing or damaged, or its observations have another size.
    pub fn model(&self, data: &Dataset) -> Result<Ensemble> {
        let path = self.folder.join(MODEL_FILE);
        let model = file::read_ensemble(&path)?;
        let plane = model.plane();
        if (plane.width, plane.height) != (data.width, data.height) {
            return Err(Error::input(&path, "the observations of the model and the data differ in size"));
        }
        Ok(model)
    }
}

/// Reads a complete series: rows of ascending steps up to step `last`; `None` for the name of a phase.
///
/// # Errors
/// [`pwrfgs_core::Error::Read`], or [`pwrfgs_core::Error::Input`] with the damaged position.
pub fn read_whole_series(path: &Path, last: u64) -> Result<Vec<Vec<Option<f64>>>> {
    let text = read_text(path)?;
    let wrong = |line: usize, problem: &str| Err(damaged(path, line, problem));
    let names: Vec<&str> = text.lines().next().unwrap_or_default().split(',').collect();
    if !text.ends_with('\n') || names[0] != "step" {
        return wrong(text.lines().count().max(1), "the file ends before the end of a row, or begins without names");
    }
    let mut rows = Vec::new();
    let mut done = 0;
    for (k, line) in text.lines().enumerate().skip(1) {
        let row: Vec<Option<f64>> = line.split(',').map(|field| field.parse().ok()).collect();
        // Names of phases are the only words.
        let is_whole =
            row.len() == names.len() && row.iter().zip(&names).all(|(v, name)| v.is_some() || *name == "phase");
        match line.split(',').next().and_then(|step| step.parse::<u64>().ok()) {
            Some(step) if is_whole && step > done => done = step,
            _ => return wrong(k + 1, "this row is damaged"),
        }
        rows.push(row);
    }
    if done != last {
        return wrong(rows.len() + 1, &format!("the last row is of step {done} instead of {last}"));
    }
    Ok(rows)
}

/// Returns the pairs of step and value of `column`, from rows in which both are numbers.
pub fn series_column(rows: &[Vec<Option<f64>>], column: usize) -> Vec<(f64, f64)> {
    rows.iter().filter_map(|row| Some(((*row.first()?)?, (*row.get(column)?)?))).collect()
}

/// Returns the folders of the trainings of a run: its own, or those of its models.
fn model_folders(folder: &Path, facts: &Facts) -> Vec<PathBuf> {
    match &facts.members[..] {
        [] => vec![folder.into()],
        members => members.iter().map(|member| folder.join(member)).collect(),
    }
}

/// Column of the mean of the first metric in `validation.csv`, counted from 0.
pub const VALIDATION_MEAN: usize = 1;
/// Column of the median of the first metric in `validation.csv`, counted from 0.
pub const VALIDATION_MEDIAN: usize = 2;

/// Reads the rows of `validation.csv` of a run, of several models their mean; empty without validations.
pub(crate) fn read_validation(folder: &Path, facts: &Facts) -> Vec<Vec<Option<f64>>> {
    mean_series(model_folders(folder, facts).iter().map(|model| read_series(&model.join(VALIDATION))).collect())
}

/// Returns the mean of series with the same steps, number by number; `None` if it is missing in one. One series is returned as
/// it is.
fn mean_series(mut series: Vec<Vec<Vec<Option<f64>>>>) -> Vec<Vec<Option<f64>>> {
    if series.len() == 1 {
        return series.swap_remove(0);
    }
    let mean = |row: usize, column: usize| {
        let numbers = series.iter().map(|rows| *rows.get(row)?.get(column)?);
        numbers.sum::<Option<f64>>().map(|sum| sum / series.len() as f64)
    };
    let columns = |row: &Vec<_>| row.len();
    let rows = series.first().map_or(&[][..], Vec::as_slice).iter().map(columns).enumerate();
    rows.map(|(row, columns)| (0..columns).map(|column| mean(row, column)).collect()).collect()
}

/// Reads the rows of a series as numbers, `None` for other fields; empty without a file.
pub fn read_series(path: &Path) -> Vec<Vec<Option<f64>>> {
    let Ok(text) = files::read_string(path) else { return Vec::new() };
    text.lines().skip(1).map(|line| line.split(',').map(|field| field.parse().ok()).collect()).collect()
}

/// Spread of the members and error of their mean for each test sample.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Confidence {
    /// Ids of the test samples.
    pub ids: Vec<u32>,
    /// Root mean square over the pixels of the standard deviation between members (n in the denominator).
    pub spreads: Vec<f64>,
    /// Root mean square over the pixels of prediction minus measurement, the prediction clamped to [0, 1].
    pub errors: Vec<f64>,
}

impl Confidence {
    /// Computes the Spearman rank correlation of spread and error: 1 if both have the same order, 0 if they are
    /// unrelated; NaN if all spreads or all errors are equal.
    pub fn rank_correlation(&self) -> f64 {
        pearson_correlation(&ranks(&self.spreads), &ranks(&self.errors))
    }

    /// Forms `count` groups by ascending spread, whose sizes differ by at most one, without empty ones. Returns mean spread and
    /// sorted errors of each.
    pub fn group_by_spread(&self, count: usize) -> Vec<(f64, Vec<f64>)> {
        let mut order: Vec<usize> = (0..self.spreads.len()).collect();
        order.sort_by(|&a, &b| self.spreads[a].total_cmp(&self.spreads[b]).then(a.cmp(&b)));
        let group = |k: usize| {
            let rows = &order[k * order.len() / count..(k + 1) * order.len() / count];
            let errors = sorted(rows.iter().map(|&i| self.errors[i]));
            (mean(rows.iter().map(|&i| self.spreads[i])), errors)
        };
        (0..count).map(group).filter(|(_, errors)| !errors.is_empty()).collect()
    }

    /// Reads `confidence.csv`.
    ///
    /// # Errors
    /// [`pwrfgs_core::Error::Read`], or [`pwrfgs_core::Error::Input`] with the line if the file is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let mut confidence = Self::default();
        for (id, spread, error) in read_csv_rows(path)? {
            confidence.ids.push(id);
            confidence.spreads.push(spread);
            confidence.errors.push(error);
        }
        Ok(confidence)
    }

    /// Formats the content of `confidence.csv`: test id, spread and error.
    pub fn to_csv(&self) -> String {
        let mut lines = Lines::new(["sample", "spread", "error"]);
        for ((id, spread), error) in self.ids.iter().zip(&self.spreads).zip(&self.errors) {
            lines.put([&id.to_string(), &spread.to_string(), &error.to_string()]);
        }
        lines.text()
    }
}

/// Ranks each value, from 0 for the smallest; equal values share their mean rank.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for equal in order.chunk_by(|&a, &b| values[a].total_cmp(&values[b]).is_eq()) {
        let mean = first as f64 + (equal.len() - 1) as f64 / 2.0;
        equal.iter().for_each(|&i| ranks[i] = mean);
        first += equal.len();
    }
    ranks
}

/// Computes the Pearson correlation of `a` and `b`; NaN if all values of one are equal.
fn pearson_correlation(a: &[f64], b: &[f64]) -> f64 {
    let (mean_a, mean_b) = (mean(a.iter().copied()), mean(b.iter().copied()));
    let product =
        |f: &dyn Fn(f64, f64) -> f64| -> f64 { a.iter().zip(b).map(|(a, b)| f(a - mean_a, b - mean_b)).sum() };
    product(&|a, b| a * b) / (product(&|a, _| a * a) * product(&|_, b| b * b)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_damaged_series() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("curve.csv");
        let wrong = [
            ("", ":1:1: the file ends"),
            ("step,phase,loss\n", ":1:1: the last row is of step 0 instead of 20"),
            ("step,phase,loss\n10,densify,0.5\n", ":2:1: the last row is of step 10"),
            ("step,phase,loss\n10,densify,0.5\n20,prune,0.", ":3:1: the file ends"),
            ("step,phase,loss\n10,densify\n20,prune,0.4\n", ":2:1: this row"),
            ("step,phase,loss\n10,densify,x\n20,prune,0.4\n", ":2:1: this row"),
            ("step,phase,loss\n10,densify,0.5\n10,densify,0.5\n20,prune,0.4\n", ":3:1: this row"),
        ];
        for (text, why) in wrong {
            std::fs::write(&path, text).unwrap();
            let message = read_whole_series(&path, 20).unwrap_err();
            assert!(message.is_input() && message.to_string().contains(why), "{message}");
        }
        std::fs::write(&path, "step,phase,loss\n10,densify,NaN\n20,prune,inf\n").unwrap();
        assert_eq!(read_whole_series(&path, 20).unwrap().len(), 2);
        assert!(read_whole_series(&folder.path().join("missing.csv"), 20).unwrap_err().is_input());
    }

    fn confidence(spreads: &[f64], errors: &[f64]) -> Confidence {
        Confidence { ids: (1..).take(spreads.len()).collect(), spreads: spreads.to_vec(), errors: errors.to_vec() }
    }

    #[test]
    fn correlations_match_scipy() {
        // scipy.stats.spearmanr([1, 2, 2, 4, 5, 3], [2, 1, 3, 9, 4, 4]) = 0.7941176470588235
        let c = confidence(&[1.0, 2.0, 2.0, 4.0, 5.0, 3.0], &[2.0, 1.0, 3.0, 9.0, 4.0, 4.0]);
        assert!((c.rank_correlation() - 0.794_117_647_058_823_5).abs() < 1e-12, "{}", c.rank_correlation());
        assert!((confidence(&[1.0, 2.0, 3.0], &[3.0, 5.0, 50.0]).rank_correlation() - 1.0).abs() < 1e-12);
        assert!(confidence(&[1.0, 1.0], &[3.0, 5.0]).rank_correlation().is_nan());
    }

    #[test]
    fn calibration_groups_have_equal_size_and_rising_spread() {
        let c = confidence(&[0.4, 0.1, 0.3, 0.2], &[4.0, 1.0, 3.0, 2.0]);
        let groups = c.group_by_spread(2);
        assert!((groups[0].0 - 0.15).abs() < 1e-12 && (groups[1].0 - 0.35).abs() < 1e-12);
        assert_eq!((&groups[0].1, &groups[1].1), (&vec![1.0, 2.0], &vec![3.0, 4.0]));
        assert_eq!(c.group_by_spread(9).len(), 4, "no group is empty");
    }
}
