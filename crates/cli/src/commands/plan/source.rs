//! Positions of a plan: candidates, and known measurements.

use crate::commands::options::in_file;
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::read_transmitters;
use pwrfgs::experiment::folder::{MODEL_FILE, PIPELINE};
use pwrfgs::experiment::sweep::LISTING;
use pwrfgs::experiment::{read_model, run_stage};
use pwrfgs::tasks::plan::PlanInput;
use pwrfgs_core::{Error, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub(crate) struct PositionOptions {
    /// Data folder, run folder, model file or name of a model in `pwrfgs pipelines`
    #[arg(value_name = "SOURCE", required_unless_present_any = ["candidates", "floor"])]
    pub(crate) source: Option<PathBuf>,
    /// CSV file of candidates: columns x, y, z in metres; other columns are ignored
    #[arg(long, value_name = "FILE", conflicts_with = "floor")]
    pub(crate) candidates: Option<PathBuf>,
    /// Candidates on a grid over the floor of this scene, outside its objects
    #[arg(long, value_name = "SCENE")]
    pub(crate) floor: Option<PathBuf>,
    /// Grid spacing of --floor in metres
    #[arg(long, value_name = "M", default_value_t = 0.25, requires = "floor")]
    pub(crate) step: f64,
    /// Height of the positions of --floor in metres
    #[arg(long, value_name = "M", default_value_t = 1.2, requires = "floor", allow_negative_numbers = true)]
    pub(crate) height: f64,
}

/// Reads the positions that the arguments name.
pub(super) fn read_positions(arguments: &PositionOptions, progress: &mut RunProgress) -> Result<PlanInput> {
    let positions =
        arguments.source.as_ref().map_or_else(|| Ok(PlanInput::default()), |path| read_source(path, progress))?;
    let (candidates, path) = match (&arguments.candidates, &arguments.floor) {
        (Some(path), _) => (read_transmitters(path)?, path),
        (_, Some(path)) => (floor_positions(path, arguments.step, arguments.height)?, path),
        _ => return Ok(positions),
    };
    let positions = positions.with_candidates(candidates, path)?;
    let title = if positions.title.is_empty() { stem(path) } else { positions.title.clone() };
    Ok(PlanInput { title, ..positions })
}

/// Returns the name of a file without its extension.
fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Reads the positions of a data folder, run folder or model.
fn read_source(path: &Path, progress: &mut RunProgress) -> Result<PlanInput> {
    if let Some(source) = recognise(path) {
        let data = run_stage(progress, "data", |progress| source.load(Path::new(""), progress))?;
        return PlanInput::of_data(data).map_err(in_file(path));
    }
    // Sweeps and unfinished runs have errors of their own.
    if path.is_dir() && ![MODEL_FILE, PIPELINE, LISTING].iter().any(|name| path.join(name).is_file()) {
        let advice = "name a data folder (layouts: docs/data.md), a run folder or a model file";
        return Err(Error::input(path, format!("neither data nor a run found; {advice}")));
    }
    let positions = PlanInput::of_model(&read_model(path)?, &stem(path));
    positions.ok_or_else(|| Error::input(path, "has no training positions; name the data folder of its training"))
}

/// Creates positions on a grid over the floor of the scene in `path`, outside its objects, in rows of alternating
/// direction; metres.
#[cfg(feature = "raytrace")]
fn floor_positions(path: &Path, step: f64, height: f64) -> Result<Vec<[f64; 3]>> {
    pwrfgs::planning::floor_grid(&pwrfgs::raytrace::SceneFile::read(path)?, step, height)
}

/// Rejects scenes, which need the feature `raytrace`.
#[cfg(not(feature = "raytrace"))]
fn floor_positions(_: &Path, _: f64, _: f64) -> Result<Vec<[f64; 3]>> {
    Err(Error::Config("--floor: this build has no scenes; build with the feature `raytrace`".into()))
}
