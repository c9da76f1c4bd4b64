//! `pwrfgs locate`: positions of transmitters from their observations.

mod observations;
mod scores;

use super::map::PlaneBounds;
use super::options::{check_position_input, read_models};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use observations::ObservationFile;
use pwrfgs::experiment::folder::PIPELINE;
use pwrfgs::experiment::text::{aligned, fixed, grouped};
use pwrfgs::experiment::{Observer as _, SplitData, check_alike, load, model_file, read_pipeline};
use pwrfgs::localise::{Located, Locator, Region, SHARES};
use pwrfgs::pipeline::Pipeline;
use pwrfgs::report::draw::location::LocationMap;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Dataset, Error, Receiver, Result};
use rayon::prelude::*;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Width of an image in print, millimetres.
const WIDTH_MM: f64 = 120.0;

#[derive(Debug, Args)]
#[command(after_help = "\
Compares an observation with the fingerprints of the training positions: what was measured there,
blended with what the model predicts there. The estimate is the mode of the most probable part of
the 90 % region. Validation samples choose the blend, the weights, whether to descend along the
model, and the size of the regions; train with validation samples, such as
split=Voxel(size_m: 0.3, validation: 0.1), to get regions.

Without OBSERVATIONS, locates the test samples of the model's data and prints the errors beside
those of nearest fingerprints, of fingerprints predicted by Kriging, and of the centre of the room.
With OBSERVATIONS, prints the estimates and the errors of validation samples.

OBSERVATIONS
  spectra   .png, or .npy [B, height, width]
  powers    .csv with a column per receiver (dBm; empty: not known), or .npy [B, receivers] (NaN)
  channels  .npy [B, antennas, subcarriers], complex
FILES of --out
  locations.csv  estimate, true position and error if known, misfit (1: that of a typical sample;
                 far above 1: like no known position), area and number of parts of the region
  regions.json   outlines of every region in metres; a region may have several parts
  errors.png     estimates and true positions; 00001.png ..: density and region of single samples

EXAMPLES
  pwrfgs locate runs/ble --out located
  pwrfgs locate runs/ble powers.csv --prior 10,30,10,40")]
pub(crate) struct Locate {
    /// Run folder, or model file next to its pipeline.ron
    #[arg(value_name = "MODEL")]
    pub(crate) model: PathBuf,
    /// Observations of unknown transmitters [default: test samples of the data]
    #[arg(value_name = "OBSERVATIONS")]
    pub(crate) observations: Option<PathBuf>,
    /// Only positions in this box, metres
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true, requires = "observations")]
    pub(crate) prior: Option<String>,
    /// Change a setting of the pipeline, such as data.root=data/ble; repeatable
    #[arg(long = "set", value_name = "FIELD=VALUE")]
    pub(crate) set: Vec<String>,
    /// Number of samples whose density is drawn
    #[arg(long, value_name = "N", default_value_t = 8)]
    pub(crate) pictures: usize,
    /// Output folder; must be new or empty [default: write no files]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
}

/// A located transmitter: its name, the result, and the true position if known.
struct Row {
    name: String,
    located: Located,
    truth: Option<[f64; 3]>,
}

impl Row {
    /// Formats the columns of `locations.csv` that need the true position: empty columns if it is unknown.
    fn truth_columns(&self) -> String {
        let Some(truth) = self.truth else { return ",,,,".into() };
        let ([x, y, z], error) = (truth, distance(self.located.position, truth));
        let holds = self.located.holds(truth).map_or("", |holds| if holds { "yes" } else { "no" });
        format!("{x},{y},{z},{error:.4},{holds}")
    }
}

/// Runs `pwrfgs locate`: prints the table of positions or errors, and writes the files of `--out`.
pub(crate) fn locate(arguments: &Locate, verbosity: Verbosity) -> Result<()> {
    let prior = arguments.prior.as_deref().map(|text| PlaneBounds::parse("--prior", text, ["x", "y"])).transpose()?;
    let ensemble = read_models(std::slice::from_ref(&arguments.model))?;
    check_position_input(&ensemble)?;
    let pipeline = read_pipeline_of_model(arguments)?;
    let folder = arguments.out.as_ref().map(|out| NewFolder::begin(out)).transpose()?;
    let split = RunProgress::observe(verbosity, |progress| load(&pipeline, Path::new(""), progress))?;
    let (data, fitting) = (&split.data, split.partition.known());
    check_alike(&ensemble.prepare(), data)?;
    let unbiased = ensemble.without_validation(data, fitting)?;
    let model = unbiased.as_ref().unwrap_or(&ensemble).prepare();
    let locator = RunProgress::observe(verbosity, |progress| {
        progress.on_stage("fingerprints", 0, 0);
        Locator::fit(data, fitting, &model, &SHARES)
    })?;
    match locator.missing_regions().filter(|_| locator.validation == 0) {
        Some(why) => output::print_warning(why),
        None => verbosity.print_note(&describe_locator(&locator)),
    }
    let expected = arguments.observations.is_some().then(|| scores::describe_validation(&locator, data, fitting));
    let locator = match prior {
        Some(bounds) => {
            let inside = locator.within(move |position| bounds.has_point(position));
            inside.map_err(|e| Error::Config(format!("--prior: {e}")))?
        }
        None => locator,
    };
    let rows = match &arguments.observations {
        Some(path) => locate_observations(&locator, path, &data.scene.receivers)?,
        None => locate_test_samples(&locator, &split, verbosity),
    };
    if let (Some(folder), Some(out)) = (folder, &arguments.out) {
        write_files(&folder, &rows, &locator, data, arguments.pictures)?;
        folder.publish()?;
        verbosity.print_note(&format!("{} positions in {}", grouped(rows.len() as i64), out.display()));
    }
    let table = match expected {
        Some(expected) => format_positions(&rows) + &expected,
        None => scores::format_errors(&rows.iter().map(|row| &row.located).collect::<Vec<_>>(), &locator, &split)?,
    };
    output::print_result(&(table + &describe_regions(&rows, &locator)))
}

/// Reads the pipeline next to the model, with the changes of `--set`; an error without such a file.
fn read_pipeline_of_model(arguments: &Locate) -> Result<Pipeline> {
    let path = model_file(&arguments.model)?.with_file_name(PIPELINE);
    if !path.is_file() {
        let problem = format!("no {PIPELINE} next to this model; localisation needs its data");
        return Err(Error::input(&arguments.model, problem));
    }
    read_pipeline(&path, &arguments.set)
}

/// Describes the number of regions with several parts, and the calibration of the regions; empty without such facts.
fn describe_regions(rows: &[Row], locator: &Locator<'_>) -> String {
    let regions: Vec<&Region> = rows.iter().filter_map(|row| row.located.region.as_ref()).collect();
    let parts = regions.iter().map(|region| region.parts());
    let several = parts.clone().filter(|count| *count > 1).count();
    let mut text = String::new();
    if several > 0 {
        let (count, most) = (regions.len(), parts.max().unwrap_or(0));
        let counts = format!("regions with several parts: {several} of {count}, up to {most} parts");
        _ = writeln!(text, "{counts}; an estimate is the mode of the most probable part");
    }
    if !regions.is_empty() && locator.validates_between_training() {
        text += "the validation samples lie between the training positions, and regions are calibrated on them: on another \
                 day, with another device or in another area they hold fewer\n";
    }
    text
}

/// Describes the chosen settings of a locator in one line.
fn describe_locator(locator: &Locator<'_>) -> String {
    let (choice, missing) = (locator.choice, locator.missing_regions());
    let descent = if choice.descends { "descent along the model" } else { "no descent" };
    format!(
        "{} fingerprints; chosen on {} validation positions: {} % model in the fingerprints, sharpness {}, {descent}{}",
        grouped(locator.positions().len() as i64),
        grouped(locator.validation as i64),
        fixed(f64::from(choice.share) * 100.0, 0),
        choice.sharpness,
        missing.map_or_else(String::new, |why| format!("; {why}"))
    )
}

/// Locates the observations of a file, in its order; their true positions are unknown.
fn locate_observations(locator: &Locator<'_>, path: &Path, receivers: &[Receiver]) -> Result<Vec<Row>> {
    let observed = ObservationFile { path, features: locator.features(), receivers }.read_features()?;
    let row = |(k, observation): (usize, &Vec<f32>)| Row {
        name: format!("{:05}", k + 1),
        located: locator.locate(observation),
        truth: None,
    };
    Ok(observed.par_iter().enumerate().map(row).collect())
}

/// Locates the transmitters of the test samples from their observations.
fn locate_test_samples(locator: &Locator<'_>, split: &SplitData, verbosity: Verbosity) -> Vec<Row> {
    let data = &split.data;
    let test = data.locations_of(&split.partition.test);
    let observations = locator.observations(data, &test);
    RunProgress::observe(verbosity, |progress| {
        let mut rows = Vec::with_capacity(test.len());
        for (chunk, chunk_observations) in test.chunks(64).zip(observations.chunks(64)) {
            progress.on_stage("locating", rows.len(), test.len());
            rows.par_extend(chunk.par_iter().zip(chunk_observations).map(|(t, observation)| {
                let transmitter = data.locations[*t];
                let (name, located) = (format!("{:05}", transmitter.id), locator.locate(observation));
                Row { name, located, truth: Some(transmitter.position()) }
            }));
        }
        rows
    })
}

/// Formats the table of the estimated positions.
fn format_positions(rows: &[Row]) -> String {
    let mut lines =
        vec![["observation", "x (m)", "y (m)", "z (m)", "misfit", "region (m²)", "parts"].map(String::from).to_vec()];
    for Row { name, located, .. } in rows {
        let [area, parts] = located
            .region
            .as_ref()
            .map_or_else(Default::default, |region| [fixed(region.area(), 3), region.parts().to_string()]);
        let mut line = vec![name.clone()];
        line.extend(located.position.map(|v| fixed(v, 3)));
        line.extend([fixed(located.misfit, 2), area, parts]);
        lines.push(line);
    }
    aligned(&lines, 1)
}

/// Writes the list of positions, the outlines of the regions, the map of the errors, and images of the first `pictures`
/// regions into `folder`.
fn write_files(folder: &NewFolder, rows: &[Row], locator: &Locator<'_>, data: &Dataset, pictures: usize) -> Result<()> {
    let mut list = "observation,x,y,z,misfit,region_m2,parts,true_x,true_y,true_z,error_m,region_holds\n".to_owned();
    let mut regions = Vec::new();
    let flat = |p: [f64; 3]| [p[0], p[1]];
    let receiver_point = |receiver: &Receiver| flat(data.scene.origin.world_pose(receiver.pose).position);
    let map = LocationMap {
        training: locator.positions().iter().map(|position| flat(*position)).collect(),
        receivers: data.scene.receivers.iter().map(receiver_point).collect(),
        ..LocationMap::default()
    };
    for (k, row) in rows.iter().enumerate() {
        let Row { name, located, truth } = row;
        let ([x, y, z], region) = (located.position, located.region.as_ref());
        let outlines = region.map(Region::outlines).unwrap_or_default();
        let parts = region.map_or(0, Region::parts);
        let area = region.map_or_else(String::new, |region| format!("{:.6}", region.area()));
        _ = writeln!(list, "{name},{x:.4},{y:.4},{z:.4},{:.4},{area},{parts},{}", located.misfit, row.truth_columns());
        regions.push(json!({ "observation": name, "position": located.position, "outlines": outlines }));
        if let Some(region) = region.filter(|_| k < pictures) {
            let image = LocationMap {
                title: format!("{}: observation {name}", data.title),
                grid: (region.first(), region.step),
                columns: region.columns,
                density: &region.values,
                parts,
                outlines,
                estimates: vec![(flat(located.position), truth.map(flat))],
                ..map.clone()
            };
            folder.put(&format!("{name}.png"), image.draw().png(WIDTH_MM))?;
        }
    }
    folder.put("locations.csv", list)?;
    folder.put("regions.json", serde_json::to_string(&regions).unwrap_or_default())?;
    let title = format!("{}: {} positions", data.title, grouped(rows.len() as i64));
    let estimates = rows.iter().map(|row| (flat(row.located.position), row.truth.map(flat))).collect();
    folder.put("errors.png", LocationMap { title, estimates, ..map }.draw().png(WIDTH_MM))
}
