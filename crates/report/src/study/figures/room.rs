//! Gaussians over the scene's point cloud with their Chamfer distances: figure 3 of the paper.

use super::loaded::Loaded;
use super::sheet::{LINE, TEXT, wrapped};
use super::{Figure, Sheet, source};
use crate::draw::charts::text_width;
use crate::draw::room::{Panel, Room, Symbol};
use crate::study::Setting;
use pwrfgs_core::Result;
use pwrfgs_experiment::Snapshot;

/// At most so many variants are shown.
const MOST: usize = 6;
/// Width of a panel before scaling.
const WIDTH: f64 = 380.0;

pub(super) fn figure(setting: &Setting, loaded: &Loaded) -> Result<Option<Figure>> {
    let shown = &setting.variants[..setting.variants.len().min(MOST)];
    let snapshot = |v: &crate::study::Variant| {
        let run = &v.runs[0];
        Ok(Snapshot::of(run.facts.steps, &loaded.model(run)?.cloud))
    };
    let clouds: Vec<Snapshot> = shown.iter().map(snapshot).collect::<Result<_>>()?;
    let mut sheet = if shown.len() == 1 { Sheet::column() } else { Sheet::page() };
    let columns = match shown.len() {
        n @ 1..=3 => n,
        4 => 2,
        _ => 3,
    };
    let width = sheet.width / columns as f64;
    let partition = loaded.partition(&setting.variants[0].runs[0])?;
    let all: Vec<&Snapshot> = clouds.iter().collect();
    let room = Room::new(&loaded.data, &partition, &all, TEXT * WIDTH / width);
    let panels: Vec<Panel> =
        shown.iter().zip(&clouds).map(|(v, cloud)| room.panel(&v.label, cloud, &loaded.data)).collect();
    let mut top = 0.0;
    for row in panels.chunks(columns) {
        top = draw_row(&mut sheet, row, width, top);
    }
    sheet.height = draw_legend(&mut sheet, &room.legend(), top + 4.0);
    let more = match setting.variants.len() - shown.len() {
        0 => String::new(),
        rest => format!(" {rest} more variants are not shown."),
    };
    let note = room.note(&loaded.data);
    let caption = format!(
        "Gaussians of the trained models in the room, the first seed of each variant, with their number N and their \
         Chamfer distance to the point cloud (sum of the two mean squared distances to the nearest neighbour).{more}{} {}",
        if note.is_empty() { note } else { format!(" {note}") },
        source(setting)
    );
    Figure::sheet("room", "Gaussians in the room", caption, &sheet).map(Some)
}

/// Draws panels beside each other, each with its name above and numbers below; returns where the row ends.
fn draw_row(sheet: &mut Sheet, row: &[Panel], width: f64, top: f64) -> f64 {
    let mut bottom = top;
    let names: Vec<Vec<String>> = row.iter().map(|panel| wrapped(&panel.title, width - 10.0)).collect();
    let head = LINE * names.iter().map(Vec::len).max().unwrap_or(1) as f64 + 4.0;
    for (k, panel) in row.iter().enumerate() {
        let (left, middle) = (k as f64 * width, (k as f64 + 0.5) * width);
        sheet.lines([middle, top + head / 2.0], "middle", &names[k]);
        sheet.piece([left, top + head], width / WIDTH, inside(&panel.svg));
        // The numbers of the axes leave room below.
        let mut y = top + head + panel.height * width / WIDTH - 8.0;
        for line in [&panel.numbers, &panel.caption].into_iter().filter(|line| !line.is_empty()) {
            for line in wrapped(line, width - 6.0) {
                y += LINE;
                sheet.text([middle, y], "middle", &line);
            }
        }
        bottom = f64::max(bottom, y + 8.0);
    }
    bottom
}

/// Draws symbols with their meaning, in as many lines as they need; returns where the last ends.
fn draw_legend(sheet: &mut Sheet, symbols: &[Symbol], top: f64) -> f64 {
    let width = |s: &Symbol| f64::from(s.width + text_width(s.meaning)) + 15.0;
    let mut lines: Vec<Vec<&Symbol>> = vec![Vec::new()];
    for symbol in symbols {
        let line = lines.last_mut().expect("there is one at least");
        if !line.is_empty() && line.iter().map(|s| width(s)).sum::<f64>() + width(symbol) > sheet.width {
            lines.push(vec![symbol]);
        } else {
            line.push(symbol);
        }
    }
    let mut y = top;
    for line in &lines {
        let mut x = (sheet.width - line.iter().map(|s| width(s)).sum::<f64>()) / 2.0 + 5.0;
        for symbol in line {
            sheet.piece([x, y], 1.0, &symbol.inner);
            sheet.text([x + f64::from(symbol.width) + 5.0, y + 11.0], "start", symbol.meaning);
            x += width(symbol);
        }
        y += LINE + 4.0;
    }
    y
}

/// An SVG element without its first and last tag.
fn inside(svg: &str) -> &str {
    let inside = svg.split_once('>').map_or(svg, |(_, rest)| rest);
    inside.strip_suffix("</svg>").unwrap_or(inside)
}
