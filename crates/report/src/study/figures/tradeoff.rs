//! First metric and rate ratio against N, bytes and milliseconds: figure 2b of the paper, and methods at equal N.

use super::Figure;
use super::shown::{CURVES, grey_baselines, has_label};
use crate::draw::charts::{Chart, ChartAxis, ChartLine};
use crate::draw::marks::Style;
use crate::study::comparison::has_unsteady_times;
use minijinja::context;
use pwrfgs_core::{Headline, statistics::bounds};
use pwrfgs_experiment::paired::is_rate_ratio;
use pwrfgs_experiment::{
    CEILING, ParetoComparison, Record, Setting, StudyVariant, VariantFamily, scores::MODEL, statistics::Spread,
};

/// Method and its published values by N.
type Published = (&'static str, &'static [(f64, f64)]);

/// Published SSIM by N: Bian, Hua and Gündüz, "P-WRFGS: Pruning 3D Gaussians for Efficient Wireless Radiance Field
/// Construction", for mask penalties of 0.02 and 0.04, and WRF-GS with the point cloud.
///
/// The text prints 0.642 at N = 8; the other values are only in its figure 2b, which has no numbers, and its LaTeX
/// source. The data are the measured spectra of NeRF2 (`s23`) with a random split, 4,898 for training and 1,225 for test,
/// and 200,000 steps. The paper does not state whether its SSIM is a mean or a median.
const PUBLISHED_SSIM: [Published; 2] =
    [("P-WRFGS in the paper", &[(157.0, 0.850), (8.0, 0.642)]), ("WRF-GS in the paper", &[(65_469.0, 0.899)])];
/// Published rate ratio η by N, from the same paper.
const PUBLISHED_ETA: [Published; 1] = [("P-WRFGS in the paper", &[(8.0, 0.9288)])];

/// Score that is plotted against N.
struct Score {
    /// Key in `scores.csv`.
    key: &'static str,
    /// Stem of the files.
    name: String,
    /// Name of the axis.
    axis: String,
    /// N and score that the paper publishes.
    published: &'static [Published],
}

/// Draws the first metric against N; `None` without scores, or if [`pareto_figure`] compares the methods.
pub(super) fn first_metric_figure(setting: &Setting) -> Option<Figure> {
    let Headline { key, short, name, .. } = setting.headline();
    let published: &[_] = if key == "ssim" { &PUBLISHED_SSIM } else { &[] };
    let stem = format!("{}-n", short.to_lowercase());
    score_figure(setting, &Score { key, name: stem, axis: format!("mean {name}"), published })
}

/// Draws the rate ratio against N; `None` without scores, or if [`pareto_figure`] compares the methods.
pub(super) fn rate_ratio_figure(setting: &Setting) -> Option<Figure> {
    score_figure(
        setting,
        &Score {
            key: "eta_0db",
            name: "eta-n".into(),
            axis: "rate loss 1 − η at 0 dB".into(),
            published: &PUBLISHED_ETA,
        },
    )
}

/// Draws a score against N; `None` without scores, or if [`pareto_figure`] compares the methods.
fn score_figure(setting: &Setting, score: &Score) -> Option<Figure> {
    if ParetoComparison::of(setting).is_some() {
        return None; // too many variants for marks with names: the figures of methods have one line per method
    }
    let mut lines = method_lines(setting, score.key);
    let counts = bounds(lines.iter().flat_map(|line| &line.marks).map(|mark| mark.0));
    // At one N, marks would hide each other.
    let count = lines.iter().map(|line| line.marks.len()).sum::<usize>();
    if lines.is_empty() || count > 1 && counts.0 == counts.1 {
        return None;
    }
    let published = is_s23(setting) && !score.published.is_empty();
    lines.extend(score.published.iter().filter(|_| published).map(|published| published_line(score.key, published)));
    lines.extend(baseline_lines(setting, score.key));
    let x = ChartAxis { name: "number of Gaussians N".into(), log: true, ends: None };
    let y = ChartAxis { name: score.axis.clone(), log: is_rate_ratio(score.key), ends: None };
    let chart = Chart { x, y, lines, ..Chart::default() };
    Figure::from_chart(&score.name, setting, context! { axis => &score.axis, published }, chart)
}

/// Returns the curve of each method that has this score over N.
pub(super) fn method_lines(setting: &Setting, key: &str) -> Vec<ChartLine> {
    let families = VariantFamily::group(setting);
    families.iter().enumerate().filter_map(|(k, family)| family_line(family, k, &NUMBER, key, true)).collect()
}

/// Returns the value of a score on its axis: 1 − η, on a logarithmic axis, for a rate ratio η, since good values are
/// all near 1.
fn axis_value(key: &str, score: f64) -> f64 {
    if is_rate_ratio(key) { 1.0 - score } else { score }
}

/// Returns the style of the `k`th baseline, called `name`, the same in all figures. Predictions of another program have a style
/// after those of [`CURVES`] variants.
pub(super) fn row_style(setting: &Setting, k: usize, name: &str) -> Style {
    if setting.is_external(name) { Style::external(CURVES + k) } else { Style::baseline(k) }
}

/// Returns a horizontal line for each of the best baselines and the noise ceiling at its score, with its name at the right.
fn baseline_lines(setting: &Setting, key: &str) -> Vec<ChartLine> {
    let line = |(k, name): (usize, &str)| {
        let score = axis_value(key, setting.baseline_score(name, key)?);
        let title = if name == CEILING { "ceiling" } else { name };
        Some(ChartLine::horizontal(score, row_style(setting, k, name)).named_at_end(title))
    };
    let ceiling = (setting.baselines().len(), CEILING);
    grey_baselines(setting).into_iter().chain([ceiling]).filter_map(line).collect()
}

/// Returns whether the data of all runs are the measured spectra of the published numbers: their name has the word `s23`, as
/// NeRF2 calls them.
fn is_s23(setting: &Setting) -> bool {
    let names = |title: &str| title.split(|c: char| !c.is_alphanumeric()).any(|word| word.eq_ignore_ascii_case("s23"));
    !setting.simulated && setting.runs().all(|run| names(&run.facts.data))
}

/// Returns the published values of a method: stars, hollow for the method of the paper.
fn published_line(key: &str, (name, published): &Published) -> ChartLine {
    let mut line = ChartLine::new(Vec::new(), Style::published(name.starts_with("P-WRFGS"))).named(name);
    line.marks = published.iter().map(|(n, score)| (*n, axis_value(key, *score))).collect();
    line
}

/// Number of the best methods that are drawn in colour; the last one is too.
const SHOWN: usize = CURVES - 1;

/// Cost on the horizontal axis.
pub(super) struct CostAxis {
    name: &'static str,
    axis: &'static str,
    value: fn(&Record) -> Option<f64>,
}

/// Number of Gaussians.
pub(super) const NUMBER: CostAxis =
    CostAxis { name: "pareto-n", axis: "number of Gaussians N", value: |run| Some(run.facts.gaussians as f64) };
/// Size of the model file.
pub(super) const BYTES: CostAxis =
    CostAxis { name: "pareto-bytes", axis: "model size [bytes]", value: |run| run.scores.value(MODEL, "model_bytes") };
/// Time of a prediction.
pub(super) const LATENCY: CostAxis =
    CostAxis { name: "pareto-ms", axis: "latency [ms]", value: |run| run.scores.value(MODEL, "latency_total_ms") };

/// Draws the first metric of methods at equal numbers of Gaussians against a cost: [`NUMBER`], [`BYTES`] or
/// [`LATENCY`]. `None` if there are too few methods, none has this cost, or it is a time that is not steady.
pub(super) fn pareto_figure(setting: &Setting, cost: &CostAxis, references: &[&str]) -> Option<Figure> {
    let headline = setting.headline();
    if cost.name == LATENCY.name && has_unsteady_times(setting) {
        return None;
    }
    // Methods that are always worse than all baselines would compress the axis.
    let is_worst = |family: &VariantFamily<'_>| is_worse_than_baselines(setting, family);
    let (left_out, families): (Vec<_>, Vec<_>) =
        ParetoComparison::of(setting)?.families.into_iter().partition(is_worst);
    let left_out: Vec<String> = left_out.into_iter().map(|family| family.name).collect();
    let last = families.len().checked_sub(1)?;
    let (mut lines, mut others, mut further) = (Vec::new(), Vec::new(), 0);
    for (k, family) in families.iter().enumerate() {
        let is_shown = k < SHOWN || k == last || has_label(family, references);
        // The last method has the style after the best ones; references follow.
        let mut style = k.min(SHOWN);
        if is_shown && k >= SHOWN && k != last {
            further += 1;
            style += further;
        }
        let line = family_line(family, style, cost, headline.key, is_shown);
        if is_shown { lines.extend(line) } else { others.extend(line) }
    }
    if lines.is_empty() {
        return None;
    }
    lines.append(&mut others);
    let published = cost.name == NUMBER.name && headline.key == "ssim" && is_s23(setting);
    lines.extend(PUBLISHED_SSIM.iter().filter(|_| published).map(|published| published_line(headline.key, published)));
    lines.extend(baseline_lines(setting, headline.key));
    let axis = format!("mean {}", headline.name);
    let x = ChartAxis { name: cost.axis.into(), log: true, ends: None };
    let chart = Chart { x, y: ChartAxis { name: axis.clone(), ..ChartAxis::default() }, lines, ..Chart::default() };
    let (families, shown) = (families.len(), SHOWN.min(last));
    Figure::from_chart(
        cost.name,
        setting,
        context! { axis, families, shown, left_out, published, cost => cost.axis },
        chart,
    )
}

/// Returns whether all scores of a method are worse than the mean score of the worst baseline; false without baselines
/// or scores.
fn is_worse_than_baselines(setting: &Setting, family: &VariantFamily<'_>) -> bool {
    let Headline { key, higher, .. } = setting.headline();
    let baselines = setting.baselines().into_iter().filter_map(|name| setting.baseline_score(name, key));
    let Some(worst) = baselines.reduce(if higher { f64::min } else { f64::max }) else { return false };
    let scores: Vec<f64> = family.results.iter().flatten().map(|(score, _)| score.mean).collect();
    !scores.is_empty() && scores.into_iter().all(|score| if higher { score < worst } else { score > worst })
}

/// Returns the style of method `k`: that of its variant if it has only one.
pub(super) fn method_style(family: &VariantFamily<'_>, k: usize) -> Style {
    if family.variants.len() > 1 { Style::method(k) } else { Style::variant(k) }
}

/// Returns the line of the `k`th method through its variants, with bars over seeds; thin and without name and bars unless
/// `shown`. Variants of equal cost, such as of two training lengths, are marks without a line. `None` if no variant has both cost
/// and score.
fn family_line(family: &VariantFamily<'_>, k: usize, cost: &CostAxis, key: &str, shown: bool) -> Option<ChartLine> {
    let cost_and_score = |variant: &&StudyVariant| {
        let (cost_spread, score) = (variant.spread(cost.value)?, variant.score(key)?);
        (cost_spread.mean > 0.0).then_some((cost_spread, score))
    };
    let mut pairs: Vec<(Spread, Spread)> = family.variants.iter().filter_map(cost_and_score).collect();
    pairs.sort_by(|a, b| a.0.mean.total_cmp(&b.0.mean));
    let points: Vec<(f64, f64)> =
        pairs.iter().map(|(cost_spread, score)| (cost_spread.mean, axis_value(key, score.mean))).collect();
    if points.is_empty() {
        return None;
    }
    let is_curve = points.windows(2).all(|pair| pair[0].0 < pair[1].0);
    let curve = if is_curve { points.clone() } else { Vec::new() };
    if !shown {
        return Some(ChartLine::new(curve, Style::thread()));
    }
    let mut line = ChartLine::new(curve, method_style(family, k)).named(&family.title);
    line.marks = points;
    let bars = |(cost_spread, score): &(Spread, Spread)| {
        let (x, y) = (cost_spread.mean, axis_value(key, score.mean));
        // A logarithmic axis has no values at or below zero.
        let least = if is_rate_ratio(key) { 0.1 * y } else { f64::NEG_INFINITY };
        let across = cost_spread.deviation.map(|d| [((x - d).max(0.1 * x), y), (x + d, y)]);
        let upright = score.deviation.map(|d| [(x, (y - d).max(least)), (x, y + d)]);
        across.into_iter().chain(upright).collect::<Vec<_>>()
    };
    line.bars = pairs.iter().flat_map(bars).filter(|[a, b]| a != b).collect();
    Some(line)
}
