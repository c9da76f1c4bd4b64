//! The report in a terminal: scores and differences as aligned text.

use super::super::page::Page;
use super::super::tables::{Column, Line, Mark, Shown, Table};
use crate::canvas::text::plain;
use pwrfgs_experiment::text::aligned;
use std::fmt::Write as _;

/// Tables of every setting that a terminal has room for.
pub(in super::super) fn text(page: &Page) -> String {
    let mut out = String::new();
    for section in &page.sections {
        _ = writeln!(out, "{}", section.title);
        for table in section.tables.iter().filter(|t| ["ranks", "scores", "differences"].contains(&t.name)) {
            _ = write!(out, "\n{}\n{}", table.title, aligned(&lines(table), 1));
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
    out.split_inclusive('\n').map(|line| plain(line.trim_end_matches('\n')) + "\n").collect()
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
fn lines(table: &Table) -> Vec<Vec<String>> {
    let head = |of: fn(&Column) -> String| [String::new()].into_iter().chain(table.columns.iter().map(of)).collect();
    let heads = [head(|c| format!("{} {} ", c.title, c.arrow)), head(|c| format!("{} ", c.detail))];
    let line = |line: &Line| [plain(&line.label)].into_iter().chain(line.cells.iter().map(cell)).collect();
    heads.into_iter().chain(table.lines.iter().map(line)).collect()
}
