//! Interactive page: its scripts and style (`web`), and its data of room, measurements and Gaussians.
//!
//! `pwrfgs view` serves it from a running program; `report.html` contains everything it needs. Both show the same
//! stage: a room to rotate, a transmitter to move, and the observation at a receiver.

use pwrfgs_core::colour::{diverging, sequential};
use pwrfgs_core::{Activated, Dataset, MeasurementSetup, Origin, Partition, Pose, Real, evenly};
use pwrfgs_model::Ensemble;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap};

/// Named arrays with a JSON note, sent to a page as one safetensors file; `web/tensors.js` reads it, as it reads
/// models.
#[derive(Clone, Debug, Default)]
pub struct TensorBundle {
    /// JSON data besides the arrays.
    pub note: Value,
    arrays: BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>,
}

impl TensorBundle {
    /// Creates a bundle without arrays.
    pub fn new(note: Value) -> Self {
        Self { note, arrays: BTreeMap::new() }
    }

    /// Adds an array of numbers in single precision, row by row.
    ///
    /// # Panics
    /// If the numbers do not fill `shape`.
    pub fn put(&mut self, name: &str, shape: &[usize], values: impl IntoIterator<Item = Real>) {
        let bytes: Vec<u8> = values.into_iter().flat_map(|v| (v as f32).to_le_bytes()).collect();
        self.insert(name, Dtype::F32, shape, bytes);
    }

    /// Adds an array of identifiers.
    pub fn put_ids(&mut self, name: &str, ids: &[u32]) {
        self.insert(name, Dtype::U32, &[ids.len()], ids.iter().flat_map(|id| id.to_le_bytes()).collect());
    }

    /// Adds an array of bytes, row by row.
    ///
    /// # Panics
    /// If the bytes do not fill `shape`.
    pub fn put_bytes(&mut self, name: &str, shape: &[usize], bytes: Vec<u8>) {
        self.insert(name, Dtype::U8, shape, bytes);
    }

    /// Adds an array, and replaces one of the same name.
    fn insert(&mut self, name: &str, dtype: Dtype, shape: &[usize], bytes: Vec<u8>) {
        let bytes_per_number = if dtype == Dtype::U8 { 1 } else { 4 };
        assert_eq!(shape.iter().product::<usize>() * bytes_per_number, bytes.len(), "an array fills its shape");
        self.arrays.insert(name.into(), (dtype, shape.to_vec(), bytes));
    }

    /// Serialises the bundle as safetensors; `web/tensors.js` finds the note in its metadata under `pwrfgs`.
    pub fn to_bytes(&self) -> Vec<u8> {
        let views = self.arrays.iter().map(|(name, (dtype, shape, bytes))| {
            (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("an array fills its shape"))
        });
        let note = HashMap::from([("pwrfgs".to_owned(), self.note.to_string())]);
        safetensors::serialize(views, Some(note)).expect("shapes fit their data")
    }
}

/// Data and their split.
#[derive(Clone, Copy, Debug)]
pub struct PartitionedData<'a> {
    /// Measurements.
    pub data: &'a Dataset,
    /// Split of the data.
    pub partition: &'a Partition,
    /// Score of the first metric per link, NaN if unknown, `[L]`.
    pub scores: &'a [f64],
    /// Links on the page, which uses their indices in this list.
    pub links: &'a [usize],
}

/// Returns the room: receivers, bounds and colour tables; of `measured` data also at most `points` surface points, and
/// transmitter, receiver, set and score of each link on the page. `setup` is that of the model. Without data, the bounds
/// contain the receivers and `means`, metres from [`origin`].
pub fn room(
    setup: &MeasurementSetup,
    measured: Option<PartitionedData<'_>>,
    means: &[[Real; 3]],
    points: usize,
) -> TensorBundle {
    let mut tensors = TensorBundle::new(describe_room(setup, measured, means));
    for (name, colour) in [("power", sequential as fn(f64) -> [u8; 3]), ("error", |t| diverging(2.0 * t - 1.0))] {
        let table = (0..256).flat_map(|i| colour(f64::from(i) / 255.0)).collect();
        tensors.put_bytes(&format!("colours.{name}"), &[256, 3], table);
    }
    if let Some(measured) = measured {
        put_data(&mut tensors, measured, points);
    }
    tensors
}

/// Describes a [`room`] as JSON for `web/stage.js`: properties of the task and the plane, receivers, bounds, and title of
/// the data.
fn describe_room(setup: &MeasurementSetup, measured: Option<PartitionedData<'_>>, means: &[[Real; 3]]) -> Value {
    let origin = origin(setup, measured.map(|measured| measured.data));
    let (receivers, local_frame, poses) = match measured {
        Some(measured) => {
            (&measured.data.scene.receivers, measured.data.scene.origin, measured.data.scene.fixed_ends())
        }
        None => (&setup.receivers, setup.origin, setup.receivers.iter().map(|receiver| receiver.pose).collect()),
    };
    let names = receivers.iter().map(|receiver| receiver.name.as_str());
    let poses: Vec<(&str, Pose)> = names.zip(poses.into_iter().map(|pose| local_frame.world_pose(pose))).collect();
    let (plane, [_, unit]) = (&setup.plane, setup.task.level_name_at(&setup.receivers));
    let mut note = json!({
        "format": "pwrfgs-room",
        "has_pixels": setup.task.has_pixels,
        "is_scalar": setup.task.is_scalar,
        "unit": unit,
        "score": { "name": setup.task.headline.name, "higher": setup.task.headline.higher },
        "origin": origin.0,
        "plane": { "width": plane.width, "height": plane.height, "wraps": plane.wraps, "angles": plane.angles,
                   "camera": plane.camera },
        "receivers": poses.iter().map(|(name, pose)| describe_receiver(name, pose, origin)).collect::<Vec<_>>(),
        "frequencies_hz": setup.frequencies_hz,
    });
    let positions = poses.iter().map(|(_, pose)| origin.local(pose.position));
    note["bounds"] = match measured {
        Some(measured) => json!([measured.data.scene.bounds.0, measured.data.scene.bounds.1]),
        None => bounding_box(means.iter().copied().chain(positions)),
    };
    if let Some(measured) = measured {
        note["title"] = json!(measured.data.title);
        note["simulated"] = json!(measured.data.is_simulated());
        note["placed"] = json!(measured.data.placed);
    }
    note
}

/// Returns the origin of all coordinates of a page: that of the data, or without data that of the model.
pub fn origin(setup: &MeasurementSetup, data: Option<&Dataset>) -> Origin {
    data.map_or(setup.origin, |data| data.scene.origin)
}

/// Adds at most `points` surface points, and transmitter, id, receiver, score and set of each of `links`.
fn put_data(
    tensors: &mut TensorBundle,
    PartitionedData { data, partition, scores, links }: PartitionedData<'_>,
    points: usize,
) {
    let shown = evenly(&(0..data.scene.points.len()).collect::<Vec<_>>(), points);
    tensors.put("points", &[shown.len(), 3], shown.iter().flat_map(|&i| data.scene.points[i]));
    let (n, samples) = (links.len(), || links.iter().map(|&i| data.sample(i)));
    tensors.put("links.tx", &[n, 3], samples().flat_map(|sample| data.scene.origin.local(sample.position())));
    tensors.put("links.id", &[n], samples().map(|sample| sample.id as Real));
    tensors.put("links.receiver", &[n], samples().map(|sample| sample.receiver as Real));
    tensors.put("links.score", &[n], links.iter().map(|&i| scores[i] as Real));
    tensors.put_bytes("links.part", &[n], links.iter().map(|&i| partition.set_of(i) as u8).collect());
}

/// Describes a receiver as JSON: name, position in metres from `origin`, and boresight as a unit vector.
fn describe_receiver(name: &str, pose: &Pose, origin: Origin) -> Value {
    json!({ "name": name, "position": origin.local(pose.position), "boresight": pose.turned([0.0, 0.0, 1.0]) })
}

/// Returns the corners of the bounding box of `points` as JSON; a cube of 2 m around the origin if there are none.
fn bounding_box(points: impl Iterator<Item = [Real; 3]>) -> Value {
    let start = ([Real::INFINITY; 3], [Real::NEG_INFINITY; 3]);
    let (low, high) = points.fold(start, |(low, high), p| {
        (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k])))
    });
    if low[0] > high[0] { json!([[-1, -1, -1], [1, 1, 1]]) } else { json!([low, high]) }
}

/// Returns the Gaussians of all members: `means` and `scales` `[N,3]`, `quats` `[N,4]`, `opacities` and [`strengths`]
/// `[N,1]`; the means in metres from `origin`. With `tx` (metres, world frame), they are those for a transmitter there.
pub fn gaussians(ensemble: &Ensemble, origin: Origin, tx: Option<[f64; 3]>) -> TensorBundle {
    let mut tensors = TensorBundle::new(json!({ "gaussians": ensemble.gaussians() }));
    let n = ensemble.gaussians();
    let activated: Vec<_> = ensemble.members().iter().map(|model| model.gaussians(tx)).collect();
    let primitives = || activated.iter().map(|gaussians| &gaussians.primitives);
    tensors.put("means", &[n, 3], ensemble.means_from(origin).into_flattened());
    tensors.put("scales", &[n, 3], primitives().flat_map(|p| p.scales.as_flattened()).copied());
    tensors.put("quats", &[n, 4], primitives().flat_map(|p| p.quats.as_flattened()).copied());
    tensors.put("opacities", &[n, 1], primitives().flat_map(|p| &p.opacities).copied());
    tensors.put("strengths", &[n, 1], activated.iter().flat_map(strengths));
    tensors
}

/// Returns the strengths of the Gaussians, `[N]`: the pixel value that each would give alone if it were opaque; 0 if it
/// depends on the transmitter and none is given.
pub fn strengths(gaussians: &Activated) -> Vec<Real> {
    gaussians.strengths.clone().unwrap_or_else(|| vec![0.0; gaussians.primitives.len()])
}

/// Markup of the stage, the interactive part of a page.
pub const STAGE: &str = include_str!("../web/stage.html");
/// Style of the stage.
pub const STYLE: &str = include_str!("../web/stage.css");
/// Style of a page that holds only the stage, in light and dark.
pub const PAGE_STYLE: &str = include_str!("../web/page.css");
/// JavaScript modules by name, each after the modules that it imports.
pub const FILES: [(&str, &str); 11] = [
    ("tensors.js", include_str!("../web/tensors.js")),
    ("predict.js", include_str!("../web/predict.js")),
    ("ssim.js", include_str!("../web/ssim.js")),
    ("room.js", include_str!("../web/room.js")),
    ("spectrum.js", include_str!("../web/spectrum.js")),
    ("chart.js", include_str!("../web/chart.js")),
    ("location.js", include_str!("../web/location.js")),
    ("source.js", include_str!("../web/source.js")),
    ("stage.js", include_str!("../web/stage.js")),
    ("tables.js", include_str!("../web/tables.js")),
    ("report.js", include_str!("../web/report.js")),
];

/// Joins all modules to one script for a self-contained page, and appends `last`. Removes the imports, each of which is
/// one line, and the word `export`.
pub fn bundle(last: &str) -> String {
    let mut script = String::from("\"use strict\";\n");
    for (_, text) in FILES {
        for line in text.lines().filter(|line| !line.starts_with("import ")) {
            script.push_str(line.strip_prefix("export ").unwrap_or(line));
            script.push('\n');
        }
    }
    script + last
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joins_modules_into_one_script_with_separate_scopes() {
        let script = bundle("start();");
        assert!(script.ends_with("start();") && !script.contains("\nimport ") && !script.contains("\nexport "));
        assert!(!script.contains("</script"), "a page would end there");
        let mut names: Vec<&str> = Vec::new();
        for line in script.lines() {
            let declared = ["function ", "class ", "const "].iter().find_map(|word| line.strip_prefix(word));
            let name = declared.map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or(""));
            names.extend(name.filter(|name| !name.is_empty()));
        }
        names.sort_unstable();
        let twice = names.windows(2).find(|pair| pair[0] == pair[1]);
        assert_eq!(twice, None, "two modules declare the same name, and a report has them in one script");
    }
}
