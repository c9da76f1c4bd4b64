//! Maps of located transmitters: the region of one transmitter, or the errors of many.

use super::plan::FloorPlan;
use crate::canvas::{Canvas, Colour, INK, Paint, Point, RasterImage, VectorPath, WHITE};
use pwrfgs_core::colour::sequential;

/// Colours of estimates and true positions (Okabe and Ito); their marks differ too.
const ESTIMATE: Colour = Colour::hex(0xd5_5e00);
const TRUTH: Colour = Colour::hex(0x00_5aa0);

/// Estimated positions in a room, with the density over the floor if there is only one.
#[derive(Clone, Debug, Default)]
pub struct LocationMap<'a> {
    /// Title above the map.
    pub title: String,
    /// Centre of the first cell of the density and side of a cell, metres.
    pub grid: (Point, f64),
    /// Number of columns.
    pub columns: usize,
    /// Density relative to the highest, row by row, lowest row first; empty for none.
    pub density: &'a [f32],
    /// Number of parts of the region.
    pub parts: usize,
    /// Outlines of the region, metres.
    pub outlines: Vec<Vec<Point>>,
    /// Training positions.
    pub training: Vec<Point>,
    /// Receivers.
    pub receivers: Vec<Point>,
    /// Estimates, each with its true position if that is known.
    pub estimates: Vec<(Point, Option<Point>)>,
}

impl LocationMap<'_> {
    /// Draws the map around the region and the estimates, or without a region around these and the training positions.
    pub fn draw(&self) -> Canvas {
        let ends = self.estimates.iter().flat_map(|(estimate, truth)| std::iter::once(*estimate).chain(*truth));
        let mut corners = FloorPlan::frame(self.outlines.iter().flatten().copied().chain(ends));
        if self.outlines.is_empty() {
            corners = FloorPlan::frame(self.training.iter().copied().chain(corners));
        } else {
            // On every side, half the longer side of the frame of the region.
            let margin = 0.5 * (corners[1][0] - corners[0][0]).max(corners[1][1] - corners[0][1]);
            corners = [corners[0].map(|v| v - margin), corners[1].map(|v| v + margin)];
        }
        let plan = FloorPlan::of_floor(corners);
        let mut map = plan.empty_map();
        self.draw_density(&mut map, &plan, corners);
        plan.draw_points(&mut map, self.training.iter().copied());
        for outline in &self.outlines {
            let corners: Vec<Point> = outline.iter().chain(outline.first()).map(|p| plan.project(*p)).collect();
            map.line(&corners, Paint::stroke(WHITE, 2.6));
            map.line(&corners, Paint::stroke(INK, 1.2));
        }
        self.receivers.iter().for_each(|at| plan.draw_receiver(&mut map, *at));
        self.draw_estimates(&mut map, &plan);
        plan.with_title(map, &self.title, &self.note(&plan))
    }

    /// Explains the marks that the map has.
    fn note(&self, plan: &FloorPlan) -> String {
        let mut words = vec!["circle: estimate"];
        if self.estimates.iter().any(|(_, truth)| truth.is_some()) {
            words.push("cross: true position");
        }
        words.push("grey dots: training positions");
        if self.receivers.iter().any(|receiver| plan.contains(*receiver)) {
            words.push("squares: receivers");
        }
        // 90 % is the coverage of the regions of `pwrfgs_localise`.
        let region = match self.parts {
            0 | 1 => "outline: 90 % region".to_owned(),
            parts => format!("outline: 90 % region in {parts} parts"),
        };
        if !self.outlines.is_empty() {
            words.push(&region);
        }
        words.join("; ")
    }

    /// Draws the cells of the density that are completely inside the frame.
    fn draw_density(&self, map: &mut Canvas, plan: &FloorPlan, [low, high]: [Point; 2]) {
        let (first, step) = self.grid;
        let sizes = [self.columns, self.density.len() / self.columns.max(1)];
        let edge = |axis: usize, k: usize| first[axis] + (k as f64 - 0.5) * step;
        let inside = |axis: usize| {
            let is_in = |k: &usize| edge(axis, *k) >= low[axis] && edge(axis, k + 1) <= high[axis];
            let cells: Vec<usize> = (0..sizes[axis]).filter(is_in).collect();
            cells.first().map_or(0..0, |start| *start..start + cells.len())
        };
        let (columns, rows) = (inside(0), inside(1));
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        let [left, bottom] = plan.project([edge(0, columns.start), edge(1, rows.start)]);
        let [right, top] = plan.project([edge(0, columns.end), edge(1, rows.end)]);
        // The square root keeps low densities visible.
        let colour = |v: &f32| {
            let [r, g, b] = sequential(f64::from(*v).sqrt());
            [r, g, b, (255.0 * f64::from(*v).sqrt().min(1.0)) as u8]
        };
        let upwards = rows.clone().rev().flat_map(|row| &self.density[row * self.columns..][columns.clone()]);
        let rgba = upwards.flat_map(colour).collect();
        let image = RasterImage { width: columns.len(), height: rows.len(), rgba, smooth: false };
        map.pixels([left, top], [right - left, bottom - top], image);
    }

    /// Draws a line from every true position to its estimate, and both ends; larger if there is only one estimate.
    fn draw_estimates(&self, map: &mut Canvas, plan: &FloorPlan) {
        let is_single = self.estimates.len() == 1;
        let (mut lines, mut crosses) = (VectorPath::default(), VectorPath::default());
        let projected =
            |(estimate, truth): &(Point, Option<Point>)| Some([*estimate, (*truth)?].map(|p| plan.project(p)));
        for [estimate, truth] in self.estimates.iter().filter_map(projected) {
            lines.add_line(&[estimate, truth]);
            crosses.add_cross(truth, if is_single { 4.0 } else { 1.6 });
        }
        map.path(lines, Paint::stroke(INK.with_opacity(0.6), 0.7));
        map.path(crosses.clone(), Paint::stroke(WHITE, if is_single { 4.0 } else { 1.4 }));
        map.path(crosses, Paint::stroke(TRUTH, if is_single { 2.0 } else { 0.8 }));
        for (estimate, _) in &self.estimates {
            let (radius, rim) = if is_single { (4.5, 1.2) } else { (1.5, 0.3) };
            map.circle(plan.project(*estimate), radius, Paint::fill(ESTIMATE).outlined(WHITE, rim));
        }
    }
}
