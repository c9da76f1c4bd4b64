//! What lies in a folder of data, and which split suits it.

use pwrfgs::data::{Nerf2Spectrum, read_points};
use pwrfgs::experiment::inspect::test_distance;
use pwrfgs::experiment::{Observer, data_warnings, observed, staged};
use pwrfgs_core::plugin::name_of as plugin_name;
use pwrfgs_core::{DataSource, Dataset, Partition, Plugin, Result, Split, Task, recognise, rng};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Edges of cells that are tried for a split that holds out space, metres; the first with enough cells is taken.
const EDGES: [f64; 9] = [2.0, 1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01];
/// Enough cells to hold some out.
const CELLS: usize = 50;
/// Test transmitters nearer than this to a training one are told of, metres.
const NEAR: f64 = 0.05;

/// The data and what is suggested for them.
pub(super) struct Survey {
    title: String,
    /// What was observed.
    pub(super) task: Task,
    /// The plugin that reads the folder.
    pub(super) source: Plugin<dyn DataSource>,
    /// Numbers that describe a transmitter in place of its position.
    pub(super) features: Option<usize>,
    /// Size of the box of positions, metres.
    pub(super) extent: f64,
    observations: String,
    size: (usize, usize),
    official: bool,
    /// The suggested split, as RON.
    pub(super) split: String,
    /// Transmitters to train on.
    pub(super) transmitters: usize,
    /// Links to train on, to validate and to test.
    samples: [usize; 3],
    /// Median distance of a test transmitter to the nearest training one, metres.
    pub(super) nearest: f64,
    /// Files that hold a point cloud, and how many points.
    pub(super) clouds: Vec<(PathBuf, usize)>,
}

impl Survey {
    /// Rows and columns a pixel of training stands for: spectra of a small array are smooth.
    pub(super) fn stride(&self) -> usize {
        let (width, height) = self.size;
        if width >= 120 && width.is_multiple_of(3) && height.is_multiple_of(3) { 3 } else { 1 }
    }

    /// Loads the data in `folder`.
    pub(super) fn of(folder: &Path, observer: &mut dyn Observer) -> Result<Self> {
        // What holds nothing known is told by the reader of spectra, which says what it expects.
        let spectra = || -> Box<dyn DataSource> {
            Box::new(Nerf2Spectrum { root: folder.to_owned(), ..Nerf2Spectrum::default() })
        };
        let source = recognise(folder).unwrap_or_else(|| spectra().into());
        let data = staged(observer, "observations", |progress| source.load(Path::new(""), progress))?;
        let (split, partition) = suggested(&data)?;
        data_warnings(&data, Some(&partition)).iter().for_each(|warning| observer.on_warning(warning));
        Ok(Self {
            task: data.task(),
            source,
            features: data.features.as_ref().map(|features| features.width),
            extent: extent(&data),
            observations: observed(&data),
            size: (data.width, data.height),
            official: data.official.is_some(),
            split,
            transmitters: partition.train.iter().map(|&i| data.links[i].transmitter).collect::<BTreeSet<_>>().len(),
            samples: partition.sizes(),
            nearest: test_distance(&data, &partition),
            clouds: clouds(folder),
            title: data.title,
        })
    }

    /// In one line.
    pub(super) fn sentence(&self) -> String {
        let Self { observations, samples: [train, validation, test], .. } = self;
        format!("{observations}: {train} to train on, {validation} to validate, {test} to test")
    }

    /// What a reader of the pipeline should know.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!("{}: {}. Written by `pwrfgs init`.", self.title, self.sentence())];
        let near = format!("half of the test transmitters stand within {:.3} m of a training one", self.nearest);
        notes.push(match (self.official, self.nearest < NEAR) {
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
        notes.extend(self.task.has_pixels.then(|| match &self.clouds[..] {
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
        let split = Plugin::<dyn Split>::parse(text).map_err(pwrfgs_core::Error::Config)?;
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
pub(crate) fn name_of(folder: &Path) -> String {
    let absolute = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = absolute.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let plain: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' }).collect();
    let plain = plain.trim_start_matches(['.', '-']).to_owned();
    if plain.is_empty() { "pipeline".into() } else { plain }
}
