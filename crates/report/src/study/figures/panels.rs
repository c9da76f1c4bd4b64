//! Panels side by side: Gaussians in the room (figure 3 of the paper) and spectra (figure 4).

use super::shown::is_oracle;
use super::{COLUMN, Figure, PAGE};
use crate::canvas::{Anchor, Canvas, LINE, TEXT, text_width, wrap_text};
use crate::draw::charts::Legend;
use crate::draw::room::{Panel, RoomFigure};
use crate::draw::spectra::{ColourScale, axis_names, draw_azimuth, draw_elevation, spectrum_image};
use minijinja::context;
use pwrfgs_core::{Dataset, Image, ImagePlane, Query, Result};
use pwrfgs_experiment::{Setting, StudyVariant, scores::MODEL};
use pwrfgs_model::Snapshot;
use std::collections::BTreeMap;

/// Draws the Gaussians of each variant over the point cloud of the scene, with their Chamfer distances: figure 3 of the paper. `None`
/// without Gaussians.
pub(super) fn room_figure(setting: &Setting, data: &Dataset) -> Result<Option<Figure>> {
    let shown: Vec<&StudyVariant> = setting.variants.iter().filter(|v| v.runs[0].facts.gaussians > 0).collect();
    if shown.is_empty() {
        return Ok(None);
    }
    let snapshot = |v: &&StudyVariant| {
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
    let cloud_refs: Vec<&Snapshot> = clouds.iter().collect();
    let room = RoomFigure::new(data, &partition, &cloud_refs, TEXT * COLUMN / width);
    let panels: Vec<Panel> =
        shown.iter().zip(&clouds).map(|(v, cloud)| room.draw_panel(&v.label, cloud, data)).collect();
    let mut top = 0.0;
    for row in panels.chunks(columns) {
        top = draw_rooms(&mut canvas, row, width, top);
    }
    let legend = Legend::new(room.legend(), canvas.width);
    legend.draw(&mut canvas, top);
    canvas.height = top + legend.height();
    Ok(Some(Figure::new("room", setting, context! { note => room.note(data) }, canvas)))
}

/// Draws panels of this `width` side by side from `top`, each with its name above and numbers below; returns the bottom of the
/// row.
fn draw_rooms(canvas: &mut Canvas, row: &[Panel], width: f64, top: f64) -> f64 {
    let mut bottom = top;
    let names: Vec<Vec<String>> = row.iter().map(|panel| wrap_text(&panel.title, width - 10.0)).collect();
    let head = LINE * names.iter().map(Vec::len).max().unwrap_or(1) as f64 + 4.0;
    for (k, panel) in row.iter().enumerate() {
        let (left, middle) = (k as f64 * width, (k as f64 + 0.5) * width);
        canvas.lines([middle, top + head / 2.0], Anchor::Middle, &names[k]);
        canvas.add_drawing([left, top + head], width / COLUMN, &panel.drawing);
        // Leaves room for the numbers of the axes.
        let mut y = top + head + panel.drawing.height * width / COLUMN - 8.0;
        let lines = std::iter::once(panel.numbers.as_str()).chain(panel.caption.split("; "));
        for line in lines.filter(|line| !line.is_empty()) {
            for line in wrap_text(line, width - 6.0) {
                y += LINE;
                canvas.text([middle, y], Anchor::Middle, line);
            }
        }
        bottom = f64::max(bottom, y + 8.0);
    }
    bottom
}

/// Maximum number of columns of baselines.
const MOST_BASELINES: usize = 2;
/// Maximum number of columns of methods.
const MOST_METHODS: usize = 5;
/// Margins for the names of rows and the elevation axis.
const LEFT: f64 = 94.0;
/// Gap between panels.
const GAP: f64 = 11.0;
/// Width of the colour bar.
const BAR: f64 = 160.0;
/// Maximum width of a panel.
const WIDEST: f64 = 220.0;

/// Test spectrum with its predictions.
struct SpectrumRow {
    name: &'static str,
    id: u32,
    truth: Image,
    /// Prediction and its SSIM per column.
    predicted: Vec<(Image, f64)>,
}

/// Predictions of a baseline or of a trained model.
pub(super) struct PredictionColumn<'a> {
    pub(super) label: String,
    /// SSIM by sample.
    scores: BTreeMap<u32, f64>,
    predict: Box<dyn Fn(Query<'_>) -> Image + 'a>,
}

/// Draws the spectra as measured, and as predicted by the best baselines and each method: figure 4 of the paper. `None`
/// for other tasks, or without common samples.
pub(super) fn spectra_figure(setting: &Setting, data: &Dataset) -> Result<Option<Figure>> {
    if data.observations.spectra().is_none() {
        return Ok(None);
    }
    let shown: Vec<&StudyVariant> = setting.variants.iter().take(MOST_METHODS).collect();
    let columns = spectra_columns(setting, &shown, data)?;
    let row = |(name, id): (&'static str, u32)| {
        let index = (0..data.len()).find(|&i| data.label(i) == id)?;
        let predict = |column: &PredictionColumn<'_>| {
            Some(((column.predict)(data.query(index)).clamped(), *column.scores.get(&id)?))
        };
        let predicted = columns.iter().map(predict).collect::<Option<_>>()?;
        Some(SpectrumRow { name, id, truth: data.image(index), predicted })
    };
    let trained = &columns[columns.len() - shown.len()..];
    let scores: Vec<&BTreeMap<u32, f64>> = trained.iter().map(|column| &column.scores).collect();
    let rows: Vec<SpectrumRow> = choose_samples(&scores).into_iter().filter_map(row).collect();
    if rows.is_empty() {
        return Ok(None);
    }
    let labels: Vec<&str> = columns.iter().map(|column| column.label.as_str()).collect();
    let canvas = draw_spectra(&labels, &rows, &shown[0].runs[0].pipeline.plane(data)?);
    let words = context! { first => shown[0].label.clone(), more => setting.variants.len() - shown.len() };
    Ok(Some(Figure::new("spectra", setting, words, canvas)))
}

/// Returns the columns of the figure of spectra: the best baselines, then `methods`, each with the SSIM of its first run.
///
/// # Errors
/// A damaged model file, or a baseline that cannot be fitted.
pub(super) fn spectra_columns<'a>(
    setting: &Setting,
    methods: &[&StudyVariant],
    data: &'a Dataset,
) -> Result<Vec<PredictionColumn<'a>>> {
    let mut columns = baseline_columns(setting, data)?;
    for variant in methods {
        let run = &variant.runs[0];
        let model = run.model(data)?;
        let scores = run.scores.values_by_id(MODEL, "ssim").unwrap_or_default();
        let predict = Box::new(move |query: Query<'_>| model.prepare().predict_timed(query).0);
        columns.push(PredictionColumn { label: variant.label.clone(), scores, predict });
    }
    Ok(columns)
}

/// Returns the columns of the best baselines by mean SSIM, without oracles and other programs, fitted again.
fn baseline_columns<'a>(setting: &Setting, data: &'a Dataset) -> Result<Vec<PredictionColumn<'a>>> {
    let (task, score) = (setting.task(), |name: &str| setting.baseline_score(name, "ssim"));
    let is_ranked = |name: &&str| !is_oracle(setting, name) && !setting.is_external(name);
    let candidates = setting.baselines().into_iter().filter(is_ranked);
    let mut ranked: Vec<(&str, f64)> = candidates.filter_map(|name| Some((name, score(name)?))).collect();
    ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut columns = Vec::new();
    for (name, _) in ranked.into_iter().take(MOST_BASELINES) {
        let scored_run = setting.runs().find_map(|run| Some((run.scores.values_by_id(name, "ssim")?, run)));
        let Some((scores, run)) = scored_run else { continue };
        let Some(baseline) = run.pipeline.baselines.iter().find(|baseline| baseline.name_for(task) == name) else {
            continue;
        };
        let fitted = baseline.fit(data, run.partition(data)?.known())?;
        let predict = Box::new(move |query: Query<'_>| fitted.predict(query));
        columns.push(PredictionColumn { label: name.to_owned(), scores, predict });
    }
    Ok(columns)
}

/// Chooses the best, median and worst sample by the first of `scores` (larger is better) among the ids that all have, without
/// repetition; none without common ids.
fn choose_samples(scores: &[&BTreeMap<u32, f64>]) -> Vec<(&'static str, u32)> {
    let Some(first) = scores.first() else { return Vec::new() };
    let mut common: Vec<(f64, u32)> =
        first.iter().filter(|(id, _)| scores.iter().all(|s| s.contains_key(id))).map(|(id, s)| (*s, *id)).collect();
    common.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let Some(last) = common.len().checked_sub(1) else { return Vec::new() };
    let mut chosen = vec![("best", common[0].1), ("median", common[last / 2].1), ("worst", common[last].1)];
    chosen.dedup_by_key(|c| c.1);
    chosen
}

/// Draws the spectra: a row per sample, and a column for the measurement and each predictor.
fn draw_spectra(predictors: &[&str], rows: &[SpectrumRow], plane: &ImagePlane) -> Canvas {
    let columns = 1 + predictors.len();
    let mut canvas = Canvas::new(if columns == 2 { COLUMN } else { PAGE }, 0.0);
    let space = (canvas.width - LEFT - 14.0 + GAP) / columns as f64 - GAP;
    let width = space.min(WIDEST);
    let height = (width * plane.height as f64 / plane.width as f64).min(width);
    let left = LEFT + columns as f64 * (space - width) / 2.0;
    let x = |column: usize| left + column as f64 * (width + GAP);
    let labels = std::iter::once("ground truth").chain(predictors.iter().copied());
    let labels: Vec<Vec<String>> = labels.map(|name| wrap_text(name, width + GAP - 2.0)).collect();
    let head = LINE * labels.iter().map(Vec::len).max().unwrap_or(1) as f64 + 4.0;
    for (k, name) in labels.iter().enumerate() {
        canvas.lines([x(k) + width / 2.0, head - 3.0 - LINE * name.len() as f64 / 2.0], Anchor::Middle, name);
    }
    let mut top = head;
    for (k, row) in rows.iter().enumerate() {
        let bottom = top + height;
        let is_last = k + 1 == rows.len();
        // Below the numbers of the axis of the last row.
        let below = bottom + if is_last { 2.0 * LINE + 2.0 } else { LINE };
        for (column, image) in std::iter::once(&row.truth).chain(row.predicted.iter().map(|p| &p.0)).enumerate() {
            canvas.framed_pixels([x(column), top], [width, height], spectrum_image(image, plane, ColourScale::Power));
            if is_last {
                draw_azimuth(&mut canvas, plane, [x(column), bottom], width);
            }
        }
        for (column, (_, ssim)) in row.predicted.iter().enumerate() {
            canvas.text([x(column + 1) + width / 2.0, below], Anchor::Middle, format!("SSIM {ssim:.3}"));
        }
        draw_elevation(&mut canvas, plane, [left, top], height);
        let middle = top + height / 2.0;
        canvas.text([2.0, middle - 2.0], Anchor::Start, row.name);
        canvas.text([2.0, middle + LINE - 2.0], Anchor::Start, format!("id {}", row.id));
        top = below + 8.0;
    }
    let [across, up] = axis_names(plane);
    canvas.text([x(0) + width / 2.0, top - 8.0], Anchor::Middle, across);
    canvas.upright_text([left - 34.0, f64::midpoint(head, top - 2.0 * LINE - 10.0)], up);
    draw_power_bar(&mut canvas, top);
    canvas.height = top + 30.0;
    canvas
}

/// Draws the colour bar of power below `top`, with its quantity to the left; both are centred.
fn draw_power_bar(canvas: &mut Canvas, top: f64) {
    let words = "spectrum, normalised";
    let bar = (canvas.width - BAR + text_width(words) + 8.0) / 2.0;
    ColourScale::Power.draw(canvas, [bar, top + 4.0], BAR);
    canvas.text([bar - 8.0, top + 12.0], Anchor::End, words);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chosen_samples_are_common_to_all_runs() {
        let first: BTreeMap<u32, f64> = [(1, 0.9), (2, 0.5), (3, 0.7), (4, 0.1), (5, 0.6)].into();
        let second: BTreeMap<u32, f64> = [(2, 0.0), (3, 0.0), (4, 0.0), (9, 1.0)].into();
        assert_eq!(choose_samples(&[&first, &second]), [("best", 3), ("median", 2), ("worst", 4)]);
        assert_eq!(choose_samples(&[&[(7, 0.5)].into()]), [("best", 7)]);
        assert!(choose_samples(&[&first, &BTreeMap::new()]).is_empty());
        assert!(choose_samples(&[]).is_empty());
    }
}
