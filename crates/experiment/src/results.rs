//! `Results`: what a run has found, as one record that a report is made of.

use crate::evaluate::Assessment;
use crate::facts::Facts;
use crate::folder::{CONFIDENCE, REPORT, SAMPLES, SCORES};
use crate::observer::Validation;
use crate::samples;
use pwrfgs_core::files::write_atomically;
use pwrfgs_core::{Dataset, Partition, Result};
use pwrfgs_model::Ensemble;
use pwrfgs_pipeline::Pipeline;
use std::path::Path;

/// Makes the page of a run, HTML in one file.
pub type Page = fn(&Results<'_>) -> Result<String>;

/// An evaluated model and all that is known of it.
#[derive(Clone, Debug)]
pub struct Results<'a> {
    /// Data, split, baselines and metrics; of one model also how it was made.
    pub pipeline: &'a Pipeline,
    /// How it was made, every setting as RON text.
    pub settings: String,
    /// The model, or several that predict together.
    pub model: &'a Ensemble,
    /// The data it was scored on.
    pub data: &'a Dataset,
    /// And their split.
    pub partition: &'a Partition,
    /// The scores.
    pub assessment: &'a Assessment,
    /// Circumstances.
    pub facts: &'a Facts,
    /// The folder where curves and snapshots of the training lie, where there was one.
    pub training: Option<&'a Path>,
    /// What each baseline, having seen the training part alone, reaches on the samples that validation looks at.
    pub floors: Vec<(String, Validation)>,
}

impl Results<'_> {
    /// Writes `scores.csv`, `samples.csv`, of an ensemble `confidence.csv`, and where there is a `page` `report.html` into
    /// `folder`.
    ///
    /// # Errors
    /// Where the folder cannot be written.
    pub fn write(&self, folder: &Path, page: Option<Page>) -> Result<()> {
        let put = |name: &str, text: String| write_atomically(&folder.join(name), text.as_bytes());
        put(SCORES, self.assessment.scores.to_csv())?;
        put(SAMPLES, samples::to_csv(self.data, self.partition))?;
        if let Some(confidence) = &self.assessment.confidence {
            put(CONFIDENCE, confidence.to_csv())?;
        }
        page.map_or(Ok(()), |page| put(REPORT, page(self)?))
    }
}
