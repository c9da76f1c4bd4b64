//! Charts: lines, marks, bars and shaded areas on two axes; legends, and parts shared by charts over training steps.
//!
//! plotters lays out the axes (`axes.rs`). Lines, marks and names are drawn here, because plotters supports neither
//! dash-dot lines nor names that avoid each other.

pub(crate) use super::axes::ChartAxis;
use super::axes::{AxisScale, PlotArea};
use super::marks::Style;
use crate::canvas::{Anchor, Canvas, Colour, INK, LETTER_MIDDLE, Paint, Point, TEXT, text_width, truncate_text};
use pwrfgs_train::Training;

/// Dimensions of a chart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChartStyle {
    /// Width, and height without the legend.
    pub(crate) size: Point,
    /// Margins for axes and names: left, top, right, bottom.
    pub(crate) margins: [f64; 4],
}

impl ChartStyle {
    /// Chart for a page on a screen, which scales it.
    pub(crate) const SCREEN: Self = Self { size: [560.0, 330.0], margins: [58.0, 40.0, 18.0, 38.0] };
    /// Chart for a print column.
    pub(crate) const COLUMN: Self = Self { size: [380.0, 262.0], margins: [60.0, 10.0, 20.0, 38.0] };
}

impl Default for ChartStyle {
    fn default() -> Self {
        Self::SCREEN
    }
}

/// Chart.
#[derive(Clone, Debug, Default)]
pub(crate) struct Chart {
    /// Dimensions.
    pub(crate) style: ChartStyle,
    /// Horizontal axis.
    pub(crate) x: ChartAxis,
    /// Vertical axis.
    pub(crate) y: ChartAxis,
    /// Shaded ranges of the horizontal axis.
    pub(crate) bands: Vec<Band>,
    /// Lines, top first.
    pub(crate) lines: Vec<ChartLine>,
}

/// Shaded range with a name above it.
#[derive(Clone, Debug)]
pub(crate) struct Band {
    /// Name above the range.
    pub(crate) name: &'static str,
    /// Ends of the range.
    pub(crate) x: (f64, f64),
    /// Colour of the range.
    pub(crate) colour: Colour,
}

/// Line with marks.
#[derive(Clone, Debug)]
pub(crate) struct ChartLine {
    /// Name of the line.
    pub(crate) name: LineName,
    /// Style of the line.
    pub(crate) style: Style,
    /// Points from left to right, or around an area. An infinite horizontal coordinate is drawn at the end of the axis;
    /// other points that are not finite are omitted.
    pub(crate) points: Vec<(f64, f64)>,
    /// Positions of marks.
    pub(crate) marks: Vec<(f64, f64)>,
    /// Horizontal or vertical bars between two points.
    pub(crate) bars: Vec<[(f64, f64); 2]>,
}

/// Name of a line and its position.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum LineName {
    /// No name.
    Hidden,
    /// In the legend below the chart.
    Legend(String),
    /// To the right of the last point.
    AtEnd(String),
}

impl ChartLine {
    /// Creates a line without name, marks and bars.
    pub(crate) fn new(points: Vec<(f64, f64)>, style: Style) -> Self {
        Self { name: LineName::Hidden, style, points, marks: Vec::new(), bars: Vec::new() }
    }

    /// Creates a horizontal line at `y` over the whole width, without name.
    pub(crate) fn horizontal(y: f64, style: Style) -> Self {
        Self::new(vec![(f64::NEG_INFINITY, y), (f64::INFINITY, y)], style)
    }

    /// Sets a name for the legend.
    pub(crate) fn named(self, name: &str) -> Self {
        Self { name: LineName::Legend(name.into()), ..self }
    }

    /// Sets a name at the end of the line.
    pub(crate) fn named_at_end(self, name: &str) -> Self {
        Self { name: LineName::AtEnd(name.into()), ..self }
    }

    /// Returns the symbol for the legend; `None` if the line is not listed there.
    fn legend_symbol(&self) -> Option<Symbol> {
        let LineName::Legend(name) = &self.name else { return None };
        let (mut drawing, end) = (Canvas::new(24.0, SYMBOL), [24.0, SYMBOL / 2.0]);
        self.style.draw_line(&mut drawing, &[[0.0, end[1]], end]);
        self.style.draw_mark(&mut drawing, [end[0] / 2.0, end[1]]);
        Some(Symbol { drawing, meaning: name.clone() })
    }

    /// Returns all points that must be visible.
    fn visible_points(&self) -> impl Iterator<Item = (f64, f64)> {
        self.points.iter().chain(&self.marks).chain(self.bars.iter().flatten()).copied()
    }
}

impl Chart {
    /// Draws the chart; `None` without lines, or if an axis has no scale ([`AxisScale::new`]).
    pub(crate) fn draw(&self) -> Option<Canvas> {
        let points = || self.lines.iter().flat_map(ChartLine::visible_points);
        let x = AxisScale::new(&self.x, points().map(|p| p.0))?;
        let y = AxisScale::new(&self.y, points().map(|p| p.1))?;
        let ChartStyle { size: [width, height], margins: [left, top, right, bottom] } = self.style;
        let legend = Legend::new(self.lines.iter().filter_map(ChartLine::legend_symbol).collect(), width);
        let mut canvas = Canvas::new(width, height + legend.height());
        // Room for names at the ends of lines, at most half of the width.
        let names = self.end_names().map(|(name, _)| text_width(name) + 12.0);
        let right = width - names.fold(right, f64::max).min(width / 2.0);
        let frame = PlotArea { x, y, left, top, right, bottom: height - bottom };
        self.draw_bands(&mut canvas, &frame);
        frame.draw(&mut canvas, height, [&self.x, &self.y]);
        self.draw_lines(&mut canvas, &frame);
        self.draw_end_names(&mut canvas, &frame);
        legend.draw(&mut canvas, height);
        (!self.lines.is_empty()).then_some(canvas)
    }

    /// Returns the names at the ends of lines, with their lines.
    fn end_names(&self) -> impl Iterator<Item = (&str, &ChartLine)> {
        self.lines.iter().filter_map(|l| match &l.name {
            LineName::AtEnd(name) => Some((name.as_str(), l)),
            _ => None,
        })
    }

    /// Draws lines and bars, then all marks on top.
    fn draw_lines(&self, canvas: &mut Canvas, frame: &PlotArea) {
        let on_canvas =
            |points: &[(f64, f64)]| points.iter().filter_map(|p| frame.position(*p)).collect::<Vec<Point>>();
        for line in self.lines.iter().rev() {
            line.style.draw_line(canvas, &on_canvas(&line.points));
            for bar in &line.bars {
                if let [a, b] = on_canvas(bar)[..] {
                    line.style.draw_bar(canvas, [a, b]);
                }
            }
        }
        let mut marks: Vec<Vec<Point>> = Vec::new();
        for line in &self.lines {
            let mut points = on_canvas(&line.marks);
            // Marks at all points are data. Marks at a few points distinguish lines: those on another mark are left out.
            if line.marks.len() < line.points.len() {
                let is_apart = |at: &Point, [x, y]: &Point| (x - at[0]).hypot(y - at[1]) > MARK_DISTANCE;
                points.retain(|at| marks.iter().flatten().all(|mark| is_apart(at, mark)));
            }
            marks.push(points);
        }
        for (line, marks) in self.lines.iter().zip(&marks).rev() {
            marks.iter().for_each(|at| line.style.draw_mark(canvas, *at));
        }
    }

    /// Draws the shaded ranges with their names.
    fn draw_bands(&self, canvas: &mut Canvas, frame: &PlotArea) {
        for band in &self.bands {
            let [a, b] = [band.x.0, band.x.1].map(|x| frame.x_position(x));
            if a >= b {
                continue;
            }
            canvas.rect([a, frame.top], [b - a, frame.bottom - frame.top], Paint::fill(band.colour));
            if b < frame.right {
                canvas.line(&[[b, frame.top], [b, frame.bottom]], Paint::stroke(Colour::hex(0xa0_a4ac), 1.0));
            }
            // A name wider than its range starts above it, one line higher than names that fit.
            if b - a > text_width(band.name) {
                canvas.text([f64::midpoint(a, b), frame.top - 9.0], Anchor::Middle, band.name);
            } else {
                canvas.text([a, frame.top - 23.0], Anchor::Start, band.name);
            }
        }
    }

    /// Draws names to the right of the ends of lines, at least [`NAME_STEP`] apart, with a short stroke to each end.
    fn draw_end_names(&self, canvas: &mut Canvas, frame: &PlotArea) {
        let end =
            |(name, line): (_, &ChartLine)| Some((name, line.points.iter().rev().find_map(|p| frame.position(*p))?[1]));
        let mut names: Vec<(&str, f64)> = self.end_names().filter_map(end).collect();
        names.sort_by(|a, b| a.1.total_cmp(&b.1));
        let targets: Vec<f64> = names.iter().map(|n| n.1).collect();
        let ends = (frame.top, frame.bottom);
        for ((name, end), y) in names.into_iter().zip(separated_positions(&targets, NAME_STEP, ends)) {
            canvas.line(&[[frame.right + 1.0, end], [frame.right + 6.0, y]], Paint::stroke(INK, 0.5));
            let left = frame.right + 8.0;
            canvas.text([left, y + LETTER_MIDDLE * TEXT], Anchor::Start, truncate_text(name, canvas.width - left));
        }
    }
}

/// Least distance of the centres of two marks.
const MARK_DISTANCE: f64 = 8.0;
/// Least vertical distance of two names at the ends of lines.
const NAME_STEP: f64 = 12.0;

/// Returns positions close to the ascending `targets` but at least `step` apart, and within `ends` if they have room. One pass
/// moves them away from the first end, and one back from the last.
fn separated_positions(targets: &[f64], step: f64, ends: (f64, f64)) -> Vec<f64> {
    let mut positions = targets.to_vec();
    for k in 1..positions.len() {
        positions[k] = positions[k].max(positions[k - 1] + step);
    }
    let mut limit = ends.1.max(ends.0 + step * (targets.len() as f64 - 1.0));
    for position in positions.iter_mut().rev() {
        *position = position.min(limit);
        limit = *position - step;
    }
    positions
}

/// Heights of text, slightly smaller than on axes, and of a row.
const SIZE: f64 = 10.5;
const ROW: f64 = 17.0;
/// Gaps from a symbol to its meaning, between columns, and on all sides.
const INDENT: f64 = 5.0;
const GAP: f64 = 12.0;
const MARGIN: f64 = 4.0;
/// Height of a symbol.
pub(crate) const SYMBOL: f64 = 14.0;

/// Symbol with its meaning.
pub(crate) struct Symbol {
    pub(crate) drawing: Canvas,
    pub(crate) meaning: String,
}

/// Legend of symbols in columns.
pub(crate) struct Legend {
    symbols: Vec<Symbol>,
    rows: usize,
    /// Start of each column.
    columns: Vec<f64>,
}

impl Legend {
    /// Arranges symbols in as few rows as fit into `width`, or else in one column.
    pub(crate) fn new(symbols: Vec<Symbol>, width: f64) -> Self {
        let symbol_width = |s: &Symbol| s.drawing.width + INDENT + text_width(&s.meaning) * SIZE / TEXT;
        let columns = |rows: usize| -> Vec<f64> {
            symbols.chunks(rows).map(|column| column.iter().map(symbol_width).fold(0.0, f64::max)).collect()
        };
        let total_width = |columns: &[f64]| columns.iter().map(|w| w + GAP).sum::<f64>() - GAP;
        let most = symbols.len().max(1);
        let rows = (1..most).find(|rows| total_width(&columns(*rows)) + 2.0 * MARGIN <= width).unwrap_or(most);
        let widths = columns(rows);
        let first = ((width - total_width(&widths)) / 2.0).max(MARGIN);
        let start = |k: usize| first + widths[..k].iter().map(|w| w + GAP).sum::<f64>();
        Self { rows, columns: (0..widths.len()).map(start).collect(), symbols }
    }

    /// Returns the height of the legend; 0 without symbols.
    pub(crate) fn height(&self) -> f64 {
        if self.symbols.is_empty() { 0.0 } else { ROW * self.rows as f64 + 2.0 * MARGIN }
    }

    /// Draws the legend below `top`, column by column; too long meanings are cut.
    pub(crate) fn draw(&self, canvas: &mut Canvas, top: f64) {
        let letters = canvas.letters;
        canvas.letters.size = SIZE;
        for (k, Symbol { drawing, meaning }) in self.symbols.iter().enumerate() {
            let (x, middle) = (self.columns[k / self.rows], top + MARGIN + ROW * ((k % self.rows) as f64 + 0.5));
            canvas.add_drawing([x, middle - SYMBOL / 2.0], 1.0, drawing);
            let left = x + drawing.width + INDENT;
            let room = (canvas.width - left) * TEXT / SIZE;
            canvas.text([left, middle + LETTER_MIDDLE * SIZE], Anchor::Start, truncate_text(meaning, room));
        }
        canvas.letters = letters;
    }
}

/// Returns the three phases of a training (algorithm 1 of the paper) as shaded ranges of its steps.
pub(crate) fn phase_bands(training: &Training) -> Vec<Band> {
    let (d, p, end) = (training.densify_until as f64, training.prune_until as f64, training.steps as f64);
    let band = |name, x, colour| Band { name, x, colour };
    vec![
        band("densify", (0.0, d), Colour::hex(0xe9_f0fa)),
        band("prune", (d, p), Colour::hex(0xfc_f0e2)),
        band("fine-tune", (p, end), Colour::hex(0xee_f6ee)),
    ]
}

/// Number of corners beyond which a step function is thinned to about as many; more cannot be distinguished in print.
const CORNERS: usize = 4_000;

/// Returns the corners of a step function through `points` (step and value): each value holds until the next step. Of more than
/// [`CORNERS`] corners, only the ends and extremes of short ranges remain.
pub(crate) fn decimate_steps(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut drawn: Vec<(f64, f64)> = Vec::new();
    for (i, &(step, n)) in points.iter().enumerate() {
        let changes = |k: usize| points.get(k).is_none_or(|p| p.1 != n);
        if i == 0 || changes(i - 1) || changes(i + 1) {
            if let Some(last) = drawn.last().filter(|last| last.1 != n) {
                drawn.push((step, last.1));
            }
            drawn.push((step, n));
        }
    }
    if drawn.len() <= CORNERS { drawn } else { drawn.chunks(4 * drawn.len() / CORNERS).flat_map(extremes).collect() }
}

/// Returns the first, last, lowest and highest of at least one point, in their order and without repetition.
fn extremes(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let by_height = |a: &usize, b: &usize| points[*a].1.total_cmp(&points[*b].1);
    let indices = 0..points.len();
    let mut selected = vec![0, points.len() - 1];
    selected.extend(indices.clone().min_by(by_height));
    selected.extend(indices.max_by(by_height));
    selected.sort_unstable();
    selected.dedup();
    selected.into_iter().map(|k| points[k]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canvas::BLACK;
    use crate::draw::marks::{Marker, Stroke};

    fn chart() -> Chart {
        let style = Style { marker: Some(Marker::Star), ..Style::line(BLACK, 2.0, Stroke::DASHED) };
        let mut line = ChartLine::new(vec![(1.0, 0.5), (10.0, 0.75), (f64::NAN, 0.1)], style);
        line.marks.clone_from(&line.points);
        line.bars.push([(10.0, 0.7), (10.0, 0.8)]);
        line.name = LineName::Legend("with a mask".into());
        let mut level = ChartLine::new(vec![(1.0, 0.6), (10.0, 0.6)], Style::line(INK, 1.0, Stroke::FULL));
        level.name = LineName::AtEnd("5-NN".into());
        Chart {
            style: ChartStyle::COLUMN,
            x: ChartAxis { name: "N".into(), log: true, ..ChartAxis::default() },
            y: ChartAxis { name: "SSIM".into(), ..ChartAxis::default() },
            bands: vec![Band { name: "densify", x: (1.0, 5.0), colour: INK }],
            lines: vec![line, level],
        }
    }

    #[test]
    fn chart_without_points_is_none() {
        let ends = ChartAxis { ends: Some((0.0, 1.0)), ..ChartAxis::default() };
        assert!(Chart { x: ends.clone(), y: ends, ..Chart::default() }.draw().is_none());
        let nowhere = ChartLine::new(vec![(f64::NAN, 1.0)], Style::line(BLACK, 1.0, Stroke::FULL));
        assert!(Chart { lines: vec![nowhere], ..Chart::default() }.draw().is_none());
    }

    #[test]
    fn chart_contains_names_axes_and_end_labels() {
        let svg = chart().draw().unwrap().svg("chart", "");
        for text in ["with a mask", "5-NN", "SSIM", ">N<", ">0.6<", ">densify<", "rotate(-90)", "stroke-dasharray"] {
            assert!(svg.contains(text), "`{text}` is not in {svg}");
        }
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn marks_that_only_distinguish_lines_do_not_overlap() {
        let drawn = |marks: Vec<(f64, f64)>| {
            let mut chart = chart();
            let style = Style { marker: Some(Marker::Square), ..Style::line(BLACK, 2.0, Stroke::FULL) };
            let mut other = ChartLine::new(vec![(1.0, 0.5), (5.0, 0.6), (10.0, 0.75)], style);
            other.marks = marks;
            chart.lines.push(other);
            chart.draw().unwrap().svg("chart", "").len()
        };
        let (none, hidden, free) = (drawn(vec![]), drawn(vec![(1.0, 0.5)]), drawn(vec![(5.0, 0.6)]));
        assert!(hidden == none && free > none, "a mark at an end is on that of the first line");
        let data = drawn(vec![(1.0, 0.5), (5.0, 0.6), (10.0, 0.75)]);
        assert!(data - none > 2 * (free - none), "marks at all points are data");
    }

    #[test]
    fn end_labels_do_not_overlap() {
        let apart = |targets: &[f64], ends| separated_positions(targets, 10.0, ends);
        assert_eq!(apart(&[10.0, 12.0, 13.0, 80.0], (0.0, 100.0)), [10.0, 20.0, 30.0, 80.0]);
        assert_eq!(apart(&[90.0, 95.0, 99.0], (0.0, 100.0)), [80.0, 90.0, 100.0]);
        assert_eq!(apart(&[5.0, 5.0, 5.0], (0.0, 15.0)), [0.0, 10.0, 20.0], "too many for the range");
        assert!(apart(&[], (0.0, 15.0)).is_empty());
    }

    #[test]
    fn legend_uses_fewest_rows_that_fit() {
        let symbol = |meaning: String| Symbol { drawing: Canvas::new(24.0, SYMBOL), meaning };
        let legend = Legend::new((0..7).map(|k| symbol(format!("no. {k}"))).collect(), 380.0);
        assert!((2..=3).contains(&legend.rows), "{} rows", legend.rows);
        assert!(legend.columns.windows(2).all(|w| w[0] < w[1]));
        let long = (0..3).map(|_| symbol("a very long name ".repeat(9))).collect();
        let legend = Legend::new(long, 380.0);
        assert_eq!(legend.columns, [MARGIN]);
        let mut canvas = Canvas::new(380.0, 100.0);
        legend.draw(&mut canvas, 0.0);
        let svg = canvas.svg("legend", "");
        assert!(svg.matches("..</text>").count() == 3 && !svg.contains(&"a very long name ".repeat(4)), "{svg}");
        assert_eq!(Legend::new(vec![], 380.0).height(), 0.0);
    }

    #[test]
    fn step_function_keeps_corners_only() {
        let points = [(1.0, 5.0), (2.0, 5.0), (3.0, 5.0), (4.0, 2.0), (5.0, 2.0)];
        assert_eq!(decimate_steps(&points), [(1.0, 5.0), (3.0, 5.0), (4.0, 5.0), (4.0, 2.0), (5.0, 2.0)]);
        assert!(decimate_steps(&[]).is_empty());
    }

    #[test]
    fn decimated_steps_keep_extremes() {
        let points: Vec<(f64, f64)> = (0..100_000).map(|k| (f64::from(k), f64::from(k * 7_919 % 1_000))).collect();
        let drawn = decimate_steps(&points);
        assert!((1_000..=CORNERS).contains(&drawn.len()), "{} corners", drawn.len());
        assert_eq!((drawn[0], drawn.last()), (points[0], points.last()));
        assert!(drawn.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        for height in [0.0, 999.0] {
            assert!(drawn.iter().any(|p| p.1 == height));
        }
    }
}
