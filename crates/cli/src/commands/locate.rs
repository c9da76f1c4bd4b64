//! `pwrfgs locate`: positions of transmitters from their observations.

mod observations;

use super::map::PlaneBounds;
use super::options::{check_positions, read_models};
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::folder::PIPELINE;
use pwrfgs::experiment::text::{aligned, fixed, grouped};
use pwrfgs::experiment::{Observer as _, check_alike, load as load_data, model_file, read_pipeline};
use pwrfgs::localise::{Located, Locator, NearestFingerprints, Region, SHARES, mean_and_median};
use pwrfgs::report::draw::location::LocationMap;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::statistics::{mean, quantile, sorted};
use pwrfgs_core::{Baseline, Dataset, Error, FittingSet, Partition, Plugin, Result};
use rayon::prelude::*;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Width of an image in print, millimetres.
const WIDTH_MM: f64 = 120.0;

#[derive(Debug, Args)]
#[command(after_help = "\
Compares an observation with the fingerprints of the training positions: what was measured there,
blended with what the model predicts there. Validation samples choose the blend, the sharpness of
the weights, whether to descend along the model, and the size of the 90 % regions; train with
validation samples, such as split=Voxel(size_m: 0.3, validation: 0.1), to get regions.

Without OBSERVATIONS, locates the test samples of the model's data and prints the errors beside
those of nearest fingerprints, of fingerprints predicted by Kriging, and of the centre of the room.

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

/// Number of samples of which the median area of regions is taken for a baseline.
const AREAS: usize = 100;

/// A located transmitter: its name, the result, and the true position if known.
struct Row {
    name: String,
    located: Located,
    region: Option<Region>,
    truth: Option<[f64; 3]>,
}

impl Row {
    fn new(name: String, located: Located, truth: Option<[f64; 3]>) -> Self {
        let region = located.region();
        Self { name, located, region, truth }
    }
}

pub(crate) fn locate(arguments: &Locate, verbosity: Verbosity) -> Result<()> {
    let prior = arguments.prior.as_deref().map(|text| PlaneBounds::parse("--prior", text, ["x", "y"])).transpose()?;
    let ensemble = read_models(std::slice::from_ref(&arguments.model))?;
    check_positions(&ensemble)?;
    let path = model_file(&arguments.model)?.with_file_name(PIPELINE);
    if !path.is_file() {
        return Err(Error::input(
            &arguments.model,
            format!("no {PIPELINE} next to this model; localisation needs its data"),
        ));
    }
    let pipeline = read_pipeline(&path, &arguments.set)?;
    let folder = arguments.out.as_ref().map(|out| NewFolder::begin(out)).transpose()?;
    let (data, partition) = RunProgress::during(verbosity, |progress| load_data(&pipeline, Path::new(""), progress))?;
    check_alike(&ensemble.prepare(), &data)?;
    let fair = ensemble.without_validation(&data, partition.known())?;
    let model = fair.as_ref().unwrap_or(&ensemble).prepare();
    let locator = RunProgress::during(verbosity, |progress| {
        progress.on_stage("fingerprints", 0, 0);
        Locator::fit(&data, partition.known(), &model, &SHARES)
    })?;
    match locator.missing_regions().filter(|_| locator.validation == 0) {
        Some(why) => output::warning(why),
        None => verbosity.note(&summary(&locator)),
    }
    let locator = match prior {
        Some(bounds) => {
            locator.within(move |place| bounds.holds(place)).map_err(|e| Error::Config(format!("--prior: {e}")))?
        }
        None => locator,
    };
    let rows = match &arguments.observations {
        Some(path) => {
            let all = observations::read(path, locator.features(), &data.scene.receivers)?;
            let located: Vec<Located> = all.par_iter().map(|own| locator.locate(own)).collect();
            located.into_par_iter().enumerate().map(|(k, own)| Row::new(format!("{:05}", k + 1), own, None)).collect()
        }
        None => test_rows(&locator, &data, &partition, verbosity),
    };
    if let (Some(folder), Some(out)) = (folder, &arguments.out) {
        write(folder.path(), &rows, &locator, &data, arguments.pictures)?;
        folder.publish()?;
        verbosity.note(&format!("{} positions in {}", grouped(rows.len() as i64), out.display()));
    }
    if arguments.observations.is_some() {
        output::result(&positions(&rows))
    } else {
        scores(&rows, &locator, &data, &partition)
    }
}

/// What was chosen, in one line.
fn summary(locator: &Locator<'_>) -> String {
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

/// Locates the test samples.
fn test_rows(locator: &Locator<'_>, data: &Dataset, partition: &Partition, verbosity: Verbosity) -> Vec<Row> {
    let test = data.transmitters_of(&partition.test);
    let all = locator.observations(data, &test);
    RunProgress::during(verbosity, |progress| {
        let mut rows = Vec::with_capacity(test.len());
        for (some, observations) in test.chunks(64).zip(all.chunks(64)) {
            progress.on_stage("locating", rows.len(), test.len());
            rows.par_extend(some.par_iter().zip(observations).map(|(t, own)| {
                let transmitter = data.transmitters[*t];
                Row::new(format!("{:05}", transmitter.id), locator.locate(own), Some(transmitter.position))
            }));
        }
        rows
    })
}

/// Prints errors of the model and of the baselines.
fn scores(rows: &[Row], locator: &Locator<'_>, data: &Dataset, partition: &Partition) -> Result<()> {
    let known = partition.known();
    let test = data.transmitters_of(&partition.test);
    let all = locator.observations(data, &test);
    let truths: Vec<[f64; 3]> = test.iter().map(|t| data.transmitters[*t].position).collect();
    let errors =
        |places: Vec<[f64; 3]>| places.iter().zip(&truths).map(|(a, b)| distance(*a, *b)).collect::<Vec<f64>>();
    let header = ["", "median (m)", "mean (m)", "90 % (m)", "regions hold", "area (m²)"];
    let mut lines = vec![header.map(String::from).to_vec()];
    let row = |name: &str, located: &[&Located], areas: Vec<f64>| {
        let held = located.iter().zip(&truths).filter(|(own, truth)| own.holds(**truth) == Some(true)).count();
        let share = held as f64 / located.len().max(1) as f64;
        let region = (!areas.is_empty()).then(|| (share, mean_and_median(areas)[1]));
        line(name, errors(located.iter().map(|own| own.position).collect()), region)
    };
    let own: Vec<&Located> = rows.iter().map(|row| &row.located).collect();
    lines.push(row("model", &own, rows.iter().filter_map(|row| row.region.as_ref()).map(Region::area).collect()));
    let kriged = kriged(data, known, &all)?;
    if !kriged.is_empty() {
        let some = kriged.iter().step_by(kriged.len().div_ceil(AREAS));
        let areas = some.filter_map(Located::region).map(|region| region.area()).collect();
        lines.push(row("fingerprints of Kriging", &kriged.iter().collect::<Vec<_>>(), areas));
    }
    let nearest = NearestFingerprints::fit(data, known, locator.features(), locator.floor());
    let name = format!("{} nearest fingerprint{}", nearest.k, if nearest.k == 1 { "" } else { "s" });
    lines.push(line(&name, errors(all.par_iter().map(|own| nearest.locate(own)).collect()), None));
    let centre = [0, 1, 2].map(|k| mean(locator.positions().iter().map(|p| p[k])));
    lines.push(line("centre of the positions", errors(vec![centre; truths.len()]), None));
    let heading = format!("{}: {} test positions\n", data.title, grouped(test.len() as i64));
    output::result(&(heading + &aligned(&lines, 1)))
}

/// Test samples located with Kriging in place of the model; none if it does not support the data.
fn kriged(data: &Dataset, known: FittingSet<'_>, observations: &[Vec<f32>]) -> Result<Vec<Located>> {
    let kriging = Plugin::<dyn Baseline>::parse("Kriging()").map_err(Error::Config)?;
    if !kriging.supports(data.task()) || kriging.check_data(data).is_err() {
        return Ok(Vec::new());
    }
    let predictor = kriging.fit(data, known)?;
    let locator = Locator::fit(data, known, predictor.as_ref(), &[1.0])?;
    Ok(observations.par_iter().map(|own| locator.locate(own)).collect())
}

fn line(name: &str, errors: Vec<f64>, region: Option<(f64, f64)>) -> Vec<String> {
    let worst = quantile(&sorted(errors.iter().copied()), 0.9);
    let [mean, median] = mean_and_median(errors);
    let [held, area] =
        region.map_or_else(Default::default, |(held, area)| [format!("{} %", fixed(100.0 * held, 1)), fixed(area, 4)]);
    vec![name.into(), fixed(median, 4), fixed(mean, 4), fixed(worst, 4), held, area]
}

/// Table of estimated positions.
fn positions(rows: &[Row]) -> String {
    let mut lines =
        vec![["observation", "x (m)", "y (m)", "z (m)", "misfit", "region (m²)", "parts"].map(String::from).to_vec()];
    for Row { name, located, region, .. } in rows {
        let [area, parts] = region
            .as_ref()
            .map_or_else(Default::default, |region| [fixed(region.area(), 3), region.outlines().len().to_string()]);
        let mut line = vec![name.clone()];
        line.extend(located.position.map(|v| fixed(v, 3)));
        line.extend([fixed(located.misfit, 2), area, parts]);
        lines.push(line);
    }
    aligned(&lines, 1)
}

/// Writes list, outlines and pictures.
fn write(folder: &Path, rows: &[Row], locator: &Locator<'_>, data: &Dataset, pictures: usize) -> Result<()> {
    let put = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).map_err(|e| Error::write(&path, e))
    };
    let mut list = "observation,x,y,z,misfit,region_m2,parts,true_x,true_y,true_z,error_m,region_holds\n".to_owned();
    let mut regions = Vec::new();
    let flat = |p: [f64; 3]| [p[0], p[1]];
    let map = LocationMap {
        training: locator.positions().iter().copied().map(flat).collect(),
        receivers: data
            .scene
            .receivers
            .iter()
            .map(|receiver| flat(data.scene.origin.world_pose(receiver.pose).position))
            .collect(),
        ..LocationMap::default()
    };
    for (k, Row { name, located, region, truth }) in rows.iter().enumerate() {
        let [x, y, z] = located.position;
        let outlines = region.as_ref().map(Region::outlines).unwrap_or_default();
        let area = region.as_ref().map_or_else(String::new, |region| format!("{:.6}", region.area()));
        _ = write!(list, "{name},{x:.4},{y:.4},{z:.4},{:.4},{area},{}", located.misfit, outlines.len());
        _ = match truth {
            Some(t) => writeln!(
                list,
                ",{},{},{},{:.4},{}",
                t[0],
                t[1],
                t[2],
                distance(located.position, *t),
                located.holds(*t).map_or("", |held| if held { "yes" } else { "no" })
            ),
            None => writeln!(list, ",,,,,"),
        };
        regions.push(json!({ "observation": name, "position": located.position, "outlines": outlines }));
        if let Some(region) = region.as_ref().filter(|_| k < pictures) {
            let one = LocationMap {
                title: format!("{}: observation {name}", data.title),
                grid: (region.first, region.step),
                columns: region.columns,
                density: &region.values,
                outlines,
                estimates: vec![(flat(located.position), truth.map(flat))],
                ..map.clone()
            };
            put(&format!("{name}.png"), &one.draw().png(WIDTH_MM))?;
        }
    }
    put("locations.csv", list.as_bytes())?;
    put("regions.json", serde_json::to_string(&regions).unwrap_or_default().as_bytes())?;
    let title = format!("{}: {} positions", data.title, grouped(rows.len() as i64));
    let estimates = rows.iter().map(|row| (flat(row.located.position), row.truth.map(flat))).collect();
    put("errors.png", &LocationMap { title, estimates, ..map }.draw().png(WIDTH_MM))
}
