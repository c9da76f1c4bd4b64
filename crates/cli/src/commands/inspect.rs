//! `pwrfgs inspect`: what to know of data before training.

use super::changes::named;
use super::init::name_of;
use crate::args::Verbosity;
use crate::output;
use crate::progress::Progress;
use clap::Args;
use pwrfgs::data::source_in;
use pwrfgs::experiment::{Observer as _, data_warnings, read_pipeline, staged};
use pwrfgs::inspect as work;
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::plugin::{Plugin, try_to_ron};
use pwrfgs_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
#[command(
    after_long_help = "Writes inspect.html (one file, nothing outside it) and says the same in short here:\n\n  samples, \
    extent, steps from an id to the next, receiver and boresight;\n  how pictures are normalised; constant, saturated and \
    equal ones; positions without a picture;\n  how many numbers the pictures are made of, and whether a planar array of \
    which spacing heard them;\n  whether the recorded pose can be right: the strongest direction against the line of \
    sight, and the rotation that fits best;\n  for each split the distance from test to training transmitters, and what \
    predictors without a model reach;\n  how alike spectra of one place are: what no function of the position can exceed \
    by much.\n\nA pipeline gives its data, split, baselines, metrics and seed; a folder of data is looked at with all \
    defaults. Nothing is trained. Of more than 20,000 pictures so many are looked at, evenly chosen, and floors are \
    scored on up to 300 test spectra a split. An older page in the folder is replaced; a folder that holds anything else \
    is never touched.\n\nEXAMPLES\n  pwrfgs inspect data/s23\n  pwrfgs inspect pipelines/quickstart.ron --out looked\n  \
    pwrfgs inspect pipelines/s23-array.ron --set data.root=/where/it/is/s23"
)]
pub(crate) struct Inspect {
    /// A folder of data (the layouts of NeRF2, arrays as `pwrfgs import` writes them, channels), a pipeline file, or a run folder
    #[arg(value_name = "DATA")]
    pub(crate) data: PathBuf,
    /// Where to write the page [default: inspect-NAME where you stand, after the folder or the pipeline]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Change a setting, such as data.root=data/other or 'split=Random(test: 0.3)'
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
}

pub(crate) fn inspect(arguments: &Inspect, verbosity: Verbosity) -> Result<ExitCode> {
    let pipeline = pipeline(&arguments.data, &arguments.set)?;
    let out = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("inspect-{}", pipeline.name)));
    work::claim(&out)?;
    let mut progress = Progress::new(verbosity);
    let written = (|| {
        let data = staged(&mut progress, "spectra", |progress| pipeline.data.load(Path::new(""), progress))?;
        let partition = pipeline.partition(&data).ok().filter(|_| !pipeline.split.is_sparse());
        data_warnings(&data, partition.as_ref()).iter().for_each(|warning| progress.on_warning(warning));
        let found = work::inspect(&pipeline, &data, &mut progress)?;
        Ok((work::write(&found, &out)?, found.text()))
    })();
    progress.finish();
    let (page, text) = written?;
    output::result(&format!("{text}\npage: {}\n", page.display()))?;
    Ok(ExitCode::SUCCESS)
}

/// The pipeline that `path` names, or one of all defaults for the data in that folder.
fn pipeline(path: &Path, set: &[String]) -> Result<Pipeline> {
    let Some((_, _, source)) = source_in(path) else {
        let pipeline = named(path).map_err(|_neither| {
            let what = "holds neither data (spectra, received powers or channels) nor a run; give a folder of data";
            Error::input(path, format!("{what}, a pipeline file, or the folder of a run"))
        });
        return read_pipeline(&pipeline?.0, set);
    };
    // Fields that are left out then get the defaults for this kind of data.
    let data = try_to_ron(&Plugin::from(source)).map_err(|why| Error::input(path, why))?;
    let text = format!("Pipeline(name: {:?}, data: {data}, initializer: Random())", name_of(path));
    let mut pipeline = Pipeline::parse(&text, path)?;
    pipeline.set_all(set)?;
    Ok(pipeline)
}
