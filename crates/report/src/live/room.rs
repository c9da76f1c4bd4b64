//! What a page knows of data and split: the room, who sends and who listens.

use crate::live::Pack;
use pwrfgs_core::colour::{diverging, sequential};
use pwrfgs_core::{Dataset, Frame, Origin, Partition, Pose, Real, evenly};
use serde_json::{Value, json};

/// Data and how they are divided.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// What was observed.
    pub data: &'a Dataset,
    /// The parts.
    pub partition: &'a Partition,
    /// A score of the first metric for each link, NaN where there is none; `[L]`.
    pub scores: &'a [f64],
    /// The links that the page knows, which calls them by their places in this list.
    pub links: &'a [usize],
}

/// The room: receivers, bounds, surface points (`points` of them at most), and of every link its transmitter, part and score.
/// `frame` is that of the model, and `means` places that the room must hold where there are no data.
pub fn room(frame: &Frame, known: Option<Known<'_>>, means: &[[Real; 3]], points: usize) -> Pack {
    let origin = origin(frame, known.map(|known| known.data));
    let receivers = known.map_or(&frame.receivers, |known| &known.data.scene.receivers);
    let own = known.map_or(frame.origin, |known| known.data.scene.origin);
    let poses: Vec<(&str, Pose)> = receivers.iter().map(|r| (r.name.as_str(), own.world_pose(r.pose))).collect();
    let plane = &frame.plane;
    let mut note = json!({
        "format": "pwrfgs-room",
        "has_pixels": frame.task.has_pixels,
        "is_scalar": frame.task.is_scalar,
        "unit": frame.task.level_name[1],
        "score": { "name": frame.task.headline.name, "higher": frame.task.headline.higher },
        "origin": origin.0,
        "plane": { "width": plane.width, "height": plane.height, "wraps": plane.wraps, "angles": plane.angles },
        "receivers": poses.iter().map(|(name, pose)| receiver(name, pose, origin)).collect::<Vec<_>>(),
        "frequencies_hz": frame.frequencies_hz,
    });
    let places = poses.iter().map(|(_, pose)| origin.local(pose.position));
    note["bounds"] = match known {
        Some(known) => json!([known.data.scene.bounds.0, known.data.scene.bounds.1]),
        None => bounds(means.iter().copied().chain(places)),
    };
    if let Some(known) = known {
        note["title"] = json!(known.data.title);
        note["simulated"] = json!(known.data.is_simulated());
        note["placed"] = json!(known.data.placed);
    }
    let mut pack = Pack::new(note);
    for (name, colour) in [("power", sequential as fn(f64) -> [u8; 3]), ("error", |t| diverging(2.0 * t - 1.0))] {
        let all = (0..256).flat_map(|i| colour(f64::from(i) / 255.0)).collect();
        pack.put_bytes(&format!("colours.{name}"), &[256, 3], all);
    }
    if let Some(known) = known {
        put_data(&mut pack, known, points);
    }
    pack
}

/// What all places of a page count from.
pub fn origin(frame: &Frame, data: Option<&Dataset>) -> Origin {
    data.map_or(frame.origin, |data| data.scene.origin)
}

fn put_data(pack: &mut Pack, Known { data, partition, scores, links }: Known<'_>, points: usize) {
    let shown = evenly(&(0..data.scene.points.len()).collect::<Vec<_>>(), points);
    pack.put("points", &[shown.len(), 3], shown.iter().flat_map(|&i| data.scene.points[i]));
    let (n, samples) = (links.len(), || links.iter().map(|&i| data.sample(i)));
    pack.put("links.tx", &[n, 3], samples().flat_map(|sample| data.scene.origin.local(sample.tx)));
    pack.put("links.id", &[n], samples().map(|sample| sample.id as Real));
    pack.put("links.receiver", &[n], samples().map(|sample| sample.receiver as Real));
    pack.put("links.score", &[n], links.iter().map(|&i| scores[i] as Real));
    pack.put_bytes("links.part", &[n], links.iter().map(|&i| partition.set_of(i) as u8).collect());
}

fn receiver(name: &str, pose: &Pose, origin: Origin) -> Value {
    json!({ "name": name, "position": origin.local(pose.position), "boresight": pose.turned([0.0, 0.0, 1.0]) })
}

/// Corners around some places; of none a metre.
fn bounds(places: impl Iterator<Item = [Real; 3]>) -> Value {
    let start = ([Real::INFINITY; 3], [Real::NEG_INFINITY; 3]);
    let (low, high) = places.fold(start, |(low, high), p| {
        (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k])))
    });
    if low[0] > high[0] { json!([[-1, -1, -1], [1, 1, 1]]) } else { json!([low, high]) }
}
