//! SSIM and the rate ratio against N: figure 2b of the paper.

use super::published::{P_WRFGS, Published};
use super::{Figure, floors, looks, runs, seeds, source};
use crate::draw::charts::{Chart, Line, Name};
use crate::study::statistics::Spread;
use crate::study::{Setting, Variant};
use pwrfgs_core::Result;
use pwrfgs_experiment::scores::MODEL;

/// A score that stands against N.
struct Score {
    /// Key in `scores.csv`.
    key: &'static str,
    /// Stem of the files.
    name: &'static str,
    /// Name of the axis.
    axis: &'static str,
    published: fn(&Published) -> Option<f64>,
}

pub(super) fn ssim(setting: &Setting) -> Result<Option<Figure>> {
    figure(setting, &Score { key: "ssim", name: "ssim-n", axis: "mean SSIM", published: |p| p.ssim })
}

pub(super) fn rate_ratio(setting: &Setting) -> Result<Option<Figure>> {
    figure(setting, &Score { key: "eta_0db", name: "eta-n", axis: "rate ratio η at 0 dB", published: |p| p.eta })
}

fn figure(setting: &Setting, score: &Score) -> Result<Option<Figure>> {
    let points: Vec<Line> = setting.variants.iter().enumerate().filter_map(|(k, v)| point(v, k, score.key)).collect();
    if points.is_empty() {
        return Ok(None);
    }
    let x = ends(score, &points);
    let mut lines = baselines(setting, score, x);
    lines.extend(threads(setting, score.key));
    lines.extend(points);
    lines.push(reference(score));
    let chart = Chart {
        x_name: "number of Gaussians N".into(),
        y_name: score.axis.into(),
        x: Some(x),
        log_x: true,
        lines,
        ..Chart::default()
    };
    let caption = format!(
        "{} on the test part against the number of Gaussians N. Marks are means over {}, bars plus and minus one \
         standard deviation over seeds; a grey line joins variants whose names differ in numbers alone. Dashed: the \
         baselines, which have no Gaussians. Hollow grey stars: what the paper on P-WRFGS publishes for the measured \
         set s23 with its random split and 200,000 steps, for reference alone. {}",
        uppercase(score.axis),
        seeds(setting),
        source(setting)
    );
    Figure::chart(score.name, &format!("{} against N", uppercase(score.axis)), caption, chart)
}

fn uppercase(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// N and score over the seeds of a variant; nothing where no run has the score.
fn spreads(variant: &Variant, key: &str) -> Option<(Spread, Spread)> {
    let scored = variant.runs.iter().filter_map(|r| Some((r.facts.gaussians as f64, r.value(MODEL, key)?)));
    let (n, score): (Vec<f64>, Vec<f64>) = scored.unzip();
    Some((Spread::of(&n)?, Spread::of(&score)?))
}

/// The mark of one variant with its bars.
fn point(variant: &Variant, k: usize, key: &str) -> Option<Line> {
    let (n, score) = spreads(variant, key)?;
    let at = (n.mean, score.mean);
    let mut line = Line::new(Vec::new(), looks::variant(k));
    line.name = Name::Legend(variant.label.clone());
    line.marks = vec![at];
    if let (Some(dn), Some(ds)) = (n.deviation, score.deviation) {
        // Less than one Gaussian has no place on a logarithmic axis.
        line.bars = vec![[((at.0 - dn).max(1.0), at.1), (at.0 + dn, at.1)], [(at.0, at.1 - ds), (at.0, at.1 + ds)]];
        line.bars.retain(|[a, b]| a != b);
    }
    Some(line)
}

/// Lines through the variants of a family, in the order of the plan.
fn threads(setting: &Setting, key: &str) -> Vec<Line> {
    let mut families: Vec<(String, Vec<(f64, f64)>)> = Vec::new();
    for variant in &setting.variants {
        let Some((n, score)) = spreads(variant, key) else { continue };
        let (family, at) = (family(&variant.label), (n.mean, score.mean));
        match families.iter_mut().find(|f| f.0 == family) {
            Some((_, points)) => points.push(at),
            None => families.push((family, vec![at])),
        }
    }
    families.into_iter().map(|(_, points)| Line::new(points, looks::thread())).collect()
}

/// The label without its numbers.
fn family(label: &str) -> String {
    label.chars().filter(|c| !(c.is_ascii_digit() || ".-+".contains(*c))).collect()
}

/// Ends of the axis of N: with some air, and far enough apart for a single variant.
fn ends(score: &Score, points: &[Line]) -> (f64, f64) {
    let published = P_WRFGS.iter().filter(|p| (score.published)(p).is_some()).map(|p| p.gaussians);
    let bars = points.iter().flat_map(|l| &l.bars).flatten().map(|p| p.0);
    let all = || points.iter().flat_map(|l| &l.marks).map(|m| m.0).chain(bars.clone()).chain(published.clone());
    let all = || all().filter(|n| *n >= 1.0);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(1.0, f64::max));
    let air = (high / low).powf(0.06).max(1.3);
    (low / air, high * air)
}

/// Level lines over the whole width, with their names at the right.
fn baselines(setting: &Setting, score: &Score, x: (f64, f64)) -> Vec<Line> {
    let line = |(k, name): (usize, String)| {
        let values: Vec<f64> = runs(setting).filter_map(|r| r.value(&name, score.key)).collect();
        let level = Spread::of(&values)?.mean;
        let mut line = Line::new(vec![(x.0, level), (x.1, level)], looks::floor(k));
        line.name = Name::AtEnd(name);
        Some(line)
    };
    floors(setting).into_iter().enumerate().filter_map(line).collect()
}

/// What the paper publishes.
fn reference(score: &Score) -> Line {
    let mut line = Line::new(Vec::new(), looks::published());
    line.name = Name::Legend("published, s23".into());
    line.marks = P_WRFGS.iter().filter_map(|p| Some((p.gaussians, (score.published)(p)?))).collect();
    line
}

#[cfg(test)]
mod tests {
    use super::family;

    #[test]
    fn families_differ_in_more_than_numbers() {
        assert_eq!(family("lambda 0.02, cloud"), family("lambda 0.4, cloud"));
        assert_ne!(family("lambda 0.02, cloud"), family("lambda 0.02, random"));
    }
}
