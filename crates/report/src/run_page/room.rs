//! The room and the Gaussians in it: at the start, when they were most, and in the end.

use crate::draw::legend::Symbol;
use crate::draw::room::{Panel, Room};
use minijinja::{Value, context};
use pwrfgs_core::Result;
use pwrfgs_experiment::LoadedRun;
use pwrfgs_experiment::folder::{START_SNAPSHOT, UNPRUNED_SNAPSHOT};
use pwrfgs_experiment::text::grouped;
use pwrfgs_model::Snapshot;

/// Height of text on the axes.
const TEXT: f64 = 10.5;

/// Three panels, what their symbols mean and what a reader must know besides; the last panel alone where nothing is
/// known of the training.
pub(super) fn figure(run: &LoadedRun<'_>) -> Result<Value> {
    let last = Snapshot::of_ensemble(run.record.facts.steps, run.model);
    let read = |name: &str| Snapshot::read(&run.record.folder.join(name));
    let step = |s: &Snapshot| grouped(s.step as i64);
    let mut moments: Vec<(String, Snapshot)> = Vec::new();
    moments.extend(read(START_SNAPSHOT)?.map(|s| ("At the start".into(), s)));
    moments.extend(read(UNPRUNED_SNAPSHOT)?.map(|s| (format!("Before pruning, step {}", step(&s)), s)));
    moments.push((if moments.is_empty() { "The Gaussians".into() } else { "In the end".into() }, last));
    let clouds: Vec<&Snapshot> = moments.iter().map(|m| &m.1).collect();
    let room = Room::new(run.data, run.partition, &clouds, TEXT);
    let panel = |(title, snapshot): &(String, Snapshot)| {
        let Panel { title, numbers, picture, caption } = room.panel(title, snapshot, run.data);
        let svg = picture.svg("room", &title);
        context! { title, numbers, svg, caption }
    };
    let panels: Vec<Value> = moments.iter().map(panel).collect();
    let symbol = |s: Symbol| (s.picture.svg("symbol", &s.meaning), s.meaning);
    let legend: Vec<(String, String)> = room.legend().into_iter().map(symbol).collect();
    Ok(context! { panels, legend, note => room.note(run.data) })
}
