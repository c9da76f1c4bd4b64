//! `Record`: one finished run, read back from its folder.

use super::{distinct, one_line};
use pwrfgs_core::files::read_text;
use pwrfgs_core::words::text_of;
use pwrfgs_core::{Error, Result};
use pwrfgs_experiment::folder::{CURVE, MODEL_FILE, PIPELINE, SAMPLES, SCORES};
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::series;
use pwrfgs_experiment::{CEILING, Facts, Recipe};
use pwrfgs_pipeline::Pipeline;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

type ById<T> = BTreeMap<u32, T>;
/// Metres; `None` if unknown.
type Positions = ById<Option<[f64; 3]>>;

/// What to do about a damaged file.
const ADVICE: &str = "the run's own files must stay as it wrote them; restore it, or repeat the run in another folder";

/// One finished run.
#[derive(Clone, Debug)]
pub struct Record {
    /// Its folder.
    pub folder: PathBuf,
    /// What was run, every default written out; paths are absolute. Of an ensemble, what it is scored by.
    pub pipeline: Pipeline,
    /// Equal for runs that differ in names and in the seeds of training alone.
    variant_key: String,
    /// The seed, or those of all members of an ensemble.
    pub(super) seeds: Vec<u64>,
    /// Circumstances and the summaries of all scores.
    pub facts: Facts,
    /// Every score.
    pub scores: Vec<Score>,
    /// Metres from each test sample to the nearest training transmitter, by id, or by link where there are several
    /// receivers; infinity where there is none.
    pub nearest_train_m: BTreeMap<u32, f64>,
    /// Position of the transmitter of each test sample, metres, by id; `None` if unknown.
    pub places: BTreeMap<u32, Option<[f64; 3]>>,
    /// Step and number of Gaussians along the training.
    pub gaussians: Vec<(f64, f64)>,
}

/// One metric of one predictor: the rows of `scores.csv` with the same first two fields.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// [`MODEL`], or the name of a baseline.
    pub predictor: String,
    /// Key of the metric, such as `ssim`.
    pub metric: String,
    /// Test ids and values in the order of the file; a number about the whole model has the id `None`.
    pub values: Vec<(Option<u32>, f64)>,
}

impl Record {
    /// Reads a run folder; `None` where its run has not finished, or not begun.
    ///
    /// # Errors
    /// One of its files is damaged or missing.
    pub fn read(folder: &Path) -> Result<Option<Self>> {
        let path = |name: &str| folder.join(name);
        let Some(facts) = Facts::read(folder)?.filter(|f| f.finished.is_some()) else { return Ok(None) };
        facts.verify(folder)?;
        let text = |name: &str| read_text(&path(name));
        let recipe = Recipe::read(&path(PIPELINE), &[])?;
        let scores = scores(&text(SCORES)?, &path(SCORES))?;
        let (nearest_train_m, places) = test_samples(&text(SAMPLES)?, &path(SAMPLES))?;
        // The members of an ensemble have curves of their own.
        let curve = if facts.members.is_empty() { series::whole(&path(CURVE), facts.steps)? } else { Vec::new() };
        let gaussians = curve.iter().filter_map(|row| Some(((*row.first()?)?, (*row.get(4)?)?))).collect();
        let (pipeline, variant_key, seeds) = (recipe.pipeline(), recipe.variant_key(), recipe.seeds());
        let folder = folder.into();
        Ok(Some(Self { folder, pipeline, variant_key, seeds, facts, scores, nearest_train_m, places, gaussians }))
    }

    /// Values a test sample of one metric of one predictor, by id.
    pub fn samples(&self, predictor: &str, metric: &str) -> Option<BTreeMap<u32, f64>> {
        let score = self.score(predictor, metric)?;
        let samples: ById<f64> = score.values.iter().filter_map(|(id, value)| Some(((*id)?, *value))).collect();
        (!samples.is_empty()).then_some(samples)
    }

    /// A metric of one predictor as one number: the number about the whole model, or the mean over test samples.
    pub fn value(&self, predictor: &str, metric: &str) -> Option<f64> {
        let values = &self.score(predictor, metric)?.values;
        (!values.is_empty()).then(|| values.iter().map(|v| v.1).sum::<f64>() / values.len() as f64)
    }

    /// Baselines in the order of the pipeline; members of an ensemble are none.
    pub fn floors(&self) -> Vec<&str> {
        let members = self.facts.scores.as_ref().map_or(&[][..], |table| &table.members);
        let is_floor = |name: &&str| *name != MODEL && !members.iter().any(|member| member == name);
        distinct(self.scores.iter().map(|s| s.predictor.as_str()).filter(is_floor))
    }

    /// Mean, median and bad tail of the ceiling by one metric.
    pub(super) fn ceiling(&self, metric: &str) -> Option<Vec<f64>> {
        let table = self.facts.scores.as_ref()?;
        let place = table.predictors.iter().position(|name| name == CEILING)?;
        let row = table.metrics.iter().find(|row| row.key == metric)?;
        Some(row.cells.get(place)?.numbers())
    }

    /// Whether there is one.
    pub(super) fn has_ceiling(&self) -> bool {
        self.facts.scores.as_ref().is_some_and(|table| table.predictors.iter().any(|name| name == CEILING))
    }

    /// The trained model's file.
    pub fn model_file(&self) -> PathBuf {
        self.folder.join(MODEL_FILE)
    }

    fn score(&self, predictor: &str, metric: &str) -> Option<&Score> {
        self.scores.iter().find(|s| s.predictor == predictor && s.metric == metric)
    }

    /// Data and split: equal for runs whose scores are comparable. What a split holds out for validation leaves the test
    /// set as it is.
    pub(super) fn setting_key(&self) -> Result<Value> {
        let failed = |e| Error::input(&self.folder, format!("data and split cannot be compared: {e}"));
        let [data, mut split] =
            [named_fields(&self.pipeline.data).map_err(failed)?, named_fields(&self.pipeline.split).map_err(failed)?];
        if let Some(fields) = split.1.as_object_mut() {
            fields.remove("validation");
        }
        Ok([data, split].into_iter().map(|(name, fields)| Value::from_iter([(name, fields)])).collect())
    }

    /// Equal for runs that differ in seed and name alone.
    pub(super) fn variant_key(&self) -> String {
        self.variant_key.clone()
    }

    /// The split as RON.
    pub(super) fn split(&self) -> String {
        one_line(&self.pipeline.split)
    }
}

/// Name and fields of a plugin; JSON has the fields alone.
fn named_fields(plugin: &impl Serialize) -> serde_json::Result<(String, Value)> {
    let name = one_line(plugin).split('(').next().unwrap_or_default().to_owned();
    // Through text: there a number of single precision has the digits that a person gave it.
    Ok((name, serde_json::from_str(&serde_json::to_string(plugin)?)?))
}

/// A row of `scores.csv`.
#[derive(Deserialize)]
struct ScoreRow {
    predictor: String,
    metric: String,
    #[serde(deserialize_with = "id")]
    sample: Option<u32>,
    /// Nothing where the metric does not apply.
    #[serde(deserialize_with = "number")]
    value: Option<f64>,
}

fn id<'de, D: Deserializer<'de>>(field: D) -> Result<Option<u32>, D::Error> {
    unless("", &String::deserialize(field)?)
}

fn number<'de, D: Deserializer<'de>>(field: D) -> Result<Option<f64>, D::Error> {
    unless("n/a", &String::deserialize(field)?)
}

fn unless<T: std::str::FromStr, E: serde::de::Error>(nothing: &str, text: &str) -> Result<Option<T>, E> {
    (text != nothing).then(|| text.parse().ok().ok_or_else(|| E::custom(format!("`{text}` is no number")))).transpose()
}

/// A row of `samples.csv`.
#[derive(Deserialize)]
struct SampleRow {
    /// Of several receivers: what scores name. Labels of one receiver's transmitters are in `id`.
    link: Option<u32>,
    id: u32,
    /// Nowhere where positions are not known.
    x: Option<f64>,
    y: Option<f64>,
    z: Option<f64>,
    split: String,
    nearest_train_m: Option<f64>,
}

/// Reads `scores.csv`; rows that do not apply are left out.
fn scores(text: &str, path: &Path) -> Result<Vec<Score>> {
    let mut all: Vec<Score> = Vec::new();
    for ScoreRow { predictor, metric, sample, value } in rows(text, path)? {
        let Some(value) = value else { continue };
        let [predictor, metric] = [predictor, metric].map(|name| text_of(&name).to_owned());
        match all.last_mut().filter(|s| s.predictor == predictor && s.metric == metric) {
            Some(score) => score.values.push((sample, value)),
            None => all.push(Score { predictor, metric, values: vec![(sample, value)] }),
        }
    }
    Ok(all)
}

/// Distances and places of the test samples in `samples.csv`, by id.
fn test_samples(text: &str, path: &Path) -> Result<(ById<f64>, Positions)> {
    let all: Vec<SampleRow> = rows(text, path)?;
    let tested = all.iter().filter(|s| s.split == "test").map(|s| (s.link.unwrap_or(s.id), s));
    let place = |s: &SampleRow| Some([s.x?, s.y?, s.z?]);
    Ok(tested.map(|(id, s)| ((id, s.nearest_train_m.unwrap_or(f64::INFINITY)), (id, place(s)))).unzip())
}

/// The rows of a file that was written whole.
fn rows<T: DeserializeOwned>(text: &str, path: &Path) -> Result<Vec<T>> {
    let at = |line: usize, what: String| Error::at(path, line, 1, format!("{what}; {ADVICE}"));
    if !text.ends_with('\n') {
        return Err(at(text.lines().count().max(1), "the file ends before the end of a row".into()));
    }
    let placed = |e: csv::Error| {
        let said = match e.kind() {
            csv::ErrorKind::Deserialize { err, .. } => err.kind().to_string(),
            _ => "the row has another number of fields than the first line".into(),
        };
        at(e.position().map_or(1, |p| p.line() as usize), said)
    };
    csv::Reader::from_reader(text.as_bytes()).into_deserialize().map(|row| row.map_err(placed)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_are_read_as_they_are_written() {
        let text = "predictor,metric,sample,value\nmodel,ssim,3,0.5\nmodel,ssim,7,0.7\nmodel,gaussians,,2613\n\
                    \"k, far\",ssim,3,0.75\n\"k, far\",gaussians,,n/a\n";
        let found = scores(text, Path::new("scores.csv")).unwrap();
        assert_eq!(found.len(), 3);
        assert_eq!(found[0].values, [(Some(3), 0.5), (Some(7), 0.7)]);
        assert_eq!((found[1].metric.as_str(), &found[1].values), ("gaussians", &vec![(None, 2613.0)]));
        assert_eq!(found[2].predictor, "k, far");
        let wrong = [
            ("model,ssim,3\n", ":2:1: the row has another number of fields than the first line;"),
            ("model,ssim,x,1\n", ":2:1: `x` is no number;"),
            ("model,ssim,3,\n", ":2:1: `` is no number;"),
            ("model,ssim,3,1", ":2:1: the file ends before the end of a row;"),
        ];
        for (row, why) in wrong {
            let said = scores(&format!("predictor,metric,sample,value\n{row}"), Path::new("scores.csv")).unwrap_err();
            assert!(said.is_input() && said.to_string().contains(why), "{said}");
        }
        assert!(
            scores("", Path::new("scores.csv")).unwrap_err().to_string().starts_with("scores.csv:1:1: the file ends")
        );
    }

    #[test]
    fn test_samples_have_distances_and_places() {
        let text = "id,x,y,z,split,nearest_train_m\n1,0,0,0,train,2\n5,2.5,0,1,test,0.5\n6,,,,test,\n";
        let (distances, places) = test_samples(text, Path::new("samples.csv")).unwrap();
        assert_eq!(distances.into_iter().collect::<Vec<_>>(), [(5, 0.5), (6, f64::INFINITY)]);
        assert_eq!((places[&5], places[&6]), (Some([2.5, 0.0, 1.0]), None));
    }
}
