//! The data of a pipeline, loaded and split.

use crate::data_warnings::data_warnings;
use crate::observer::{Observer, staged};
use pwrfgs_core::{Dataset, Error, Partition, Result};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;

/// Loads the data of a pipeline and divides them.
///
/// # Errors
/// Whatever is wrong with the data, or a split that leaves nothing to train on or to test.
pub fn load(pipeline: &Pipeline, base: &Path, observer: &mut dyn Observer) -> Result<(Dataset, Partition)> {
    let data = staged(observer, "spectra", |progress| pipeline.data.load(base, progress))?;
    let partition = pipeline.partition(&data)?;
    for (part, name) in [(&partition.train, "training"), (&partition.test, "test")] {
        if part.is_empty() {
            return Err(Error::Config(format!("split: no sample is left for the {name} part; change `split`")));
        }
    }
    let judged = (!pipeline.split.is_sparse()).then_some(&partition);
    data_warnings(&data, judged).iter().for_each(|warning| observer.on_warning(warning));
    Ok((data, partition))
}
