//! Time of a prediction by stage: stacked bars.

use super::sheet::wrapped;
use super::{Figure, Sheet, looks, runs, seeds, source};
use crate::draw::charts::text_width;
use crate::draw::ticks::ticks;
use crate::study::statistics::Spread;
use crate::study::{Setting, Variant};
use pwrfgs_core::Result;
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::text::number;

/// Stages with their keys in `scores.csv`.
const STAGES: [(&str, &str); 4] = [
    ("network", "latency_network_ms"),
    ("projection", "latency_projection_ms"),
    ("sort", "latency_sort_ms"),
    ("blending", "latency_blending_ms"),
];
const TOTAL: &str = "latency_total_ms";

/// Height of a row, of every further line of its name, and of its bar.
const ROW: f64 = 21.0;
const FURTHER: f64 = 12.0;
const BAR: f64 = 13.0;
/// Names of variants take so much at most.
const NAMES: f64 = 130.0;

/// One bar.
struct Bar<'a> {
    label: &'a str,
    /// Milliseconds of each stage.
    stages: Vec<f64>,
    total: Spread,
}

impl<'a> Bar<'a> {
    /// Of a variant; nothing where it was not timed.
    fn of(variant: &'a Variant) -> Option<Self> {
        let spread = |key: &str| {
            let values: Vec<f64> = variant.runs.iter().filter_map(|r| r.value(MODEL, key)).collect();
            Spread::of(&values)
        };
        let stages: Option<Vec<f64>> = STAGES.iter().map(|(_, key)| Some(spread(key)?.mean)).collect();
        Some(Self { label: &variant.label, stages: stages?, total: spread(TOTAL)? })
    }

    /// Where its bar ends.
    fn length(&self) -> f64 {
        self.stages.iter().sum()
    }
}

pub(super) fn figure(setting: &Setting) -> Result<Option<Figure>> {
    let bars: Vec<Bar<'_>> = setting.variants.iter().filter_map(Bar::of).collect();
    let longest = bars.iter().map(Bar::length).fold(0.0, f64::max);
    if !(longest > 0.0 && longest.is_finite()) {
        return Ok(None);
    }
    let caption = format!(
        "Time of one prediction by stage: means over {} of each run's medians. At the end of a bar: the time of all \
         stages together, measured by itself, with its standard deviation over seeds. {} {}",
        seeds(setting),
        machines(setting),
        source(setting)
    );
    Figure::sheet("latency", "Time of a prediction by stage", caption, &draw(&bars, longest)).map(Some)
}

/// What it was measured on.
fn machines(setting: &Setting) -> String {
    let mut all: Vec<String> =
        runs(setting).map(|r| format!("{}, {} threads", r.facts.machine.cpu, r.facts.machine.threads)).collect();
    all.sort();
    all.dedup();
    match all.as_slice() {
        [one] => format!("Machine: {one}."),
        _ => format!("Machines differ, so times cannot be compared: {}.", all.join("; ")),
    }
}

fn draw(bars: &[Bar<'_>], longest: f64) -> Sheet {
    let mut sheet = Sheet::column();
    let labels: Vec<Vec<String>> = bars.iter().map(|b| wrapped(b.label, NAMES)).collect();
    let names = labels.iter().flatten().map(|line| f64::from(text_width(line))).fold(0.0, f64::max);
    let row = ROW + FURTHER * (labels.iter().map(Vec::len).max().unwrap_or(1) as f64 - 1.0);
    let (left, top) = (names + 12.0, 6.0);
    let ends = bars.iter().map(|b| f64::from(text_width(&b.end()))).fold(0.0, f64::max);
    let width = sheet.width - left - ends - 10.0;
    let bottom = top + row * bars.len() as f64;
    let x = |ms: f64| left + width * ms / longest;
    let apart = |all: &[(f64, String)]| {
        all.windows(2).all(|w| x(w[1].0) - x(w[0].0) > f64::from(text_width(&w[0].1) + text_width(&w[1].1)) / 2.0 + 8.0)
    };
    for (ms, label) in ticks((0.0, longest), false, &apart) {
        sheet.line([x(ms), bottom], [x(ms), bottom + 4.0], "#464a52");
        sheet.text([x(ms), bottom + 16.0], "middle", &label);
    }
    for (k, bar) in bars.iter().enumerate() {
        let y = top + row * (k as f64 + 0.5);
        sheet.lines([left - 6.0, y], "end", &labels[k]);
        let mut begun = 0.0;
        for (stage, ms) in bar.stages.iter().enumerate() {
            sheet.rect([x(begun), y - BAR / 2.0], [x(begun + ms) - x(begun), BAR], looks::SHADES[stage]);
            begun += ms;
        }
        sheet.text([x(begun) + 5.0, y + 4.0], "start", &bar.end());
    }
    sheet.line([left, top], [left, bottom], "#464a52");
    sheet.line([left, bottom], [left + width, bottom], "#464a52");
    sheet.text([left + width / 2.0, bottom + 32.0], "middle", "time of a prediction [ms]");
    let keys: f64 = STAGES.iter().map(|s| f64::from(text_width(s.0)) + 34.0).sum();
    let mut key = (sheet.width - keys) / 2.0 + 8.0;
    for (stage, (name, _)) in STAGES.iter().enumerate() {
        sheet.rect([key, bottom + 43.0], [13.0, 10.0], looks::SHADES[stage]);
        sheet.text([key + 18.0, bottom + 52.0], "start", name);
        key += f64::from(text_width(name)) + 34.0;
    }
    sheet.height = bottom + 60.0;
    sheet
}

impl Bar<'_> {
    /// What stands at its end.
    fn end(&self) -> String {
        match self.total.deviation {
            // Two digits of the deviation, and as many of the mean.
            Some(deviation) if deviation > 0.0 => {
                let decimals = (1.0 - deviation.log10().floor()).clamp(0.0, 6.0) as usize;
                format!("{:.decimals$} ± {deviation:.decimals$}", self.total.mean)
            }
            _ => number(self.total.mean),
        }
    }
}
