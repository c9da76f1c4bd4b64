//! `Record`: a run read back from its folder, as it was measured; `scores.csv` and `samples.csv` both ways.

use crate::confidence::Confidence;
use crate::facts::Facts;
use crate::folder::{CONFIDENCE, CURVE, MODEL_FILE, PIPELINE, REPORT, SAMPLES, SCORES, VALIDATION};
use crate::input::read_pipeline;
use crate::load::load;
use crate::observer::Observer;
use crate::scores::{Cell, ScoreTable, Scores};
use crate::series;
use crate::text::{Lines, csv_rows, damaged};
use pwrfgs_core::words::text_of;
use pwrfgs_core::{Dataset, Error, Goal, Measurement, Partition, Result, Values};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What lies in the folder of an evaluated model, as it was measured.
#[derive(Clone, Debug)]
pub struct Record {
    /// Its folder.
    pub folder: PathBuf,
    /// What was run, every default written out; paths are absolute. Of a joined model, what it is scored by.
    pub pipeline: Pipeline,
    /// Circumstances.
    pub facts: Facts,
    /// Every score.
    pub scores: Scores,
    /// Distances and positions of the test samples.
    pub test: TestSamples,
    /// Rows of `curve.csv`; empty without a training, as of an ensemble.
    pub curve: Vec<Vec<Option<f64>>>,
    /// Rows of `validation.csv`.
    pub validation: Vec<Vec<Option<f64>>>,
    /// Spread and error of an ensemble.
    pub confidence: Option<Confidence>,
}

impl Record {
    /// Reads the folder of a finished run; `None` if the run has not finished, or not begun.
    ///
    /// # Errors
    /// A file that the numbers come from is damaged or missing; `report.html` may be.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let Some(facts) = Facts::read(folder)?.filter(|facts| facts.finished.is_some()) else { return Ok(None) };
        let sources = facts.files.keys().filter(|name| *name != REPORT);
        sources.clone().try_for_each(|name| facts.verify_file(folder, name))?;
        Self::of(folder, &read_pipeline(&folder.join(PIPELINE), &[])?, facts).map(Some)
    }

    /// Reads what the evaluation by `pipeline` under the circumstances `facts` has left in `folder`.
    ///
    /// # Errors
    /// A file is damaged or missing.
    pub fn of(folder: &Path, pipeline: &Pipeline, facts: Facts) -> Result<Self> {
        let path = |name: &str| folder.join(name);
        let trained = facts.members.is_empty() && facts.steps > 0;
        let confidence = path(CONFIDENCE);
        Ok(Self {
            folder: folder.into(),
            pipeline: pipeline.clone(),
            scores: Scores::read(&path(SCORES), facts.scores.clone().unwrap_or_default())?,
            test: TestSamples::read(&path(SAMPLES))?,
            curve: if trained { series::whole(&path(CURVE), facts.steps)? } else { Vec::new() },
            validation: if trained { series::read(&path(VALIDATION)) } else { Vec::new() },
            confidence: confidence.is_file().then(|| Confidence::read(&confidence)).transpose()?,
            facts,
        })
    }

    /// Equal for runs that differ in names and in the seed of training alone, and for copies of one joined model.
    pub fn variant_key(&self) -> String {
        let nameless = Pipeline { name: String::new(), seed: 0, ..self.pipeline.clone() };
        let joined = self.facts.files.get(MODEL_FILE).filter(|_| !self.facts.members.is_empty());
        nameless.to_ron() + joined.map_or("", |mark| &mark.sha256)
    }

    /// Step and another column of `curve.csv` along the training, such as 2, the loss, or 4, the number of Gaussians.
    pub fn curve_of(&self, column: usize) -> Vec<(f64, f64)> {
        series::column(&self.curve, column)
    }

    /// The data of the run, read or simulated again.
    ///
    /// # Errors
    /// Whatever is wrong with them, or that they have changed since the run.
    pub fn load_data(&self, observer: &mut dyn Observer) -> Result<Dataset> {
        let (data, _) = load(&self.pipeline, Path::new(""), observer)?;
        self.partition(&data).map(|_| data)
    }

    /// How the run split `data`.
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

    /// What the run has trained, for observations like those of `data`.
    ///
    /// # Errors
    /// The model file is damaged, or of observations of another size.
    pub fn model(&self, data: &Dataset) -> Result<Ensemble> {
        let path = self.folder.join(MODEL_FILE);
        let model = file::read_ensemble(&path)?;
        let plane = model.plane();
        if (plane.width, plane.height) != (data.width, data.height) {
            return Err(Error::input(&path, "the model's observations are of another size than the data hold"));
        }
        Ok(model)
    }
}

impl Scores {
    /// The text of `scores.csv`.
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

    /// Reads `scores.csv` in `path`, of which `table` is the summary.
    ///
    /// # Errors
    /// [`Error::Input`] with the line if the file is damaged, or `table` is of other scores.
    pub fn read(path: &Path, table: ScoreTable) -> Result<Self> {
        let mut found = Self { table, ..Self::default() };
        let (rows, mut line) = (csv_rows::<ScoreRow>(path)?, 2);
        for group in rows.chunk_by(|a, b| (&a.predictor, &a.metric) == (&b.predictor, &b.metric)) {
            // A metric that is listed twice has its samples twice.
            let again = group[1..].iter().position(|row| row.sample == group[0].sample);
            for rows in group.chunks(again.map_or(group.len(), |k| k + 1)) {
                found.take(rows).map_err(|what| damaged(path, line, &what))?;
                line += rows.len();
            }
        }
        Ok(found)
    }

    /// Adds the rows of one metric of one predictor.
    fn take(&mut self, rows: &[ScoreRow]) -> Result<(), String> {
        let ScoreRow { predictor, metric, sample, value } = &rows[0];
        let (predictor, key) = (text_of(predictor), text_of(metric));
        let place = self.table.predictors.iter().position(|name| name == predictor);
        let row = self.table.metrics.iter_mut().find(|row| row.key == key);
        let (Some(place), Some(row)) = (place, row) else {
            return Err(format!("run.json has no {key} of {predictor}"));
        };
        let values = match (sample, value, row.cells.get(place)) {
            (Some(_), Some(_), _) => {
                let ids: Vec<u32> = rows.iter().filter_map(|row| row.sample).collect();
                if self.ids.is_empty() {
                    self.ids.clone_from(&ids);
                }
                let values: Vec<f64> = rows.iter().filter_map(|row| row.value).collect();
                if ids != self.ids || values.len() != ids.len() {
                    return Err(format!("{key} of {predictor} is of other samples than the first metric"));
                }
                Values::PerSample(values)
            }
            (None, Some(value), _) => Values::Whole(*value),
            (_, None, Some(Cell::NotApplicable(why))) => Values::NotApplicable(why.clone()),
            (_, None, _) => return Err(format!("run.json has a value of {key} of {predictor}")),
        };
        let goal = if row.higher_is_better { Goal::Higher } else { Goal::Lower };
        let measurement = Measurement { key: key.to_owned(), unit: row.unit.clone(), goal, values };
        // JSON has neither infinity nor NaN: the summary is that of the values.
        if let Some(cell) = row.cells.get_mut(place) {
            *cell = Cell::of(&measurement);
        }
        match self.predictors.last_mut().filter(|(name, _)| name == predictor) {
            Some((_, measured)) => measured.push(measurement),
            None => self.predictors.push((predictor.to_owned(), vec![measurement])),
        }
        Ok(())
    }
}

/// A row of `scores.csv`.
#[derive(Deserialize)]
struct ScoreRow {
    predictor: String,
    metric: String,
    #[serde(deserialize_with = "unless_empty")]
    sample: Option<u32>,
    /// `None` where the metric does not apply.
    #[serde(deserialize_with = "unless_not_applicable")]
    value: Option<f64>,
}

fn unless_empty<'de, D: Deserializer<'de>>(field: D) -> Result<Option<u32>, D::Error> {
    number_unless("", &String::deserialize(field)?)
}

fn unless_not_applicable<'de, D: Deserializer<'de>>(field: D) -> Result<Option<f64>, D::Error> {
    number_unless("n/a", &String::deserialize(field)?)
}

fn number_unless<T: FromStr, E: serde::de::Error>(none: &str, text: &str) -> Result<Option<T>, E> {
    (text != none).then(|| text.parse().ok().ok_or_else(|| E::custom(format!("`{text}` is no number")))).transpose()
}

/// The test samples, by label as in `scores.csv`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TestSamples {
    /// Distance to the nearest training transmitter, metres; infinity if there is none.
    pub nearest_train_m: BTreeMap<u32, f64>,
    /// Transmitter position, metres; `None` if unknown.
    pub positions: BTreeMap<u32, Option<[f64; 3]>>,
}

/// A row of `samples.csv`.
#[derive(Deserialize)]
struct SampleRow {
    /// Label in `scores.csv` if there are several receivers, else `id` is.
    link: Option<u32>,
    id: u32,
    x: Option<f64>,
    y: Option<f64>,
    z: Option<f64>,
    split: String,
    nearest_train_m: Option<f64>,
}

impl TestSamples {
    /// Reads `samples.csv`.
    ///
    /// # Errors
    /// [`pwrfgs_core::Error::Read`], or [`pwrfgs_core::Error::Input`] with the line if the file is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let mut found = Self::default();
        for SampleRow { link, id, x, y, z, split, nearest_train_m } in csv_rows(path)? {
            if split == "test" {
                let label = link.unwrap_or(id);
                found.nearest_train_m.insert(label, nearest_train_m.unwrap_or(f64::INFINITY));
                found.positions.insert(label, x.zip(y).zip(z).map(|((x, y), z)| [x, y, z]));
            }
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn test_samples_have_distances_and_positions() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("samples.csv");
        let text = "id,x,y,z,split,nearest_train_m\n1,0,0,0,train,2\n5,2.5,0,1,test,0.5\n6,,,,test,\n";
        std::fs::write(&path, text).unwrap();
        let found = TestSamples::read(&path).unwrap();
        assert_eq!(found.nearest_train_m, BTreeMap::from([(5, 0.5), (6, f64::INFINITY)]));
        assert_eq!(found.positions, BTreeMap::from([(5, Some([2.5, 0.0, 1.0])), (6, None)]));
    }
}
