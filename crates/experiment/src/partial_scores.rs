//! `PartialScores`: results of a scoring that several starts of a command complete.

use crate::folder::PARTIAL_SCORES;
use crate::{VERSION, load::SplitData};
use pwrfgs_core::files::{self, GrowingFile, digest, if_found};
use pwrfgs_core::{Error, Real, Result, device};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::data_digest;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::path::Path;

/// Results of the parts of a scoring, such as the measurements of one predictor. Each is a line of the file
/// [`PARTIAL_SCORES`]: a digest of request and result, the name of the part, and the result as JSON.
#[derive(Default)]
pub(crate) struct PartialScores {
    /// Digest of all that the results depend on.
    request: String,
    /// Results of earlier starts as JSON, by part.
    known: BTreeMap<String, String>,
    /// File that grows by each further part; `None` without a folder.
    file: Option<GrowingFile>,
}

impl PartialScores {
    /// Opens the results in `folder` of earlier starts that scored the same model on the same data, with the same settings.
    /// The file is cut before the first line of another request, or the first incomplete line.
    ///
    /// # Errors
    /// A file that cannot be read or written.
    pub(crate) fn open(folder: &Path, model: &Ensemble, pipeline: &Pipeline, split: &SplitData) -> Result<Self> {
        let path = folder.join(PARTIAL_SCORES);
        let model = digest(&file::ensemble_to_bytes(model));
        let SplitData { data, partition } = split;
        let (settings, data) = (pipeline.to_ron()?, data_digest(data));
        let rounding = (size_of::<Real>(), device::name());
        let request = digest(format!("{VERSION} {rounding:?} {settings} {model} {data} {partition:?}").as_bytes());
        let text = if_found(&path, files::read(&path))?.unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let mut scores = Self { request, ..Self::default() };
        let mut length = 0;
        for line in text.split_inclusive('\n') {
            let Some((part, result)) = scores.parse_line(line) else { break };
            scores.known.insert(part.into(), result.into());
            length += line.len() as u64;
        }
        scores.file = Some(GrowingFile::resume(path, &[], length)?);
        Ok(scores)
    }

    /// Returns part and result of a line of the file; `None` if it is incomplete or of another request.
    fn parse_line<'l>(&self, line: &'l str) -> Option<(&'l str, &'l str)> {
        let (seal, entry) = line.strip_suffix('\n')?.split_once(' ')?;
        entry.split_once('\t').filter(|_| seal == self.seal(entry))
    }

    /// Returns the digest of this request with an entry.
    fn seal(&self, entry: &str) -> String {
        digest(format!("{} {entry}", self.request).as_bytes())
    }

    /// Returns the result of `part`: that of an earlier start, or that of `work`, which is then written. JSON has no numbers
    /// that are not finite; results with such numbers are computed again.
    ///
    /// # Errors
    /// Errors of `work`; a file that cannot be written.
    pub(crate) fn complete<T: Serialize + DeserializeOwned>(
        &mut self,
        part: &str,
        work: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        if let Some(result) = self.known.remove(part).and_then(|text| serde_json::from_str(&text).ok()) {
            return Ok(result);
        }
        let result = work()?;
        let text = serde_json::to_string(&result).map_err(|e| Error::Config(format!("{PARTIAL_SCORES}: {e}")))?;
        let entry = format!("{part}\t{text}");
        let line = format!("{} {entry}\n", self.seal(&entry));
        if let Some(file) = &mut self.file {
            file.append(line.as_bytes())?;
            file.flush()?;
        }
        Ok(result)
    }
}
