//! Folder of the report: its files in HTML, LaTeX and text, and their ownership.
//!
//! `report.json` lists the files of the report. Only these are replaced or removed, each atomically; a
//! non-empty folder without such a list is rejected.

use super::page::{ReportOptions, StudyPage};
use super::tables::{FormattedValue, RankMark, Table, TableColumn, TableLine};
use crate::canvas::single_line;
use crate::templates::render;
use minijinja::value::Serde;
use minijinja::{Value, context};
use pwrfgs_core::files::{self, refuse_foreign, write_atomically};
use pwrfgs_core::{Error, Result};
use pwrfgs_experiment::text::align_columns;
use pwrfgs_experiment::{Observer, Study};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

/// File that marks a folder as a report.
const LIST: &str = "report.json";

/// Content of [`LIST`].
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
struct FileList {
    /// Version of pwrfgs.
    version: String,
    /// Paths inside the folder, in ascending order.
    files: BTreeSet<String>,
}

/// Writes the report of a study into `out`: `report.csv`, `report.tex` with `tables/`, `report.html` and
/// `figures/`. Returns the tables as text for a terminal. `options` choose the reference of paired differences, columns of a
/// table, and variants of the figures.
///
/// Equal runs give equal bytes.
///
/// # Errors
/// If a name in the options does not exist, the folder is not a report or holds symbolic links, or a file cannot be written.
pub fn write(study: &Study, options: &ReportOptions, out: &Path, observer: &mut dyn Observer) -> Result<String> {
    let check = || refuse_links(out).and_then(|()| read_list(out));
    check()?; // before the figures are drawn
    let page = StudyPage::new(study, options, observer)?;
    let files = report_files(&page)?;
    let before = check()?; // another program may have written there meanwhile
    let names: BTreeSet<String> = files.iter().map(|(name, _)| name.clone()).collect();
    if let Some(foreign) = names.difference(&before.files).find(|name| out.join(name).symlink_metadata().is_ok()) {
        let path = out.join(foreign);
        return Err(Error::Config(format!("{}: not a file of the report; choose another --out", path.display())));
    }
    for folder in ["tables", "figures"] {
        let folder = out.join(folder);
        std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
    }
    // First the list of all files, so that an interrupted report can be replaced.
    write_list(out, &before.files | &names)?;
    before.files.difference(&names).for_each(|old| files::remove(&out.join(old)));
    for (name, bytes) in &files {
        write_atomically(&out.join(name), bytes)?;
    }
    // Removes the folder of figures if it is empty.
    _ = std::fs::remove_dir(out.join("figures"));
    write_list(out, names)?;
    Ok(format_tables(&page))
}

/// Returns the names and bytes of all files except [`LIST`]. The page is the last: a new folder with a page is
/// complete.
fn report_files(page: &StudyPage) -> Result<Vec<(String, Vec<u8>)>> {
    let mut files = vec![("report.csv".into(), page.csv.clone().into())];
    for section in &page.sections {
        for figure in &section.figures {
            let stem = format!("figures/{}-{}", section.name, figure.name);
            files.push((format!("{stem}.svg"), figure.svg.clone().into()));
            files.push((format!("{stem}.pdf"), figure.pdf.clone()));
            files.push((format!("{stem}.png"), figure.png.clone()));
        }
    }
    files.extend(render_documents(page)?.into_iter().map(|(name, text)| (name, text.into())));
    Ok(files)
}

/// Rejects a symbolic link at `out`, its list or its folders: a report replaces and removes only its own files.
fn refuse_links(out: &Path) -> Result<()> {
    let paths = [out.to_owned(), out.join(LIST), out.join("tables"), out.join("figures")];
    let is_link = |path: &&std::path::PathBuf| path.symlink_metadata().is_ok_and(|metadata| metadata.is_symlink());
    paths.iter().find(is_link).map_or(Ok(()), |path| {
        let advice = "reports are not written through links; choose another --out";
        Err(Error::Config(format!("{}: symbolic link; {advice}", path.display())))
    })
}

/// Returns the list of files in `out`; empty for a new folder. Rejects paths that are not folders, and folders with
/// files but without a valid list of a report.
fn read_list(out: &Path) -> Result<FileList> {
    let path = out.join(LIST);
    let Some(text) = files::if_found(&path, files::read_string(&path))? else {
        return refuse_foreign(out, "a report's folder", "").map(|()| FileList::default());
    };
    // Only names of report files: nothing else is removed, whatever the list contains.
    serde_json::from_str::<FileList>(&text)
        .ok()
        .filter(|list| list.files.iter().all(|name| is_report_file(name)))
        .ok_or_else(|| Error::input(&path, "not a list of report files; choose another --out"))
}

/// Returns whether a report writes files of this name.
fn is_report_file(name: &str) -> bool {
    let below = |folder: &str, ends: &[&str]| {
        name.strip_prefix(folder).is_some_and(|n| !n.contains(['/', '\\']) && ends.iter().any(|end| n.ends_with(end)))
    };
    ["report.csv", "report.tex", "report.html"].contains(&name)
        || below("tables/", &[".tex"])
        || below("figures/", &[".svg", ".pdf", ".png"])
}

/// Writes the list of `files`, with the version of this program, into `out`.
fn write_list(out: &Path, files: BTreeSet<String>) -> Result<()> {
    let list = FileList { version: env!("CARGO_PKG_VERSION").into(), files };
    let text = serde_json::to_string_pretty(&list).expect("plain data") + "\n";
    write_atomically(&out.join(LIST), text.as_bytes())
}

/// Returns the names and texts of all documents: `report.tex` with one file per table, then `report.html`.
fn render_documents(page: &StudyPage) -> Result<Vec<(String, String)>> {
    let (mut documents, mut sections) = (Vec::new(), Vec::new());
    for section in &page.sections {
        let (mut printed, mut tables) = (Vec::new(), Vec::new());
        for table in &section.tables {
            let t = table_context(table, &mut printed);
            // Chosen columns replace the table in LaTeX only.
            let chosen = section.chosen.as_ref().filter(|chosen| chosen.name == table.name);
            let latex = chosen.map_or_else(|| t.clone(), |chosen| table_context(chosen, &mut Vec::new()));
            let context = context! { t => latex, setting => section.title.clone(), name => section.name.clone() };
            documents.push((format!("tables/{}-{}.tex", section.name, table.name), render("table.tex", context)?));
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
        documents.push((name.to_owned(), render(name, context.clone())?));
    }
    Ok(documents)
}

/// Returns the table for a template, with groups of neighbouring columns of one title and of lines of one kind. `fresh` are the
/// sentences of its legend that are not in `printed`, the legends of the tables above; they are added there.
fn table_context<'a>(table: &'a Table, printed: &mut Vec<&'a str>) -> Value {
    let fresh: Vec<&str> = table.legend.iter().map(String::as_str).filter(|s| !printed.contains(s)).collect();
    printed.extend(&fresh);
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

/// Formats the tables of every setting that fit a terminal, with warnings and notes; then the runs that are left out.
fn format_tables(page: &StudyPage) -> String {
    let mut out = String::new();
    for section in &page.sections {
        _ = writeln!(out, "{}", section.title);
        for table in section.tables.iter().filter(|t| ["ranks", "scores", "differences"].contains(&t.name)) {
            _ = write!(out, "\n{}\n{}", table.title, align_columns(&text_lines(table), 1));
            if table.name == "differences" {
                // The first sentences of the legend explain the method.
                let caveats = table.legend.get(2..).unwrap_or_default().join(" ");
                _ = writeln!(out, "[95 % interval], * excludes 0. {caveats}");
            } else if table.is_marked() {
                _ = writeln!(out, "* best, + second best");
            }
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

/// Formats a cell with deviation or interval and its mark, a blank if it has none; `n/a` without a number.
fn format_cell(shown: &FormattedValue) -> String {
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

/// Formats the lines of a table for [`align_columns`]: labels and cells below two header lines.
fn text_lines(table: &Table) -> Vec<Vec<String>> {
    let head =
        |text: fn(&TableColumn) -> String| [String::new()].into_iter().chain(table.columns.iter().map(text)).collect();
    let heads = [head(|c| format!("{} {} ", c.title, c.arrow)), head(|c| format!("{} ", c.detail))];
    let line =
        |line: &TableLine| [single_line(&line.label)].into_iter().chain(line.cells.iter().map(format_cell)).collect();
    heads.into_iter().chain(table.lines.iter().map(line)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::comparison::RowKind;
    use super::super::page::Section;
    use super::*;

    #[test]
    fn refuses_folder_that_is_not_a_report() {
        let folder = tempfile::tempdir().unwrap();
        read_list(folder.path()).unwrap();
        read_list(&folder.path().join("missing")).unwrap();
        std::fs::write(folder.path().join("thesis.tex"), "x").unwrap();
        let message = read_list(folder.path()).unwrap_err();
        assert!(message.is_input() && message.to_string().contains("`thesis.tex`"), "{message}");
        assert!(read_list(&folder.path().join("thesis.tex")).unwrap_err().is_input());
        write_list(folder.path(), BTreeSet::from(["report.csv".into()])).unwrap();
        read_list(folder.path()).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn refuses_to_write_or_remove_through_symlink() {
        let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let precious = elsewhere.path().join("1-old.svg");
        std::fs::write(&precious, "mine").unwrap();
        write_list(folder.path(), BTreeSet::from(["figures/1-old.svg".to_owned()])).unwrap();
        write_list(elsewhere.path(), BTreeSet::new()).unwrap();
        let study = Study { title: "none".into(), ..Study::default() };
        let write = |out: &Path| write(&study, &ReportOptions::default(), out, &mut pwrfgs_experiment::NoopObserver);
        let link_to = |name: &str| {
            let link = folder.path().join(name);
            std::os::unix::fs::symlink(elsewhere.path(), &link).unwrap();
            link
        };
        for link in [link_to("figures"), link_to("tables")] {
            let message = write(folder.path()).unwrap_err();
            assert!(
                message.is_input() && message.to_string().contains("symbolic link; reports are not written"),
                "{message}"
            );
            std::fs::remove_file(link).unwrap();
        }
        assert!(write(&link_to("report")).unwrap_err().is_input());
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "mine");
        // A link in place of a file is rejected if it is not listed; if it is listed, it is replaced and not followed.
        std::os::unix::fs::symlink(&precious, folder.path().join("report.csv")).unwrap();
        assert!(write(folder.path()).unwrap_err().to_string().contains("report.csv: not a file of the report"));
        write_list(folder.path(), BTreeSet::from(["report.csv".to_owned()])).unwrap();
        write(folder.path()).unwrap();
        assert!(!folder.path().join("report.csv").is_symlink());
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "mine");
    }

    #[test]
    fn rejects_file_list_with_foreign_paths() {
        for name in ["../../precious", "/etc/hosts", "tables/../../a.tex", "figures/x.gif", "notes.md"] {
            let folder = tempfile::tempdir().unwrap();
            write_list(folder.path(), BTreeSet::from([name.to_owned()])).unwrap();
            assert!(read_list(folder.path()).unwrap_err().is_input(), "{name}");
        }
        assert!(
            is_report_file("figures/1-ssim.svg")
                && is_report_file("tables/2-scores.tex")
                && is_report_file("report.csv")
        );
    }

    /// Returns a cell.
    fn shown(value: &str, deviation: &str, mark: RankMark) -> FormattedValue {
        FormattedValue { value: value.into(), deviation: deviation.into(), mark, ..FormattedValue::default() }
    }

    /// Returns the page of one section with one table.
    fn page(columns: Vec<TableColumn>, lines: Vec<TableLine>) -> StudyPage {
        let table = Table { name: "scores", title: "50 % of a_b".into(), columns, lines, legend: vec!["a<b".into()] };
        let title = "office (simulated)".to_owned();
        let section = Section { name: "1".into(), title, tables: vec![table], ..Section::default() };
        StudyPage { title: "a & b".into(), sections: vec![section], ..StudyPage::default() }
    }

    /// Returns the text of a document.
    fn document(page: &StudyPage, name: &str) -> String {
        render_documents(page).unwrap().into_iter().find(|(file, _)| file == name).unwrap().1
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
