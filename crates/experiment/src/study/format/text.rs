//! The report in a terminal: scores and differences as aligned text.

use super::super::page::Page;
use super::super::tables::{Line, Mark, Shown, Table};
use std::fmt::Write as _;

/// Tables of every setting that a terminal has room for.
pub(in super::super) fn text(page: &Page) -> String {
    let mut out = String::new();
    for section in &page.sections {
        _ = writeln!(out, "{}", section.title);
        for table in section.tables.iter().filter(|t| ["scores", "differences"].contains(&t.name)) {
            _ = write!(out, "\n{}\n{}", table.title, aligned(table));
            let how = if table.is_marked() { "* best, + second best" } else { "[95 % interval], * leaves 0 out" };
            _ = writeln!(out, "{how}");
        }
        out.push('\n');
        let warnings = section.warnings.iter().map(|w| format!("warning: {w}\n"));
        out.extend(warnings.chain(section.notes.iter().map(|note| format!("note: {note}\n"))));
        out.push('\n');
    }
    out.truncate(out.trim_end().len());
    out.push('\n');
    out.extend(page.left_out.iter().map(|why| format!("left out: {why}\n")));
    out
}

fn cell(shown: &Shown) -> String {
    let mark = match shown.mark {
        Mark::None => " ",
        Mark::Best | Mark::Clear => "*",
        Mark::Second => "+",
    };
    let more = match (&shown.interval, shown.deviation.as_str()) {
        (Some((low, high)), _) => format!(" [{low}, {high}]"),
        (None, "") => String::new(),
        (None, deviation) => format!(" ± {deviation}"),
    };
    if shown.value.is_empty() { "n/a ".into() } else { format!("{}{more}{mark}", shown.value) }
}

/// Labels to the left, numbers to the right, under two lines of heads.
fn aligned(table: &Table) -> String {
    let head = |of: &dyn Fn(usize) -> String| (String::new(), (0..table.columns.len()).map(of).collect::<Vec<_>>());
    let titles = head(&|k| format!("{} {} ", table.columns[k].title, table.columns[k].arrow));
    let details = head(&|k| format!("{} ", table.columns[k].detail));
    let line = |line: &Line| (line.label.clone(), line.cells.iter().map(cell).collect::<Vec<_>>());
    let lines: Vec<_> = [titles, details].into_iter().chain(table.lines.iter().map(line)).collect();
    let width = |text: &str| text.chars().count();
    let first = lines.iter().map(|(label, _)| width(label)).max().unwrap_or(0);
    let widths: Vec<usize> =
        (0..table.columns.len()).map(|k| lines.iter().map(|(_, cells)| width(&cells[k])).max().unwrap_or(0)).collect();
    let mut out = String::new();
    for (label, cells) in &lines {
        let mut line = format!("{label:<first$}");
        for (cell, width) in cells.iter().zip(&widths) {
            _ = write!(line, "  {cell:>width$}");
        }
        if !line.trim().is_empty() {
            out.push_str(line.trim_end());
            out.push('\n');
        }
    }
    out
}
