//! `Loaded`: the data behind a setting, for figures that need more than scores.

use crate::study::{Record, Setting};
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_experiment::Silent;
use pwrfgs_model::{Ensemble, file};
use std::path::Path;

/// What all runs of a setting were trained and tested on.
pub(super) struct Loaded {
    pub(super) data: Dataset,
}

impl Loaded {
    /// Reads or simulates the spectra again; paths in a run's pipeline are absolute.
    pub(super) fn of(setting: &Setting) -> Result<Self> {
        let first = &setting.variants[0].runs[0];
        let (data, _) = pwrfgs_experiment::load(&first.pipeline, Path::new(""), &mut Silent)?;
        let loaded = Self { data };
        loaded.partition(first)?;
        Ok(loaded)
    }

    /// How a run divided them.
    pub(super) fn partition(&self, run: &Record) -> Result<Partition> {
        let partition = run.pipeline.partition(&self.data)?;
        let sizes = [&partition.train, &partition.validation, &partition.test].map(Vec::len);
        if sizes != run.facts.samples || self.data.title != run.facts.data {
            return Err(Error::input(&run.folder, "the data have changed since this run; run it again"));
        }
        Ok(partition)
    }

    /// What a run has trained.
    pub(super) fn model(&self, run: &Record) -> Result<Ensemble> {
        let path = run.model_file();
        let model = file::read_ensemble(&path)?;
        let plane = model.plane();
        if (plane.width, plane.height) != (self.data.width, self.data.height) {
            return Err(Error::input(&path, "the model's observations are of another size than the data hold"));
        }
        Ok(model)
    }
}
