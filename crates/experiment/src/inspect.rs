//! Checks before training: [`preview`] for `pwrfgs check` (size and cost of a run, with a [`DataSummary`]), and
//! [`Inspection`] for `pwrfgs inspect` (the summary, and all splits with their baselines).

mod cost;
mod floor;
mod inspection;

pub use crate::findings::pose::{Correction, PoseCheck, PoseVerdict};
pub use inspection::{Inspection, SplitScores};

use crate::findings::channels::PhaseCheck;
use crate::findings::{cloud, pose, spectra};
use crate::input::resolve_pipeline;
use crate::load::{SplitData, describe_observations, load_split_data};
use crate::repeatability::is_in_time_order;
use crate::residuals::check_residuals;
use crate::samples::nearest_training_distances;
use crate::session::{Observer, run_stage};
use crate::text::{format_length, grouped, number};
use crate::training::{device_warnings, new_trainer};
use pwrfgs_core::files;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::statistics::{median, quantile, sorted};
use pwrfgs_core::{Dataset, Partition, Result, Unmatched, device, free_memory, peak_memory};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::{TimeEstimate, Trainer};
use std::fmt::Write as _;
use std::path::Path;

/// Largest number of spectra that a preview reads for its summary.
const SUMMARISED: usize = 1_000;

/// Size and cost of a run.
#[derive(Clone, Debug)]
pub struct Preview {
    /// The pipeline, with every default and its scale.
    pub pipeline: Pipeline,
    /// Title of the data set.
    pub title: String,
    /// Number and size of the observations.
    pub observed: String,
    /// Numbers of training, validation and test samples.
    pub samples: [usize; 3],
    /// Number of network weights.
    pub weights: usize,
    /// Warnings about settings without effect.
    pub warnings: Vec<String>,
    /// Sentences of the pruners on the number of Gaussians that they keep.
    pub outlook: Vec<String>,
    /// Memory of a step with the initial Gaussians in addition to the loaded data, bytes.
    pub step_bytes: u64,
    /// Time of the training of one model.
    pub time: TimeEstimate,
    /// Load average of the machine in the minute before, and its number of cores; `None` if unavailable.
    pub load: Option<(f64, usize)>,
    /// Positions, values and pose of the data.
    pub summary: DataSummary,
    /// Median distance from a test transmitter to the nearest training transmitter, metres; NaN if positions are unknown.
    pub test_distance: f64,
    /// Name of the GPU on which the network of the timed steps ran; `None` for the CPU.
    pub device: Option<&'static str>,
    /// Memory of this process with all data loaded, bytes; 0 if unavailable.
    pub loaded_bytes: u64,
    /// Remaining free memory, bytes; `None` if unavailable.
    pub free_bytes: Option<u64>,
}

/// Loads and initialises everything that a run of `pipeline` needs, and times a few steps.
///
/// # Errors
/// All errors of [`crate::run`] before its first step.
pub fn preview(pipeline: &Pipeline, base: &Path, observer: &mut dyn Observer) -> Result<Preview> {
    let load_before = load_average();
    let mut pipeline = resolve_pipeline(pipeline, base)?;
    let split = load_split_data(&pipeline, observer)?;
    let SplitData { data, partition } = &split;
    pipeline.check_data(data)?;
    check_residuals(&pipeline, &split, false)?;
    let member = pipeline.member(0);
    let member_partition = member.partition(data)?;
    let mut loaded_bytes = 0;
    let make = || {
        let trainer = Trainer::sketch(&member.plan()?, data, &member_partition)?;
        loaded_bytes = peak_memory(); // before a step is tried, which is counted by itself
        Ok(trainer)
    };
    let trainer = run_stage(observer, "initialising", |_| new_trainer(&member, make))?;
    let batch = pipeline.training.batch.min(data.locations_of(&member_partition.train).len());
    pipeline.set_all(&[format!("training.batch={batch}")])?; // as the trainer limits it
    let mut preview = Preview {
        title: data.title.clone(),
        observed: describe_observations(data),
        samples: partition.sizes(),
        weights: trainer.weight_count(),
        summary: DataSummary::of(data, SUMMARISED, observer)?,
        test_distance: test_distance(data, partition),
        warnings: trainer.warnings(),
        outlook: trainer.outlook(),
        step_bytes: trainer.step_bytes(),
        time: run_stage(observer, "timing a few steps", |_| trainer.estimate_time())?,
        load: load_before,
        loaded_bytes,
        free_bytes: free_memory(),
        device: device::name().filter(|_| device::is_used()),
        pipeline,
    };
    device::check()?;
    preview.warnings.extend(device_warnings(preview.time.start.gaussians));
    Ok(preview)
}

/// Returns the load average of the machine over the last minute, and its number of cores; `None` if the system does
/// not report it.
fn load_average() -> Option<(f64, usize)> {
    let text = files::read_string("/proc/loadavg").ok()?;
    let load = text.split_whitespace().next()?.parse().ok()?;
    // The load is that of all cores, also of those that this process may not use.
    let info = files::read_string("/proc/cpuinfo").ok()?;
    let cores = info.lines().filter(|line| line.starts_with("processor")).count();
    (cores > 0).then_some((load, cores))
}

/// Positions, values and pose of a data set.
#[derive(Clone, Debug)]
pub struct DataSummary {
    /// Names and texts, one per line.
    pub facts: Vec<(&'static str, String)>,
    /// The check of the recorded pose; `None` without spectra, or with too few.
    pub pose: Option<PoseCheck>,
}

impl DataSummary {
    /// Summarises `data`, reading at most `most` evenly chosen spectra.
    ///
    /// # Errors
    /// If a spectrum cannot be read.
    pub fn of(data: &Dataset, most: usize, observer: &mut dyn Observer) -> Result<Self> {
        let mut summary = Self { facts: Vec::new(), pose: None };
        if data.placed {
            summary.facts.extend(describe_positions(data));
        }
        summary.facts.push(describe_fixed_ends(data));
        summary.facts.push(("point cloud", describe_points(data)));
        if data.observations.spectra().is_none() {
            summary.facts.push(describe_levels(data));
            summary.facts.extend(PhaseCheck::of(data).map(|phases| ("phases", phases.describe())));
            return Ok(summary);
        }
        let spectra = run_stage(observer, "reading the spectra", |progress| spectra::summarise(data, most, progress))?;
        summary.facts.extend(spectra::describe(data, &spectra));
        if data.unmatched != Unmatched::default() {
            let Unmatched { positions, spectra } = data.unmatched;
            let text = format!("{positions} positions without a spectrum, {spectra} spectra without a position");
            summary.facts.push(("left out", text));
        }
        if spectra.len() < data.len() {
            summary.facts.push(("read", format!("{} of {} spectra, evenly chosen", spectra.len(), data.len())));
        }
        summary.pose = pose::check_pose(data, &spectra);
        Ok(summary)
    }
}

/// Returns names and descriptions: extent and repeated positions of the moving end, and, if there are consecutive ids, the steps
/// from one to the next.
fn describe_positions(data: &Dataset) -> Vec<(&'static str, String)> {
    let positions: Vec<[f64; 3]> = data.locations.iter().map(pwrfgs_core::Location::position).collect();
    let mut ordered = positions.clone();
    ordered.sort_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let shared: usize = ordered.chunk_by(|a, b| a == b).map(<[_]>::len).filter(|count| *count > 1).sum();
    let mut text = cloud::extent(positions).map_or_else(String::new, cloud::format_extent);
    if shared > 0 {
        _ = write!(text, "; {} at the position of another", grouped(shared as i64));
    }
    let next = data.locations.windows(2).filter(|pair| pair[1].id == pair[0].id + 1);
    let steps = sorted(next.map(|pair| distance(pair[0].position(), pair[1].position())));
    let moving = if data.scene.moving.is_receiver() { "receiver" } else { "transmitters" };
    if steps.is_empty() {
        return vec![(moving, text)];
    }
    let [low, middle, high] = [0.05, 0.5, 0.95].map(|q| format_length(quantile(&steps, q)));
    let order = if is_in_time_order(data) {
        "ids follow a trajectory: a random split leaves near neighbours in training"
    } else {
        "ids do not follow a trajectory: a block of ids is not a block of space"
    };
    let steps = format!("{middle} from an id to the next (median; {low} to {high}, 5 % to 95 %); {order}");
    vec![(moving, text), ("steps", steps)]
}

/// Returns name and description of the ends that do not move.
fn describe_fixed_ends(data: &Dataset) -> (&'static str, String) {
    let list = |numbers: [f64; 3]| numbers.map(|v| format!("{}", v + 0.0)).join(", "); // adding 0 turns -0 into 0
    let pose = data.scene.origin.world_pose(data.scene.pose());
    if data.scene.moving.is_receiver() {
        let position = data.scene.has_distances().then(|| format!("at ({}) m", list(pose.position)));
        return ("transmitter", position.unwrap_or_else(|| "at an unknown position".into()));
    }
    let names: Vec<&str> = data.scene.receivers.iter().map(|receiver| receiver.name.as_str()).collect();
    if let [first, second, others @ ..] = &names[..] {
        let more = if others.is_empty() { "" } else { ", .." };
        return ("receiver", format!("{}: {first}, {second}{more}", names.len()));
    }
    let boresight = pose.world_from_receiver().z_axis.to_array().map(|v| (f64::from(v) * 1e3).round() / 1e3);
    ("receiver", format!("at ({}) m, boresight ({})", list(pose.position), list(boresight)))
}

/// Describes number and extent of the points of the room.
fn describe_points(data: &Dataset) -> String {
    let points = &data.scene.points;
    let extent = cloud::extent(points.iter().map(|point| data.scene.origin.world(*point)));
    let count = grouped(points.len() as i64);
    extent.map_or_else(|| "none".into(), |extent| format!("{count} points, {}", cloud::format_extent(extent)))
}

/// Returns name and description of the levels of all links: their median and range.
fn describe_levels(data: &Dataset) -> (&'static str, String) {
    let [name, unit] = data.task().level_name_at(&data.scene.receivers);
    let level = |link: usize| data.task().level(&data.image(link));
    let levels = sorted((0..data.len()).map(level).filter(|level| level.is_finite()));
    let [low, tenth, middle, last, high] = [0.0, 0.1, 0.5, 0.9, 1.0].map(|q| number(quantile(&levels, q)));
    ("level", format!("{name} {middle} {unit} (median; {tenth} to {last}, 10 % to 90 %; {low} to {high} in all)"))
}

/// Returns the median distance from a test transmitter to the nearest other training transmitter, metres: NaN if positions are
/// unknown, and without test samples.
pub fn test_distance(data: &Dataset, partition: &Partition) -> f64 {
    if !data.placed {
        return f64::NAN;
    }
    let nearest = nearest_training_distances(data, &partition.train);
    median(partition.test.iter().map(|&i| nearest[i] as f64))
}
