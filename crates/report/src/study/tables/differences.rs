//! The table of paired differences against a reference.

use super::super::comparison::{Comparison, Metric, Row};
use super::super::statistics::{CONFIDENCE, Difference, REPLICATES};
use super::columns::{fixed, words};
use super::{Column, Line, Mark, Section, Shown, Table, title};
use pwrfgs_experiment::text::grouped;

/// Decimals of a difference: one more than scores have.
const DECIMALS: usize = 4;

/// Every row less the reference, in SSIM, η and whatever else is shown first.
pub(in super::super) fn differences(comparison: &Comparison<'_>, reference: &Row<'_>) -> Option<Table> {
    let shown = |m: &&Metric| m.per_sample && (m.key == "ssim" || m.key.starts_with("eta_"));
    let mut metrics: Vec<&Metric> = comparison.metrics.iter().filter(shown).collect();
    if metrics.is_empty() {
        metrics = comparison.metrics.iter().filter(|m| m.per_sample).collect();
    }
    let others = comparison.rows.iter().filter(|row| row.label != reference.label);
    let lines: Vec<(Line, usize)> = others
        .filter_map(|row| {
            let found: Vec<Option<Difference>> =
                metrics.iter().map(|m| row.less(reference, m, &comparison.blocks)).collect();
            let seeds = found.iter().flatten().map(|d| d.seeds).max()?;
            let cells = found.iter().map(|d| d.as_ref().map_or_else(Shown::default, cell)).collect();
            Some((Line::new(row.label, row.kind, cells), seeds))
        })
        .collect();
    let seeds = (lines.iter().map(|l| l.1).min()?, lines.iter().map(|l| l.1).max()?);
    let column = |m: &&Metric| {
        let (title, unit) = words(m);
        let detail = if unit.is_empty() { String::new() } else { format!("[{unit}]") };
        Column { title: format!("Δ {title}"), detail, arrow: if m.higher_is_better { "↑" } else { "↓" } }
    };
    let mut table = Table {
        name: "differences",
        title: title(&format!("Paired differences from {}", reference.label), comparison.setting),
        columns: metrics.iter().map(column).collect(),
        lines: lines.into_iter().map(|l| l.0).collect(),
        legend: Vec::new(),
    };
    table.legend = legend(comparison, reference, seeds);
    if table.has(Section::Bounds) {
        table.legend.push("† knows the scene that made the simulated spectra.".into());
    }
    Some(table)
}

fn cell(difference: &Difference) -> Shown {
    let signed = |v: f64| {
        let text = fixed(v, DECIMALS);
        if v > 0.0 { format!("+{text}") } else { text }
    };
    Shown {
        value: signed(difference.mean),
        interval: difference.interval.map(|(low, high)| (signed(low), signed(high))),
        mark: if difference.is_clear() { Mark::Clear } else { Mark::None },
        ..Shown::default()
    }
}

/// What the interval is one of, and what it leaves out.
fn legend(comparison: &Comparison<'_>, reference: &Row<'_>, (least, most): (usize, usize)) -> Vec<String> {
    let percent = (CONFIDENCE * 100.0).round();
    let blocks = &comparison.blocks;
    let seeds = if least == most { most.to_string() } else { format!("{least} to {most}") };
    let plural = if most == 1 { "" } else { "s" };
    let mut legend = vec![
        format!(
            "Row less {}: mean over test spectra, paired by seed and spectrum ({seeds} seed{plural}), with the {percent} \
             % bootstrap interval in brackets; * marks intervals that leave 0 out.",
            reference.label
        ),
        format!(
            "The {} replicates draw seeds, and cubes of {:.2} m ({} of them hold test transmitters) rather than single \
             spectra, because neighbouring transmitters err alike; errors that reach farther than a cube would make the \
             intervals wider.",
            grouped(REPLICATES as i64),
            blocks.edge_m,
            blocks.count
        ),
    ];
    if blocks.count < 10 {
        legend.push("Fewer than ten cubes: the intervals are a rough guide.".into());
    }
    match least {
        1 => legend.push(
            "Of one seed the interval holds for that seed alone: how much another would differ is not in it.".into(),
        ),
        2..5 => legend.push(
            "With fewer than five seeds the intervals are too narrow where seeds differ more than places do.".into(),
        ),
        _ => {}
    }
    legend.push("Each interval stands for itself: of twenty that should hold 0, one leaves it out by chance.".into());
    legend
}
