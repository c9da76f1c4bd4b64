//! `pwrfgs locate`: positions of transmitters from their observations.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::load_split_data;
use pwrfgs::experiment::text::grouped;
use pwrfgs::tasks::locate::{
    LocateSettings, ReadFeatures, UnlocatedObservations, locate as locate_model, read_known_pipeline,
};
use pwrfgs::tasks::{check_positions, read_models};
use pwrfgs_core::Result;
use pwrfgs_core::files::NewFolder;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "\
The command compares an observation with one fingerprint per training position: a weighted mean of
the measured observation and the prediction of the model. The result is a probability density over
the floor. Its 90 % region is calibrated to contain nine of ten validation samples. The estimate is
the most probable position in the most probable part of this region. Up to 1,000 validation samples
determine the weights, the size of the regions, and whether an optimiser refines the estimate by the
predictions of the model. Regions need at least 9 validation samples: train with a validation set,
such as split=Voxel(size_m: 0.3, validation: 0.1).

If OBSERVATIONS are given for a model without pipeline.ron, or for a model in the program without
--set, the fingerprints are the predictions of the model at the training positions in its file, and
there are no regions.

Without OBSERVATIONS, the command locates the test samples of the model's data. It prints the errors
of the model and of up to three baselines: nearest fingerprints, fingerprints predicted by Kriging,
and the mean of the training positions. With OBSERVATIONS, the command prints the estimates and, if
the run has validation samples, the errors of estimates for up to 200 of these samples.

OBSERVATIONS of B transmitters (spectra and channels only of models with one receiver)
  spectra   .png, or .npy [B, height, width]
  powers    .csv with a column per receiver (dBm), or .npy [B, receivers]; empty or NaN: unknown
  channels  .npy [B, antennas, subcarriers], complex
FILES of --out
  locations.csv  estimate; true position and error, if known; misfit to the best fingerprint (1:
                 typical; far above 1: unlike all fingerprints); area and number of parts of region
  regions.json   outlines of every region in metres; a region may have several parts
  errors.png     estimates, and true positions if known
  00001.png ..   density and region of single samples, named by id or number of the observation

EXAMPLES
  pwrfgs locate runs/ble --out located
  pwrfgs locate runs/ble powers.csv --prior 10,30,10,40
  pwrfgs locate s23 spectrum.png")]
pub(crate) struct Locate {
    /// Run folder, model file or name of a model in `pwrfgs pipelines`, such as s23
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Observations of unknown transmitters [default: test samples of the data]
    #[arg(value_name = "OBSERVATIONS")]
    pub(crate) observations: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) settings: LocateSettings,
    /// Change a setting of the pipeline, such as data.root=data/ble; repeatable
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
    /// Continue despite this finding (a fault in data or observations that an error names), such as lone-value; repeatable
    #[arg(long, value_name = "FINDING")]
    pub(crate) accept: Vec<String>,
    /// Number of samples with an image of the probability density in --out
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub(crate) pictures: usize,
    /// Output folder; must be new or empty [default: write no files]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// Runs `pwrfgs locate`: prints the table of positions or errors, and writes the files of `--out`.
pub(crate) fn locate(arguments: &Locate, verbosity: Verbosity) -> Result<()> {
    let ensemble = read_models(std::slice::from_ref(&arguments.model))?;
    check_positions(&ensemble)?;
    let observations = arguments.observations.as_ref();
    let mut pipeline = read_known_pipeline(Some(&arguments.model), &arguments.set, observations.is_some())?;
    pipeline.iter_mut().for_each(|pipeline| pipeline.accept.extend(arguments.accept.iter().cloned()));
    let folder = arguments.out.as_ref().map(|out| NewFolder::begin(out)).transpose()?;
    let load = |pipeline: &_| RunProgress::observe(verbosity, |progress| load_split_data(pipeline, progress));
    let split = pipeline.as_ref().map(load).transpose()?;
    let accepted = pipeline.as_ref().map_or(&arguments.accept, |pipeline| &pipeline.accept);
    let read = observations.map(|path| {
        move |features: &_, data: &_| UnlocatedObservations { path, features, data, accepted }.read_features()
    });
    let read = read.as_ref().map(|read| read as ReadFeatures<'_>);
    let pictures = if folder.is_some() { arguments.pictures } else { 0 };
    let located = RunProgress::observe(verbosity, |progress| {
        locate_model(&ensemble, split.as_ref(), read, &arguments.settings, pictures, progress)
    })?;
    if let (Some(folder), Some(out)) = (folder, &arguments.out) {
        located.write(&folder)?;
        folder.publish()?;
        verbosity.print_note(&format!("{} positions in {}", grouped(located.rows.len() as i64), out.display()));
    }
    output::print_result(&located.text)
}
