//! A pipeline for data: the shipped pipeline for their kind, with settings for their size.

mod effort;
mod survey;

use crate::models::plain_name;
pub use effort::Effort;
use effort::Sizing;
use pwrfgs_core::plugin::try_to_ron;
use pwrfgs_core::{Dataset, Error, Result, ShippedFile};
use pwrfgs_pipeline::Pipeline;
use std::path::Path;
use survey::longest_side;
pub use survey::{DataSurvey, is_table_or_array, suggest_split, unknown_folder_error};

/// Median distance from test transmitters to the nearest training transmitter below which training learns fine detail,
/// metres.
const CLOSE_M: f64 = 0.03;

/// Shipped pipelines that new ones start from.
const FINE_SPECTRA: &str = "s23-laptop";
const COARSE_SPECTRA: &str = "quickstart";
const POWERS: &str = "ble";
const CHANNELS: &str = "office-channel";
const UPLINKS: &str = "uplink";

/// Changes to `COARSE_SPECTRA` for lobes that move with the transmitter. The network takes the transmitter and the
/// centre of a Gaussian together, so what it learns of a lobe in one direction holds for others.
const MOVING_LOBES: [&str; 4] = [
    "deformation=Mlp(depth: 4, width: 96, position_frequencies: 2, tx_frequencies: 2, tx_hidden: 64, tx_features: 32, \
     skip: None, outputs: Signals)",
    "training.steps=2000",
    "training.optimizer.network.first=0.004",
    "training.optimizer.network_decay=0.1",
];

/// Changes to `COARSE_SPECTRA` for images of a camera: small Gaussians, whose brightness does not depend on the pose.
const CAMERA_IMAGES: [&str; 5] = [
    "projector=Pinhole()",
    "deformation=Fixed()",
    "pruners=[OpacityThreshold(epsilon: 0.005)]",
    "training.moving_stride=true",
    "training.tx_jitter_m=0.0",
];
/// Changes to `UPLINKS` for channels at an array that moves and turns.
const TURNING_ARRAY: [&str; 4] = [
    "method.deformation.tx_encoding=Wavelengths(count: 24, longest_m: 4.0, shortest_m: 0.3, seed: 0)",
    "training.optimizer.means=Constant(0.0005)",
    "training.optimizer.signals=Constant(0.002)",
    "training.optimizer.network=Cosine(first: 0.001, last: 0.00001)",
];
/// Largest number of trained pixels per image of a camera; larger images get a stride.
const PIXELS: usize = 40_000;

impl DataSurvey {
    /// Suggests a pipeline called `name` for the data, with the paths of the data; errors name the file `out`. Also
    /// returns notes on the settings that depend on the number of positions, the first on models and steps.
    ///
    /// # Errors
    /// A path that is not UTF-8, or an invalid `name`.
    pub fn suggest_pipeline(&self, name: &str, effort: Effort, out: &Path) -> Result<(Pipeline, Vec<String>)> {
        let mut set = vec![
            format!("name={name}"),
            format!("data={}", try_to_ron(&self.source).map_err(Error::Config)?),
            format!("split={}", self.split),
        ];
        let (start, batch, baselines) = select_template(self, &mut set)?;
        set.push(format!("training.batch={}", self.batch_size(batch)));
        let mut sizing = Sizing::of(self, effort);
        set.extend(sizing.set);
        set.push(format!("baselines=[{baselines}]"));
        set.extend((!self.accepted.is_empty()).then(|| format!("accept={:?}", self.accepted)));
        let shipped = ShippedFile::all(ShippedFile::PIPELINES).into_iter().find(|file| file.name == start);
        let mut pipeline = Pipeline::parse(shipped.expect("the facade registers its pipelines").source, out)?;
        pipeline.set_all(&set)?;
        sizing.notes.extend(self.batch_note(pipeline.training.batch));
        Ok((pipeline, sizing.notes))
    }
}

/// Creates a pipeline called `name` for `data`, which the data source `source` (RON) reads, with the split of [`suggest_split`],
/// or the default one if that is an error, and the defaults for the kind of data, without baselines that do not support them.
///
/// # Errors
/// An invalid source or name.
pub fn default_pipeline(source: &str, data: &Dataset, name: &str) -> Result<Pipeline> {
    let split = suggest_split(data).map_or_else(|_| String::new(), |(split, _)| format!("split: {split}, "));
    // Missing fields then get the defaults for this kind of data.
    let text = format!("Pipeline(name: {name:?}, data: {source}, {split}initializer: Random())");
    let mut pipeline = Pipeline::parse(&text, Path::new("pipeline"))?;
    pipeline.baselines.retain(|baseline| baseline.check_data(data).is_ok());
    Ok(pipeline)
}

/// Formats a path as a text in RON; an error if it is not UTF-8.
fn quote_path(path: &Path) -> Result<String> {
    let text = path.to_str().map(|text| format!("{text:?}"));
    text.ok_or_else(|| Error::input(path, "not UTF-8; rename the folder"))
}

/// Shipped pipeline to start from, largest number of transmitters per step, and baselines as RON.
type Template = (&'static str, usize, &'static str);

/// Selects the template for the kind of data, and adds the settings that differ from it to `set`. Returns an error if the path of
/// a point cloud is not UTF-8.
fn select_template(survey: &DataSurvey, set: &mut Vec<String>) -> Result<Template> {
    let data = &survey.data;
    Ok(match data.features.as_ref().map(|features| features.width) {
        _ if data.camera().is_some() => {
            set.extend(camera_settings(data));
            (COARSE_SPECTRA, 4, "MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto)")
        }
        _ if data.task().has_pixels => {
            let cloud = survey.clouds.first().map(|(cloud, _)| quote_path(cloud)).transpose()?;
            select_spectrum_template(survey, cloud, set)
        }
        _ if data.task().is_scalar => {
            set.push(tx_encoding_setting(data));
            (POWERS, 128, "MeanSpectrum(), NearestNeighbours(k: Auto), Kriging()")
        }
        Some(width) => {
            set.push(format!("method.deformation.tx_encoding=Features(width: {width})"));
            (UPLINKS, 128, "Zero(), NearestNeighbours(k: Auto), Ridge()") // Kriging needs positions
        }
        // The search needs antennas of fixed orientation.
        None if data.scene.moving.is_receiver() && data.scene.receivers[0].antennas != [[0.0; 3]] => {
            set.extend(TURNING_ARRAY.map(str::to_owned));
            (UPLINKS, 32, "Zero(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto), Kriging()")
        }
        None => (CHANNELS, 256, "Zero(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto), Kriging()"),
    })
}

/// Selects the template for spectra, and adds the settings that differ from it to `set`; `cloud` is the path of a point
/// cloud, as RON.
fn select_spectrum_template(survey: &DataSurvey, cloud: Option<String>, set: &mut Vec<String>) -> Template {
    let stride = survey.training_stride();
    set.push(format!("training.stride={stride}"));
    if stride == 1 {
        set.push("projector=Mercator()".into());
    }
    match cloud {
        Some(path) => {
            set.push(format!("data.points={path}"));
            set.push("initializer=PointCloud(max_points: 300)".into());
        }
        None if !survey.data.scene.points.is_empty() => set.push("initializer=PointCloud(max_points: 300)".into()),
        None => set.push("initializer=Grid(count: 220, overlap: 1.0, opacity: 0.12)".into()),
    }
    let (start, batch) = if survey.nearest < CLOSE_M {
        // Correlations reach a few training positions.
        set.push(format!("deformation.near.length_m={:.3}", (3.0 * survey.nearest).max(0.01)));
        (FINE_SPECTRA, 32)
    } else {
        set.extend(MOVING_LOBES.map(str::to_owned));
        (COARSE_SPECTRA, 16)
    };
    if survey.data.scene.receivers.len() == 1 {
        (start, batch, "MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto), Kriging()")
    } else {
        set.push("deformation.carrier=2.0".into()); // several carriers
        (start, batch, "MeanSpectrum(), NearestCarrier(), NearestNeighbours(k: Auto), Kriging()")
    }
}

/// Formats the setting of the encoding of transmitter positions for received powers: wavelengths from the size of the
/// site to 2 m, or to an eighth of a small site, in random directions, since maps have stripes if these are along the
/// axes.
fn tx_encoding_setting(data: &Dataset) -> String {
    let longest = longest_side(data).max(1.0).ceil();
    let shortest = (longest / 8.0).min(2.0);
    format!("deformation.tx_encoding=Wavelengths(count: 10, longest_m: {longest:?}, shortest_m: {shortest:?}, seed: 0)")
}

/// Lists the settings for images of a camera: stride, start and step size of the Gaussians, from image size and site.
fn camera_settings(data: &Dataset) -> Vec<String> {
    let Dataset { width, height, .. } = *data;
    let divides = |stride: &usize| width.is_multiple_of(*stride) && height.is_multiple_of(*stride);
    let strides = || (1..=16).filter(divides);
    // The largest one if even that leaves more pixels.
    let stride = strides().find(|stride| width * height <= PIXELS * stride * stride).or_else(|| strides().next_back());
    let extent = longest_side(data).max(0.01);
    let start = if data.scene.points.is_empty() {
        format!("Random(count: 2000, std: {:.3})", extent / 4.0)
    } else {
        "PointCloud(max_points: 4000, nearest: 3)".into()
    };
    let mut set = CAMERA_IMAGES.map(str::to_owned).to_vec();
    set.push(format!("training.stride={}", stride.unwrap_or(1)));
    set.push(format!("training.optimizer.means.first={:.6}", 0.001 * extent));
    set.push(format!("initializer={start}"));
    set
}

/// Returns the name of the folder as a valid name of a pipeline: other characters become dashes, and points and dashes at the
/// start are removed; `pipeline` if none is left.
pub fn pipeline_name(folder: &Path) -> String {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let plain = plain_name(&name);
    let plain = plain.trim_start_matches(['.', '-']);
    if plain.is_empty() { "pipeline".into() } else { plain.into() }
}
