//! `Record`: a run read back from its folder, and the data and the model behind it.

use crate::confidence::Confidence;
use crate::facts::{Facts, Mark};
use crate::folder::{CONFIDENCE, CURVE, MODEL_FILE, PIPELINE, REPORT, RunFolder, SAMPLES, SCORES, VALIDATION};
use crate::input::read_pipeline;
use crate::load::load;
use crate::observer::Observer;
use crate::samples::{TestSamples, to_csv};
use crate::scores::{ScoreTable, Scores};
use crate::session::Session;
use crate::{clock, series};
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use std::path::{Path, PathBuf};

/// What lies in the folder of an evaluated model, as it was measured.
#[derive(Clone, Debug)]
pub struct Record {
    /// Its folder.
    pub folder: PathBuf,
    /// What was run, every default written out; paths are absolute. Of a joined model, what it is scored by.
    pub pipeline: Pipeline,
    /// How the model was made, every setting as RON text.
    pub settings: String,
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

/// A record with the data and the model behind it: what a page is made of.
#[derive(Clone, Copy, Debug)]
pub struct LoadedRun<'a> {
    /// What lies in the folder.
    pub record: &'a Record,
    /// The data it was scored on.
    pub data: &'a Dataset,
    /// Their split.
    pub partition: &'a Partition,
    /// The model, or several that predict together.
    pub model: &'a Ensemble,
}

/// Makes the page of a run, HTML in one file.
pub type Page = fn(&LoadedRun<'_>) -> Result<String>;

/// What stands above the pipeline of a joined model.
const JOINED_SETTINGS: &str = "// each run has its own pipeline; this one scores the mean of their predictions:\n";

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
            settings: if facts.members.is_empty() { String::new() } else { JOINED_SETTINGS.into() }
                + &pipeline.to_ron(),
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
        self.curve.iter().filter_map(|row| Some(((*row.first()?)?, (*row.get(column)?)?))).collect()
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
        let sizes = [&partition.train, &partition.validation, &partition.test].map(Vec::len);
        if sizes != self.facts.samples || data.title != self.facts.data {
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

/// Writes what an evaluation found: `scores.csv`, `samples.csv`, of an ensemble `confidence.csv`.
///
/// # Errors
/// [`Error::Write`].
pub fn write_scores(
    folder: &Path,
    (scores, confidence): (&Scores, Option<&Confidence>),
    data: &Dataset,
    partition: &Partition,
) -> Result<()> {
    let put = |name: &str, text: String| write_atomically(&folder.join(name), text.as_bytes());
    put(SCORES, scores.to_csv())?;
    put(SAMPLES, to_csv(data, partition))?;
    confidence.map_or(Ok(()), |confidence| put(CONFIDENCE, confidence.to_csv()))
}

/// Makes `report.html` from what lies in the folder of `run`, and writes it there.
///
/// # Errors
/// A damaged snapshot; [`Error::Write`].
pub fn write_page(run: &LoadedRun<'_>, page: Page) -> Result<()> {
    write_atomically(&run.record.folder.join(REPORT), page(run)?.as_bytes())
}

/// Ends the run of `pipeline` in `folder` with what its evaluation found: writes the scores, makes the page if the session asks
/// for one, seals the files and writes `run.json`.
///
/// # Errors
/// [`Error::Write`]; a damaged file of the training.
pub(crate) fn conclude(
    folder: &RunFolder,
    pipeline: &Pipeline,
    facts: &mut Facts,
    (data, partition, model): (&Dataset, &Partition, &Ensemble),
    (scores, confidence): (Scores, Option<Confidence>),
    session: &mut Session<'_>,
) -> Result<ScoreTable> {
    let path = folder.path();
    facts.gaussians = model.gaussians();
    facts.scores = Some(scores.table.clone());
    facts.finished = Some(clock::now());
    facts.report = session.page.is_some();
    facts.note_memory(); // here, so that the page says what run.json says
    write_scores(path, (&scores, confidence.as_ref()), data, partition)?;
    if let Some(page) = session.page {
        let record = Record::of(path, pipeline, facts.clone())?;
        write_page(&LoadedRun { record: &record, data, partition, model }, page)?;
    }
    facts.seal(path)?;
    facts.write(path)?;
    session.observer.on_evaluation(&scores.table);
    Ok(scores.table)
}

/// Makes `report.html` of the finished run in `folder` again, from its folder and its data.
///
/// # Errors
/// The run has not finished, another process is at work in it, a file is damaged, or the data have changed since.
pub fn rebuild_page(folder: &Path, page: Page, observer: &mut dyn Observer) -> Result<()> {
    let held = RunFolder::claim(folder, &read_pipeline(&folder.join(PIPELINE), &[])?)?;
    let mut rebuild = || {
        let unfinished = || Error::Config(format!("{} has not finished; run it first", held.name().display()));
        let record = Record::read(held.path())?.ok_or_else(unfinished)?;
        let data = record.load_data(observer)?;
        let (partition, model) = (record.partition(&data)?, record.model(&data)?);
        let text = page(&LoadedRun { record: &record, data: &data, partition: &partition, model: &model })?;
        let path = held.file(REPORT);
        let mark = Mark::of(text.as_bytes());
        if record.facts.files.get(REPORT) == Some(&mark) && files::read(&path).is_ok_and(|own| Mark::of(&own) == mark) {
            return Ok(());
        }
        // A mark is never of another page than the one that lies there.
        let mut facts = Facts { report: true, ..record.facts };
        facts.files.remove(REPORT);
        facts.write(held.path())?;
        write_atomically(&path, text.as_bytes())?;
        facts.files.insert(REPORT.into(), mark);
        facts.write(held.path())
    };
    let rebuilt = rebuild();
    held.settle(rebuilt)
}
