//! `pwrfgs inspect`: a summary of data before training.

use super::changes::named;
use super::init::name_of;
use crate::args::Verbosity;
use crate::output;
use crate::progress::Progress;
use clap::Args;
use pwrfgs::experiment::inspect as summary;
use pwrfgs::experiment::{Observer as _, data_warnings, read_pipeline, staged};
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::plugin::try_to_ron;
use pwrfgs_core::{Error, Result, recognise};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
#[command(
    after_long_help = "Prints positions, values, unusual spectra, whether the recorded pose can be right, and for each split \
    the distance from test to training transmitters and the scores of baselines. Trains nothing and writes nothing.\n\n\
    A pipeline gives its data, split, baselines, metrics and seed; a folder of data is read with all defaults.\n\nEXAMPLES\n  \
    pwrfgs inspect data/s23\n  pwrfgs inspect pipelines/quickstart.ron\n  pwrfgs inspect pipelines/s23-array.ron \
    --set data.root=/where/it/is/s23"
)]
pub(crate) struct Inspect {
    /// A folder of data (the layouts of NeRF2, arrays as `pwrfgs import` writes them, channels), a pipeline file, or a run folder
    #[arg(value_name = "DATA")]
    pub(crate) data: PathBuf,
    /// Change a setting, such as data.root=data/other or 'split=Random(test: 0.3)'
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
}

pub(crate) fn inspect(arguments: &Inspect, verbosity: Verbosity) -> Result<ExitCode> {
    let pipeline = pipeline(&arguments.data, &arguments.set)?;
    let mut progress = Progress::new(verbosity);
    let text = (|| {
        let data = staged(&mut progress, "spectra", |progress| pipeline.data.load(Path::new(""), progress))?;
        let partition = pipeline.partition(&data).ok().filter(|_| !pipeline.split.is_sparse());
        data_warnings(&data, partition.as_ref()).iter().for_each(|warning| progress.on_warning(warning));
        summary::inspect(&pipeline, &data, &mut progress)
    })();
    progress.finish();
    output::result(&text?)?;
    Ok(ExitCode::SUCCESS)
}

/// The pipeline that `path` names, or one of all defaults for the data in that folder.
fn pipeline(path: &Path, set: &[String]) -> Result<Pipeline> {
    let Some(source) = recognise(path) else {
        let pipeline = named(path).map_err(|_neither| {
            let what = "holds neither data (spectra, received powers or channels) nor a run; give a folder of data";
            Error::input(path, format!("{what}, a pipeline file, or the folder of a run"))
        });
        return read_pipeline(&pipeline?.0, set);
    };
    // Fields that are left out then get the defaults for this kind of data.
    let data = try_to_ron(&source).map_err(|why| Error::input(path, why))?;
    let text = format!("Pipeline(name: {:?}, data: {data}, initializer: Random())", name_of(path));
    let mut pipeline = Pipeline::parse(&text, path)?;
    pipeline.set_all(set)?;
    Ok(pipeline)
}
