//! Gaussians over the scene's point cloud with their Chamfer distances: figure 3 of the paper.

use super::{COLUMN, Figure, PAGE};
use crate::canvas::font::{LINE, TEXT, wrapped};
use crate::canvas::{Anchor, Canvas};
use crate::draw::legend::Legend;
use crate::draw::room::{Panel, Room};
use crate::study::{Setting, Variant};
use minijinja::context;
use pwrfgs_core::Dataset;
use pwrfgs_core::Result;
use pwrfgs_model::Snapshot;

/// At most so many variants are shown.
const MOST: usize = 6;

pub(super) fn figure(setting: &Setting, data: &Dataset) -> Result<Option<Figure>> {
    let with = || setting.variants.iter().filter(|v| v.runs[0].facts.gaussians > 0);
    let shown: Vec<&Variant> = with().take(MOST).collect();
    if shown.is_empty() {
        return Ok(None);
    }
    let snapshot = |v: &&Variant| {
        let run = &v.runs[0];
        Ok(Snapshot::of_ensemble(run.facts.steps, &run.model(data)?))
    };
    let clouds: Vec<Snapshot> = shown.iter().map(snapshot).collect::<Result<_>>()?;
    let mut canvas = Canvas::new(if shown.len() == 1 { COLUMN } else { PAGE }, 0.0);
    let columns = match shown.len() {
        n @ 1..=3 => n,
        4 => 2,
        _ => 3,
    };
    let width = canvas.width / columns as f64;
    let partition = setting.variants[0].runs[0].partition(data)?;
    let all: Vec<&Snapshot> = clouds.iter().collect();
    let room = Room::new(data, &partition, &all, TEXT * COLUMN / width);
    let panels: Vec<Panel> = shown.iter().zip(&clouds).map(|(v, cloud)| room.panel(&v.label, cloud, data)).collect();
    let mut top = 0.0;
    for row in panels.chunks(columns) {
        top = draw_row(&mut canvas, row, width, top);
    }
    let legend = Legend::new(room.legend(), canvas.width);
    legend.draw(&mut canvas, top);
    canvas.height = top + legend.height();
    let words = context! { more => with().count() - shown.len(), note => room.note(data) };
    Ok(Some(Figure::new("room", setting, words, &canvas)))
}

/// Draws panels beside each other, each with its name above and numbers below; returns where the row ends.
fn draw_row(canvas: &mut Canvas, row: &[Panel], width: f64, top: f64) -> f64 {
    let mut bottom = top;
    let names: Vec<Vec<String>> = row.iter().map(|panel| wrapped(&panel.title, width - 10.0)).collect();
    let head = LINE * names.iter().map(Vec::len).max().unwrap_or(1) as f64 + 4.0;
    for (k, panel) in row.iter().enumerate() {
        let (left, middle) = (k as f64 * width, (k as f64 + 0.5) * width);
        canvas.lines([middle, top + head / 2.0], Anchor::Middle, &names[k]);
        canvas.put([left, top + head], width / COLUMN, &panel.picture);
        // The numbers of the axes leave room below.
        let mut y = top + head + panel.picture.height * width / COLUMN - 8.0;
        let lines = std::iter::once(panel.numbers.as_str()).chain(panel.caption.split("; "));
        for line in lines.filter(|line| !line.is_empty()) {
            for line in wrapped(line, width - 6.0) {
                y += LINE;
                canvas.text([middle, y], Anchor::Middle, line);
            }
        }
        bottom = f64::max(bottom, y + 8.0);
    }
    bottom
}
