//! `report.md`: bold is best, italics are second.

use super::super::page::{Page, Section};
use super::super::tables::{Column, Mark, Shown, Table};
use std::fmt::Write as _;

/// The whole report; figures lie in `figures/`.
pub(in super::super) fn markdown(page: &Page) -> String {
    let mut out = format!("# {}\n", escaped(&page.title));
    for section in &page.sections {
        out.push_str(&of_section(section));
    }
    if !page.left_out.is_empty() {
        out.push_str("\n## Not in this report\n\n");
        out.extend(page.left_out.iter().map(|why| format!("- {}\n", escaped(why))));
    }
    out
}

fn of_section(section: &Section) -> String {
    let mut out = format!("\n## {}\n\n{}\n", escaped(&section.title), escaped(&section.lead));
    for warning in &section.warnings {
        _ = write!(out, "\n**Warning:** {}\n", escaped(warning));
    }
    for (t, legend) in section.tables() {
        _ = write!(out, "\n### {}\n\n{}\n", escaped(&t.title), table(t));
        let marks = t.is_marked().then(|| "**Best**, *second best*.".to_owned());
        out.extend(legend.into_iter().map(escaped).chain(marks).map(|sentence| sentence + "\n"));
    }
    for figure in &section.figures {
        let (title, caption) = (escaped(&figure.title), escaped(&figure.caption));
        _ = write!(out, "\n![{title}](figures/{}-{}.png)\n\n{title}. {caption}\n", section.name, figure.name);
    }
    out.push_str("\n### Runs\n\n| variant | seed | training | machine | program | finished | folder |\n");
    out.push_str("|---|---:|---|---|---|---|---|\n");
    for run in &section.runs {
        let fields = [&run.variant, &run.seed.to_string(), &run.training, &run.machine, &run.program, &run.finished];
        let fields = fields.map(|f| escaped(f)).join(" | ");
        _ = writeln!(out, "| {fields} | {} |", escaped(&run.folder));
    }
    if !section.notes.is_empty() {
        let notes: Vec<String> = section.notes.iter().map(|note| escaped(note)).collect();
        _ = write!(out, "\n{}\n", notes.join("\n"));
    }
    out
}

fn table(table: &Table) -> String {
    let head = |c: &Column| [c.title.as_str(), &c.detail, c.arrow].map(escaped).join(" ").trim().replace("  ", " ");
    let heads: Vec<String> = table.columns.iter().map(head).collect();
    let mut out = format!("| | {} |\n|---|{}\n", heads.join(" | "), "---:|".repeat(heads.len()));
    for line in &table.lines {
        let cells: Vec<String> = line.cells.iter().map(cell).collect();
        _ = writeln!(out, "| {} | {} |", escaped(&line.label), cells.join(" | "));
    }
    out
}

fn cell(shown: &Shown) -> String {
    let value = &shown.value;
    let value = match shown.mark {
        _ if value.is_empty() => return "n/a".into(),
        Mark::None => value.clone(),
        Mark::Best => format!("**{value}**"),
        Mark::Second => format!("*{value}*"),
        Mark::Clear => format!("{value}\\*"),
    };
    match (&shown.interval, shown.deviation.as_str()) {
        (Some((low, high)), _) => format!("{value} \\[{low}, {high}\\]"),
        (None, "") => value,
        (None, deviation) => format!("{value} ± {deviation}"),
    }
}

/// Text that Markdown takes as it is, in a table too.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '\n' | '\r' => out.push(' '),
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '|' | '#' | '&' | '~' | '$' => out.extend(['\\', c]),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::super::tables::{Line, Section as Rows};
    use super::*;

    #[test]
    fn nothing_in_a_label_is_markup() {
        assert_eq!(escaped("a_b|c*d <i> [x](y)\n#1"), "a\\_b\\|c\\*d \\<i\\> \\[x\\](y) \\#1");
    }

    #[test]
    fn marks_are_bold_and_italic() {
        let shown = |value: &str, deviation: &str, mark| Shown {
            value: value.into(),
            deviation: deviation.into(),
            mark,
            ..Shown::default()
        };
        let interval = Some(("−0.1".to_owned(), "+0.3".to_owned()));
        let cells = vec![
            shown("0.75", "0.01", Mark::Best),
            shown("0.50", "", Mark::Second),
            Shown { interval, ..shown("+0.1", "", Mark::None) },
            Shown::default(),
        ];
        let columns = ["SSIM", "η", "Δ", "N"].map(|title| Column { title: title.into(), ..Column::default() }).into();
        let lines = vec![Line { label: "a|b".into(), section: Rows::Variants, cells }];
        let text = table(&Table { name: "scores", title: String::new(), columns, lines, legend: vec![] });
        let row = "| a\\|b | **0.75** ± 0.01 | *0.50* | +0.1 \\[−0.1, +0.3\\] | n/a |\n";
        assert!(text.ends_with(row), "{text}");
        assert!(text.starts_with("| | SSIM | η | Δ | N |\n|---|---:|---:|---:|---:|\n"), "{text}");
    }
}
