//! Spectra side by side, as measured and as each variant predicts them: figure 4 of the paper.

use super::loaded::Loaded;
use super::sheet::{LINE, wrapped};
use super::{Figure, Sheet, source};
use crate::draw::spectra::{Ruler, Scale, pixels, rulers};
use crate::study::{Setting, Variant};
use pwrfgs_core::{Image, ImagePlane, Result};
use pwrfgs_experiment::scores::MODEL;
use std::collections::BTreeMap;

/// At most so many variants are shown.
const MOST: usize = 5;
/// Room for the names of rows and the axis of elevation.
const LEFT: f64 = 94.0;
/// Between panels.
const GAP: f64 = 11.0;
/// No panel is wider.
const WIDEST: f64 = 220.0;
const INK: &str = "#464a52";

/// A test spectrum and what is predicted for it.
struct Row {
    name: &'static str,
    id: u32,
    truth: Image,
    /// Prediction and its SSIM, one a variant.
    predicted: Vec<(Image, f64)>,
}

pub(super) fn figure(setting: &Setting, loaded: &Loaded) -> Result<Option<Figure>> {
    let shown = &setting.variants[..setting.variants.len().min(MOST)];
    let scores: Option<Vec<BTreeMap<u32, f64>>> = shown.iter().map(|v| v.runs[0].samples(MODEL, "ssim")).collect();
    let Some(scores) = scores else { return Ok(None) };
    let models = shown.iter().map(|v| loaded.model(&v.runs[0])).collect::<Result<Vec<_>>>()?;
    let samples = &loaded.data.samples;
    let row = |(name, id): (&'static str, u32)| {
        let index = samples.iter().position(|s| s.id == id)?;
        let predicted =
            models.iter().zip(&scores).map(|(m, s)| (m.predict(samples[index].tx).clamped(), s[&id])).collect();
        Some(Row { name, id, truth: loaded.data.image(index), predicted })
    };
    let rows: Vec<Row> = chosen(&scores).into_iter().filter_map(row).collect();
    if rows.is_empty() {
        return Ok(None);
    }
    let more = match setting.variants.len() - shown.len() {
        0 => String::new(),
        rest => format!(" {rest} more variants are not shown."),
    };
    let caption = format!(
        "Test spectra as they are and as the first seed of each variant predicts them, with the SSIM of each prediction: \
         those on which {} is best, median and worst of the test spectra that all have in common.{more} {}",
        setting.variants[0].label,
        source(setting)
    );
    let sheet = draw(shown, &rows, &models[0].stages.plane);
    Figure::sheet("spectra", "Spectra side by side", caption, &sheet).map(Some)
}

/// Best, median and worst by the scores of the first variant, among the ids that all have.
fn chosen(scores: &[BTreeMap<u32, f64>]) -> Vec<(&'static str, u32)> {
    let Some(first) = scores.first() else { return Vec::new() };
    let mut common: Vec<(f64, u32)> =
        first.iter().filter(|(id, _)| scores.iter().all(|s| s.contains_key(id))).map(|(id, s)| (*s, *id)).collect();
    common.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let Some(last) = common.len().checked_sub(1) else { return Vec::new() };
    let mut chosen = vec![("best", common[0].1), ("median", common[last / 2].1), ("worst", common[last].1)];
    chosen.dedup_by_key(|c| c.1);
    chosen
}

fn draw(variants: &[Variant], rows: &[Row], plane: &ImagePlane) -> Sheet {
    let columns = 1 + variants.len();
    let mut sheet = if columns == 2 { Sheet::column() } else { Sheet::page() };
    let room = (sheet.width - LEFT - 14.0 + GAP) / columns as f64 - GAP;
    let width = room.min(WIDEST);
    let height = (width * plane.height as f64 / plane.width as f64).min(width);
    let left = LEFT + columns as f64 * (room - width) / 2.0;
    let x = |column: usize| left + column as f64 * (width + GAP);
    let names = std::iter::once("ground truth").chain(variants.iter().map(|v| v.label.as_str()));
    let names: Vec<Vec<String>> = names.map(|name| wrapped(name, width + GAP - 2.0)).collect();
    let head = LINE * names.iter().map(Vec::len).max().unwrap_or(1) as f64 + 4.0;
    for (k, name) in names.iter().enumerate() {
        sheet.lines([x(k) + width / 2.0, head - 3.0 - LINE * name.len() as f64 / 2.0], "middle", name);
    }
    let mut top = head;
    for (k, row) in rows.iter().enumerate() {
        let bottom = top + height;
        let is_last = k + 1 == rows.len();
        // Below the numbers of the axis in the last row.
        let below = bottom + if is_last { 2.0 * LINE + 2.0 } else { LINE };
        for (column, image) in std::iter::once(&row.truth).chain(row.predicted.iter().map(|p| &p.0)).enumerate() {
            sheet.pixels([x(column), top], [width, height], &pixels(image, plane, Scale::Power));
            if is_last {
                draw_azimuth(&mut sheet, plane, [x(column), bottom], width);
            }
        }
        for (column, (_, ssim)) in row.predicted.iter().enumerate() {
            sheet.text([x(column + 1) + width / 2.0, below], "middle", &format!("SSIM {ssim:.3}"));
        }
        draw_elevation(&mut sheet, plane, [left, top], height);
        let middle = top + height / 2.0;
        sheet.text([2.0, middle - 2.0], "start", row.name);
        sheet.text([2.0, middle + LINE - 2.0], "start", &format!("id {}", row.id));
        top = below + 8.0;
    }
    let names = if plane.angles.is_some() { ("azimuth", "elevation") } else { ("column", "row") };
    sheet.text([x(0) + width / 2.0, top - 8.0], "middle", names.0);
    let upright_at = [left - 34.0, f64::midpoint(head, top - 2.0 * LINE - 10.0)];
    sheet.upright(upright_at, names.1);
    draw_bar(&mut sheet, top + 4.0);
    sheet.height = top + 30.0;
    sheet
}

/// Ticks and numbers below a panel; those at its ends stay within it.
fn draw_azimuth(sheet: &mut Sheet, plane: &ImagePlane, [left, bottom]: [f64; 2], width: f64) {
    let (across, _) = rulers(plane);
    let most = (width / 42.0).floor().max(2.0);
    for (value, part) in ticks(&across, 90.0, most) {
        let x = left + width * part;
        sheet.line([x, bottom], [x, bottom + 3.0], INK);
        let (anchor, shift) = match part {
            p if p < 0.05 => ("start", -1.0),
            p if p > 0.95 => ("end", 1.0),
            _ => ("middle", 0.0),
        };
        sheet.text([x + shift, bottom + LINE], anchor, &degrees(value, plane));
    }
}

/// Ticks and numbers left of a panel.
fn draw_elevation(sheet: &mut Sheet, plane: &ImagePlane, [left, top]: [f64; 2], height: f64) {
    let (_, up) = rulers(plane);
    let most = (height / 16.0).floor().max(1.0);
    for (value, part) in ticks(&up, 30.0, most) {
        let y = top + height * (1.0 - part);
        sheet.line([left - 3.0, y], [left, y], INK);
        sheet.text([left - 5.0, y + 4.0], "end", &degrees(value, plane));
    }
}

/// Round values with their places from 0 to 1; so many intervals at most, the ends of the axis first of all.
fn ticks(ruler: &Ruler, step: f64, intervals: f64) -> Vec<(f64, f64)> {
    let all = ruler.ticks(step, 4.0);
    let whole = all.len().saturating_sub(1).max(1);
    let stride = (1..=whole).find(|s| whole.is_multiple_of(*s) && (whole / s) as f64 <= intervals).unwrap_or(whole);
    all.into_iter().step_by(stride).map(|v| (v, ruler.part(v).clamp(0.0, 1.0))).collect()
}

fn degrees(value: f64, plane: &ImagePlane) -> String {
    format!("{value}{}", if plane.angles.is_some() { "°" } else { "" }).replace('-', "−")
}

/// The scale that all panels share.
fn draw_bar(sheet: &mut Sheet, top: f64) {
    let (width, middle) = (160.0, sheet.width / 2.0);
    let left = middle - width / 2.0;
    sheet.pixels([left, top], [width, 8.0], &Scale::Power.strip());
    for part in [0.0, 0.5, 1.0] {
        let x = left + width * part;
        sheet.line([x, top + 8.0], [x, top + 11.0], INK);
        sheet.text([x, top + 22.0], "middle", &part.to_string());
    }
    sheet.text([left - 8.0, top + 8.0], "end", "spectrum, normalised");
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Axis;

    #[test]
    fn best_median_and_worst_are_common_to_all() {
        let first: BTreeMap<u32, f64> = [(1, 0.9), (2, 0.5), (3, 0.7), (4, 0.1), (5, 0.6)].into();
        let second: BTreeMap<u32, f64> = [(2, 0.0), (3, 0.0), (4, 0.0), (9, 1.0)].into();
        assert_eq!(chosen(&[first.clone(), second]), [("best", 3), ("median", 2), ("worst", 4)]);
        assert_eq!(chosen(&[[(7, 0.5)].into()]), [("best", 7)]);
        assert!(chosen(&[first, BTreeMap::new()]).is_empty());
        assert!(chosen(&[]).is_empty());
    }

    #[test]
    fn ticks_keep_the_ends() {
        let degree = Axis { first: 0.0, step: 1.0 };
        let plane = ImagePlane { width: 360, height: 90, wraps: true, angles: Some((degree, degree)) };
        let values = |n| ticks(&rulers(&plane).0, 90.0, n).into_iter().map(|t| t.0).collect::<Vec<_>>();
        assert_eq!(values(4.0), [0.0, 90.0, 180.0, 270.0, 360.0]);
        assert_eq!(values(2.0), [0.0, 180.0, 360.0]);
        assert_eq!(values(1.0), [0.0, 360.0]);
    }
}
