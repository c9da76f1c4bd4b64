//! The room and the Gaussians in it: at the start, when they were most, and in the end.

use crate::draw::room::{Panel, Room, Symbol};
use pwrfgs_core::Result;
use pwrfgs_experiment::Results;
use pwrfgs_experiment::Snapshot;
use pwrfgs_experiment::folder::{START_SNAPSHOT, UNPRUNED_SNAPSHOT};
use pwrfgs_experiment::text::grouped;
use serde::Serialize;

/// Height of text on the axes, SVG units.
const TEXT: f64 = 10.5;

/// The figure: three panels and what their symbols mean.
#[derive(Serialize)]
pub(super) struct Figure {
    panels: Vec<Panel>,
    legend: Vec<(String, &'static str)>,
    /// What a reader of the picture must know besides.
    note: String,
}

/// The figure of a run; where nothing is known of the training the last panel alone.
pub(super) fn figure(results: &Results<'_>) -> Result<Figure> {
    let last = Snapshot::of(results.facts.steps, &results.model.cloud);
    let read = |name: &str| results.training.map_or(Ok(None), |folder| Snapshot::read(&folder.join(name)));
    let step = |s: &Snapshot| grouped(s.step as i64);
    let mut moments: Vec<(String, Snapshot)> = Vec::new();
    moments.extend(read(START_SNAPSHOT)?.map(|s| ("At the start".into(), s)));
    moments.extend(read(UNPRUNED_SNAPSHOT)?.map(|s| (format!("Before pruning, step {}", step(&s)), s)));
    moments.push((if moments.is_empty() { "The Gaussians".into() } else { "In the end".into() }, last));
    let clouds: Vec<&Snapshot> = moments.iter().map(|m| &m.1).collect();
    let room = Room::new(results.data, results.partition, &clouds, TEXT);
    let panels = moments.iter().map(|(title, snapshot)| room.panel(title, snapshot, results.data)).collect();
    let symbol = |s: Symbol| {
        let size = format!("viewBox=\"0 0 {0} 14\" style=\"width:{0}px\"", s.width);
        (format!("<svg {size}>{}</svg>", s.inner), s.meaning)
    };
    let legend = room.legend().into_iter().map(symbol).collect();
    Ok(Figure { panels, legend, note: room.note(results.data) })
}
