//! The first metric and the rate ratio against N: figure 2b of the paper.

use super::{Figure, looks};
use crate::draw::charts::{Axis, Chart, Line};
use crate::study::race::Race;
use crate::study::{Setting, Variant};
use minijinja::context;
use pwrfgs_core::Headline;
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::statistics::Spread;

/// Bian, Hua and Gündüz, "P-WRFGS: Pruning 3D Gaussians for Efficient Wireless Radiance Field Construction", section
/// IV-A, its source and table I, for weights of 0, 0.02 and 0.04 of the mask loss; with 0 it is WRF-GS started from
/// the point cloud. The numbers belong to the measured spectra of NeRF2 (`s23`), split at random: 4,898 to train on,
/// 1,225 to test, 200,000 steps. Whether its SSIM is a mean or a median the paper does not say; its figure 2b shows
/// more points without their numbers.
const PUBLISHED_SSIM: [(f64, f64); 3] = [(65_469.0, 0.899), (157.0, 0.850), (8.0, 0.642)];
const PUBLISHED_ETA: [(f64, f64); 1] = [(8.0, 0.9288)];

/// A score that stands against N.
struct Score {
    /// Key in `scores.csv`.
    key: &'static str,
    /// Stem of the files.
    name: String,
    /// Name of the axis.
    axis: String,
    /// N and score that the paper publishes.
    published: &'static [(f64, f64)],
}

pub(super) fn first_metric(setting: &Setting) -> Option<Figure> {
    let Headline { key, short, name, .. } = setting.headline();
    let published: &[_] = if key == "ssim" { &PUBLISHED_SSIM } else { &[] };
    let stem = format!("{}-n", short.to_lowercase());
    figure(setting, &Score { key, name: stem, axis: format!("mean {name}"), published })
}

pub(super) fn rate_ratio(setting: &Setting) -> Option<Figure> {
    figure(
        setting,
        &Score {
            key: "eta_0db", name: "eta-n".into(), axis: "rate ratio η at 0 dB".into(), published: &PUBLISHED_ETA
        },
    )
}

fn figure(setting: &Setting, score: &Score) -> Option<Figure> {
    if Race::of(setting).is_some() {
        return None; // a mark and a name for each variant would be too many: figures of the race have a line a way
    }
    let points: Vec<Line> = setting.variants.iter().enumerate().filter_map(|(k, v)| point(v, k, score.key)).collect();
    if points.is_empty() {
        return None;
    }
    let published = is_s23(setting) && !score.published.is_empty();
    let mut lines = points;
    lines.extend(published.then(|| reference(score)));
    lines.extend(threads(setting, score.key));
    lines.extend(floors(setting, score.key));
    let x = Axis { name: "number of Gaussians N".into(), log: true, ends: None };
    let chart = Chart { x, y: Axis { name: score.axis.clone(), ..Axis::default() }, lines, ..Chart::default() };
    Figure::chart(&score.name, setting, context! { axis => &score.axis, published }, chart)
}

/// N and score over the seeds of a variant; nothing where no run has the score, or the method no Gaussians.
fn spreads(variant: &Variant, key: &str) -> Option<(Spread, Spread)> {
    let scored = variant.runs.iter().filter_map(|r| Some((r.facts.gaussians as f64, r.scores.value(MODEL, key)?)));
    let (n, score): (Vec<f64>, Vec<f64>) = scored.unzip();
    let n = Spread::of(&n)?;
    // Without Gaussians there is no place on the axis.
    if n.mean > 0.0 { Some((n, Spread::of(&score)?)) } else { None }
}

/// The mark of one variant with its bars.
fn point(variant: &Variant, k: usize, key: &str) -> Option<Line> {
    let (n, score) = spreads(variant, key)?;
    let at = (n.mean, score.mean);
    let mut line = Line::new(Vec::new(), looks::variant(k)).named(&variant.label);
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
        let (family, at) = (without_digits(&variant.label), (n.mean, score.mean));
        match families.iter_mut().find(|f| f.0 == family) {
            Some((_, points)) => points.push(at),
            None => families.push((family, vec![at])),
        }
    }
    families.into_iter().map(|(_, points)| Line::new(points, looks::thread())).collect()
}

/// The label without its numbers, within words too.
fn without_digits(label: &str) -> String {
    label.chars().filter(|c| !(c.is_ascii_digit() || ".-+".contains(*c))).collect()
}

/// Level lines over the whole width, with their names at the right.
pub(super) fn floors(setting: &Setting, key: &str) -> Vec<Line> {
    let line =
        |(k, name): (usize, &str)| Some(Line::level(setting.floor(name, key)?, looks::floor(k)).named_at_end(name));
    setting.floors().into_iter().enumerate().filter_map(line).collect()
}

/// Whether these are the measured spectra that the published numbers belong to, going by what the data call themselves:
/// NeRF2's own name of the set.
fn is_s23(setting: &Setting) -> bool {
    let names = |title: &str| title.split(|c: char| !c.is_alphanumeric()).any(|word| word.eq_ignore_ascii_case("s23"));
    !setting.simulated && setting.runs().all(|run| names(&run.facts.data))
}

/// What the paper publishes.
fn reference(score: &Score) -> Line {
    let mut line = Line::new(Vec::new(), looks::published()).named("published, s23");
    line.marks = score.published.to_vec();
    line
}
