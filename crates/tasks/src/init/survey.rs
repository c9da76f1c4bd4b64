//! `DataSurvey`: content of a data folder, and a split without leakage.

use pwrfgs_core::plugin::name_of as plugin_name;
use pwrfgs_core::{
    DataSource, Dataset, Error, Location, Partition, Plugin, Result, SiteSize, Split, block_of, recognise, rng,
};
use pwrfgs_data::read_points;
use pwrfgs_experiment::inspect::test_distance;
use pwrfgs_experiment::text::grouped;
use pwrfgs_experiment::{Observer, check_findings, describe_observations, run_stage};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Candidate cell edges of a split that holds out space, times the powers of ten, metres; the largest with enough cells is used.
const EDGES: [f64; 4] = [5.0, 3.0, 2.0, 1.0];
/// Exponents of the powers of ten.
const POWERS: std::ops::RangeInclusive<i32> = -2..=5;
/// Number of cells that suffices for such a split.
const CELLS: usize = 50;
/// Number of cells that suffices if their edges are at most [`SiteSize::block_edge`], since smaller cells are no regions.
const LEAST_CELLS: usize = 12;
/// Number of links per step above which a batch has fewer transmitters; `ble` has 128 transmitters at 21 receivers.
const LINKS: usize = 2_720;
/// Distance of test to training transmitters below which the file has a note, metres.
const NEAR: f64 = 0.05;

/// Problem of a folder without data of a known layout.
const UNKNOWN: &str = "no known layout of data: expected spectrum/ and gateway_info.yml, or spectra.npy (spectra); \
                       gateway_rssi.csv and gateway_position.yml (received powers); channel.npy and receiver.yml, or csidata.npy \
                       and base-station.yml (channels); sparse/0/images.txt and images/ (images of a camera); see docs/data.md";

/// Creates the error for a folder without data of a known layout, for a file, or for a missing path.
pub fn unknown_folder_error(folder: &Path) -> Error {
    let problem = match folder.metadata() {
        Ok(entry) if entry.is_dir() => UNKNOWN.to_owned(),
        Ok(_) => format!("is a file; {}", advise_on_file(folder)),
        Err(_) => "no such folder".to_owned(),
    };
    Error::input(folder, problem)
}

/// Suggests the next step for a file that was given in place of a data folder.
fn advise_on_file(file: &Path) -> String {
    let folder = file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if recognise(folder).is_some() {
        return format!("give the folder of the data, {}", folder.display());
    }
    let import = match lowercase_extension(file).as_str() {
        "csv" | "tsv" | "txt" | "gz" => "convert a table of powers with `pwrfgs import --table",
        "npy" | "npz" => "convert spectra with `pwrfgs import --spectra",
        _ => return "give a folder in a layout of docs/data.md".into(),
    };
    format!("give a folder in a layout of docs/data.md, or {import} {} --out FOLDER`", file.display())
}

/// Returns whether `path` is a file with the extension of a table or of NumPy arrays; not `txt`, which any text can have.
pub fn is_table_or_array(path: &Path) -> bool {
    path.is_file() && ["csv", "tsv", "gz", "npy", "npz"].contains(&lowercase_extension(path).as_str())
}

/// Returns the extension in lower case, or an empty text.
fn lowercase_extension(path: &Path) -> String {
    path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase()
}

/// Content of a data folder, with a suitable split.
pub struct DataSurvey {
    /// Plugin that reads the folder.
    pub(super) source: Plugin<dyn DataSource>,
    /// The data.
    pub data: Dataset,
    /// Names of accepted findings.
    pub(super) accepted: Vec<String>,
    /// Suggested split, as RON.
    pub(super) split: String,
    partition: Partition,
    /// Median distance of test transmitters to the nearest training transmitter, metres.
    pub(super) nearest: f64,
    /// Point cloud files, with numbers of points.
    pub(super) clouds: Vec<(PathBuf, usize)>,
}

impl DataSurvey {
    /// Loads the data in `folder` and suggests a split; warns of findings on the data. `accepted` are the names of accepted
    /// findings.
    ///
    /// # Errors
    /// No data of a known layout, invalid data, or errors of [`Self::of_data`].
    pub fn read(folder: &Path, accepted: &[String], observer: &mut dyn Observer) -> Result<Self> {
        let source = recognise(folder).ok_or_else(|| unknown_folder_error(folder))?;
        let data = run_stage(observer, "observations", |progress| source.load(Path::new(""), progress))?;
        Self::of_data(source, data, Some(folder), accepted, observer)
    }

    /// Suggests a split for `data`, which `source` reads; warns of findings on the data. The first point cloud in `folder`
    /// becomes that of the room, except for images of a camera.
    ///
    /// # Errors
    /// Data that no split divides, or findings that make results meaningless and are not `accepted`.
    pub fn of_data(
        source: Plugin<dyn DataSource>,
        mut data: Dataset,
        folder: Option<&Path>,
        accepted: &[String],
        observer: &mut dyn Observer,
    ) -> Result<Self> {
        let clouds = folder.map(read_clouds).unwrap_or_default();
        let (split, partition) = suggest_split(&data)?;
        if let Some((_, points)) = clouds.first().filter(|_| data.camera().is_none()) {
            data.scene.points = points.iter().map(|point| data.scene.origin.local(*point)).collect();
        }
        check_findings(&data, Some(&partition), Some(accepted), observer)?;
        let nearest = test_distance(&data, &partition);
        let clouds = clouds.into_iter().map(|(path, points)| (path, points.len())).collect();
        Ok(Self { source, data, accepted: accepted.to_vec(), split, partition, nearest, clouds })
    }

    /// Returns the stride of training pixels: 3 for spectra of at least 120 columns whose size it divides, since spectra
    /// of a small array are smooth; else 1.
    pub(super) fn training_stride(&self) -> usize {
        let Dataset { width, height, .. } = self.data;
        if width >= 120 && width.is_multiple_of(3) && height.is_multiple_of(3) { 3 } else { 1 }
    }

    /// Returns the number of positions in the training and validation sets.
    pub(super) fn known_positions(&self) -> usize {
        let known = self.partition.known().all();
        known.iter().map(|&i| self.data.links[i].location).collect::<BTreeSet<_>>().len()
    }

    /// Returns the number of links of the training and validation sets.
    pub(super) fn known_links(&self) -> usize {
        self.partition.known().all().len()
    }

    /// Returns the number of parts of the training and validation sets that the split does not divide, such as cells: the
    /// largest number of folds.
    pub(super) fn known_parts(&self) -> usize {
        let split = Plugin::<dyn Split>::parse(&self.split);
        split.map_or(0, |split| split.units(&self.data, &self.partition.known().all()).len())
    }

    /// Returns whether the validation set has samples.
    pub(super) fn has_validation(&self) -> bool {
        !self.partition.validation.is_empty()
    }

    /// Returns the batch size: the number of training transmitters, at most `most`, and at least 1. With more than 1, a
    /// step has on average at most 2,720 links (`LINKS`).
    pub fn batch_size(&self, most: usize) -> usize {
        let transmitters = self.data.locations_of(&self.partition.train).len();
        transmitters.min(LINKS / self.links_per_transmitter()).clamp(1, most)
    }

    /// Returns the mean number of training links per transmitter, rounded up; at least 1.
    fn links_per_transmitter(&self) -> usize {
        self.partition.train.len().div_ceil(self.data.locations_of(&self.partition.train).len().max(1)).max(1)
    }

    /// Returns whether the number of links limits a `batch`.
    pub(super) fn is_link_limited(&self, batch: usize) -> bool {
        batch == (LINKS / self.links_per_transmitter()).max(1)
    }

    /// Describes the size of a `batch` that the number of links limits; `None` if it does not.
    pub(super) fn batch_note(&self, batch: usize) -> Option<String> {
        let links = self.links_per_transmitter();
        self.is_link_limited(batch).then(|| {
            format!(
                "`batch` is the number of transmitters per step: {batch} of {links} links each are about {} links.",
                grouped((batch * links) as i64)
            )
        })
    }

    /// Describes the part that the suggested split of data without index files holds out.
    fn held_out_part(&self) -> &'static str {
        match self.split.split('(').next() {
            Some("Voxel") => "whole regions, so that test transmitters are not next to training transmitters",
            Some("TimeBlock") => "a block of time",
            _ => "random samples",
        }
    }

    /// Describes the observations and the sizes of the sets in one line.
    pub fn describe(&self) -> String {
        let [train, validation, test] = self.partition.sizes();
        let observations = describe_observations(&self.data);
        format!("{observations}: {train} training, {validation} validation, {test} test")
    }

    /// Lists the notes for the head of the pipeline file: data, split, frequencies and start of the Gaussians.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = vec![format!("{}: {}. Written by `pwrfgs init`.", self.data.title, self.describe())];
        let near = if self.data.placed {
            format!("the median distance from test to training transmitters is {:.3} m", self.nearest)
        } else {
            "the data have no transmitter positions".into()
        };
        notes.push(match (self.data.official.is_some(), self.nearest < NEAR) {
            (true, true) => format!(
                "The split is from the index files of the data, and {near}: copying the nearest training sample scores \
                 high. `split: Voxel()` holds out cells of space and `split: TimeBlock()` a block of time."
            ),
            (true, false) => format!("The split is from the index files of the data; {near}."),
            (false, _) => {
                format!("The data have no index files. The split holds out {}; {near}.", self.held_out_part())
            }
        });
        if plugin_name(&self.source) == "Nerf2Csi" {
            notes.push(
                "The files do not contain the frequencies: correct `carrier_hz` and `spacing_hz` of the data.".into(),
            );
        }
        notes.extend(self.data.task().has_pixels.then(|| match &self.clouds[..] {
            _ if self.data.camera().is_some() => match self.data.scene.points.len() {
                0 => "The model has no points: Gaussians start at random amid the camera positions.".into(),
                points => format!("Gaussians start on the points of the model ({points})."),
            },
            [] => "The folder has no point cloud of the room: Gaussians start on a grid of directions.".into(),
            [(path, points), others @ ..] => {
                let others: Vec<String> = others.iter().map(|(path, _)| file_name(path)).collect();
                let more = if others.is_empty() {
                    String::new()
                } else {
                    format!(" Other point clouds: {}.", others.join(", "))
                };
                format!("Gaussians start on {} ({points} points).{more}", file_name(path))
            }
        }));
        notes
    }
}

/// Returns the last part of a path.
fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Suggests a split with little leakage, as RON and applied: index files of the data, else cells of space, else a block of
/// time, else random.
///
/// # Errors
/// No split is possible.
pub fn suggest_split(data: &Dataset) -> Result<(String, Partition)> {
    let split_by = |text: &str| -> Result<Partition> {
        let split = Plugin::<dyn Split>::parse(text).map_err(Error::Config)?;
        split.split(data, &mut rng::stream(0, "split", 0))
    };
    if data.official.is_some() {
        return Ok(("Official()".into(), split_by("Official()")?));
    }
    let edge = suggest_cell_edge(data).map(|edge| format!("Voxel(size_m: {edge})"));
    let choices = edge.into_iter().chain(["TimeBlock()".into(), "Random()".into()]);
    let fits = |partition: &Partition| !partition.train.is_empty() && !partition.test.is_empty();
    for choice in choices {
        if let Some(partition) = split_by(&choice).ok().filter(fits) {
            return Ok((choice, partition));
        }
    }
    // The error of this split, or its sets, of which one is empty.
    Ok(("Random()".into(), split_by("Random()")?))
}

/// Returns the longest side of the bounding box of the positions, metres.
pub(super) fn longest_side(data: &Dataset) -> f64 {
    SiteSize::new(data.locations.iter().map(Location::position)).longest
}

/// Suggests the edge of cells that are held out, metres: the largest with enough cells, at least two spacings of the
/// positions; `None` if there is none.
fn suggest_cell_edge(data: &Dataset) -> Option<f64> {
    let positions = || data.locations.iter().map(Location::position);
    let site = SiteSize::new(positions());
    // Parsed, so that each edge is the number nearest to its decimal form.
    let edges = POWERS.rev().flat_map(|power| EDGES.map(|edge| format!("{edge}e{power}").parse().unwrap_or(edge)));
    edges.into_iter().take_while(|edge| *edge >= 2.0 * site.spacing).find(|&edge: &f64| {
        let cells = positions().map(|position| block_of(position, edge)).collect::<BTreeSet<_>>().len();
        cells >= if edge <= site.block_edge() { LEAST_CELLS } else { CELLS }
    })
}

/// Reads the point clouds in the folder, in order of their file names: PLY, XYZ, and CSV with `point` in the name. Unreadable
/// files are left out.
fn read_clouds(folder: &Path) -> Vec<(PathBuf, Vec<[f64; 3]>)> {
    let is_cloud = |path: &PathBuf| {
        let extension = lowercase_extension(path);
        let has_name = path.file_stem().is_some_and(|name| name.to_string_lossy().to_lowercase().contains("point"));
        path.is_file() && (extension == "ply" || extension == "xyz" || (extension == "csv" && has_name))
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut paths: Vec<PathBuf> = entries.filter(is_cloud).collect();
    paths.sort();
    let read = |path: PathBuf| {
        let points = read_points(&path).ok()?;
        Some((path, points))
    };
    paths.into_iter().filter_map(read).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Observations, Pose, Receiver, Sample};

    /// Powers at `count` positions, `step` metres apart in rows of `columns`.
    fn grid(count: u32, columns: u32, step: f64) -> Dataset {
        let place = |id: u32| [step * f64::from(id % columns), step * f64::from(id / columns), 0.0];
        let samples: Vec<Sample> = (0..count).map(|id| Sample::new(id, place(id))).collect();
        let receivers = vec![Receiver::new("a", Pose::IDENTITY)];
        let powers = Observations::Powers(vec![-60.0; count as usize]);
        Dataset::of_links("grid", receivers, vec![], &samples, powers).unwrap()
    }

    #[test]
    fn cells_follow_spacing_and_site() {
        // A walk of 1 km with a position every 2 m; a survey of 1 m in an office; a dense scan of 10 x 10 m.
        for (count, columns, step, edge) in
            [(500, 500, 2.0, Some(30.0)), (108, 27, 1.0, Some(3.0)), (10_000, 100, 0.1, Some(1.0)), (8, 8, 1.0, None)]
        {
            assert_eq!(suggest_cell_edge(&grid(count, columns, step)), edge, "{count} positions");
        }
    }

    #[test]
    fn notes_state_what_the_split_holds_out() {
        let note = |split: &str, placed: bool| {
            let (source, mut data) = (Plugin::parse("Nerf2Rssi(root: \"grid\")").unwrap(), grid(9, 3, 1.0));
            data.placed = placed;
            let (split, partition) = (split.to_owned(), Partition { train: (0..9).collect(), ..Partition::default() });
            let survey = DataSurvey { source, data, accepted: vec![], split, partition, nearest: 0.0, clouds: vec![] };
            survey.notes()[1].clone()
        };
        assert!(note("Voxel(size_m: 1)", true).contains("holds out whole regions, so that"));
        assert!(note("TimeBlock()", true).contains("holds out a block of time; the median distance"));
        assert!(note("Random()", false).ends_with("random samples; the data have no transmitter positions."));
    }

    #[test]
    fn step_has_about_2_720_links_at_most() {
        let batch = |receivers: usize, most: usize| {
            let sample = |k: usize| Sample {
                receiver: k % receivers,
                ..Sample::new((k / receivers) as u32, [(k / receivers) as f64, 0.0, 0.0])
            };
            let samples: Vec<Sample> = (0..200 * receivers).map(sample).collect();
            let ends: Vec<Receiver> = (0..receivers).map(|k| Receiver::new(format!("g{k}"), Pose::IDENTITY)).collect();
            let powers = Observations::Powers(vec![-60.0; samples.len()]);
            let data = Dataset::of_links("many", ends, vec![], &samples, powers).unwrap();
            let partition = Partition { train: (0..data.len()).collect(), validation: vec![], test: vec![] };
            let source = Plugin::parse("Nerf2Rssi(root: \"many\")").unwrap();
            let (split, nearest) = ("Random()".to_owned(), 1.0);
            let survey = DataSurvey { source, data, accepted: vec![], split, partition, nearest, clouds: vec![] };
            (survey.batch_size(most), survey.batch_note(survey.batch_size(most)).is_some())
        };
        assert_eq!(batch(1, 128), (128, false));
        assert_eq!(batch(1, 500), (200, false), "as many as there are");
        assert_eq!(batch(21, 128), (128, false), "as `ble`");
        assert_eq!(batch(500, 32), (5, true));
        assert_eq!(batch(500, 4), (4, false));
        assert_eq!(batch(3_000, 32), (1, true));
    }
}
