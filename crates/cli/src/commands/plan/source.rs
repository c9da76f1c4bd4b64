//! Positions of a plan: candidates, and known measurements.

use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::data::read_transmitters;
use pwrfgs::experiment::folder::{MODEL_FILE, PIPELINE};
use pwrfgs::experiment::sweep::LISTING;
use pwrfgs::experiment::text::{grouped, number};
use pwrfgs::experiment::{model_file, staged};
use pwrfgs::model::file;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Dataset, Error, Location, Receiver, Result, evenly, recognise};
use std::path::{Path, PathBuf};

/// Largest number of candidates, and of covariances between candidates and region.
const MOST: usize = 20_000;
const MOST_PAIRS: usize = 1 << 25;
/// Largest number of known measurements that are used, evenly chosen.
const MOST_KNOWN: usize = 2_000;
/// Largest distance of the candidates from the known measurements, in diagonals of these.
const FAR: f64 = 10.0;

#[derive(Debug, Args)]
pub(crate) struct PlaceOptions {
    /// Data folder, run folder or model file
    #[arg(value_name = "SOURCE", required_unless_present_any = ["candidates", "floor"])]
    pub(crate) source: Option<PathBuf>,
    /// CSV file of candidates: columns x, y, z in metres; others are ignored
    #[arg(long, value_name = "FILE", conflicts_with = "floor")]
    pub(crate) candidates: Option<PathBuf>,
    /// Candidates on a grid over the floor of this scene, outside its objects
    #[arg(long, value_name = "SCENE")]
    pub(crate) floor: Option<PathBuf>,
    /// Grid spacing of --floor in metres
    #[arg(long, value_name = "M", default_value_t = 0.25, requires = "floor")]
    pub(crate) step: f64,
    /// Height of --floor in metres
    #[arg(long, value_name = "M", default_value_t = 1.2, requires = "floor", allow_negative_numbers = true)]
    pub(crate) height: f64,
}

/// Positions of a plan, metres, world frame.
#[derive(Default)]
pub(super) struct Places {
    pub(super) title: String,
    pub(super) candidates: Vec<[f64; 3]>,
    /// Positions with measurements.
    pub(super) measured: Vec<[f64; 3]>,
    pub(super) receivers: Vec<[f64; 3]>,
    /// Observations at `measured`, or at the candidates if that is empty.
    pub(super) data: Option<Dataset>,
}

impl Places {
    /// Returns the candidates for which `is_inside` holds, evenly thinned so that their covariances with all candidates
    /// fit into memory.
    pub(super) fn thinned_candidates(&self, is_inside: impl Fn([f64; 3]) -> bool) -> Vec<[f64; 3]> {
        let positions: Vec<[f64; 3]> =
            self.candidates.iter().copied().filter(|position| is_inside(*position)).collect();
        evenly(&positions, MOST_PAIRS / self.candidates.len().max(1))
    }

    /// Returns `simulated ` if the observations are, else an empty text.
    pub(super) fn simulated_prefix(&self) -> &'static str {
        if self.data.as_ref().is_some_and(Dataset::is_simulated) { "simulated " } else { "" }
    }
}

/// Reads the positions that the arguments name; an error without candidates, or with more than [`MOST`].
pub(super) fn read_places(arguments: &PlaceOptions, progress: &mut RunProgress) -> Result<Places> {
    let mut places =
        arguments.source.as_ref().map_or_else(|| Ok(Places::default()), |path| read_measured(path, progress))?;
    let new = match (&arguments.candidates, &arguments.floor) {
        (Some(path), _) => Some((read_transmitters(path)?, path)),
        (_, Some(path)) => Some((floor_positions(path, arguments.step, arguments.height)?, path)),
        _ => None,
    };
    match new {
        Some((candidates, path)) => {
            check_distance(&candidates, &places.measured, path)?;
            places.candidates = candidates;
            places.measured = evenly(&places.measured, MOST_KNOWN);
            if places.title.is_empty() {
                places.title = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            }
        }
        None if places.data.is_some() => places.candidates = std::mem::take(&mut places.measured),
        None => {
            let problem = "a model has no candidates; set --candidates FILE or --floor SCENE, or name a data folder";
            return Err(Error::Config(problem.into()));
        }
    }
    if places.candidates.len() > MOST {
        let (count, most) = (grouped(places.candidates.len() as i64), grouped(MOST as i64));
        return Err(Error::Config(format!(
            "{count} candidates, expected at most {most}; give fewer, or a larger --step"
        )));
    }
    Ok(places)
}

/// Reads the measured positions of a data folder, run folder or model, without candidates; an error if it has none.
fn read_measured(path: &Path, progress: &mut RunProgress) -> Result<Places> {
    if let Some(source) = recognise(path) {
        let data = staged(progress, "data", |progress| source.load(Path::new(""), progress))?;
        if !data.placed || data.features.is_some() {
            return Err(Error::input(path, "has no transmitter positions; name data with positions"));
        }
        let position = |receiver: &Receiver| data.scene.origin.world_pose(receiver.pose).position;
        return Ok(Places {
            title: data.title.clone(),
            measured: data.locations.iter().map(Location::position).collect(),
            receivers: data.scene.receivers.iter().map(position).collect(),
            candidates: Vec::new(),
            data: Some(data),
        });
    }
    // Sweeps and unfinished runs have errors of their own.
    if path.is_dir() && ![MODEL_FILE, PIPELINE, LISTING].iter().any(|name| path.join(name).is_file()) {
        let advice = "name a data folder (layouts: docs/data.md), a run folder or a model file";
        return Err(Error::input(path, format!("neither data nor a run found; {advice}")));
    }
    let model = model_file(path)?;
    let ensemble = file::read_ensemble(&model)?;
    let measured = ensemble.training_positions();
    if measured.is_empty() {
        return Err(Error::input(&model, "has no training positions; name the data folder of its training"));
    }
    let setup = &ensemble.members()[0].stages.setup;
    let receivers = setup.receivers.iter().map(|receiver| setup.origin.world_pose(receiver.pose).position);
    let title = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Places { title, measured, receivers: receivers.collect(), ..Places::default() })
}

/// Rejects candidates of which all are far from the known measurements: probably another frame or unit. `path` is their
/// file.
fn check_distance(candidates: &[[f64; 3]], measured: &[[f64; 3]], path: &Path) -> Result<()> {
    let Some(first) = measured.first() else { return Ok(()) };
    let extent = measured.iter().map(|position| distance(*position, *first)).fold(0.0, f64::max).max(1.0);
    let gap =
        |position: &[f64; 3]| measured.iter().map(|near| distance(*near, *position)).fold(f64::INFINITY, f64::min);
    let nearest = evenly(candidates, 100).iter().map(gap).fold(f64::INFINITY, f64::min);
    if nearest <= FAR * extent {
        return Ok(());
    }
    let [gap, extent] = [nearest, extent].map(number);
    Err(Error::input(
        path,
        format!(
            "candidates are {gap} m from the nearest known measurement, and these extend over {extent} m; give both in metres \
             in one frame"
        ),
    ))
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
