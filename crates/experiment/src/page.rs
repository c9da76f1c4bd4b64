//! Results and report of a run: written at its end; `pwrfgs report` recreates the report from the folder.

use crate::evaluate::EvaluationResult;
use crate::facts::{Facts, FileDigest, utc_now};
use crate::folder::{CONFIDENCE, PARTIAL_SCORES, PIPELINE, REPORT, RESUME_ONLY, SAMPLES, SCORES, member_folder};
use crate::input::read_pipeline;
use crate::load::{ActiveRun, SplitData, load_with_findings};
use crate::record::Record;
use crate::residuals::trained_links;
use crate::run_folder::RunFolder;
use crate::samples::samples_csv;
use crate::scores::ScoreTable;
use crate::session::{LoadedRun, Observer, PageBuilder};
use pwrfgs_core::files::{self, write_atomically};
use pwrfgs_core::{Dataset, Error, Result};
use pwrfgs_model::Ensemble;
use std::path::Path;

impl Record {
    /// Loads or simulates the data of the run again.
    ///
    /// # Errors
    /// Invalid data, or data that have changed since the run.
    pub fn load_data(&self, observer: &mut dyn Observer) -> Result<Dataset> {
        let (SplitData { data, .. }, _) = load_with_findings(&self.pipeline, None, observer)?;
        self.partition(&data).map(|_| data)
    }
}

impl ActiveRun<'_, '_> {
    /// Writes the results of an evaluation into `folder`: `samples.csv`, `scores.csv`, for an ensemble `confidence.csv`, and
    /// `report.html` if the session has a `page`.
    ///
    /// # Errors
    /// A damaged training file; [`Error::Write`]; errors of the `page`.
    pub fn write_results(
        &self,
        folder: &Path,
        facts: &Facts,
        model: &Ensemble,
        EvaluationResult { scores, confidence }: &EvaluationResult,
    ) -> Result<()> {
        let SplitData { data, partition } = self.split;
        let write = |name: &str, text: String| write_atomically(&folder.join(name), text.as_bytes());
        let trained = trained_links(self.pipeline, partition);
        write(SAMPLES, samples_csv(data, partition, &trained, &scores.intervals))?;
        write(SCORES, scores.to_csv())?;
        confidence.as_ref().map_or(Ok(()), |confidence| write(CONFIDENCE, confidence.to_csv()))?;
        let Some(page) = self.session.page else { return Ok(()) };
        let record = Record::of(folder, self.pipeline, facts.clone())?;
        write(REPORT, page(&LoadedRun { record: &record, data, partition, model })?)
    }

    /// Concludes the run in `folder`: writes the scores, the report if the session has a `page`, the checksums and
    /// `run.json`, and removes the partial scores, and the checkpoint unless the session keeps it. Returns the summary of the
    /// scores, which the observer also gets.
    ///
    /// # Errors
    /// As [`Self::write_results`]; a file that cannot be read.
    pub(crate) fn conclude(
        &mut self,
        folder: &RunFolder,
        mut facts: Facts,
        model: &Ensemble,
        result: EvaluationResult,
    ) -> Result<ScoreTable> {
        let path = folder.path();
        facts.gaussians = model.gaussians();
        facts.scores = Some(result.scores.table.clone());
        facts.finished = Some(utc_now());
        facts.report = self.session.page.is_some();
        facts.update_peak_memory(); // here, so that report and run.json agree
        self.write_results(path, &facts, model, &result)?;
        facts.seal(path)?;
        if !self.session.keep_checkpoint {
            self.remove_resume_files(folder);
        }
        files::remove(&folder.file(PARTIAL_SCORES));
        facts.write(path)?;
        self.session.observer.on_evaluation(&result.scores.table);
        Ok(result.scores.table)
    }

    /// Removes what only a resumed training reads, from the folder of the run and of its models. Failures are ignored.
    fn remove_resume_files(&self, folder: &RunFolder) {
        let members = (0..self.pipeline.members).map(|index| folder.file(&member_folder(index)));
        for run in members.chain([folder.path().to_owned()]) {
            RESUME_ONLY.iter().for_each(|name| files::remove(&run.join(name)));
        }
    }
}

/// Calls `read` with the finished run in `folder` and its data and model, and returns the result.
///
/// # Errors
/// The run has not finished, a file is damaged, or the data have changed; errors of `read`.
pub fn with_run<T>(
    folder: &Path,
    observer: &mut dyn Observer,
    read: impl FnOnce(&LoadedRun<'_>) -> Result<T>,
) -> Result<T> {
    let unfinished = || Error::Config(format!("{} has not finished; run it first", folder.display()));
    let record = Record::read(folder)?.ok_or_else(unfinished)?;
    let data = record.load_data(observer)?;
    let (partition, model) = (record.partition(&data)?, record.model(&data)?);
    read(&LoadedRun { record: &record, data: &data, partition: &partition, model: &model })
}

/// Recreates `report.html` of the finished run in `folder` from its folder and data.
///
/// # Errors
/// The run has not finished, another process uses it, a file is damaged or cannot be written, or the data have changed; errors
/// of `page`.
pub fn rebuild_page(folder: &Path, page: PageBuilder, observer: &mut dyn Observer) -> Result<()> {
    let run_folder = RunFolder::claim(folder, &read_pipeline(&folder.join(PIPELINE), &[])?)?;
    let mut rebuild = || {
        let (text, facts) = with_run(run_folder.path(), observer, |run| Ok((page(run)?, run.record.facts.clone())))?;
        let path = run_folder.file(REPORT);
        let digest = FileDigest::of(text.as_bytes());
        if facts.files.get(REPORT) == Some(&digest)
            && files::read(&path).is_ok_and(|bytes| FileDigest::of(&bytes) == digest)
        {
            return Ok(());
        }
        // The checksum always belongs to the current page.
        let mut facts = Facts { report: true, ..facts };
        facts.files.remove(REPORT);
        facts.write(run_folder.path())?;
        write_atomically(&path, text.as_bytes())?;
        facts.files.insert(REPORT.into(), digest);
        facts.write(run_folder.path())
    };
    let rebuilt = rebuild();
    run_folder.settle(rebuilt)
}
