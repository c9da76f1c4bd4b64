//! `pwrfgs init`: a commented pipeline for the data in a folder.

use crate::output::{self, Verbosity};
use crate::progress::Progress;
use crate::reference::commented::{Style, Value};
use crate::reference::example;
use clap::Args;
use pwrfgs::data::{Nerf2Spectrum, read_points};
use pwrfgs::experiment::inspect::test_distance;
use pwrfgs::experiment::text::wrapped;
use pwrfgs::experiment::{Observer, data_warnings, observed, staged};
use pwrfgs::prelude::Pipeline;
use pwrfgs_core::docs::Docs;
use pwrfgs_core::files::{check_place, write_new};
use pwrfgs_core::plugin::{name_of as plugin_name, to_ron, try_to_ron};
use pwrfgs_core::{DataSource, Dataset, Error, Partition, Plugin, Result, Split, recognise, rng};
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

/// Median distance from a test transmitter to the nearest training one, metres, below which training learns fine detail.
const CLOSE_M: f64 = 0.03;

/// Edges of cells that are tried for a split that holds out space, metres; the first with enough cells is taken.
const EDGES: [f64; 9] = [2.0, 1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01];
/// Enough cells to hold some out.
const CELLS: usize = 50;
/// Test transmitters nearer than this to a training one are told of, metres.
const NEAR: f64 = 0.05;

/// Fields of a pipeline that the file shows; the others have their defaults.
const SHOWN: [&str; 9] =
    ["name", "seed", "data", "split", "initializer", "deformation", "readout", "pruners", "training"];

/// Those of them that another method does not read.
const OF_SPLATS: [&str; 2] = ["deformation", "readout"];

/// The shipped pipelines that new ones start from.
const FINE_SPECTRA: &str = include_str!("../../../../pipelines/s23-laptop.ron");
const COARSE_SPECTRA: &str = include_str!("../../../../pipelines/quickstart.ron");
const POWERS: &str = include_str!("../../../../pipelines/ble.ron");
const CHANNELS: &str = include_str!("../../../../pipelines/office-channel.ron");
const UPLINKS: &str = include_str!("../../../../pipelines/uplink.ron");

pub(crate) fn init(arguments: &Init, verbosity: Verbosity) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("{}.ron", name_of(&arguments.folder))));
    let exists = || Error::input(&out, "exists, and nothing is overwritten; name another file with --out");
    if out.symlink_metadata().is_ok() {
        return Err(exists());
    }
    check_place(&out)?;
    let survey = Progress::during(verbosity, |progress| Survey::of(&arguments.folder, progress))?;
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

/// What is suggested for these data.
fn pipeline(survey: &Survey, folder: &Path, out: &Path) -> Result<Pipeline> {
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
    let start = match survey.data.features.as_ref().map(|features| features.width) {
        _ if survey.data.task().has_pixels => {
            let stride = survey.stride();
            set.push(format!("training.stride={stride}"));
            set.push(format!("training.batch={}", survey.batch(32)));
            set.push(
                "baselines=[MeanSpectrum(), NearestNeighbours(k: 1), NearestNeighbours(k: Auto), Kriging()]".into(),
            );
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
            if survey.nearest < CLOSE_M { FINE_SPECTRA } else { COARSE_SPECTRA }
        }
        _ if survey.data.task().is_scalar => {
            // Waves from the size of the site to 2 m, or to an eighth of a small one.
            let longest = extent(&survey.data).max(1.0).ceil();
            set.push(format!("deformation.tx_encoding.longest_m={longest:?}"));
            set.push(format!("deformation.tx_encoding.shortest_m={:?}", (longest / 8.0).min(2.0)));
            set.push(format!("training.batch={}", survey.batch(128)));
            POWERS
        }
        Some(width) => {
            set.push(format!("method.deformation.tx_encoding=Features(width: {width})"));
            set.push(format!("training.batch={}", survey.batch(128)));
            UPLINKS
        }
        None => {
            set.push(format!("training.batch={}", survey.batch(256)));
            CHANNELS
        }
    };
    let mut pipeline = Pipeline::parse(start, out)?;
    pipeline.set_all(&set)?;
    Ok(pipeline)
}

/// The text of the file.
fn written(survey: &Survey, pipeline: &Pipeline) -> Result<String> {
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
    let style = Style { opens: &|field| field != "receiver", shows: &shows };
    let body = style.write(&value, Some(Docs::of::<Pipeline>()), "");
    let mut text = String::new();
    for line in survey.notes() {
        text += &wrapped(&line, ["// "; 2], 100);
    }
    text += "//\n// What is left out has its default: `pwrfgs plugins` shows everything that could stand here, and \
             `pwrfgs plugins NAME`\n// a part of it. What a line takes stands in brackets.\n";
    text += &body;
    text.push('\n');
    // What was written must say what was meant.
    let again = Pipeline::parse(&text, Path::new("the new pipeline"))?;
    if again.to_ron() != pipeline.to_ron() {
        return Err(Error::Config("the new pipeline does not read as it was meant; please report this".into()));
    }
    Ok(text)
}

/// What lies in a folder of data, and which split suits it.
struct Survey {
    /// The plugin that reads the folder.
    source: Plugin<dyn DataSource>,
    data: Dataset,
    /// The suggested split, as RON, and what it gives.
    split: String,
    partition: Partition,
    /// Median distance of a test transmitter to the nearest training one, metres.
    nearest: f64,
    /// Files that hold a point cloud, and how many points.
    clouds: Vec<(PathBuf, usize)>,
}

impl Survey {
    /// Loads the data in `folder`.
    fn of(folder: &Path, observer: &mut dyn Observer) -> Result<Self> {
        // What holds nothing known is told by the reader of spectra, which says what it expects.
        let spectra = || -> Box<dyn DataSource> {
            Box::new(Nerf2Spectrum { root: folder.to_owned(), ..Nerf2Spectrum::default() })
        };
        let source = recognise(folder).unwrap_or_else(|| spectra().into());
        let data = staged(observer, "observations", |progress| source.load(Path::new(""), progress))?;
        let (split, partition) = suggested(&data)?;
        data_warnings(&data, Some(&partition)).iter().for_each(|warning| observer.on_warning(warning));
        let nearest = test_distance(&data, &partition);
        Ok(Self { source, data, split, partition, nearest, clouds: clouds(folder) })
    }

    /// Rows and columns a pixel of training stands for: spectra of a small array are smooth.
    fn stride(&self) -> usize {
        let Dataset { width, height, .. } = self.data;
        if width >= 120 && width.is_multiple_of(3) && height.is_multiple_of(3) { 3 } else { 1 }
    }

    /// Transmitters to train on, at most so many.
    fn batch(&self, most: usize) -> usize {
        let train = self.partition.train.iter().map(|&i| self.data.links[i].transmitter);
        train.collect::<BTreeSet<_>>().len().clamp(1, most)
    }

    /// In one line.
    fn sentence(&self) -> String {
        let [train, validation, test] = self.partition.sizes();
        let observations = observed(&self.data);
        format!("{observations}: {train} to train on, {validation} to validate, {test} to test")
    }

    /// What a reader of the pipeline should know.
    fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!("{}: {}. Written by `pwrfgs init`.", self.data.title, self.sentence())];
        let near = format!("half of the test transmitters stand within {:.3} m of a training one", self.nearest);
        notes.push(match (self.data.official.is_some(), self.nearest < NEAR) {
            (true, true) => format!(
                "The split is that of the data's own index files. With it {near}: copying what the nearest had \
                 scores high. `split: Voxel()` holds out space and `split: TimeBlock()` time."
            ),
            (true, false) => format!("The split is that of the data's own index files; with it {near}."),
            (false, _) => format!(
                "The data bring no index files. The split holds out whole parts, so that no test transmitter stands beside a \
                 training one by chance; with it {near}."
            ),
        });
        if plugin_name(&self.source) == "Nerf2Csi" {
            notes.push(
                "The files do not say the frequencies: correct `carrier_hz` and `spacing_hz` of the data.".into(),
            );
        }
        notes.extend(self.data.task().has_pixels.then(|| match &self.clouds[..] {
            [] => "There is no point cloud of the room in the folder: Gaussians start on a grid over the sky.".into(),
            [(name, points), others @ ..] => {
                let others: Vec<String> = others.iter().map(|(name, _)| name.display().to_string()).collect();
                let more =
                    if others.is_empty() { String::new() } else { format!(" Also there: {}.", others.join(", ")) };
                format!("Gaussians start on {} ({points} points).{more}", name.display())
            }
        }));
        notes
    }
}

/// The longest side of the box of positions, metres.
fn extent(data: &Dataset) -> f64 {
    let ends = |k: usize| {
        let all = data.samples().map(move |sample| sample.tx[k]);
        all.clone().fold(f64::NEG_INFINITY, f64::max) - all.fold(f64::INFINITY, f64::min)
    };
    (0..3).map(ends).fold(0.0, f64::max)
}

/// A split that does not leak, as RON, and what it gives: the data's own, else cells of space, else a block of time.
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

/// Files in the folder that are point clouds and can be read, by name.
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

/// The folder's own name, as a pipeline may be called.
pub(super) fn name_of(folder: &Path) -> String {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let plain: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' }).collect();
    let plain = plain.trim_start_matches(['.', '-']).to_owned();
    if plain.is_empty() { "pipeline".into() } else { plain }
}
