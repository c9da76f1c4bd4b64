//! Formats of the report: HTML and LaTeX by templates, and aligned text for a terminal.

use super::page::StudyPage;
use super::tables::{FormattedValue, RankMark, Table, TableColumn, TableLine};
use crate::canvas::single_line;
use crate::templates::render;
use minijinja::value::Serde;
use minijinja::{Value, context};
use pwrfgs_core::Result;
use pwrfgs_experiment::text::aligned;
use std::fmt::Write as _;

/// Names and texts of all documents: `report.html`, `report.tex` with one file per table.
pub(super) fn documents(page: &StudyPage) -> Result<Vec<(String, String)>> {
    let (mut all, mut sections) = (Vec::new(), Vec::new());
    for section in &page.sections {
        let (mut message, mut tables) = (Vec::new(), Vec::new());
        for table in &section.tables {
            let t = shown(table, &mut message);
            let context = context! { t => t.clone(), setting => section.title.clone(), name => section.name.clone() };
            all.push((format!("tables/{}-{}.tex", section.name, table.name), render("table.tex", context)?));
            tables.push(t);
        }
        sections.push(context! { tables, ..Serde(section) });
    }
    let context = context! {
        title => page.title.clone(),
        sections,
        left_out => page.left_out.clone(),
        version => env!("CARGO_PKG_VERSION"),
    };
    for name in ["report.tex", "report.html"] {
        all.push((name.to_owned(), render(name, context.clone())?));
    }
    Ok(all)
}

/// Table for a template: groups neighbouring columns of one title and lines of one kind; separates the sentences of the
/// legend that no table above contains.
fn shown<'a>(table: &'a Table, message: &mut Vec<&'a str>) -> Value {
    let fresh: Vec<&str> = table.legend.iter().map(String::as_str).filter(|s| !message.contains(s)).collect();
    message.extend(&fresh);
    let groups: Vec<&[TableColumn]> =
        table.columns.chunk_by(|a, b| (&a.title, a.arrow) == (&b.title, b.arrow)).collect();
    let sections: Vec<&[TableLine]> = table.lines.chunk_by(|a, b| a.kind == b.kind).collect();
    context! {
        groups => Serde(groups),
        sections => Serde(sections),
        detailed => table.columns.iter().any(|c| !c.detail.is_empty()),
        marked => table.is_marked(),
        fresh => Serde(fresh),
        ..Serde(table)
    }
}

/// Tables of every setting that fit a terminal.
pub(super) fn text(page: &StudyPage) -> String {
    let mut out = String::new();
    for section in &page.sections {
        _ = writeln!(out, "{}", section.title);
        for table in section.tables.iter().filter(|t| ["ranks", "scores", "differences"].contains(&t.name)) {
            _ = write!(out, "\n{}\n{}", table.title, aligned(&lines(table), 1));
            let how = if table.is_marked() { "* best, + second best" } else { "[95 % interval], * excludes 0" };
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
    out.split_inclusive('\n').map(|line| single_line(line.trim_end_matches('\n')) + "\n").collect()
}

fn cell(shown: &FormattedValue) -> String {
    let mark = match shown.mark {
        RankMark::None => " ",
        RankMark::Best | RankMark::Clear => "*",
        RankMark::Second => "+",
    };
    let more = match (&shown.interval, shown.deviation.as_str()) {
        (Some((low, high)), _) => format!(" [{low}, {high}]"),
        (None, "") => String::new(),
        (None, deviation) => format!(" ± {deviation}"),
    };
    if shown.value.is_empty() { "n/a ".into() } else { format!("{}{more}{mark}", shown.value) }
}

/// Aligned text: labels left, numbers right, below two header lines.
fn lines(table: &Table) -> Vec<Vec<String>> {
    let head =
        |of: fn(&TableColumn) -> String| [String::new()].into_iter().chain(table.columns.iter().map(of)).collect();
    let heads = [head(|c| format!("{} {} ", c.title, c.arrow)), head(|c| format!("{} ", c.detail))];
    let line = |line: &TableLine| [single_line(&line.label)].into_iter().chain(line.cells.iter().map(cell)).collect();
    heads.into_iter().chain(table.lines.iter().map(line)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::comparison::RowKind;
    use super::super::page::Section;
    use super::*;

    fn shown(value: &str, deviation: &str, mark: RankMark) -> FormattedValue {
        FormattedValue { value: value.into(), deviation: deviation.into(), mark, ..FormattedValue::default() }
    }

    /// Page of one section with one table.
    fn page(columns: Vec<TableColumn>, lines: Vec<TableLine>) -> StudyPage {
        let table = Table { name: "scores", title: "50 % of a_b".into(), columns, lines, legend: vec!["a<b".into()] };
        let title = "office (simulated)".to_owned();
        let section = Section { name: "1".into(), title, tables: vec![table], ..Section::default() };
        StudyPage { title: "a & b".into(), sections: vec![section], ..StudyPage::default() }
    }

    fn document(page: &StudyPage, name: &str) -> String {
        documents(page).unwrap().into_iter().find(|(found, _)| found == name).unwrap().1
    }

    #[test]
    fn latex_table_has_rules_groups_and_marks() {
        let column =
            |title: &str, detail: &str| TableColumn { title: title.into(), detail: detail.into(), arrow: "↑" };
        let line = |label: &str, kind, value, mark| {
            let cells = vec![shown(value, "", mark), shown("1", "", RankMark::None), FormattedValue::default()];
            TableLine { label: label.into(), kind, cells }
        };
        let columns = vec![column("SSIM", "mean"), column("SSIM", "median"), column("η", "mean")];
        let lines = vec![
            line("a_b", RowKind::Variant, "0.9", RankMark::Best),
            line("5-NN", RowKind::Baseline, "0.8", RankMark::Second),
        ];
        let table = document(&page(columns, lines), "tables/1-scores.tex");
        for part in [
            "{\\usebox0}\\else\\usebox0\\fi}\n\\begin{table}[htbp]\n",
            "\\caption{50 \\% of a\\_b: office (simulated)}\n\\label{tab:1-scores}\n\\pwrfgsfit{%\n\\begin{tabular}{lrrr}\n",
            "\\multicolumn{2}{c}{SSIM \\ensuremath{\\uparrow}} & \\multicolumn{1}{r}{\\ensuremath{\\eta}",
            "\\cmidrule(lr){2-3}\n & mean & median & mean \\\\\n\\midrule\n",
            "a\\_b & \\textbf{0.9} & 1 & -- \\\\\n\\midrule\n5-{}NN & \\underline{0.8} & 1 & -- \\\\\n\\bottomrule",
            "\\footnotesize a\\textless{}b \\textbf{Best}",
        ] {
            assert!(table.contains(part), "`{part}` is not in\n{table}");
        }
    }

    #[test]
    fn labels_are_escaped_in_html() {
        let line =
            TableLine { label: "<i>".into(), kind: RowKind::Variant, cells: vec![shown("1", "", RankMark::None)] };
        let text = document(&page(vec![TableColumn::default()], vec![line]), "report.html");
        assert!(text.contains("<h1>a &amp; b</h1>") && text.contains("<td>&lt;i&gt;</td>"), "{text}");
    }
}
