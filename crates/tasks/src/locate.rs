//! Positions of transmitters from their observations.

mod known;
mod observations;
mod scores;

use crate::models::check_positions;
use crate::plane::PlaneBounds;
use clap::Args;
use known::predicted_samples;
pub use known::read_known_pipeline;
pub use observations::UnlocatedObservations;
use pwrfgs_core::files::NewFolder;
use pwrfgs_core::neighbours::distance;
use pwrfgs_core::{Dataset, Error, Geodetic, Result};
use pwrfgs_experiment::text::{align_columns, fixed, grouped};
use pwrfgs_experiment::{Observer, SplitData, check_alike, run_stage};
use pwrfgs_localise::{FingerprintFeatures, Located, Locator, Region, SHARES};
use pwrfgs_model::Ensemble;
use pwrfgs_report::draw::location::LocationMap;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::json;
use std::fmt::Write as _;

/// Width of an image in print, millimetres.
const WIDTH_MM: f64 = 120.0;
/// Number of samples that are located between two reports of progress.
const CHUNK: usize = 64;

/// Settings of [`locate`].
#[derive(Clone, Debug, Default, Args, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LocateSettings {
    /// Search only in this box of x and y in metres, or of latitude and longitude in degrees
    #[arg(long, value_name = "X0,X1,Y0,Y1", allow_hyphen_values = true, requires = "observations")]
    pub prior: Option<String>,
    /// Omit the baseline with fingerprints predicted by Kriging, which is slow for many training positions
    #[arg(long)]
    pub no_kriging: bool,
}

/// A located transmitter.
#[derive(Clone, Debug)]
pub struct LocatedRow {
    /// Number of the observation, or ID of the test sample.
    pub name: String,
    /// Position, misfit and region.
    pub located: Located,
    /// True position, metres; `None` if unknown.
    pub truth: Option<[f64; 3]>,
}

impl LocatedRow {
    /// Formats the five columns of `locations.csv` from `true_x` to `region_holds`: empty if the true position is unknown.
    fn truth_columns(&self) -> String {
        let Some(truth) = self.truth else { return ",,,,".into() };
        let ([x, y, z], error) = (truth, distance(self.located.position, truth));
        let holds = self.located.holds(truth).map_or("", |holds| if holds { "yes" } else { "no" });
        format!("{x},{y},{z},{error:.4},{holds}")
    }
}

/// Result of [`locate`].
#[derive(Clone, Debug)]
pub struct Localisation {
    /// Located transmitters: the observations in their order, or the test samples.
    pub rows: Vec<LocatedRow>,
    /// Table of estimates or of errors, with a verdict.
    pub text: String,
    title: String,
    geodetic: Option<Geodetic>,
    /// Map without samples.
    map: LocationMap<'static>,
}

/// Function that reads the observations of unknown transmitters as features, given the known data.
pub type ReadFeatures<'a> = &'a dyn Fn(&FingerprintFeatures, &Dataset) -> Result<Vec<Vec<f32>>>;

/// Locates transmitters by comparison with the training positions of `split` or, if there are `observations` and no `split`, with
/// predictions at the training positions in the model file. With `observations`, estimates the positions of unknown
/// transmitters and the errors of validation samples. Without, locates the test samples and compares their errors with those
/// of baselines. The regions of the first `images` rows keep their densities. `observer` receives the progress and a
/// description of the fit.
///
/// # Errors
/// A model whose input is not a position, or without training positions if there is no `split`; data of another scene, without
/// positions or with a moving receiver; invalid observations or settings.
pub fn locate(
    ensemble: &Ensemble,
    split: Option<&SplitData>,
    observations: Option<ReadFeatures<'_>>,
    settings: &LocateSettings,
    images: usize,
    observer: &mut dyn Observer,
) -> Result<Localisation> {
    let prior = settings.prior.as_deref().map(|text| PlaneBounds::parse("--prior", text, ["x", "y"])).transpose()?;
    check_positions(ensemble)?;
    let predict = || run_stage(observer, "predictions", |progress| predicted_samples(ensemble, progress));
    let predicted = split.is_none().then(predict).transpose()?;
    let split = split.or(predicted.as_ref()).expect("measured or predicted samples");
    let (data, fitting) = (&split.data, split.partition.known());
    let prior = prior.map(|bounds| bounds.in_metres(data.scene.geodetic));
    if predicted.is_none() {
        check_alike(&ensemble.prepare(), data)?;
    }
    let shares = if predicted.is_some() { &[0.0][..] } else { &SHARES[..] };
    let unbiased = ensemble.without_validation(data, fitting)?;
    let model = unbiased.as_ref().unwrap_or(ensemble).prepare();
    let locator =
        run_stage(observer, "fingerprints", |progress| Locator::fit(data, fitting, &model, shares, progress))?;
    report_fit(&locator, predicted.is_some(), data.locations_of(fitting.validation).len(), observer);
    // Of all validation samples, before `--prior` leaves some out.
    let observations = observations.map(|read| (read, scores::describe_validation(&locator, data, fitting)));
    let locator = restrict_to_prior(locator, prior)?;
    let (rows, table) = if let Some((read, expected)) = observations {
        let rows = locate_observations(&locator, &read(locator.features(), data)?, images, observer);
        let table = format_positions(&rows, data.scene.geodetic) + &expected;
        (rows, table)
    } else {
        let rows = locate_test_samples(&locator, split, images, observer);
        let located: Vec<&Located> = rows.iter().map(|row| &row.located).collect();
        let table = scores::format_errors(&located, &locator, split, !settings.no_kriging, observer)?;
        (rows, table)
    };
    let text = table + &describe_regions(&rows, &locator);
    let (title, geodetic) = (data.title.clone(), data.scene.geodetic);
    Ok(Localisation { rows, text, title, geodetic, map: empty_map(&locator, data) })
}

/// Reports the fit of a locator to the observer. It warns of measured fingerprints without validation samples. `is_predicted`:
/// the fingerprints are predictions; `validation` is the number of all validation positions.
fn report_fit(locator: &Locator<'_>, is_predicted: bool, validation: usize, observer: &mut dyn Observer) {
    if is_predicted {
        observer.on_message(&describe_predictions(locator));
    } else if let Some(why) = locator.missing_regions().filter(|_| locator.validation == 0) {
        observer.on_warning(why);
    } else {
        observer.on_message(&describe_locator(locator, validation));
    }
}

/// Restricts a locator to the area of `--prior`, if given.
///
/// # Errors
/// No training position is inside.
fn restrict_to_prior(locator: Locator<'_>, prior: Option<PlaneBounds>) -> Result<Locator<'_>> {
    let Some(bounds) = prior else { return Ok(locator) };
    let inside = locator.within(move |position| bounds.has_point(position));
    inside.map_err(|e| Error::Config(format!("--prior: {e}")))
}

/// Locates unknown transmitters by their observations, one row of features each.
fn locate_observations(
    locator: &Locator<'_>,
    observations: &[Vec<f32>],
    images: usize,
    observer: &mut dyn Observer,
) -> Vec<LocatedRow> {
    locate_rows(observations.len(), images, observer, |k| LocatedRow {
        name: format!("{:05}", k + 1),
        located: locator.locate(&observations[k]),
        truth: None,
    })
}

/// Locates the test transmitters of `split`, whose positions are known.
fn locate_test_samples(
    locator: &Locator<'_>,
    split: &SplitData,
    images: usize,
    observer: &mut dyn Observer,
) -> Vec<LocatedRow> {
    let data = &split.data;
    let test = data.locations_of(&split.partition.test);
    let observations = locator.observations(data, &test);
    locate_rows(test.len(), images, observer, |k| LocatedRow {
        name: format!("{:05}", data.locations[test[k]].id),
        located: locator.locate(&observations[k]),
        truth: Some(data.locations[test[k]].position()),
    })
}

/// Describes how many regions have several parts, and warns if regions are calibrated between the training positions; empty if
/// neither applies.
fn describe_regions(rows: &[LocatedRow], locator: &Locator<'_>) -> String {
    let regions: Vec<&Region> = rows.iter().filter_map(|row| row.located.region.as_ref()).collect();
    let parts = regions.iter().map(|region| region.part_count());
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

/// Describes the fingerprints of a locator without measured samples in one line.
fn describe_predictions(locator: &Locator<'_>) -> String {
    format!(
        "{} fingerprints, predicted at the training positions in the model file; without measured samples there are no regions",
        grouped(locator.positions().len() as i64)
    )
}

/// Describes the chosen settings of a locator in one line; `validation` is the number of all validation positions.
fn describe_locator(locator: &Locator<'_>, validation: usize) -> String {
    let (choice, missing) = (locator.choice, locator.missing_regions());
    let descent = if choice.descends { "descent along the model" } else { "no descent" };
    format!(
        "{} fingerprints; chosen on {}{} validation positions: {} % model in the fingerprints, sharpness {}, {descent}{}",
        grouped(locator.positions().len() as i64),
        grouped(locator.validation as i64),
        if validation > locator.validation { format!(" of {}", grouped(validation as i64)) } else { String::new() },
        fixed(f64::from(choice.share) * 100.0, 0),
        choice.sharpness,
        missing.map_or_else(String::new, |why| format!("; {why}"))
    )
}

/// Locates `count` transmitters by `locate`, in their order; the regions of the first `images` keep their densities.
fn locate_rows(
    count: usize,
    images: usize,
    observer: &mut dyn Observer,
    locate: impl Fn(usize) -> LocatedRow + Sync,
) -> Vec<LocatedRow> {
    let without_density = |k: usize| {
        let mut row = locate(k);
        row.located.region = row.located.region.map(|region| if k < images { region } else { region.without_values() });
        row
    };
    let mut rows = Vec::with_capacity(count);
    for first in (0..count).step_by(CHUNK) {
        observer.on_stage("locating", first, count);
        rows.par_extend((first..(first + CHUNK).min(count)).into_par_iter().map(without_density));
    }
    observer.on_stage("locating", count, count);
    rows
}

/// Formats the table of the estimated positions, with degrees if the frame has them.
fn format_positions(rows: &[LocatedRow], geodetic: Option<Geodetic>) -> String {
    let degrees = if geodetic.is_some() { &["latitude", "longitude"][..] } else { &[] };
    let names = ["observation", "x (m)", "y (m)", "z (m)", "misfit", "region (m²)", "parts"];
    let mut lines = vec![names.iter().chain(degrees).map(|name| (*name).to_owned()).collect::<Vec<_>>()];
    for LocatedRow { name, located, .. } in rows {
        let [area, parts] = located
            .region
            .as_ref()
            .map_or_else(Default::default, |region| [fixed(region.area(), 3), region.part_count().to_string()]);
        let mut line = vec![name.clone()];
        line.extend(located.position.map(|v| fixed(v, 3)));
        line.extend([fixed(located.misfit, 2), area, parts]);
        let [x, y, _] = located.position;
        line.extend(geodetic.iter().flat_map(|geodetic| geodetic.degrees([x, y]).map(|v| fixed(v, 6))));
        lines.push(line);
    }
    align_columns(&lines, 1)
}

/// Returns the horizontal coordinates of a position.
fn flat(position: [f64; 3]) -> [f64; 2] {
    [position[0], position[1]]
}

/// Creates a map of training positions, and of receivers of known position, without samples.
fn empty_map(locator: &Locator<'_>, data: &Dataset) -> LocationMap<'static> {
    LocationMap {
        training: locator.positions().iter().map(|position| flat(*position)).collect(),
        receivers: data.scene.known_ends().into_iter().map(flat).collect(),
        ..LocationMap::default()
    }
}

impl Localisation {
    /// Writes `locations.csv`, `regions.json` with their outlines, the map `errors.png`, and an image per region with densities
    /// into `folder`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, folder: &NewFolder) -> Result<()> {
        let mut list = "observation,x,y,z,misfit,region_m2,parts,true_x,true_y,true_z,error_m,region_holds".to_owned();
        list += if self.geodetic.is_some() { Geodetic::COLUMNS } else { "" };
        list.push('\n');
        let mut regions = Vec::new();
        for row in &self.rows {
            let LocatedRow { name, located, truth } = row;
            let ([x, y, z], region) = (located.position, located.region.as_ref());
            let outlines = region.map(Region::outlines).unwrap_or_default();
            let parts = region.map_or(0, Region::part_count);
            let area = region.map_or_else(String::new, |region| format!("{:.6}", region.area()));
            _ = writeln!(
                list,
                "{name},{x:.4},{y:.4},{z:.4},{:.4},{area},{parts},{}{}",
                located.misfit,
                row.truth_columns(),
                self.geodetic.map_or_else(String::new, |geodetic| geodetic.cells(located.position))
            );
            regions.push(json!({ "observation": name, "position": located.position, "outlines": outlines }));
            if let Some(region) = region.filter(|region| !region.values.is_empty()) {
                let image = LocationMap {
                    title: format!("{}: observation {name}", self.title),
                    grid: (region.first_centre(), region.step),
                    columns: region.columns,
                    density: &region.values,
                    parts,
                    outlines,
                    estimates: vec![(flat(located.position), truth.map(flat))],
                    ..self.map.clone()
                };
                folder.put(&format!("{name}.png"), image.draw().png(WIDTH_MM))?;
            }
        }
        folder.put("locations.csv", list)?;
        folder.put("regions.json", serde_json::to_string(&regions).unwrap_or_default())?;
        let title = format!("{}: {} positions", self.title, grouped(self.rows.len() as i64));
        let estimates = self.rows.iter().map(|row| (flat(row.located.position), row.truth.map(flat))).collect();
        folder.put("errors.png", LocationMap { title, estimates, ..self.map.clone() }.draw().png(WIDTH_MM))
    }
}
