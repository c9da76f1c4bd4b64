//! The medians of this run as the table of `docs/lab/performance.md`.

use serde_json::Value;
use std::path::PathBuf;
use std::time::SystemTime;

/// A row: its name, criterion's group and function, and the targets in ms at the three sizes.
type Row = (&'static str, &'static str, &'static str, [f64; 3]);

const ROWS: [Row; 4] = [
    ("prediction, `Mlp()`", "predict", "seeded", [0.6, 8.0, 190.0]),
    ("prediction, `Wrfgs()`", "predict", "seeded, WRF-GS", [0.3, 2.0, 25.0]),
    ("many at once, `Mlp()`, a spectrum", "predict", "many at once", [0.5, 7.0, 180.0]),
    ("training step, `Mlp()`", "step", "one transmitter", [5.0, 55.0, 1100.0]),
];

/// Prints what was measured since `start`, in ms beside the targets, and nothing where nothing was.
#[allow(clippy::print_stdout)]
pub(crate) fn print(sizes: [usize; 3], start: SystemTime) {
    let mut lines = Vec::new();
    for (name, group, function, targets) in ROWS {
        let cells = sizes.iter().zip(targets).map(|(n, target)| {
            let measured = median(group, function, *n, start).map_or_else(|| "-".into(), digits);
            format!("{measured} ({})", digits(target))
        });
        let cells: Vec<String> = cells.collect();
        if cells.iter().any(|cell| !cell.starts_with('-')) {
            lines.push(format!("| {name} | {} |", cells.join(" | ")));
        }
    }
    if !lines.is_empty() {
        let threads = rayon::current_num_threads();
        println!("\nMedians in ms (targets), {threads} threads:\n");
        println!("| | {} |\n|---|---|---|---|", sizes.map(|n| format!("N = {n}")).join(" | "));
        lines.iter().for_each(|line| println!("{line}"));
    }
}

/// What criterion wrote for a benchmark since `start`, ms.
fn median(group: &str, function: &str, n: usize, start: SystemTime) -> Option<f64> {
    let folder = |name| std::env::var_os(name).map(PathBuf::from);
    let home = folder("CRITERION_HOME")
        .unwrap_or_else(|| folder("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into()).join("criterion"));
    let path = home.join(group).join(function).join(n.to_string()).join("new/estimates.json");
    (path.metadata().ok()?.modified().ok()? >= start).then_some(())?;
    let estimates: Value = serde_json::from_slice(&std::fs::read(path).ok()?).ok()?;
    Some(estimates["median"]["point_estimate"].as_f64()? / 1e6)
}

/// Three digits that count.
fn digits(ms: f64) -> String {
    let places = (2 - ms.log10().floor() as i32).max(0) as usize;
    format!("{ms:.places$}")
}
