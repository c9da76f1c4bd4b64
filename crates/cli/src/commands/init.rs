//! `pwrfgs init`: writes a commented pipeline for the data in a folder.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use crate::reference::commented::{CommentStyle, Value};
use crate::reference::example;
use clap::Args;
use pwrfgs::data::read_points;
use pwrfgs::experiment::inspect::test_distance;
use pwrfgs::experiment::text::wrapped;
use pwrfgs::experiment::{Observer, data_warnings, observed, staged};
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::Docs;
use pwrfgs_core::files::{check_place, write_new};
use pwrfgs_core::plugin::{name_of as plugin_name, to_ron, try_to_ron};
use pwrfgs_core::{DataSource, Dataset, Error, Partition, Plugin, Result, ShippedFile, Split, recognise, rng};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Reads spectra, received powers or channels in the layouts of docs/data.md, with index files and a
point cloud if present. The pipeline runs as written; comments explain the settings. Without index
files, it uses a split that holds out cells of space, so that no test transmitter is close to a
training transmitter. Existing files are never overwritten.

EXAMPLES
  pwrfgs init data/s23
  pwrfgs init data/s23 --out pipelines/mine.ron")]
pub(crate) struct Init {
    /// Folder with the data
    #[arg(value_name = "FOLDER", default_value = ".")]
    pub(crate) folder: PathBuf,
    /// Pipeline file [default: ./NAME.ron, from the name of the folder]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

/// Median distance from test transmitters to the nearest training transmitter below which training learns fine detail,
/// metres.
const CLOSE_M: f64 = 0.03;

/// Candidate cell edges of a split that holds out space, metres; the first with enough cells is used.
const EDGES: [f64; 9] = [2.0, 1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01];
/// Minimum number of cells for such a split.
const CELLS: usize = 50;
/// Distance of test to training transmitters below which the file has a note, metres.
const NEAR: f64 = 0.05;

/// Fields of a pipeline in the file; others are shown if they differ from their default.
const SHOWN: [&str; 9] =
    ["name", "seed", "data", "split", "initializer", "deformation", "readout", "pruners", "training"];

/// Fields among them that only splatting reads.
const OF_SPLATS: [&str; 2] = ["deformation", "readout"];

/// Shipped pipelines that new ones start from.
const FINE_SPECTRA: &str = "s23-laptop";
const COARSE_SPECTRA: &str = "quickstart";
const POWERS: &str = "ble";
const CHANNELS: &str = "office-channel";
const UPLINKS: &str = "uplink";

const UNKNOWN: &str = "no known layout of data: expected spectrum/ and gateway_info.yml, or spectra.npy (spectra); gateway_rssi.csv \
                       and gateway_position.yml (received powers); channel.npy and receiver.yml, or csidata.npy and \
                       base-station.yml (channels); see docs/data.md";

/// Changes to `COARSE_SPECTRA` for lobes that move with the transmitter. The network takes the transmitter and the centre
/// of a Gaussian together, so what it learns of a lobe in one direction holds for others.
const MOVING_LOBES: [&str; 4] = [
    "deformation=Mlp(depth: 4, width: 96, position_frequencies: 2, tx_frequencies: 2, tx_hidden: 64, tx_features: 32, \
     skip: None, outputs: Signals)",
    "training.steps=2000",
    "training.optimizer.network.first=0.004",
    "training.optimizer.network_decay=0.1",
];

pub(crate) fn init(arguments: &Init, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.ron", name_of(&arguments.folder))));
    let exists = || Error::input(&out, "file exists and is not overwritten; set another file with --out");
    if out.symlink_metadata().is_ok() {
        return Err(exists());
    }
    check_place(&out)?;
    let survey = RunProgress::during(verbosity, |progress| DataSurvey::of(&arguments.folder, progress))?;
    let pipeline = pipeline(&survey, &arguments.folder, &out)?;
    let text = written(&survey, &pipeline)?;
    if let Some(parent) = out.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
    }
    if !write_new(&out, text.as_bytes())? {
        return Err(exists());
    }
    output::result(&format!("{}: {}\nnext: pwrfgs run {}\n", out.display(), survey.sentence(), out.display()))
}

/// Error for a folder without data of a known layout.
pub(super) fn unknown_folder(folder: &Path) -> Error {
    let what = match folder.metadata() {
        Ok(entry) if entry.is_dir() => UNKNOWN,
        Ok(_) => "is a file; give a folder in a layout of docs/data.md",
        Err(_) => "no such folder",
    };
    Error::input(folder, what)
}

/// Suggests a pipeline for the data.
pub(super) fn pipeline(survey: &DataSurvey, folder: &Path, out: &Path) -> Result<Pipeline> {
    // Paths in a pipeline are relative to its file.
    let beside = out.parent().is_none_or(|parent| parent.as_os_str().is_empty());
    let root =
        if beside { folder.to_owned() } else { std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned()) };
    let path = |path: &Path| {
        let text = path.to_str().map(|text| format!("{text:?}"));
        text.ok_or_else(|| Error::input(path, "not UTF-8; rename the folder"))
    };
    path(&root)?;
    let source = recognise(&root).unwrap_or_else(|| survey.source.clone());
    let mut set = vec![
        format!("name={}", name_of(folder)),
        format!("data={}", try_to_ron(&source).map_err(Error::Config)?),
        format!("split={}", survey.split),
    ];
    let (start, batch, baselines) = match survey.data.features.as_ref().map(|features| features.width) {
        _ if survey.data.task().has_pixels => {
            let stride = survey.stride();
            set.push(format!("training.stride={stride}"));
            if stride == 1 {
                set.push("projector=Mercator()".into());
            }
            match survey.clouds.first() {
                Some((name, _)) => {
                    set.push(format!("data.points={}", path(&root.join(name))?));
                    set.push("initializer=PointCloud(max_points: 300)".into());
                }
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
        _ if survey.data.task().is_scalar => {
            // Wavelengths from the size of the site to 2 m, or to an eighth of a small site.
            let longest = extent(&survey.data).max(1.0).ceil();
            set.push(format!("deformation.tx_encoding.longest_m={longest:?}"));
            set.push(format!("deformation.tx_encoding.shortest_m={:?}", (longest / 8.0).min(2.0)));
            (POWERS, 128, "MeanSpectrum(), NearestNeighbours(k: Auto), Kriging()")
        }
        Some(width) => {
            set.push(format!("method.deformation.tx_encoding=Features(width: {width})"));
            (UPLINKS, 128, "Zero(), NearestNeighbours(k: Auto), Ridge()") // Kriging needs positions
        }
        None => (CHANNELS, 256, "Zero(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto), Kriging()"),
    };
    set.push(format!("training.batch={}", survey.batch(batch)));
    set.push(format!("baselines=[{baselines}]"));
    let start = ShippedFile::all(ShippedFile::PIPELINES).into_iter().find(|file| file.name == start);
    let mut pipeline = Pipeline::parse(start.expect("the facade registers its pipelines").source, out)?;
    pipeline.set_all(&set)?;
    Ok(pipeline)
}

/// Writes the text of the file.
fn written(survey: &DataSurvey, pipeline: &Pipeline) -> Result<String> {
    let default = example().map_err(Error::Config)?;
    let value = Value::new(to_ron(pipeline)).map_err(Error::Config)?;
    let differs = |path: &[&str]| value.at(path) != default.at(path);
    let draws = !differs(&["method"]);
    let shows = |owner: &str, field: &str| match owner {
        "Pipeline" => differs(&[field]) || SHOWN.contains(&field) && (draws || !OF_SPLATS.contains(&field)),
        "Training" => !["loss", "optimizer", "densify"].contains(&field) || differs(&["training", field]),
        "Loss" | "Optimizer" | "Densify" => differs(&["training", &owner.to_lowercase(), field]),
        _ => true,
    };
    let style = CommentStyle { opens: &|field| field != "receiver", shows: &shows };
    let body = style.write(&value, Some(Docs::of::<Pipeline>()), "");
    let mut text = String::new();
    for line in survey.notes() {
        text += &wrapped(&line, ["// "; 2], 100);
    }
    text += "//\n// Brackets show the type of a setting. Settings that are not listed have their defaults: `pwrfgs plugins` lists \
             them,\n// and `pwrfgs plugins NAME` describes them.\n";
    text += &body;
    text.push('\n');
    // The text must parse to the same pipeline.
    let again = Pipeline::parse(&text, Path::new("the new pipeline"))?;
    if again.to_ron() != pipeline.to_ron() {
        return Err(Error::Config(
            "the new pipeline does not parse to the intended settings; please report this bug".into(),
        ));
    }
    Ok(text)
}

/// Content of a data folder, with a suitable split.
pub(super) struct DataSurvey {
    /// Plugin that reads the folder.
    source: Plugin<dyn DataSource>,
    pub(super) data: Dataset,
    /// Suggested split, as RON.
    split: String,
    partition: Partition,
    /// Median distance of test transmitters to the nearest training transmitter, metres.
    nearest: f64,
    /// Point cloud files, with numbers of points.
    clouds: Vec<(PathBuf, usize)>,
}

impl DataSurvey {
    /// Loads the data in `folder` and suggests a split.
    pub(super) fn of(folder: &Path, observer: &mut dyn Observer) -> Result<Self> {
        let source = recognise(folder).ok_or_else(|| unknown_folder(folder))?;
        let data = staged(observer, "observations", |progress| source.load(Path::new(""), progress))?;
        let (split, partition) = suggested(&data)?;
        data_warnings(&data, Some(&partition)).iter().for_each(|warning| observer.on_warning(warning));
        let nearest = test_distance(&data, &partition);
        Ok(Self { source, data, split, partition, nearest, clouds: clouds(folder) })
    }

    /// Stride of training pixels: spectra of a small array are smooth.
    fn stride(&self) -> usize {
        let Dataset { width, height, .. } = self.data;
        if width >= 120 && width.is_multiple_of(3) && height.is_multiple_of(3) { 3 } else { 1 }
    }

    /// Batch size: the number of training transmitters, at most `most`.
    pub(super) fn batch(&self, most: usize) -> usize {
        let train = self.partition.train.iter().map(|&i| self.data.links[i].transmitter);
        train.collect::<BTreeSet<_>>().len().clamp(1, most)
    }

    /// Describes the data in one line.
    fn sentence(&self) -> String {
        let [train, validation, test] = self.partition.sizes();
        let observations = observed(&self.data);
        format!("{observations}: {train} training, {validation} validation, {test} test")
    }

    /// Notes for the head of the pipeline file.
    fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!("{}: {}. Written by `pwrfgs init`.", self.data.title, self.sentence())];
        let near = format!("the median distance from test to training transmitters is {:.3} m", self.nearest);
        notes.push(match (self.data.official.is_some(), self.nearest < NEAR) {
            (true, true) => format!(
                "The split is from the index files of the data, and {near}: copying the nearest training sample scores \
                 high. `split: Voxel()` holds out cells of space and `split: TimeBlock()` a block of time."
            ),
            (true, false) => format!("The split is from the index files of the data; {near}."),
            (false, _) => format!(
                "The data have no index files. The split holds out whole regions, so that test transmitters are not next to \
                 training transmitters; {near}."
            ),
        });
        if plugin_name(&self.source) == "Nerf2Csi" {
            notes.push(
                "The files do not contain the frequencies: correct `carrier_hz` and `spacing_hz` of the data.".into(),
            );
        }
        notes.extend(self.data.task().has_pixels.then(|| match &self.clouds[..] {
            [] => "The folder has no point cloud of the room: Gaussians start on a grid of directions.".into(),
            [(name, points), others @ ..] => {
                let others: Vec<String> = others.iter().map(|(name, _)| name.display().to_string()).collect();
                let more = if others.is_empty() {
                    String::new()
                } else {
                    format!(" Other point clouds: {}.", others.join(", "))
                };
                format!("Gaussians start on {} ({points} points).{more}", name.display())
            }
        }));
        notes
    }
}

/// Longest side of the bounding box of the positions, metres.
fn extent(data: &Dataset) -> f64 {
    let ends = |k: usize| {
        let all = data.samples().map(move |sample| sample.tx[k]);
        all.clone().fold(f64::NEG_INFINITY, f64::max) - all.fold(f64::INFINITY, f64::min)
    };
    (0..3).map(ends).fold(0.0, f64::max)
}

/// Split without leakage, as RON and applied: index files of the data, else cells of space, else a block of time.
fn suggested(data: &Dataset) -> Result<(String, Partition)> {
    let try_out = |text: &str| -> Result<Partition> {
        let split = Plugin::<dyn Split>::parse(text).map_err(Error::Config)?;
        split.split(data, &mut rng::stream(0, "split", 0))
    };
    if data.official.is_some() {
        return Ok(("Official()".into(), try_out("Official()")?));
    }
    let cells = |edge: f64| {
        let cell = |tx: [f64; 3]| tx.map(|v| (v / edge).floor() as i64);
        data.samples().map(|s| cell(s.tx)).collect::<BTreeSet<_>>().len()
    };
    let edge = EDGES.into_iter().find(|&edge| cells(edge) >= CELLS).map(|edge| format!("Voxel(size_m: {edge})"));
    let choices = edge.into_iter().chain(["TimeBlock()".into(), "Random()".into()]);
    let fits = |partition: &Partition| !partition.train.is_empty() && !partition.test.is_empty();
    for choice in choices {
        if let Some(partition) = try_out(&choice).ok().filter(fits) {
            return Ok((choice, partition));
        }
    }
    Ok(("Random()".into(), try_out("Random()")?))
}

/// Readable point clouds in the folder, by name.
fn clouds(folder: &Path) -> Vec<(PathBuf, usize)> {
    let is_cloud = |path: &PathBuf| {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_lowercase();
        let points = path.file_stem().is_some_and(|name| name.to_string_lossy().to_lowercase().contains("point"));
        path.is_file() && (extension == "ply" || extension == "xyz" || (extension == "csv" && points))
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut paths: Vec<PathBuf> = entries.filter(is_cloud).collect();
    paths.sort();
    let read = |path: PathBuf| {
        let points = read_points(&path).ok()?.len();
        Some((PathBuf::from(path.file_name()?), points))
    };
    paths.into_iter().filter_map(read).collect()
}

/// Name of the folder, as a valid name of a pipeline.
pub(super) fn name_of(folder: &Path) -> String {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let plain: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' }).collect();
    let plain = plain.trim_start_matches(['.', '-']).to_owned();
    if plain.is_empty() { "pipeline".into() } else { plain }
}
